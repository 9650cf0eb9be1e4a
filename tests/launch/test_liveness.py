"""A run is `running` while its launcher lives, and `killed` afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.errors import NotRunning
from mast_zenoh.launch import folder, liveness
from mast_zenoh.launch.interception import client
from mast_zenoh.report.narrative.circumstances import status
from mast_zenoh.report.runfolder import RunFolder

SAYS_WHO = (
    "from mast_zenoh.launch import liveness; import json; print(json.dumps(liveness.identity()), flush=True); input()"
)


@pytest.fixture
def other() -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Another process, and the identity that it reports."""
    import json

    command = [sys.executable, "-c", SAYS_WHO]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        yield process, json.loads(process.stdout.readline())
        process.kill()


def test_a_process_is_alive_until_killed_even_if_not_yet_reaped(other) -> None:
    process, identity = other
    assert liveness.lives(identity)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert liveness.lives(identity) is False


def test_a_later_process_with_the_same_pid_is_not_the_same(other) -> None:
    _, identity = other
    assert liveness.lives(identity | {"began": "1"}) is False


@pytest.mark.parametrize(
    ("elsewhere", "lives"),
    [({"machine": "another"}, None), ({"pid_namespace": "pid:[1]"}, None), ({"boot": "yesterday"}, False)],
)
def test_remote_processes_have_an_unknown_state_unless_their_machine_was_restarted(elsewhere, lives) -> None:
    assert liveness.lives(liveness.identity()) is True
    assert liveness.lives(liveness.identity() | elsewhere) is lives


@pytest.mark.parametrize("launcher", [None, {}, {"pid": "x"}, "someone", [1]])
def test_a_record_without_its_launcher_is_taken_at_face_value(launcher: object) -> None:
    assert liveness.seen_now({"status": "running", "launcher": launcher})["status"] == "running"


def test_an_ended_run_is_not_killed_when_its_launcher_is_gone() -> None:
    dead = liveness.identity() | {"began": "1"}
    assert liveness.seen_now({"status": "ok", "launcher": dead})["status"] == "ok"


def test_every_tool_reports_that_the_run_was_killed(tmp_path: Path) -> None:
    record = {"id": "a-1", "status": "running", "runtime": "mesh", "launcher": liveness.identity()}
    folder.write_json(tmp_path / "run.json", record)
    assert RunFolder.load(tmp_path).run["status"] == "running"
    folder.write_json(tmp_path / "run.json", record | {"launcher": liveness.identity() | {"began": "1"}})
    run = RunFolder.load(tmp_path)
    assert run.run["status"] == "killed"
    assert "cut off" in status(run)
    with pytest.raises(NotRunning, match="the run is over: killed"):
        client.release(tmp_path, name="x")
