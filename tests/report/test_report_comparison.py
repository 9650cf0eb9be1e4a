"""Only comparable runs are compared."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from mast_zenoh.errors import NotComparable, RunFolderError
from mast_zenoh.report import comparison
from mast_zenoh.report.html import write_report
from mast_zenoh.report.terminal import show_run
from mast_zenoh.viewer.run import RunRecord

Pair = tuple[Path, Path]


@pytest.fixture
def pair(run_folder: Callable[..., Path]) -> Pair:
    return run_folder("uncoordinated"), run_folder()


def edit(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_the_page_has_both_runs_and_the_difference(pair: Pair) -> None:
    run, other = pair
    page = write_report(run, against=other).read_text()
    assert "6.25 more false objects a frame in the common picture than baseline-1, due to adversary_1" in page
    assert "compared with baseline-1" in page
    assert "(+6.25)" in page
    assert "beyond those of baseline-1 in the same frame" in page
    assert "(+6.25)" not in write_report(run).read_text()


def test_the_terminal_has_both_runs_and_the_difference(pair: Pair) -> None:
    page = io.StringIO()
    show_run(Console(file=page, width=80), *pair)
    assert "6.25 (+6.25)" in page.getvalue()
    assert "6.25 more false objects a frame" in page.getvalue()


def test_runs_of_equal_name_are_distinguished_by_folder(pair: Pair) -> None:
    run, other = pair
    for folder in pair:
        edit(folder / "run.json", lambda data: data.update(name="mine"))
    assert comparison.reference(RunRecord.load(run), other).name == "baseline"


def score_with(folder: Path, **options: Any) -> None:
    """Write an evaluator with other options to scenario.json."""
    config = {"agents": ["ego"], "scorer": {"type": "Scorer", "range_m": 100.0}} | options
    edit(folder / "scenario.json", lambda data: data.update(nodes={"evaluator": {"config": config}}))


def test_user_defined_metrics_do_not_prevent_comparison(pair: Pair) -> None:
    run, other = pair
    score_with(run, metrics=[{"type": "FalseNearby"}])
    score_with(other)
    assert comparison.reference(RunRecord.load(run), other).name == "baseline-1"


@pytest.mark.parametrize(
    "experiment",
    [{"faults": {"infra_1": [["Blindness", 1.0, None]]}}, {"picture_ages_s": {"ego": 0.2}}],
    ids=["a fault", "how long an agent uses a picture"],
)
def test_what_the_evaluator_knows_of_the_experiment_does_not_prevent_comparison(
    pair: Pair, experiment: dict[str, Any]
) -> None:
    run, other = pair
    score_with(run, **experiment)
    score_with(other)
    assert comparison.reference(RunRecord.load(run), other).name == "baseline-1"
    assert comparison.reference(RunRecord.load(other), run).name == "uncoordinated-1"


REFUSED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "metrics.json is missing": (lambda folder: (folder / "metrics.json").unlink(), "has no results"),
    "metrics.json is damaged": (
        lambda folder: (folder / "metrics.json").write_text('{"agents": '),
        "has a damaged metrics.json",
    ),
    "another length": (
        lambda folder: edit(folder / "metrics.json", lambda data: data.update(frames=39)),
        "found 40 and 39 frames",
    ),
    "another seed": (lambda folder: edit(folder / "run.json", lambda data: data.update(seed=4)), "with seed 4"),
    "other scored frames": (
        lambda folder: edit(folder / "metrics.json", lambda data: data.update(scored_frames=[6, 29])),
        r"scored_frames: found \(0, 39\) and \(6, 29\)",
    ),
    "another range": (
        lambda folder: score_with(folder, scorer={"type": "Scorer", "range_m": 50.0}),
        r"evaluator\.scorer\.range_m: found 100\.0 and 50\.0",
    ),
    "an option more": (
        lambda folder: score_with(folder, driving={"brake_ttc_s": 3.0}),
        r"evaluator\.driving\.brake_ttc_s: found nothing and 3\.0",
    ),
    "other agents": (
        lambda folder: edit(folder / "metrics.json", lambda data: data.update(agents={"car": data["agents"]["ego"]})),
        "found car only in the second",
    ),
    "an agent more": (
        lambda folder: edit(folder / "metrics.json", lambda data: data["agents"].update(infra_9=data["agents"]["ego"])),
        "found infra_9 only in the second",
    ),
}


@pytest.mark.parametrize(("spoil", "message"), REFUSED.values(), ids=REFUSED)
def test_incomparable_runs_are_rejected(pair: Pair, spoil: Callable[[Path], Any], message: str) -> None:
    run, other = pair
    for folder in pair:
        score_with(folder)
    spoil(other)
    with pytest.raises(NotComparable, match=message):
        write_report(run, against=other)


def test_different_scene_is_rejected(pair: Pair) -> None:
    run, other = pair
    scene = RunRecord.load(other).recording
    assert scene is not None
    moved = replace(scene.truth, position=scene.truth.position + 1.0)
    replace(scene, truth=moved).save(other / "scene.npz")
    with pytest.raises(NotComparable, match="expected the same scene and seed"):
        write_report(run, against=other)


def test_without_recordings_scenes_are_compared_by_scenario(pair: Pair) -> None:
    run, other = pair
    (other / "scene.npz").unlink()
    assert comparison.reference(RunRecord.load(run), other).name == "baseline-1"
    edit(other / "scenario.json", lambda data: data.update(scene={"type": "Other"}))
    with pytest.raises(NotComparable, match="an unknown scene"):
        comparison.reference(RunRecord.load(run), other)


def test_runs_with_different_unscored_agents_are_rejected(pair: Pair) -> None:
    run, other = pair
    scene = RunRecord.load(other).recording
    assert scene is not None
    renamed = (*scene.agents[:-1], replace(scene.agents[-1], name="infra_9"))
    replace(scene, agents=renamed).save(other / "scene.npz")
    with pytest.raises(NotComparable, match="found infra_4 only in the first and infra_9 only in the second"):
        write_report(run, against=other)


def test_a_folder_without_a_run_is_refused(pair: Pair, tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="no such folder"):
        write_report(pair[0], against=tmp_path / "nosuch")
