"""The reference scene: detections, fields of view and scoring.

It has its own reader, so that these tests depend only on tracking and fusion.
"""

import json
import os
import tarfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion, to_world, wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, ObjectStates, concatenate
from mast_zenoh.fusion.pipelines import Pipeline
from mast_zenoh.tracking import SensorView, Tracker

FIRST, LAST = 6, -10  # frames that are scored
RANGE_M = 100.0
GATE_M = 2.0


@dataclass
class Frames:
    """By frame: detections (world frame) and views, truth, and the ego's position."""

    time_ns: list = field(default_factory=list)
    detections: list = field(default_factory=list)
    view: list = field(default_factory=list)
    truth: list = field(default_factory=list)
    ego: list = field(default_factory=list)


@dataclass
class Score:
    fn: float
    fp: float
    rmse_m: float
    id_switches: int


def data_folder(name: str) -> Path:
    """A file or folder of the reference data; skips if it is missing."""
    root = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")
    if not (root / name).exists():
        pytest.skip(f"no reference data: {root / name} is missing (set MAST_DATA)")
    return root / name


def unpacked(folder: Path) -> Path:
    """The reference scene unpacked into `folder`; skips if it is missing."""
    with tarfile.open(data_folder("scene_a.tar.gz")) as tar:
        tar.extractall(folder, filter="data")
    return folder / "scene_a"


def read(folder: Path) -> Frames:
    poses = {(row["frame"], row["agent"]): row for row in _lines(folder / "agents.jsonl")}
    detections = {(row["frame"], row["agent"]): row["detections"] for row in _lines(folder / "detections.jsonl")}
    truth = json.loads((folder / "truth.json").read_text())
    frames, agents = sorted({key[0] for key in poses}), sorted({key[1] for key in poses})
    scene = Frames()
    for frame in frames:
        pose = [poses[frame, agent] for agent in agents]
        # The quaternions are passive: they turn world components into the lidar's.
        sensor = [(np.array(p["lidar_x"]), rotation_from_quaternion(np.array(p["q"])).T) for p in pose]
        scene.time_ns.append(round(poses[frame, 0]["t"] * 1e9))
        scene.detections.append(
            [_detections(detections[frame, agent], *sensor[row]) for row, agent in enumerate(agents)]
        )
        scene.view.append([_view(p["kind"] == "mobile", *s) for p, s in zip(pose, sensor, strict=True)])
        seen = [row for row in truth[str(frame)] if row[8]]
        scene.truth.append((np.array([row[0] for row in seen]), np.array([row[1:4] for row in seen])))
        scene.ego.append(np.array(poses[frame, 0]["x"]))
    return scene


def _lines(path: Path) -> list:
    return [json.loads(line) for line in path.read_text().splitlines()]


def _detections(rows: list, position: np.ndarray, rotation: np.ndarray) -> Detections:
    def column(*names: str) -> np.ndarray:
        return np.array([[row[name] for name in names] for row in rows], float).reshape(len(rows), len(names))

    return Detections(
        position=to_world(column("x", "y", "z"), position, rotation),
        size=column("l", "w", "h"),
        yaw=wrap_angle(column("yaw")[:, 0] + heading(rotation)),
        score=column("score")[:, 0],
        class_id=np.array([CLASS_INDEX[row["class"]] for row in rows], np.uint8),
        covariance=np.zeros((len(rows), 3, 3)),
    )


def _view(mobile: bool, position: np.ndarray, rotation: np.ndarray) -> SensorView:
    azimuth, low, high = (np.pi, -17.6, 2.4) if mobile else (np.pi / 4, -25.0, 30.0)
    return SensorView(position, rotation, -azimuth, azimuth, np.deg2rad(low), np.deg2rad(high), RANGE_M)


def run(
    scene: Frames, tracker: type[Tracker], pipeline: Pipeline, frames: int | None = None
) -> tuple[list[list[ObjectStates]], list[ObjectStates]]:
    """(per frame the tracks of each agent, per frame the picture)."""
    trackers = [tracker() for _ in scene.detections[0]]
    names = tuple(f"agent_{row}" for row in range(len(trackers)))
    tracks, pictures = [], []
    for frame, time_ns in enumerate(scene.time_ns[:frames]):
        inputs = zip(trackers, scene.detections[frame], scene.view[frame], strict=True)
        own = [one.step(time_ns, detections, view) for one, detections, view in inputs]
        agent = np.repeat(np.arange(len(own)), [len(states) for states in own])
        tracks.append(own)
        pictures.append(pipeline.step(time_ns, concatenate(own), agent, names)[0])
    return tracks, pictures


def score(scene: Frames, tracks: list[ObjectStates]) -> Score:
    """Means over scored frames; RMSE and id switches over all of them."""
    fn, fp, squared, switches = [], [], [], 0
    last: dict[int, int] = {}
    frames = list(zip(scene.truth, scene.ego, tracks, strict=True))[FIRST:LAST]
    for (ids, position), ego, estimate in frames:
        truth = _near(position, ego)
        in_range = _near(estimate.position, ego)
        distance = np.linalg.norm(position[truth, None, :2] - estimate.position[None, in_range, :2], axis=2)
        rows, columns = linear_sum_assignment(np.where(distance <= GATE_M, distance, 1e6))
        pairs = [(r, c) for r, c in zip(rows, columns, strict=True) if distance[r, c] <= GATE_M]
        fn.append(len(truth) - len(pairs))
        fp.append(len(in_range) - len(pairs))
        for r, c in pairs:
            squared.append(distance[r, c] ** 2)
            object_id, track_id = int(ids[truth[r]]), int(estimate.id[in_range[c]])
            switches += last.get(object_id, track_id) != track_id
            last[object_id] = track_id
    return Score(float(np.mean(fn)), float(np.mean(fp)), float(np.sqrt(np.mean(squared))), switches)


def _near(position: np.ndarray, ego: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.hypot(*(position[:, :2] - ego[:2]).T) <= RANGE_M)
