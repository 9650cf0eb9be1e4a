"""Cars of SUMO's traffic that are driven, on the mesh: equal to one process, and replayed to the last byte."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
from equal_runs import assert_equal
from sumo_network import vehicle, write_network

from mast_zenoh import replay, scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = [
    pytest.mark.mesh,
    pytest.mark.heavy,
    pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed (pip install 'mast-zenoh[sumo]')"),
]
FRAMES = 30
#: Three cars that follow each other, and one that has to give way.
TRAFFIC = [
    vehicle("10", "eastward", 0, 430),
    vehicle("20", "northward", 0, 480),
    vehicle("11", "eastward", 2, 430),
    vehicle("12", "eastward", 4, 430),
]


def test_a_driven_run_on_sumo_is_the_same_on_the_mesh_in_one_process_and_replayed(
    launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_network(tmp_path, traffic="\n".join(TRAFFIC))
    monkeypatch.chdir(tmp_path)  # the path of the scene is relative, and nodes run elsewhere
    settings = ["scene=sumo:crossing.sumocfg", "cars=3", "n_infrastructure=1", "attack=SeizedCommands"]
    settings += ["attack_start_s=1.5", "scene.start_s=5", "scene.ego=11"]
    arguments = [part for setting in settings for part in ("--set", setting)]
    run = launch("driving", "--frames", str(FRAMES), "--seed", "3", *arguments)
    run.ended()
    resolved = scenario.resolve(*scenario.load("driving", settings), frames=FRAMES, seed=3, record=True)
    alone = launcher.run(resolved, tmp_path / "alone", runtime="inproc")
    assert alone.error is None
    assert_equal(run.out, alone.folder)
    driven = json.loads((alone.folder / "metrics.json").read_text())["driven"]
    assert sorted(driven) == ["ego", "mobile_1", "mobile_2"]
    assert driven["ego"]["hardest_braking_mps2"] > 5.0
    again = launcher.run(replay.resolve(run.out, "simulator").resolved, tmp_path / "again", runtime="inproc")
    difference = compare(run.out, again.folder, taps=True)
    assert difference.first is None
    assert difference.equal > 0
    assert json.loads((again.folder / "metrics.json").read_text())["driven"] == driven
