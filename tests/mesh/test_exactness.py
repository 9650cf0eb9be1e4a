"""Runs on the mesh are bitwise equal to one process, and their logs replay."""

import json
import sys
from pathlib import Path

import protocol_log
import pytest
from equal_runs import assert_equal, run_alone
from launched import Launched

from mast_zenoh.mesh.protocol_log import PROTOCOL_LOGS, difference
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.recording.reader import read

pytestmark = pytest.mark.mesh
FRAMES = 8


def on_mesh(launch, name: str, *settings: str) -> Path:
    """The run folder of a fully recorded run on the mesh."""
    words = [word for setting in settings for word in ("--set", setting)]
    run: Launched = launch(name, "--frames", str(FRAMES), *words)
    run.ended()
    assert run.record()["recorded"] == {"messages": len(list(read(run.out))), "malformed": 0, "lost": 0}
    return run.out


FAULTS = [
    dict(type="Partition", at=0.2, until=0.4, node="infra_1"),
    dict(type="Loss", at=0.1, node="ego", probability=0.4),
    dict(type="BandwidthLimit", at=0.0, nodes=["ego", "infra_3"], bits_per_s=300_000.0),
    dict(type="Delay", at=0.1, node="infra_2", mean_s=0.15, jitter_s=0.1),
]


def test_peers_with_links_faults_and_lies_are_the_same_on_the_mesh_and_in_one_process(launch, tmp_path: Path) -> None:
    lies = ("n_adversaries=1", "attack_start_s=0.2", "on=pair", "n_slanderers=1")
    what = ("peers", *lies, "relays=true", "gossip=true", f"faults={json.dumps(FAULTS)}")
    mesh = on_mesh(launch, *what)
    assert any(message.message == "link_report" for message in read(mesh))
    checks = read_json(mesh / "checks.json")["checks"]
    passed = {check["name"] for check in checks if check["ok"] and check["values"]["checked"]}
    assert passed >= {"processes", "sequences"}, checks
    assert_equal(mesh, run_alone(tmp_path / "inproc", *what, frames=FRAMES, record=True))


def check_replays(run: Launched) -> None:
    """Every node has a log, and its replay asks for the same actions and writes nothing into the run folder."""
    before = {path: path.stat().st_mtime_ns for path in run.out.rglob("*")}
    paths = sorted((run.out / PROTOCOL_LOGS).iterdir())
    assert {path.stem for path in paths} == run.record()["nodes"].keys()
    for path in paths:
        (log,) = protocol_log.logs_in(path)
        assert difference(log, protocol_log.replayed(run.out, log)) == "", path.stem
        assert log.steps[-1].call == "handle"
        assert {action[0] for step in log.steps for action in step.actions} >= {"control", "appear", "hand_in"}
    assert {path: path.stat().st_mtime_ns for path in run.out.rglob("*")} == before


def test_a_run_is_logged_on_request_and_each_log_replays_to_the_same_actions(launch, monkeypatch, capsys) -> None:
    run: Launched = launch("uncoordinated", "--set", "n_infrastructure=2", "--frames", "3", "--debug-protocol")
    run.ended()
    check_replays(run)
    monkeypatch.setattr(sys, "argv", ["protocol_log.py", str(run.out), "ego"])
    protocol_log.main()
    assert "steps are equal" in capsys.readouterr().out
    logs = [str(run.out / PROTOCOL_LOGS / f"{node}.msgpack") for node in ("infra_1", "infra_2")]
    monkeypatch.setattr(sys, "argv", ["protocol_log.py", *logs])
    with pytest.raises(SystemExit, match=r"1: \['subscribe', 'agent/infra_1/"):
        protocol_log.main()
