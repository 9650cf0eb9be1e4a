"""Reproducible objects, detections and estimates of any number, for checks."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Detections, Floats, ObjectStates
from mast_zenoh.metrics.causes import CAUSES
from mast_zenoh.metrics.scoring import Estimate

#: Numbers of objects that a class must handle.
COUNTS = (0, 1, 1000)
PERIOD_NS = 100_000_000


def positions(n: int, frame: int, seed: int = 0) -> tuple[Floats, Floats]:
    """(n, 3) m and (n, 3) m/s: objects of constant velocity on a grid, in a frame."""
    random = np.random.default_rng(seed)
    grid = np.stack(np.divmod(np.arange(n), 40), axis=1) * 12.0 - 20.0
    velocity = np.column_stack([random.uniform(-8.0, 8.0, (n, 2)), np.zeros(n)])
    start = np.column_stack([grid + random.uniform(-1.0, 1.0, (n, 2)), np.full(n, 0.8)])
    return start + velocity * (frame * PERIOD_NS * 1e-9), velocity


def states(n: int, frame: int = 0, *, noise_m: float = 0.1, source: int = 0) -> ObjectStates:
    """n cars in a frame, as one source reports them, with ids from 0."""
    random = np.random.default_rng([n, frame, source])
    position, velocity = positions(n, frame)
    variance = [0.04] * 3 + [0.02] * 3 + [0.5] * 3
    return ObjectStates.of(
        position + random.normal(0.0, noise_m, (n, 3)),
        id=np.arange(n),
        velocity=velocity + random.normal(0.0, 0.3, (n, 3)),
        size=np.tile([4.5, 1.8, 1.5], (n, 1)) + random.normal(0.0, 0.05, (n, 3)),
        yaw=np.arctan2(velocity[:, 1], velocity[:, 0]),
        covariance=np.tile(np.diag(variance), (n, 1, 1)) * random.uniform(0.8, 1.2, (n, 1, 1)),
        score=random.uniform(0.6, 0.99, n),
        class_id=np.full(n, CLASS_INDEX["car"], np.uint8),
    )


def detections(n: int, frame: int = 0) -> Detections:
    """n detections of cars in the world frame, in a frame."""
    objects = states(n, frame, noise_m=0.2)
    return Detections(
        objects.position,
        objects.size,
        objects.yaw,
        objects.score,
        objects.class_id,
        objects.covariance[:, :3, :3].copy(),
    )


def estimate(n: int, frames: int = 20) -> Estimate:
    """n boxes over a run: matched and missed objects, matched and false tracks."""
    random = np.random.default_rng(n)
    is_track = np.arange(n) % 2 == 1
    outcome = np.where(np.arange(n) % 4 < 2, "matched", np.where(is_track, "false", "missed"))
    return Estimate(
        agent="ego",
        estimator="picture",
        frames=np.arange(frames),
        period_s=0.1,
        scored=np.arange(frames) >= min(5, frames),
        frame=np.sort(random.integers(0, max(frames, 1), n)),
        is_track=is_track,
        outcome=outcome,
        id=np.arange(n) // 2,
        match_id=np.where(outcome == "matched", np.arange(n) // 2, -1),
        position=random.uniform(-60.0, 60.0, (n, 3)),
        size=np.tile([4.5, 1.8, 1.5], (n, 1)),
        yaw=random.uniform(-np.pi, np.pi, n),
        score=np.where(is_track, random.uniform(0.0, 1.0, n), np.nan),
        range_m=random.uniform(0.0, 100.0, n),
        cause=np.where(outcome == "matched", "", next(iter(CAUSES))),
    )
