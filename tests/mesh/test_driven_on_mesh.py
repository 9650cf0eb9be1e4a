"""A car that reacts, on the mesh: with a link, a fault and an adversary on its commands, equal to one process."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from equal_runs import assert_equal

from mast_zenoh import replay, scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = [pytest.mark.mesh, pytest.mark.heavy]
FRAMES = 24

ROUGH = """
from mast_zenoh.scenario import load


def scenario():
    _, driving = load("driving", ["attack=SeizedCommands", "attack_start_s=1.0", "n_infrastructure=1"])
    driving["scene"] |= dict(n_vehicles=6, n_bicycles=0, n_pedestrians=2)
    driving["keyexpr"]["rewrites"] += ["network_drivers.toml"]
    return driving | dict(
        name="rough",
        world=dict(take_over_s=0.4),
        links=dict(ego=dict(up=[dict(type="Loss", probability=0.3), dict(type="Delay", mean_s=0.15)])),
        faults=[dict(type="Partition", at=1.2, until=1.8, node="ego")],
    )
"""


def test_commands_that_are_attacked_lost_and_late_act_alike_everywhere_and_replay_to_the_last_byte(
    launch, tmp_path: Path
) -> None:
    file = tmp_path / "rough.py"
    file.write_text(ROUGH)
    run = launch(str(file), "--frames", str(FRAMES), "--seed", "3")
    assert "no new command" in run.ended()
    resolved = scenario.resolve(*scenario.load(str(file)), frames=FRAMES, seed=3, record=True)
    alone = launcher.run(resolved, tmp_path / "alone", runtime="inproc")
    assert alone.error is None
    assert_equal(run.out, alone.folder)
    again = launcher.run(replay.resolve(run.out, "simulator").resolved, tmp_path / "again", runtime="inproc")
    difference = compare(run.out, again.folder, taps=True)
    assert difference.first is None
    assert difference.equal > 0
    happened = [json.loads((folder / "metrics.json").read_text())["driven"] for folder in (run.out, again.folder)]
    assert happened[0] == happened[1]
