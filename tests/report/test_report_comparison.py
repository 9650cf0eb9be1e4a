"""Only comparable runs are compared."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from run_samples import edit

from mast_zenoh.errors import NotComparable
from mast_zenoh.runs.run import Run
from mast_zenoh.show import comparison
from mast_zenoh.show.html import write_report

Pair = tuple[Path, Path]


@pytest.fixture
def pair(run_folder: Callable[..., Path]) -> Pair:
    return run_folder("uncoordinated"), run_folder()


def test_runs_of_equal_name_are_distinguished_by_folder(pair: Pair) -> None:
    run, other = pair
    for folder in pair:
        edit(folder, run={"name": "mine"})
    assert comparison.reference(Run(run), other).name == "baseline"


def score_with(folder: Path, **options: Any) -> None:
    """Write an evaluator with other options to scenario.json."""
    config = {"agents": ["ego"], "scorer": {"type": "Scorer", "range_m": 100.0}} | options
    edit(folder, scenario={"nodes": {"evaluator": {"config": config}}})


def test_what_the_evaluator_computes_besides_scores_does_not_prevent_comparison(pair: Pair) -> None:
    """Metrics of the user, known faults, and how long an agent uses a picture."""
    run, other = pair
    score_with(other)
    for experiment in (
        {"metrics": [{"type": "FalseNearby"}]},
        {"faults": {"infra_1": [["Blindness", 1.0, None]]}},
        {"picture_ages_s": {"ego": 0.2}},
    ):
        edit(run, scenario={"nodes": ...})
        score_with(run, **experiment)
        assert comparison.reference(Run(run), other).name == "baseline-1"
        assert comparison.reference(Run(other), run).name == "uncoordinated-1"


def test_incomparable_runs_are_rejected(run_folder: Callable[..., Path]) -> None:
    run = run_folder("uncoordinated")
    score_with(run)
    refused: dict[str, dict[str, Any]] = {
        "has no results": {"metrics": ...},
        "has a damaged metrics.json": {"metrics": '{"agents": '},
        "found 40 and 39 frames": {"metrics": {"frames": 39}},
        "with seed 4": {"run": {"seed": 4}},
        r"scored_frames: found \(0, 39\) and \(6, 29\)": {"metrics": {"scored_frames": [6, 29]}},
        r"evaluator\.scorer\.range_m: found 100\.0 and 50\.0": evaluator(scorer={"range_m": 50.0}),
        r"evaluator\.driving\.brake_ttc_s: found nothing and 3\.0": evaluator(driving={"brake_ttc_s": 3.0}),
        "found car only in the second": {"metrics": {"agents": lambda agents: {"car": agents["ego"]}}},
        "found infra_9 only in the second": {"metrics": {"agents": lambda agents: agents | {"infra_9": agents["ego"]}}},
    }
    for message, changes in refused.items():
        other = run_folder()
        score_with(other)
        with pytest.raises(NotComparable, match=message):
            write_report(run, against=edit(other, **changes))


def evaluator(**config: Any) -> dict[str, Any]:
    return {"scenario": {"nodes": {"evaluator": {"config": config}}}}


def test_different_scenes_and_unscored_agents_are_rejected(pair: Pair) -> None:
    run, other = pair
    scene = Run(other).files.scene
    replace(scene, truth=replace(scene.truth, position=scene.truth.position + 1.0)).save(other / "scene.npz")
    with pytest.raises(NotComparable, match=r"same scene.*seed"):
        write_report(run, against=other)
    renamed = (*scene.agents[:-1], replace(scene.agents[-1], name="infra_9"))
    replace(scene, agents=renamed).save(other / "scene.npz")
    with pytest.raises(NotComparable, match=r"infra_4.*infra_9.*second"):
        write_report(run, against=other)


def test_without_recordings_scenes_are_compared_by_scenario(pair: Pair) -> None:
    run, other = pair
    (other / "scene.npz").unlink()
    assert comparison.reference(Run(run), other).name == "baseline-1"
    edit(other, scenario={"scene": {"type": "Other"}})
    with pytest.raises(NotComparable, match="an unknown scene"):
        comparison.reference(Run(run), other)
