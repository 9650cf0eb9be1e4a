"""A run is `running` while its launcher lives, and `killed` afterwards."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import run_folder
from mast_zenoh.errors import NotRunning
from mast_zenoh.launch import live_interception, liveness
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.results import status

SAYS_WHO = (
    "from mast_zenoh.launch import liveness; import json; print(json.dumps(liveness.identity()), flush=True); input()"
)


@pytest.fixture
def other() -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Another process, and the identity that it reports."""
    import json

    command = [sys.executable, "-c", SAYS_WHO]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process, json.loads(process.stdout.readline())
        process.kill()


def test_a_zombie_process_counts_as_dead_and_a_later_one_with_the_same_id_is_another(other) -> None:
    process, identity = other
    assert liveness.lives(identity)
    assert liveness.lives(identity | {"began": "1"}) is False
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert liveness.lives(identity) is False


def test_a_finished_run_and_a_record_without_a_launcher_keep_their_status() -> None:
    for launcher in (None, {}, {"pid": "x"}, "someone", [1]):
        assert liveness.current_record({"status": "running", "launcher": launcher})["status"] == "running"
    dead = liveness.identity() | {"began": "1"}
    assert liveness.current_record({"status": "ok", "launcher": dead})["status"] == "ok"


def test_a_live_run_is_its_users_own_and_one_of_another_user_or_of_a_dead_launcher_is_not(
    other, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process, identity = other
    (file := tmp_path / "run.json").write_text("{}")
    assert liveness.is_own(file, {"launcher": identity})
    for launcher in (None, {}, identity | {"began": "1"}, identity | {"machine": "another"}):
        assert not liveness.is_own(file, {"launcher": launcher})
    assert not liveness.is_own(tmp_path / "none.json", {"launcher": identity})
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert not liveness.is_own(file, {"launcher": identity})
    monkeypatch.undo()
    process.kill()
    process.wait()
    assert not liveness.is_own(file, {"launcher": identity})


@pytest.mark.parametrize(
    ("elsewhere", "lives"),
    [({"machine": "another"}, None), ({"pid_namespace": "pid:[1]"}, None), ({"boot": "yesterday"}, False)],
)
def test_liveness_on_another_machine_is_unknown_but_a_reboot_ends_every_process(elsewhere, lives) -> None:
    assert liveness.lives(liveness.identity()) is True
    assert liveness.lives(liveness.identity() | elsewhere) is lives


def test_every_tool_that_reads_the_folder_reports_a_killed_run(tmp_path: Path) -> None:
    record = {"id": "a-1", "status": "running", "runtime": "mesh", "launcher": liveness.identity()}
    run_folder.write_json(tmp_path / "run.json", record)
    assert Run(tmp_path).files.record["status"] == "running"
    run_folder.write_json(tmp_path / "run.json", record | {"launcher": liveness.identity() | {"began": "1"}})
    run = Run(tmp_path)
    assert run.files.record["status"] == "killed"
    assert [each.what for each in status(run)] == ["killed"]
    with pytest.raises(NotRunning, match=r"run.*over: killed"):
        live_interception.release(tmp_path, name="x")
