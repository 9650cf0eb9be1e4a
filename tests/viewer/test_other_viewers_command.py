"""`mast view --foxglove` and `--rerun` say where they serve a run, and end with Ctrl-C."""

from __future__ import annotations

import http.client
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer

import mast_zenoh as mast
from mast_zenoh.cli import view
from mast_zenoh.errors import RunFolderError


def lines_until_ready(process: subprocess.Popen[str]) -> dict[str, str]:
    """What a command prints before it serves, by the words before the colon."""
    lines = {}
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("Ctrl-C"):
            return lines
        name, _, value = line.strip().partition(": ")
        lines[name] = value
    raise AssertionError(f"ended without serving: {lines}")


def started(run: mast.Run, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "mast_zenoh", "view", str(run.path), *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def test_foxglove_gets_an_address_and_a_layout(recorded: mast.Run) -> None:
    with started(recorded, "--foxglove", "--loop") as process:
        try:
            lines = lines_until_ready(process)
            assert re.fullmatch(r"ws://127\.0\.0\.1:\d+", lines["foxglove"])
            assert "configById" in Path(lines["layout"]).read_text()
            assert lines["from another computer"].startswith("ssh -L ")
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert not Path(lines["layout"]).exists()


def test_rerun_gets_a_recording_and_a_page(recorded: mast.Run) -> None:
    with started(recorded, "--rerun") as process:
        try:
            lines = lines_until_ready(process)
            port = int(re.fullmatch(r"rerun http://127\.0\.0\.1:(\d+)/run\.rrd", lines["native viewer"])[1])  # type: ignore[index]
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
            connection.request("GET", "/run.rrd")
            assert connection.getresponse().read(4) == b"RRF2"
            assert lines["view"] == f"http://127.0.0.1:{port}/"
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


@pytest.mark.parametrize("words", [{"foxglove": True, "rerun": True}, {"other": Path("other"), "rerun": True}])
def test_a_viewer_shows_one_run(recorded: mast.Run, words: dict[str, Any]) -> None:
    with pytest.raises(typer.BadParameter, match="expected one"):
        view.view(str(recorded.path), **words)


@pytest.mark.parametrize("status", ["running", "finished"])
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"foxglove": True, "browser": True}, "--frame and --open are for this testbed's own page"),
        ({"rerun": True, "frame": 3}, "--frame and --open are for this testbed's own page"),
        ({"loop": True}, "--rate and --loop are for --foxglove"),
        ({"run": "some_id"}, "expected a router, such as tcp/HOST:7447, for --run"),
    ],
)
def test_options_are_refused_alike_for_finished_and_running_runs(
    words: dict[str, Any], message: str, status: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "record_of", lambda folder: {"status": status})
    with pytest.raises(typer.BadParameter, match=message):
        view.view(str(tmp_path), **words)


@pytest.mark.parametrize("words", [{"frame": 3}, {"foxglove": True, "loop": True}, {"foxglove": True, "rate": 2.0}])
def test_options_of_finished_runs_are_refused_for_running_ones(
    words: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "record_of", lambda folder: {"status": "running"})
    for target in (str(tmp_path), "tcp/127.0.0.1:1"):
        with pytest.raises(typer.BadParameter, match="expected a finished one for --frame, --rate and --loop"):
            view.view(target, **words)


def test_two_runs_are_refused_while_one_is_running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statuses = {"done": "finished", "busy": "running"}
    monkeypatch.setattr(view, "record_of", lambda folder: {"status": statuses[folder.name]})
    for target, other in (("done", "busy"), ("busy", "done")):
        with pytest.raises(RunFolderError, match="busy: the run is still in progress"):
            view.view(str(tmp_path / target), tmp_path / other)
