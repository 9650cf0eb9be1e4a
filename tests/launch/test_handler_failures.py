"""Failed handlers are named in the error, run.json and report unless allowed."""

import json
from pathlib import Path
from typing import Any

import failing
import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import HandlerFailed, NodeDied
from mast_zenoh.launch import checks, run
from mast_zenoh.mesh.control import failures
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.html import write_report, write_study_report


def resolved(name: str, folder: Path, frames: int = 12) -> Resolved:
    return scenario.resolve(*scenario.load(str(failing.write(name, folder)), []), frames=frames, record=True)


def played(name: str, folder: Path, **options: Any) -> run.EndedRun:
    return run.run(resolved(name, folder), folder / "run", runtime="inproc", **options)


@pytest.mark.parametrize(
    ("name", "node", "handler", "frames", "text"),
    [
        ("attack", "eve", "on_detections", list(range(5, 12)), "ValueError: no [plan] for frame 5"),
        ("center", "command_center", "on_collated", [2, 5, 8, 11], "RuntimeError: no clusters"),
        ("evaluator", "evaluator", "finish", [11], "ZeroDivisionError: division by zero"),
    ],
)
def test_failed_handlers_are_named_with_node_frames_exception_and_line(
    tmp_path: Path, name: str, node: str, handler: str, frames: list[int], text: str
) -> None:
    ended = played(name, tmp_path)
    assert isinstance(ended.error, HandlerFailed)
    record = json.loads((ended.folder / "run.json").read_text())
    assert record["status"] == "handler_failures"
    (entry,) = record["nodes"][node]["failures"]
    where = entry.pop("where")
    assert entry == {
        "handler": handler,
        "count": len(frames),
        "frames": len(frames),
        "first_frame": frames[0],
        "last_frame": frames[-1],
        "exception": text,
    }
    assert Path(where.rpartition(":")[0]).parent == tmp_path, "in the user's file"
    log = ended.folder / "logs" / f"{node}.log"
    for part in (f"{node}.{handler} failed", text, where, str(log)):
        assert part in str(ended.error)
    assert "Traceback" in log.read_text()
    assert not any(each["failures"] for other, each in record["nodes"].items() if other != node)


def test_another_error_takes_precedence_and_the_failures_are_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = resolved("attack", tmp_path)
    truth_at = Recording.truth_at

    def fails_at_9(self: Recording, frame: int) -> Any:
        if frame == 9:
            raise RuntimeError("no truth")
        return truth_at(self, frame)

    monkeypatch.setattr(Recording, "truth_at", fails_at_9)
    outcome = run.run(world, tmp_path / "run", runtime="inproc")
    assert isinstance(outcome.error, NodeDied)
    assert outcome.record["status"] == "failed"
    assert outcome.record["nodes"]["eve"]["failures"][0]["last_frame"] == 8
    assert outcome.record["nodes"]["eve"]["ended"] == "did not finish"


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("allowed", [False, True])
def test_results_are_written_and_the_report_has_a_red_banner_or_an_amber_one_for_allowed_failures(
    tmp_path: Path, allowed: bool
) -> None:
    ended = played("attack", tmp_path, allow_failures=allowed)
    assert (ended.error is None) == allowed
    record = json.loads((ended.folder / "run.json").read_text())
    assert record["status"] == ("ok" if allowed else "handler_failures")
    assert (record["message"] == "") == allowed
    assert record["nodes"]["eve"]["failures"][0]["count"] == 7
    assert json.loads((ended.folder / "metrics.json").read_text())["frames"] == 12
    assert (ended.folder / "messages.mcap").is_file()
    page = write_report(ended.folder).read_text()
    kind = "note mild" if allowed else "note"
    banner = page.partition(f'<div class="{kind}" role="alert">')[2].partition("</div>")[0]
    assert "numbers may" in banner
    assert "(5 to 11)" in banner
    assert page.count("frame 5") == 1, "and not repeated as the run's message"
    assert "7 handler failures" in page
    if allowed:
        return
    page = write_study_report(tmp_path, {"mine": ended.folder}).read_text()
    banner = page.partition('role="alert">')[2].partition("</div>")[0]
    assert banner.startswith("<p><strong>mine: handlers failed, so the numbers may be wrong")
    assert page.index('role="alert"') < page.index('id="scores"')


@pytest.mark.usefixtures("without_figures")
def test_a_run_without_failures_has_no_banner_and_no_error(tmp_path: Path) -> None:
    ended = played("second", tmp_path)
    assert ended.error is None
    assert ended.record["status"] == "ok"
    page = write_report(ended.folder).read_text()
    assert 'role="alert"' not in page
    assert list((ended.folder / "logs").iterdir()) == []


def test_a_run_with_links_is_checked_even_if_handlers_failed(tmp_path: Path) -> None:
    file, loaded = scenario.load(str(failing.write("attack", tmp_path)), [])
    loaded["faults"] = [dict(type="Loss", at=0.2, until=0.6, node="ego", probability=0.5)]
    world = scenario.resolve(file, loaded, frames=12, record=True)
    outcome = run.run(world, tmp_path / "run", runtime="inproc")
    assert isinstance(outcome.error, HandlerFailed)
    checks_by_name = {
        check["name"]: check for check in json.loads((outcome.folder / checks.FILE).read_text())["checks"]
    }
    assert checks_by_name["sequences"]["values"].get("checked", True), "the run was completed"


def test_a_failing_metric_is_named_with_its_line_and_leaves_the_others_unchanged(tmp_path: Path) -> None:
    ended = played("metric", tmp_path)
    assert isinstance(ended.error, HandlerFailed)
    record = json.loads((ended.folder / "run.json").read_text())
    (entry,) = record["nodes"]["evaluator"]["failures"]
    assert (entry["handler"], entry["count"]) == ("metric broken", 1)
    assert "ValueError: no box" in entry["exception"]
    file, _, line = entry["where"].rpartition(":")
    assert "len([])" in Path(file).read_text().splitlines()[int(line) - 1]
    ego = json.loads((ended.folder / "metrics.json").read_text())["agents"]["ego"]["picture"]
    assert ego["broken"] == {"mean": None, "std": None}
    assert ego["tracks"] > 0.0
    assert ego["fn"]["mean"] is not None
    assert np.isnan(read_table(ended.folder / "metrics.parquet")["broken"]).all()


def test_failures_of_several_nodes_stay_apart_on_one_line() -> None:
    entry = {"handler": "on_tracks", "count": 2, "exception": "ValueError: no", "where": "mine.py:3"}
    text = " ".join(str(failures.error({"eve": [entry], "mallory": [entry]})).split())
    assert "(mine.py:3); mallory.on_tracks failed" in text
    assert "(mine.py:3); the results" in text
