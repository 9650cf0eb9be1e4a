"""A run is `running` as long as its launcher lives, and `killed` when it cannot end any more."""

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
    """Another process, and what it says that it is."""
    import json

    command = [sys.executable, "-c", SAYS_WHO]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        yield process, json.loads(process.stdout.readline())
        process.kill()


def test_a_process_lives_until_it_is_killed_also_if_nobody_has_collected_it(other) -> None:
    process, identity = other
    assert liveness.lives(identity)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert liveness.lives(identity) is False


def test_a_later_process_of_the_same_number_is_another(other) -> None:
    _, identity = other
    assert liveness.lives(identity | {"began": "1"}) is False


@pytest.mark.parametrize(
    ("elsewhere", "lives"),
    [({"machine": "another"}, None), ({"pid_namespace": "pid:[1]"}, None), ({"boot": "yesterday"}, False)],
)
def test_what_lives_elsewhere_cannot_be_told_but_nothing_outlives_its_machine(elsewhere, lives) -> None:
    assert liveness.lives(liveness.identity()) is True
    assert liveness.lives(liveness.identity() | elsewhere) is lives


@pytest.mark.parametrize("launcher", [None, {}, {"pid": "x"}, "someone", [1]])
def test_a_record_that_does_not_say_who_launched_it_is_taken_at_its_word(launcher: object) -> None:
    assert liveness.current_record({"status": "running", "launcher": launcher})["status"] == "running"


def test_a_run_that_has_ended_is_not_killed_when_its_launcher_has_gone() -> None:
    dead = liveness.identity() | {"began": "1"}
    assert liveness.current_record({"status": "ok", "launcher": dead})["status"] == "ok"


def test_every_tool_that_reads_the_folder_says_that_the_run_was_killed(tmp_path: Path) -> None:
    record = {"id": "a-1", "status": "running", "runtime": "mesh", "launcher": liveness.identity()}
    folder.write_json(tmp_path / "run.json", record)
    assert RunFolder.load(tmp_path).run["status"] == "running"
    folder.write_json(tmp_path / "run.json", record | {"launcher": liveness.identity() | {"began": "1"}})
    run = RunFolder.load(tmp_path)
    assert run.run["status"] == "killed"
    assert "cut off" in status(run)
    with pytest.raises(NotRunning, match="the run is over: killed"):
        client.release(tmp_path, name="x")
