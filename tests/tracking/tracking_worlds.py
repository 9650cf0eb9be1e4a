"""Small worlds for trackers: moving objects and detections of them."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment
from tracked_objects import STEP_S, nanoseconds

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, ObjectStates
from mast_zenoh.tracking import Tracker

SIZE = {"car": (4.5, 1.8, 1.5), "pedestrian": (0.6, 0.6, 1.7), "bicycle": (1.8, 0.6, 1.7), "truck": (9.0, 2.5, 3.2)}

#: The position and heading of an object at a time in s: x, y (m), heading (rad).
Path = Callable[[float], tuple[float, float, float]]


def detected(xy: object, yaw: object = 0.0, kind: str = "car", covariance: np.ndarray | None = None) -> Detections:
    """Detections of one kind of objects at `xy` (n, 2) m with heading `yaw`."""
    xy = np.asarray(xy, float).reshape(-1, 2)
    n = len(xy)
    return Detections(
        position=np.column_stack([xy, np.full(n, SIZE[kind][2] / 2)]),
        size=np.tile(SIZE[kind], (n, 1)),
        yaw=np.broadcast_to(np.asarray(yaw, float), n).copy(),
        score=np.full(n, 0.9),
        class_id=np.full(n, CLASS_INDEX[kind], np.uint8),
        covariance=np.zeros((n, 3, 3)) if covariance is None else covariance,
    )


def joined(*parts: Detections) -> Detections:
    return Detections(*(np.concatenate([p.columns()[name] for p in parts]) for name in parts[0].columns()))


def straight(x: float, y: float, yaw: float, speed: float) -> Path:
    return lambda t: (x + speed * t * np.cos(yaw), y + speed * t * np.sin(yaw), yaw)


def turning(x: float, y: float, yaw: float, speed: float, radius: float, start_s: float) -> Path:
    """Straight until `start_s`, then a quarter turn to the left, then straight."""

    def path(t: float) -> tuple[float, float, float]:
        along = speed * min(t, start_s)
        px, py = x + along * np.cos(yaw), y + along * np.sin(yaw)
        arc = speed * max(t - start_s, 0.0)
        angle = min(arc / radius, np.pi / 2)
        px += radius * (np.sin(yaw + angle) - np.sin(yaw))
        py -= radius * (np.cos(yaw + angle) - np.cos(yaw))
        remaining = max(arc - radius * np.pi / 2, 0.0)
        return px + remaining * np.cos(yaw + angle), py + remaining * np.sin(yaw + angle), yaw + angle

    return path


def speeding_up(x: float, y: float, yaw: float, speed: float, change: float, period_s: float) -> Path:
    """Stop and go: `speed` on average, alternately `change` m/s more and less."""
    rate = 2 * np.pi / period_s

    def path(t: float) -> tuple[float, float, float]:
        along = speed * t + change / rate * (1 - np.cos(rate * t))
        return x + along * np.cos(yaw), y + along * np.sin(yaw), yaw

    return path


def changing_lanes(path: Path, at_s: float, width: float) -> Path:
    """`path`, shifted `width` m to the left from `at_s` in one step."""

    def shifted(t: float) -> tuple[float, float, float]:
        x, y, yaw = path(t)
        lateral = width if t >= at_s else 0.0
        return x - lateral * np.sin(yaw), y + lateral * np.cos(yaw), yaw

    return shifted


def watch(
    tracker: Tracker,
    objects: list[tuple[str, Path]],
    frames: int,
    random: np.random.Generator,
    *,
    probability: float = 0.9,
    noise_m: float = 0.3,
    yaw_noise: float = 0.06,
    flips: float = 0.05,
    clutter: float = 1.0,
    range_m: float = 80.0,
) -> dict[str, float]:
    """Tracking of noisy detections: misses, false tracks, id switches, error (m).

    The sensor is at the origin. Scored from the tenth frame on; an object counts while it has been in range for ten.
    """
    counts = {"fn": 0.0, "fp": 0.0, "switches": 0.0}
    squared: list[float] = []
    last: dict[int, int] = {}
    inside = np.zeros(len(objects), int)
    for frame in range(frames):
        pose = np.array([path(frame * STEP_S) for _, path in objects])
        near = np.hypot(pose[:, 0], pose[:, 1]) <= range_m
        inside = np.where(near, inside + 1, 0)
        seen = [detected(np.zeros((0, 2)))]
        for row in np.flatnonzero(near & (random.random(len(objects)) < probability)):
            yaw = pose[row, 2] + yaw_noise * random.normal() + np.pi * (random.random() < flips)
            seen.append(detected(pose[row, :2] + noise_m * random.normal(size=2), wrap_angle(yaw), objects[row][0]))
        for _ in range(random.poisson(clutter)):
            spot = range_m * np.sqrt(random.random()) * np.exp(1j * random.uniform(-np.pi, np.pi))
            seen.append(detected([spot.real, spot.imag], random.uniform(-np.pi, np.pi)))
        tracks = tracker.step(nanoseconds(frame), joined(*seen))
        if frame < 10:
            continue
        pairs = matched(pose[:, :2], tracks)
        counts["fn"] += np.sum((inside > 10) & ~np.isin(np.arange(len(objects)), [row for row, _ in pairs]))
        counts["fp"] += len(tracks) - len(pairs)
        for row, column in pairs:
            squared.append(float(np.sum((pose[row, :2] - tracks.position[column, :2]) ** 2)))
            counts["switches"] += last.get(row, tracks.id[column]) != tracks.id[column]
            last[row] = tracks.id[column]
    scored = frames - 10
    return {
        "fn": counts["fn"] / scored,
        "fp": counts["fp"] / scored,
        "switches": counts["switches"],
        "rmse_m": float(np.sqrt(np.mean(squared))),
    }


def matched(truth: np.ndarray, tracks: ObjectStates) -> list[tuple[int, int]]:
    """Pairs of truth (n, 2) and tracks within 2 m, by least total distance."""
    distance = np.linalg.norm(truth[:, None, :] - tracks.position[None, :, :2], axis=2)
    rows, columns = linear_sum_assignment(np.where(distance <= 2.0, distance, 1e6))
    return [(r, c) for r, c in zip(rows, columns, strict=True) if distance[r, c] <= 2.0]
