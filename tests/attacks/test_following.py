"""Targets follow their objects through misses, neighbours and reordering."""

import numpy as np
from attack_worlds import SECOND, at, world
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, canonical_order
from mast_zenoh.attacks.following import Follower

PERIOD = SECOND // 10
NO_ID = -1


def follow(frames: list[ObjectStates], position: tuple[float, float], radius: float = 6.0) -> list[int]:
    """The row in each frame of the target that starts at `position`; -1: missed."""
    follower, target, rows = Follower(radius), at(position), []
    for frame, objects in enumerate(frames):
        order = canonical_order(objects)
        follower.observe(objects.select(order), frame * PERIOD)
        target, row = follower.locate(target, 0.5)
        rows.append(int(order[row[0]]) if row[0] >= 0 else -1)
    return rows


def without_ids(*places: tuple[float, float]) -> ObjectStates:
    return at(*places, id=np.full(len(places), NO_ID))


def test_a_target_waits_while_its_object_is_missed_and_never_takes_a_neighbour():
    both, neighbour = without_ids((0.0, 0.0), (3.0, 0.0)), without_ids((3.0, 0.0))
    frames = [both] * 5 + [neighbour] * 20 + [both] * 3
    assert follow(frames, (0.0, 0.0)) == [0] * 5 + [-1] * 20 + [0] * 3


def test_without_neighbours_a_target_is_reattached_farther_away():
    moving = [without_ids((0.4 * k, 0.0)) for k in range(8)]
    frames = moving + [without_ids()] * 8 + [without_ids((0.4 * 16 + 1.0, 0.0))]
    assert follow(frames, (0.0, 0.0))[-1] == 0


def test_ids_resolve_ambiguous_positions():
    """Two pedestrians pass through each other."""
    frames = [at((0.1 * k, 0.0), (2.0 - 0.1 * k, 0.0), id=np.array([7, 8])) for k in range(20)]
    assert follow(frames, (0.0, 0.0)) == [0] * 20


def test_an_id_that_moves_to_another_object_is_not_followed():
    before = at((0.0, 0.0), (4.0, 0.0), id=np.array([7, 8]))
    id_moved = at((0.0, 0.0), (4.0, 0.0), id=np.array([9, 7]))
    assert follow([before] * 5 + [id_moved] * 5, (0.0, 0.0)) == [0] * 10


def test_a_lost_target_never_takes_an_object_that_was_distinct_from_it_before():
    """Whichever objects are missed, a target follows its own object or none."""
    rng = np.random.default_rng(3)
    start = np.array([[4.0 * k, 0.0] for k in range(8)])
    velocity = np.array([[5.0, 0.0]] * 8)
    for index in range(8):
        follower, target = Follower(6.0), at(tuple(start[index]))
        for frame in range(80):
            seen = rng.random(8) < 0.7 if frame else np.ones(8, bool)
            places = start + velocity * frame * 0.1 + (rng.normal(0.0, 0.2, (8, 2)) if frame else 0.0)
            rows = np.flatnonzero(seen)
            objects = without_ids(*map(tuple, places[rows]))
            order = canonical_order(objects)
            follower.observe(objects.select(order), frame * PERIOD)
            target, row = follower.locate(target, 0.5)
            if row[0] >= 0:
                assert rows[order[row[0]]] == index


@given(st.integers(0, 1000), st.booleans())
def test_targets_are_located_at_distinct_objects(seed, with_ids):
    rng = np.random.default_rng(seed)
    follower, objects = Follower(4.0), world(10, seed=seed, spread=8.0)
    targets = objects.select(slice(0, 4)).with_(id=np.arange(4))
    for frame in range(12):
        noisy = objects.with_(
            position=objects.position + rng.normal(0.0, 1.0, (10, 3)),
            velocity=np.zeros((10, 3)),
            id=objects.id if with_ids else np.full(10, NO_ID),
        )
        seen = noisy.select(np.flatnonzero(rng.random(10) < 0.6))
        seen = seen.select(canonical_order(seen))
        follower.observe(seen, frame * PERIOD)
        targets, row = follower.locate(targets, 2.0)
        located = row[row >= 0]
        assert len(set(located.tolist())) == len(located)


def test_a_target_that_followed_clutter_returns_to_the_coordinators_position():
    """Clutter leads the track of a stationary object away, and then disappears."""
    follower, rows = Follower(6.0), []
    drifting = [without_ids((0.4 * k, 0.0)) for k in range(10)]
    for frame, objects in enumerate([*drifting, *[without_ids()] * 5, *[without_ids((0.1, 0.0))] * 5]):
        follower.observe(objects, frame * PERIOD)
        _, row = follower.locate(at((0.0, 0.0)), 2.5)
        rows.append(int(row[0]))
    assert rows == [0] * 10 + [-1] * 5 + [0] * 5
