"""Tracks of cars for tests of tracking and fusion, a command centre, and comparisons of states."""

from typing import Any

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, ObjectStates
from mast_zenoh.fusion import (
    CovarianceIntersectionFusion,
    GroupTracker,
    GroupTrackerWrapper,
    SampledAssignmentClusterer,
)
from mast_zenoh.fusion.pipelines import CommandCenterPipeline
from mast_zenoh.tracking import KalmanBoxTracker3D

STEP_S = 0.1
#: Variances of a track that is a second old, in the order of the state.
MATURE = np.diag([0.05, 0.05, 0.02, 0.05, 0.05, 0.05, 0.6, 0.6, 0.05])
#: What no covariance is, although a message may say so.
INVALID_COVARIANCES = {
    "none": np.zeros((9, 9)),
    "negative": -np.eye(9),
    "huge": np.full((9, 9), 1e300),
    "not symmetric": np.triu(np.full((9, 9), 5.0)),
    "tiny": np.diag([1e-300] * 9),
}


def nanoseconds(frame: int) -> int:
    return frame * round(STEP_S * 1e9)


def cars(
    position: Any, velocity: Any = 0.0, covariance: np.ndarray = MATURE, kind: str = "car", **columns: Any
) -> ObjectStates:
    """Tracks at (n, 2) or (n, 3) m with velocities that are broadcast to (n, 2) m/s, headed along them."""
    position = np.asarray(position, float)
    position = position.reshape(-1, position.shape[-1])
    n = len(position)
    if position.shape[1] == 2:
        position = np.column_stack([position, np.full(n, 0.8)])
    velocity = np.broadcast_to(velocity, (n, 2))
    given = dict(
        velocity=np.column_stack([velocity, np.zeros(n)]),
        size=np.tile([4.5, 1.8, 1.5], (n, 1)),
        yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
        covariance=np.broadcast_to(covariance, (n, 9, 9)).copy(),
        score=np.full(n, 0.99),
        class_id=np.full(n, CLASS_INDEX[kind], np.uint8),
    )
    return ObjectStates.of(position, **(given | columns))


def centre(group: GroupTracker | None = None, id_memory_s: float = 4.0, **stages: Any) -> CommandCenterPipeline:
    fusion = CovarianceIntersectionFusion()
    tracker = group or GroupTrackerWrapper(fusion=fusion, tracker=KalmanBoxTracker3D(), id_memory_s=id_memory_s)
    return CommandCenterPipeline(clustering=SampledAssignmentClusterer(), group_tracking=tracker, **stages)


def assert_same_bits(one: ObjectStates, other: ObjectStates) -> None:
    for name, column in one.columns().items():
        assert column.tobytes() == other.columns()[name].tobytes(), name


def assert_close(one: ObjectStates, other: ObjectStates) -> None:
    np.testing.assert_array_equal(one.id, other.id)
    for name in ("position", "velocity", "size", "yaw", "covariance", "score"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=1e-9)
