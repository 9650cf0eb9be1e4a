"""Reads optional files next to a recorded scene: detections, visibility, buildings.

See docs/scenes.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.carla.decode import class_of, reason, reject_constant

_DEFAULT_HEIGHT_M = 12.0  # of buildings


def read_detections(
    path: Path, frames: Sequence[int], agents: Sequence[int], sensor_rotation: Floats
) -> tuple[Detections, Ints, Ints]:
    """Detection columns of a recording, from `detections.jsonl`.

    The result is `detections`, `detection_start` and `detection_truth_id`.

    frames: F frame numbers; agents: A agent numbers; sensor_rotation: (F, A, 3, 3) active, sensor to world; needed for
    detections that have an attitude in the sensor's frame instead of a yaw
    """
    rows: dict[tuple[int, int], tuple[Detections, Ints]] = {}
    for place, frame, agent, data in _lines(path, frames, agents, "detections"):
        rotation = sensor_rotation[frame, agent]
        try:
            rows[frame, agent] = _detections(data, rotation)
        except (ValueError, KeyError, TypeError) as error:
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


def read_visibility(
    path: Path, frames: Sequence[int], agents: Sequence[int], ids: Ints, start: Ints
) -> NDArray[np.int32]:
    """(N, A) lidar returns of each truth row at each agent, from `visibility.jsonl`.

    ids (N,) and start (F + 1,): the truth rows. Objects that are not listed have no returns.
    """
    points = np.zeros((len(ids), len(agents)), np.int32)
    for place, frame, agent, data in _lines(path, frames, agents, "objects"):
        row = {int(i): k for k, i in enumerate(ids[start[frame] : start[frame + 1]], start=int(start[frame]))}
        try:
            for entry in data:
                if int(entry[0]) not in row:
                    raise ValueError(f"object {entry[0]} is not in the scene in this frame")
                if int(entry[1]) < 0:
                    raise ValueError(f"object {entry[0]} has {entry[1]} points, expected 0 or more")
                points[row[int(entry[0])], agent] = int(entry[1])
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise SceneError(f"{place}: {reason(error)}") from error
    return points


def read_buildings(path: Path, scene: Path | None) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (k, 2) m, and heights (B,) m, from `buildings.json`.

    The polygons are in the world frame. All have the height `building_height_m` of `scene.json`, by default 12 m.
    """
    data = _load(path)
    settings = _load(scene) if scene is not None else {}
    outlines = []
    try:
        height = float(settings.get("building_height_m", _DEFAULT_HEIGHT_M))
        for index, polygon in enumerate(data):
            outline = np.array(polygon, np.float64)
            if outline.ndim != 2 or outline.shape[1:] != (2,) or not np.isfinite(outline).all():
                raise ValueError(f"polygon {index}: expected [[x, y], ...], finite")
            if np.array_equal(outline[0], outline[-1]):
                outline = outline[:-1]
            if len(outline) < 3:
                raise ValueError(f"polygon {index} has {len(outline)} corners, expected at least 3")
            outlines.append(outline)
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error
    return tuple(outlines), np.full(len(outlines), height)


def _lines(
    path: Path, frames: Sequence[int], agents: Sequence[int], key: str
) -> Iterator[tuple[str, int, int, list[Any]]]:
    """Yield the list under `key` for the requested frames and agents.

    Each comes with its position in the file, frame row and agent row.
    Raises SceneError if a frame of an agent occurs twice or not at all.
    """
    frame_row = {frame: k for k, frame in enumerate(frames)}
    agent_row = {agent: k for k, agent in enumerate(agents)}
    line_numbers: dict[tuple[int, int], int] = {}
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                place = f"{path}: line {number}"
                try:
                    data = json.loads(line, parse_constant=reject_constant)
                    frame_agent = (int(data["frame"]), int(data["agent"]))
                    entries = data[key]
                    if not isinstance(entries, list):
                        raise ValueError(f"{key} is not a list")
                except (ValueError, KeyError, TypeError) as error:
                    raise SceneError(f"{place}: {reason(error)}") from error
                if frame_agent in line_numbers:
                    raise SceneError(
                        f"{place}: frame {frame_agent[0]} of agent {frame_agent[1]} "
                        f"is already in line {line_numbers[frame_agent]}"
                    )
                line_numbers[frame_agent] = number
                if frame_agent[0] in frame_row and frame_agent[1] in agent_row:
                    yield place, frame_row[frame_agent[0]], agent_row[frame_agent[1]], entries
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: {error}") from error
    for frame in frames:
        for agent in agents:
            if (frame, agent) not in line_numbers:
                raise SceneError(
                    f"{path}: no line for frame {frame}, agent {agent}; use an empty list if nothing was detected"
                )


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=reject_constant)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {error}") from error
