"""`mast view` refuses options that do not fit a run, and names what serves instead of servers that there were."""

from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from mast_zenoh.cli import observers, view
from mast_zenoh.cli.app import app
from mast_zenoh.errors import RunFolderError


def refused(message: str, target: Path | str, **words: Any) -> None:
    with pytest.raises(typer.BadParameter, match=message):
        view.view(str(target), **words)


@pytest.mark.parametrize(("viewer", "name", "more"), [("foxglove", "foxglove", ()), ("rerun", "rrd", ("--attached",))])
def test_servers_for_other_viewers_are_refused_with_what_serves_instead(
    viewer: str, name: str, more: tuple[str, ...], tmp_path: Path
) -> None:
    result = CliRunner().invoke(app, ["view", str(tmp_path), f"--{viewer}", *more])
    assert result.exit_code == 2
    refused(f"--{viewer}: .*`mast export RUN --to {name}`.*; `mast view RUN` shows", tmp_path, **{viewer: True})


def test_options_that_do_not_fit_a_run_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for status in ("running", "finished"):
        monkeypatch.setattr(observers, "record_of", lambda folder, status=status: {"status": status})
        refused("expected a router, such as tcp/HOST:7447, for --run", tmp_path, run="some_id")
    monkeypatch.setattr(observers, "record_of", lambda folder: {"status": "running"})
    for target in (tmp_path, "tcp/127.0.0.1:1"):
        refused("expected a finished one for --frame", target, frame=3)
    statuses = {"done": "finished", "busy": "running"}
    monkeypatch.setattr(observers, "record_of", lambda folder: {"status": statuses[folder.name]})
    for one, other in (("done", "busy"), ("busy", "done")):
        with pytest.raises(RunFolderError, match=r"busy.*still.*progress"):
            view.view(str(tmp_path / one), tmp_path / other)
