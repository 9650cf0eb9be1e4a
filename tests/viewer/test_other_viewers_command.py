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
from mast_zenoh.cli import observers, view
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


def test_options_that_do_not_fit_a_run_are_refused_by_name(
    recorded: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(message: str, target: Path | str, **words: Any) -> None:
        with pytest.raises(typer.BadParameter, match=message):
            view.view(str(target), **words)

    refused("expected one", recorded.path, foxglove=True, rerun=True)
    refused("expected one", recorded.path, other=Path("other"), rerun=True)
    for status in ("running", "finished"):
        monkeypatch.setattr(observers, "record_of", lambda folder, status=status: {"status": status})
        own_page = "--frame and --open are for this testbed's own page"
        refused(own_page, tmp_path, foxglove=True, browser=True)
        refused(own_page, tmp_path, rerun=True, frame=3)
        refused("--rate and --loop are for --foxglove", tmp_path, loop=True)
        refused("expected a router, such as tcp/HOST:7447, for --run", tmp_path, run="some_id")
    monkeypatch.setattr(observers, "record_of", lambda folder: {"status": "running"})
    for target in (tmp_path, "tcp/127.0.0.1:1"):
        for words in ({"frame": 3}, {"foxglove": True, "loop": True}, {"foxglove": True, "rate": 2.0}):
            refused("expected a finished one for --frame, --rate and --loop", target, **words)
    statuses = {"done": "finished", "busy": "running"}
    monkeypatch.setattr(observers, "record_of", lambda folder: {"status": statuses[folder.name]})
    for one, other in (("done", "busy"), ("busy", "done")):
        with pytest.raises(RunFolderError, match="busy: the run is still in progress"):
            view.view(str(tmp_path / one), tmp_path / other)
