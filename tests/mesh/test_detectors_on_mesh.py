"""Detectors of points in processes: with an interpreter of their own, and when they crash or return rubbish."""

import json
import subprocess
import venv
from pathlib import Path

import numpy as np
import pytest
from launched import MAST, Launched, shared_packages

from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

FRAMES = 8
SCENARIO = '''
import os
import sys

import numpy as np

from mast_zenoh.arrays.states import Detections
from mast_zenoh.scenario import load
from mast_zenoh.sensing import PointDetector


class Told(PointDetector):
    """One object, whose score says in which environment it was detected."""

    def detect(self, points):
        score = 0.25 if sys.prefix.endswith("own-env") else 0.75
        return Detections(
            np.array([[10.0, 0, 0]]), np.ones((1, 3)), np.zeros(1), np.array([score]), np.zeros(1, np.uint8),
            np.eye(3)[None],
        )


class Crashing(Told):
    """Ends its process in the fourth scan."""

    scans = 0

    def detect(self, points):
        self.scans += 1
        if self.scans == 4:
            os._exit(3)
        return super().detect(points)


class Rubbish(PointDetector):
    def detect(self, points):
        return None


def scenario(detector="Told", python=""):
    _, base = load("baseline", ["n_infrastructure=1", "n_mobile=1"])
    node = dict(python=python) if python else {}
    points = dict(detector=dict(type=detector), lidar="VLP-16", clutter=None, node=node)
    return base | dict(name="detectors", points=points)
'''


@pytest.fixture
def file(tmp_path: Path) -> str:
    (tmp_path / "detectors.py").write_text(SCENARIO)
    return str(tmp_path / "detectors.py")


def scores(folder: Path) -> list[float]:
    """Of the detections of the ego, frame by frame; nan for none."""
    found = [
        codec.decode(each.payload, each.message).body for each in read(folder) if each.wire.endswith("/detections")
    ]
    return [float(body["score"][0]) if len(body["score"]) else np.nan for body in found]


def test_a_detector_runs_in_the_environment_of_its_own_interpreter(launch, file: str, tmp_path: Path) -> None:
    venv.create(tmp_path / "own-env", symlinks=True, with_pip=False)
    (site,) = (tmp_path / "own-env").glob("lib/python3*/site-packages")
    (site / "shared.pth").write_text(shared_packages())
    run: Launched = launch(file, "--set", "python=own-env/bin/python", "--frames", str(FRAMES))
    run.ended()
    assert set(scores(run.out)) == {0.25}
    nodes = json.loads((run.out / "scenario.json").read_text())["nodes"]
    python = {name: spec["python"] for name, spec in nodes.items() if "python" in spec}
    assert set(python.values()) == {str(tmp_path / "own-env/bin/python")}
    assert all(name.startswith("detector_") for name in python)


def test_a_detector_that_crashes_is_lost_by_name_and_its_agent_goes_on_without(launch, file: str) -> None:
    run: Launched = launch(file, "--set", "detector=Crashing", "--frames", str(FRAMES))
    output = run.ended(33)
    record = run.record()
    assert record["status"] == "node_lost"
    lost = {each["node"] for each in record["churn"]}
    assert "detector_ego" in lost
    assert all(name.startswith("detector_") for name in lost)
    assert record["nodes"]["detector_ego"]["ended"] == "exit code 3"
    assert "detector_ego was lost before frame" in output
    assert json.loads((run.out / "metrics.json").read_text())["frames"] == FRAMES
    tracks = [each.frame for each in read(run.out) if each.wire == "agent/ego/tracks"]
    assert sorted(tracks) == list(range(FRAMES - 1)), "its agent goes on when the next frame begins"
    subprocess.run([*MAST, "report", str(run.out)], check=True, capture_output=True)
    assert "detector_ego was lost" in (run.out / "report.html").read_text()


def test_a_detector_that_returns_rubbish_finds_nothing_and_fails_the_run_at_the_end(launch, file: str) -> None:
    run: Launched = launch(file, "--set", "detector=Rubbish", "--frames", str(FRAMES))
    output = run.ended(30)
    record = run.record()
    assert record["status"] == "handler_failures"
    (entry,) = record["nodes"]["detector_ego"]["failures"]
    assert (entry["handler"], entry["count"]) == ("detect", FRAMES)
    assert entry["exception"] == "ValueError: Rubbish.detect: returned NoneType, expected Detections"
    assert "detector_ego" in output
    assert np.isnan(scores(run.out)).all()


def test_in_real_time_a_run_goes_on_without_a_detector_that_crashed(launch, file: str) -> None:
    run: Launched = launch(file, "--set", "detector=Crashing", "--mode", "realtime", "--frames", "20")
    run.ended()
    record = run.record()
    assert record["status"] == "ok"
    assert "detector_ego" in {each["node"] for each in record["churn"]}
    assert record["nodes"]["detector_ego"]["ended"] == "exit code 3"
