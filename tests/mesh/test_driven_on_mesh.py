"""Cars that react, on the mesh, also in SUMO's traffic: equal to one process, and replayed to the last byte."""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from equal_runs import assert_equal
from sumo_network import vehicle, write_network

from mast_zenoh import scenario
from mast_zenoh.launch import replay
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = [pytest.mark.mesh, pytest.mark.heavy]

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


def driven_alike(launch, folder: Path, name: str, frames: int, *settings: str) -> tuple[str, dict[str, Any]]:
    """Output of a run on the mesh, and what happened to its cars; in one process and replayed, the same happens."""
    words = [word for setting in settings for word in ("--set", setting)]
    run = launch(name, "--frames", str(frames), "--seed", "3", *words)
    output = run.ended()
    resolved = scenario.resolve(*scenario.load(name, settings), frames=frames, seed=3, record=True)
    alone = launcher.run(resolved, folder / "alone", runtime="inproc")
    assert alone.error is None
    assert_equal(run.out, alone.folder)
    again = launcher.run(replay.resolve(run.out, "simulator").resolved, folder / "again", runtime="inproc")
    difference = compare(run.out, again.folder, taps=True)
    assert difference.first is None
    assert difference.equal > 0
    driven, replayed = (json.loads((each / "metrics.json").read_text())["driven"] for each in (run.out, again.folder))
    assert driven == replayed
    return output, driven


def test_commands_that_are_attacked_lost_and_late_act_alike_everywhere(launch, tmp_path: Path) -> None:
    (tmp_path / "rough.py").write_text(ROUGH)
    output, _ = driven_alike(launch, tmp_path, str(tmp_path / "rough.py"), 24)
    assert "no new command" in output


@pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed (pip install 'mast-zenoh[sumo]')")
def test_a_driven_run_on_sumo_is_the_same_everywhere(launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three cars follow each other, and one has to give way."""
    eastward = [vehicle(f"1{k}", "eastward", 2 * k, 430) for k in range(3)]
    write_network(tmp_path, traffic="\n".join([*eastward[:1], vehicle("20", "northward", 0, 480), *eastward[1:]]))
    monkeypatch.chdir(tmp_path)  # the path of the scene is relative, and nodes run elsewhere
    settings = ("scene=sumo:crossing.sumocfg", "cars=3", "n_infrastructure=1", "attack=SeizedCommands")
    settings += ("attack_start_s=1.5", "scene.start_s=5", "scene.ego=11")
    _, driven = driven_alike(launch, tmp_path, "driving", 30, *settings)
    assert sorted(driven) == ["ego", "mobile_1", "mobile_2"]
    assert driven["ego"]["hardest_braking_mps2"] > 5.0
