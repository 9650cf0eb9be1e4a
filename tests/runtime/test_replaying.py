"""On its recording a run is measured as it was measured while it went on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import local, measuring
from mast_zenoh.messagelog.events import REWIRED, Event
from mast_zenoh.messagelog.writer import MessageLog
from mast_zenoh.runtime.replaying import replay
from mast_zenoh.tables import read_table

SCENARIOS = sorted(path.stem for path in (Path(__file__).parents[2] / "scenarios").glob("*.py"))
#: These act on hosts or in real time, which one process cannot.
ELSEWHERE = {"rogue", "two_hosts"}


def recorded(folder: Path, name: str, *settings: str, frames: int = 60) -> Path:
    path, loaded = scenario.load(name, settings)
    resolved = scenario.resolve(path, loaded, frames=frames, seed=1, record=True)
    ended = local.run(resolved, folder, runtime="inproc")
    assert ended.error is None
    return ended.folder


def results_in(folder: Path) -> dict[str, Any]:
    """Everything that the evaluator has left in a run folder."""
    tables = {path.name: read_table(path) for path in folder.glob("*.parquet")}
    return {"metrics.json": json.loads((folder / "metrics.json").read_text()), **tables}


def assert_equal(once: dict[str, Any], again: dict[str, Any]) -> None:
    assert once.keys() == again.keys()
    for name, content in once.items():
        if name == "metrics.json":
            assert content == again[name]
            continue
        assert content.keys() == again[name].keys(), name
        for column, values in content.items():
            np.testing.assert_array_equal(values, again[name][column], err_msg=f"{name}: {column}")


@pytest.mark.parametrize("name", [name for name in SCENARIOS if name not in ELSEWHERE])
def test_a_run_is_measured_the_same_from_its_recording(tmp_path: Path, name: str) -> None:
    folder = recorded(tmp_path / "run", name)
    once = results_in(folder)
    for file in (folder / measuring.METRICS, *folder.glob("*.parquet")):
        file.unlink()
    assert measuring.can_fill_in(folder)
    assert measuring.measure(folder) == []
    assert not measuring.can_fill_in(folder)
    again = results_in(folder)
    again["metrics.json"]["late"] = once["metrics.json"]["late"]  # of the broker's counts: see measuring
    assert_equal(once, again)


def test_what_no_recording_tells_is_kept(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", "realistic_network", frames=30)
    metrics = json.loads((folder / measuring.METRICS).read_text())
    metrics |= {"latency_ms": {"sim_to_picture": {"p50": 12.0}}, "frames_per_second": 9.5, "late": {"ego": 3}}
    (folder / measuring.METRICS).write_text(json.dumps(metrics | {"agents": "spoilt"}))
    measuring.measure(folder)
    assert json.loads((folder / measuring.METRICS).read_text()) == metrics


def test_a_folder_without_a_recording_is_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", "baseline", frames=20)
    (folder / "messages.mcap").unlink()
    with pytest.raises(RunFolderError, match=r"messages\.mcap: missing"):
        measuring.measure(folder)


@pytest.mark.parametrize(
    ("file", "content"),
    [("scenario.json", ""), ("scenario.json", "[]"), ("scenario.json", '{"nodes": 3}'), ("wiring.json", "")],
)
def test_a_folder_that_is_no_run_is_refused(tmp_path: Path, file: str, content: str) -> None:
    folder = recorded(tmp_path / "run", "baseline", frames=2)
    (folder / file).write_text(content)
    with pytest.raises(RunFolderError, match="cannot be read"):
        measuring.measure(folder)


@pytest.mark.parametrize("wiring", [{}, {"wires": 3}, {"wires": [{"key": "clock"}]}])
def test_a_wiring_in_a_recording_that_is_none_is_named(tmp_path: Path, wiring: dict[str, Any]) -> None:
    path, loaded = scenario.load("baseline")
    resolved = scenario.resolve(path, loaded, frames=2)
    log = MessageLog(tmp_path / "messages.mcap")
    log.begin({})
    log.add_event(Event(REWIRED, -1, wiring=wiring))
    log.close()
    with pytest.raises(RunFolderError, match=r"messages\.mcap: the wiring of frame -1"):
        replay(resolved, "evaluator", tmp_path)
