"""Any scene with the detections of a user's own detector."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import Detections, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.detection_tables import class_of, read_kitti, read_parquet
from mast_zenoh.scenes.making.assembly import DetectionColumns
from mast_zenoh.scenes.recording import Recording


def lines_of_agents(
    path: Path, frames: Sequence[int], agents: Sequence[int] | Sequence[str], key: str
) -> Iterator[tuple[str, int, int, list[Any]]]:
    """Yield the list under `key` for the requested frames and agents.

    Each comes with its position in the file, frame row and agent row. agents: as they are called in the file.
    Raises SceneError if a frame of an agent occurs twice or not at all.
    """
    frame_row = {frame: k for k, frame in enumerate(frames)}
    agent_row = {agent: k for k, agent in enumerate(agents)}
    named = any(isinstance(agent, str) for agent in agents)
    line_numbers: dict[tuple[int, int | str], int] = {}
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                place = f"{path}: line {number}"
                try:
                    data = json.loads(line, parse_constant=reject_constant)
                    frame_agent = (int(data["frame"]), str(data["agent"]) if named else int(data["agent"]))
                    entries = data[key]
                    if not isinstance(entries, list):
                        raise ValueError(f"{key} is not a list")
                except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
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


def reject_constant(name: str) -> NoReturn:
    """Refuse a number that is not finite, for `json.loads(parse_constant=)`."""
    raise ValueError(f"{name} is not a finite number")


def reason(error: Exception) -> str:
    """Why decoding failed, in words."""
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


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
    flat = Detections.joined([part for part, _ in ordered])
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


class OwnDetections(Scene):
    """A scene whose detections come from files, see docs/scenes.md.

    scene:       where everything else comes from
    path:        a .jsonl or .parquet file, or a folder with a text file for each agent (KITTI, AB3DMOT)
    first_frame: number of the scene's first frame in the files

    Each agent has one sensor, its first, which measures at the times of the frames.
    In a scenario, `detections` of any scene makes one: dict(type="AV2Log", path=…, detections=PATH).
    """

    def __init__(self, *, scene: Scene, path: str, first_frame: int = 0) -> None:
        self.scene = scene
        self.path = Path(path)
        self.first_frame = first_frame

    def inputs(self) -> Sequence[Path]:
        """The scene's inputs and the detections."""
        return (*self.scene.inputs(), self.path)

    def record(self, seed: int, frames: int | None) -> Recording:
        recording = self.scene.record(seed, frames)
        detections, start, truth_id = self._read(recording, shortened=frames is not None)
        agents = tuple(replace(agent, sensors=()) for agent in recording.agents)
        complete = replace(
            recording,
            agents=agents,
            detections=detections,
            detection_start=start,
            detection_truth_id=truth_id,
            measurements=None,
        )
        complete.validate()
        return complete

    def _read(self, recording: Recording, shortened: bool) -> DetectionColumns:
        """The detections of the recorded frames; later ones are an error unless the recording is shortened."""
        names, count = recording.agent_names, len(recording)
        if self.path.suffix == ".jsonl":
            mounts = np.stack([agent.sensor.mount_rotation for agent in recording.agents])
            numbers = range(self.first_frame, self.first_frame + count)
            return read_json_lines(self.path, numbers, names, recording.agent_rotation @ mounts)
        if self.path.suffix == ".parquet":
            rows = read_parquet(self.path, names, self.first_frame)
        elif self.path.is_dir():
            rows = read_kitti(self.path, names, self.first_frame)
        else:
            raise SceneError(f"{self.path}: found no such folder, expected a folder, a .jsonl or a .parquet file")
        return (rows.before(count) if shortened else rows).columns(count, len(names), self.path)
