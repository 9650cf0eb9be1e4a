"""Detections in a file of JSON lines: one line for each frame of each agent, see docs/scenes.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.class_names import class_of
from mast_zenoh.scenes.files.json_lines import lines_of_agents, reason
from mast_zenoh.scenes.making.assembly import DetectionColumns


def read_json_lines(
    path: Path, frames: Sequence[int], agents: Sequence[int] | Sequence[str], sensor_rotation: Floats
) -> DetectionColumns:
    """The detections of a recording, in the order of the file.

    frames: F frame numbers, and agents: A agents, as they are called in the file
    sensor_rotation: (F, A, 3, 3) active, sensor to world; needed for detections that have an attitude in the sensor's
    frame instead of a yaw

    Raises SceneError with the line.
    """
    rows: dict[tuple[int, int], tuple[Detections, Ints]] = {}
    for place, frame, agent, data in lines_of_agents(path, frames, agents, "detections"):
        rotation = sensor_rotation[frame, agent]
        try:
            rows[frame, agent] = _detections(data, rotation)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise SceneError(f"{place}: {reason(error)}") from error
    ordered = [rows[frame, agent] for frame in range(len(frames)) for agent in range(len(agents))]
    flat = Detections(*(np.concatenate([getattr(part, name) for part, _ in ordered]) for name in DETECTION_COLUMNS))
    ids = np.concatenate([truth_id for _, truth_id in ordered])
    return flat, np.cumsum([0, *(len(part) for part, _ in ordered)]), ids


def _detections(data: Sequence[Mapping[str, Any]], sensor_rotation: Floats) -> tuple[Detections, Ints]:
    n = len(data)
    numbers = np.array([[float(d[key]) for key in ("x", "y", "z", "l", "w", "h")] for d in data]).reshape(n, 6)
    yaw = np.array([float(d["yaw"]) if "yaw" in d else _yaw(d["q"], sensor_rotation) for d in data])
    score = np.array([float(d.get("score", 1.0)) for d in data])
    covariance = np.array([d.get("covariance", np.zeros((3, 3))) for d in data], np.float64).reshape(n, 3, 3)
    for name, values in (("x, y, z, l, w, h", numbers), ("yaw", yaw), ("covariance", covariance)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} contains a number that is not finite")
    if n and numbers[:, 3:].min() <= 0:
        raise ValueError("l, w, h: expected more than 0")
    if n and (score.min() < 0 or score.max() > 1):
        raise ValueError("score: expected 0 to 1")
    classes = np.array([class_of(str(d.get("class", "unknown"))) for d in data], np.uint8)
    truth_id = np.array([int(d.get("gt", -1)) for d in data], np.int64)
    return Detections(numbers[:, :3], numbers[:, 3:], yaw, score, classes, covariance), truth_id


def _yaw(q: Sequence[float], sensor_rotation: Floats) -> float:
    """Yaw about the world's vertical minus the sensor's.

    q: passive attitude (w, x, y, z) in the sensor's frame
    """
    if len(q) != 4:
        raise ValueError(f"q has {len(q)} numbers, expected 4")
    rotation = sensor_rotation @ rotation_from_quaternion(np.array(q, np.float64) * [1.0, -1.0, -1.0, -1.0])
    return float(heading(rotation) - heading(sensor_rotation))
