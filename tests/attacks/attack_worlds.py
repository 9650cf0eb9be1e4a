"""Small worlds of objects for the tests of attacks."""

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.surroundings import UNKNOWN, Coverage, unlimited


def world(n: int, seed: int = 0, spread: float = 25.0) -> ObjectStates:
    """n cars around the origin with the attributes that a tracker gives them."""
    rng = np.random.default_rng(seed)
    position = np.column_stack([rng.normal(0.0, spread, (n, 2)), np.full(n, 0.75)])
    velocity = np.column_stack([rng.normal(0.0, 8.0, (n, 2)), np.zeros(n)])
    return ObjectStates.of(
        position,
        id=rng.permutation(100)[:n],
        velocity=velocity,
        size=np.tile([4.5, 1.8, 1.5], (n, 1)),
        yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
        covariance=np.eye(9) * rng.uniform(0.1, 1.0, n)[:, None, None],
        score=rng.uniform(0.6, 1.0, n),
        class_id=np.full(n, 1, np.uint8),
    )


def at(*positions: tuple[float, float], **columns: Floats | Ints) -> ObjectStates:
    """Objects at these bird's-eye positions, 0.75 m above the ground."""
    position = np.array([[x, y, 0.75] for x, y in positions]).reshape(-1, 3)
    return ObjectStates.of(position, size=np.tile([4.5, 1.8, 1.5], (len(position), 1)), **columns)


def equal(a: ObjectStates, b: ObjectStates) -> bool:
    """Whether two sets of states are bitwise equal."""
    return all(np.array_equal(column, b.columns()[name]) for name, column in a.columns().items())


ORIGIN = np.zeros(3)
SECOND = 1_000_000_000


def coverage_of(position: Floats, time_s: float = 0.0) -> Coverage:
    """Coverage of victims at (3,) or (a, 3) m with unknown sensors and surroundings."""
    return Coverage(UNKNOWN, tuple(map(unlimited, np.atleast_2d(position))), time_s)
