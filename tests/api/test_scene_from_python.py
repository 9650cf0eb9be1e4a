"""`mast.scene` gives what a run with the same seed plays, without a run."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, SceneError

FRAMES = 5
SCENARIO = """
from mast_zenoh.scenario import load

def scenario(n_infrastructure=2):
    return load("baseline", [f"n_infrastructure={n_infrastructure}"])[1] | dict(run=dict(seed=4))
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "mine.py"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def run(file: Path) -> mast.Run:
    return mast.run(file, frames=FRAMES, seed=3, out=file.parent / "run")


def test_truth_poses_and_detections_equal_those_in_a_run(file: Path, run: mast.Run) -> None:
    scene = mast.scene(file, seed=3, frames=FRAMES)
    assert scene.agents == run.agents
    assert len(scene) == FRAMES
    assert scene.truth.equals(run.truth, check_metadata=True)
    for name in scene.agents:
        ours, of_run = scene.agent(name), run.agent(name)
        assert ours.pose.equals(of_run.pose)
        detections = ours.detections
        known = {-1, *scene.truth["id"].to_pylist()}
        assert set(detections["truth_id"].to_pylist()) <= known
        assert detections.drop_columns(["truth_id"]).equals(of_run.detections)
        assert repr(ours) == f"<Agent {name} of {scene.name}: pose, detections>"


def test_the_scene_of_a_run_folder_is_read(run: mast.Run) -> None:
    scene = mast.scene(run.path / "scene.npz")
    assert scene.truth.slice(0, run.truth.num_rows).equals(run.truth)
    assert repr(scene).startswith("<Scene intersection-0: ")
    with pytest.raises(ConfigurationError, match=r"scene.npz.*recorded already"):
        mast.scene(run.path / "scene.npz", seed=3)
    with pytest.raises(SceneError):
        mast.scene(run.path / "nosuch.npz")


def test_a_scene_is_given_by_name_or_by_dict(file: Path) -> None:
    named = mast.scene("intersection", frames=2, n_infrastructure=1)
    assert named.agents == ("ego", "infra_1")
    assert named.truth.equals(mast.scene(dict(type="Intersection", n_infrastructure=1), seed=0, frames=2).truth)
    assert not named.truth.equals(mast.scene("intersection", seed=1, frames=2, n_infrastructure=1).truth)
    assert isinstance(mast.scene(frames=1).truth, pyarrow.Table)
    assert np.all(mast.scene(frames=1).recording.points >= 0)


@pytest.mark.parametrize(
    ("scene", "parameters", "message"),
    [
        ("intersectoin", {}, r"unknown.*'intersectoin'.*'intersection'"),
        ("intersection", dict(n_infrastructur=1), r"Intersection.*parameter 'n_infrastructur'"),
        (dict(type="Nowhere"), {}, "Scene named 'Nowhere'"),
        ("nosuch.py", {}, r"nosuch.py: no.*file"),
    ],
)
def test_anything_but_a_scene_is_refused(scene: Any, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        mast.scene(scene, **parameters)
    with pytest.raises(ConfigurationError, match=r"intersection-0.*'eg'.*'ego'"):
        mast.scene(frames=1).agent("eg")
