"""Runs in one process, as `mast run` plays them, and whether two runs are equal: every message, and the metrics."""

import json
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.launch import run
from mast_zenoh.run_folder.recording.difference import compare, explain
from mast_zenoh.run_folder.recording.reader import read


def run_alone(out: Path, name: str, *settings: str, **options: Any) -> Path:
    """The folder of a run of a scenario in one process, which must end well."""
    ended = run.run(scenario.resolve(*scenario.load(name, settings), **options), out, runtime="inproc")
    assert ended.error is None
    return ended.folder


def assert_equal(here: Path, there: Path, *, taps: bool = True, metrics: bool = True) -> None:
    """Assert that two run folders hold the same messages, at least one, and the same metrics.json."""
    difference = compare(here, there, taps=taps)
    assert difference.first is None, "\n".join(explain(difference))
    assert difference.equal > 0
    assert not taps or difference.equal == len(list(read(here)))
    if metrics:
        assert json.loads((here / "metrics.json").read_text()) == json.loads((there / "metrics.json").read_text())
