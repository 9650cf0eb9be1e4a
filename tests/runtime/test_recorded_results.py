"""A recording gives the metrics measured during the run."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from equal_runs import run_alone
from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import liveness, measurement
from mast_zenoh.launch.measurement import results_of
from mast_zenoh.run_folder.recording.format import REWIRED, RecordedEvent
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.show import html, terminal

pytestmark = pytest.mark.heavy

SCENARIOS = sorted(path.stem for path in (Path(__file__).parents[2] / "scenarios").glob("*.py"))
#: These affect hosts or need real time, which one process cannot provide.
ELSEWHERE = {"rogue", "sybil", "two_hosts"}


def recorded(folder: Path, name: str, *settings: str, frames: int = 60) -> Path:
    return run_alone(folder, name, *settings, frames=frames, seed=1, record=True)


def results_in(folder: Path) -> dict[str, Any]:
    """All files of the evaluator in a run folder."""
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
def test_a_replayed_recording_gives_the_same_metrics(tmp_path: Path, name: str) -> None:
    folder = recorded(tmp_path / "run", name, *(["n_mobile=6"] if name == "congested" else []), frames=30)
    once = results_in(folder)
    for file in (folder / measurement.METRICS, *folder.glob("*.parquet")):
        file.unlink()
    assert measurement.can_fill_in(folder)
    assert measurement.measure(folder) == []
    assert not measurement.can_fill_in(folder)
    again = results_in(folder)
    again["metrics.json"]["late"] = once["metrics.json"]["late"]  # of the broker's counts: see measuring
    assert_equal(once, again)


def test_results_that_are_not_in_a_recording_are_kept(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", "realistic_network", frames=30)
    metrics = json.loads((folder / measurement.METRICS).read_text())
    metrics |= {"latency_ms": {"sim_to_picture": {"p50": 12.0}}, "frames_per_second": 9.5, "late": {"ego": 3}}
    (folder / measurement.METRICS).write_text(json.dumps(metrics | {"agents": "spoilt"}))
    measurement.measure(folder)
    assert json.loads((folder / measurement.METRICS).read_text()) == metrics


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 60 frames with its recording; copied, never changed."""
    return recorded(tmp_path_factory.mktemp("whole") / "run", "baseline")


def cut(run: Path, to: Path, part: float) -> Path:
    """A copy of a run with a truncated recording."""
    shutil.copytree(run, to)
    data = (to / "messages.mcap").read_bytes()
    (to / "messages.mcap").write_bytes(data[: int(part * len(data))])
    return to


@pytest.mark.parametrize("part", [0.6, 0.98, 0.001], ids=["60 %", "the last chunk", "all but its head"])
def test_metrics_are_kept_if_the_recording_ends_before_the_run(tmp_path: Path, whole: Path, part: float) -> None:
    folder = cut(whole, tmp_path / "run", part)
    once = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".json", ".parquet")}
    ends = r"ends (at frame \d+ of 60|before its first frame), .*metrics\.json is kept.*restore the recording"
    with pytest.raises(RunFolderError, match=ends):
        measurement.measure(folder)
    assert {name: (folder / name).read_bytes() for name in once} == once


def test_a_run_without_metrics_is_measured_to_the_end_of_its_recording_and_reports_it(tmp_path, whole, capsys) -> None:
    folder = cut(whole, tmp_path / "run", 0.6)
    (folder / "metrics.json").unlink()
    for file in folder.glob("*.parquet"):
        file.unlink()
    run = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(run | {"status": "running", "launcher": None, "nodes": {}}))
    measurement.measure(folder)
    metrics = json.loads((folder / "metrics.json").read_text())
    frames = metrics["frames"]
    assert 0 < frames < 60
    assert metrics["recording"] == {"frames": frames, "played_frames": 60}
    notice = f"holds {frames} of 60 frames: the numbers are of these alone"
    assert notice in terminal.failure(folder)
    terminal.show_run(Console(width=300), folder)
    assert notice in capsys.readouterr().out
    assert notice in html.write_report(folder).read_text()
    measurement.measure(folder)  # repeated: these metrics cover no more frames
    assert json.loads((folder / "metrics.json").read_text()) == metrics


def test_a_run_in_progress_is_not_measured(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", "baseline", frames=4)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": liveness.identity()}))
    with pytest.raises(RunFolderError, match="in progress"):
        measurement.measure(folder)


def test_a_removed_recording_is_distinguished_from_one_that_was_never_made(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", "baseline", frames=4)
    (folder / "messages.mcap").unlink()
    with pytest.raises(RunFolderError, match=r"messages\.mcap: missing; the run was recorded.* counts \d+ messages"):
        measurement.measure(folder)


@pytest.mark.parametrize(
    ("file", "content"),
    [("scenario.json", ""), ("scenario.json", "[]"), ("scenario.json", '{"nodes": 3}'), ("wiring.json", "")],
)
def test_a_folder_that_is_not_a_run_folder_is_refused(tmp_path: Path, file: str, content: str) -> None:
    folder = recorded(tmp_path / "run", "baseline", frames=2)
    (folder / file).write_text(content)
    with pytest.raises(RunFolderError, match="cannot be read"):
        measurement.measure(folder)


@pytest.mark.parametrize("wiring", [{}, {"wires": 3}, {"wires": [{"key": "clock"}]}])
def test_an_invalid_wiring_in_a_recording_is_reported(tmp_path: Path, wiring: dict[str, Any]) -> None:
    resolved = scenario.resolve(*scenario.load("baseline"), frames=2)
    log = MessageLog(tmp_path / "messages.mcap")
    log.begin({})
    log.add_event(RecordedEvent(REWIRED, -1, wiring=wiring))
    log.close()
    with pytest.raises(RunFolderError, match=r"messages\.mcap: the wiring of frame -1"):
        results_of(resolved, "evaluator", tmp_path)
