"""`mast run --debug-protocol`: each process on the mesh writes a log that replays to the same actions."""

from __future__ import annotations

import sys

import protocol_log
import pytest
from launched import Launched

from mast_zenoh.runtime.protocol_log import PROTOCOL_LOGS, difference

pytestmark = pytest.mark.mesh


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


def test_a_run_is_logged_on_request_and_each_log_replays_to_the_same_actions(
    launch, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: Launched = launch("uncoordinated", "--frames", "3", "--debug-protocol")
    run.ended()
    check_replays(run)
    monkeypatch.setattr(sys, "argv", ["protocol_log.py", str(run.out), "ego"])
    protocol_log.main()
    assert "steps are equal" in capsys.readouterr().out
    logs = [str(run.out / PROTOCOL_LOGS / f"{node}.msgpack") for node in ("infra_1", "infra_2")]
    monkeypatch.setattr(sys, "argv", ["protocol_log.py", *logs])
    with pytest.raises(SystemExit, match=r"process 0:\nstep 0: action 1: \['subscribe', 'agent/infra_1/"):
        protocol_log.main()


@pytest.mark.heavy
@pytest.mark.parametrize(
    "words", [("--secure", "acl"), ("--mode", "realtime", "--rate", "4")], ids=["secure", "real time"]
)
def test_signed_and_delayed_messages_are_replayed_too(launch, words: tuple[str, ...]) -> None:
    run: Launched = launch("realistic_network", "--frames", "20", "--debug-protocol", *words)
    run.ended()
    check_replays(run)
