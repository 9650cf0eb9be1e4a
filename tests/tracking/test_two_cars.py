"""Two cars with a realistic detector in a recorded log: from KITTI text to a scored picture, by documented commands."""

import json
import re
import shlex
import subprocess
import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ab3dmot_reference import Ab3dmot, Matching, merged
from mast_datasets import AV2Log
from reference_scene import FIRST, LAST, RANGE_M, Frames, data_folder, score

from mast_zenoh.arrays.states import Detections
from mast_zenoh.scenes import OwnDetections, Recording
from mast_zenoh.sensing import sensor_pose, to_world

pytestmark = pytest.mark.heavy

LOG = "3bffdcff-c3a7-38b6-a0f2-64196d130958"
PAGE = Path(__file__).parents[2] / "docs" / "ref-detections-and-arrays.md"
#: Of the reference: how detections are matched with tracks, when two cars' detections are one, and the least score.
MATCHINGS = Matching(overlap=0.01), Matching(distance_m=1.0), Matching(distance_m=2.0)
SAME = Matching(overlap=0.1), Matching(distance_m=1.5)
LEAST_SCORES = 0.0, 0.3, 0.4, 0.5


@pytest.fixture(scope="module")
def log() -> Path:
    return data_folder("av2_logs") / LOG


@pytest.fixture(scope="module")
def folder(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the commands of the page were run: detections in `cars`, the run in `two_cars`."""
    folder = tmp_path_factory.mktemp("two_cars")
    section = PAGE.read_text(encoding="utf-8").partition("## Two cars in a recorded log")[2].partition("\n## ")[0]
    commands = re.findall(r"^    mast (.*)$", section, flags=re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["scene", "run"]
    for command in commands:
        words = shlex.split(command.replace("LOG", str(log)))
        subprocess.run([sys.executable, "-m", "mast_zenoh", *words], cwd=folder, check=True, timeout=300)
    return folder


@pytest.fixture(scope="module")
def picture(folder: Path) -> dict:
    numbers: dict = json.loads((folder / "two_cars" / "metrics.json").read_text())["agents"]["ego"]["picture"]
    return numbers


def test_precision_and_recall_are_085_without_tuning(picture: dict) -> None:
    assert picture["precision"] >= 0.85
    assert picture["recall"] >= 0.85
    assert picture["mota"] >= 0.80


def test_the_picture_is_better_than_ab3dmot_with_its_best_settings(log: Path, folder: Path, picture: dict) -> None:
    scene = AV2Log(path=str(log), n_infrastructure=0, n_mobile=1)
    recording = OwnDetections(scene=scene, path=str(folder / "cars")).record(0, None)
    frames = frames_of(recording)
    best = max(
        mota(frames, reference(frames, matching, same, least_score))
        for matching, same, least_score in product(MATCHINGS, SAME, LEAST_SCORES)
    )
    assert best > 0.7
    assert picture["mota"] > best


def frames_of(recording: Recording) -> Frames:
    frames = Frames()
    for frame in range(len(recording)):
        frames.time_ns.append(int(recording.times_ns[frame]))
        frames.detections.append([world_detections(recording, frame, row) for row in range(len(recording.agents))])
        truth, seen = recording.truth_at(frame), (recording.points_at(frame) >= 5).any(axis=1)
        frames.truth.append((truth.id[seen], truth.position[seen]))
        frames.ego.append(recording.agent_position[frame, 0])
    return frames


def world_detections(recording: Recording, frame: int, row: int) -> Detections:
    sensor = recording.agents[row].sensor
    pose = recording.agent_position[frame, row], recording.agent_rotation[frame, row]
    return to_world(
        recording.detections_at(frame, row), *sensor_pose(*pose, sensor.mount_position, sensor.mount_rotation)
    )


def reference(frames: Frames, matching: Matching, same: Matching, least_score: float) -> list:
    """Tracks of AB3DMOT by frame, from the merged detections of both cars."""
    tracker, tracks = Ab3dmot(matching), []
    for detections in frames.detections:
        ids, boxes = tracker.step(merged(detections, same, least_score))
        tracks.append(SimpleNamespace(id=ids, position=boxes[:, :3]))
    return tracks


def mota(frames: Frames, tracks: list) -> float:
    numbers = score(frames, tracks)
    near = [
        np.hypot(*(position - ego)[:, :2].T) <= RANGE_M
        for (_, position), ego in zip(frames.truth, frames.ego, strict=True)
    ]
    objects = np.mean([mask.sum() for mask in near[FIRST:LAST]])
    return 1.0 - (numbers.fn + numbers.fp + numbers.id_switches / len(near[FIRST:LAST])) / objects
