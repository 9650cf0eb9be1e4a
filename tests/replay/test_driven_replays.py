"""Replays of driven runs tell the causes of brakes as the run does, or that they are unknown."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from driven import driven

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import measurement, replay
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.replay.cut import Place

FRAMES = 30
GHOSTS = ("attack=GhostAhead", "attack_start_s=1.0")


def consequences(folder: Path) -> dict[str, Any]:
    """What happened to the ego."""
    return json.loads((folder / "metrics.json").read_text())["driven"]["ego"]


def replayed(folder: Path, out: Path, place: Place, *settings: str) -> Path:
    again = launcher.run(replay.resolve(folder, place, settings=settings).resolved, out, runtime="inproc")
    assert again.error is None
    return again.folder


def kinds(folder: Path) -> list[str]:
    return [brake["cause"]["kind"] for brake in consequences(folder)["brakes"]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose ego brakes for ghosts in its mission estimate."""
    ended = launcher.run(
        driven(*GHOSTS, frames=FRAMES, record=True), tmp_path_factory.mktemp("driven") / "run", runtime="inproc"
    )
    assert ended.error is None
    causes = [brake["cause"] for brake in consequences(ended.folder)["brakes"]]
    assert {"false"} == {cause["kind"] for cause in causes}
    assert {"adversary_1"} == {cause["adversary"] for cause in causes}
    return ended.folder


def test_a_replay_with_live_agents_tells_the_causes_of_the_run_also_measured_and_replayed_again(
    run: Path, tmp_path: Path
) -> None:
    expected = consequences(run)
    once = replayed(run, tmp_path / "once", "simulator")
    assert consequences(once) == expected
    assert consequences(replayed(once, tmp_path / "twice", "simulator")) == expected
    measurement.measure(once)
    assert consequences(once) == expected


def test_without_the_estimate_that_the_driver_received_a_cause_is_unknown(run: Path, tmp_path: Path) -> None:
    expected = consequences(run)
    unknown = {"object": None, "kind": "unknown", "adversary": None}
    folder = replayed(run, tmp_path / "agents", "agents")
    expected["brakes"] = [brake | {"cause": unknown} for brake in expected["brakes"]]
    expected["blind_frames"] = None
    assert consequences(folder) == expected
    assert consequences(replayed(folder, tmp_path / "again", "agents")) == expected


@pytest.mark.parametrize("damaged", [7, {"ego": 7}, {"ego": [["mission"]]}, {"ego": [[1, 2]]}])
def test_damaged_settings_of_played_drivers_are_refused(damaged: Any, run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(run, folder)
    scenario = json.loads((folder / "scenario.json").read_text())
    scenario["nodes"]["evaluator"]["config"]["played_drivers"] = damaged
    (folder / "scenario.json").write_text(json.dumps(scenario))
    with pytest.raises(ConfigurationError, match="played_drivers"):
        replay.resolve(folder, "simulator")


def test_a_changed_command_centre_does_not_change_what_the_recorded_driver_received(run: Path, tmp_path: Path) -> None:
    radius = "command_center.pipeline.clustering.assign_radius=4.0"
    assert {*kinds(replayed(run, tmp_path / "changed", "simulator", radius))} == {"unknown"}
    assert kinds(replayed(run, tmp_path / "scored", "simulator", "evaluator.skip_last=5")) == kinds(run)


@pytest.mark.parametrize(
    "settings",
    [
        ("estimate=truth", "attack=SeizedCommands", "attack_start_s=1.0"),
        ("estimate=safety", *GHOSTS, "wire=detections"),
    ],
    ids=["seized", "own tracks"],
)
def test_a_replay_that_leaves_out_nothing_of_the_driver_is_equal(settings: tuple[str, ...], tmp_path: Path) -> None:
    ended = launcher.run(driven(*settings, frames=FRAMES, record=True), tmp_path / "run", runtime="inproc")
    expected = consequences(ended.folder)
    assert {brake["cause"]["adversary"] for brake in expected["brakes"]} == {"adversary_1"}
    assert consequences(replayed(ended.folder, tmp_path / "agents", "agents")) == expected
    assert consequences(replayed(ended.folder, tmp_path / "simulator", "simulator")) == expected
