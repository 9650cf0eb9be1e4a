"""Numbers of the cells of a matrix, from synthetic trials."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

import pytest

from mast_zenoh.report.defence_rows import DefenceMatrix
from mast_zenoh.report.figures.defences import figures_of_defences
from mast_zenoh.report.tables import defences as tables
from mast_zenoh.study.defences import Cell
from mast_zenoh.study.defences.estimates import Collection

SEEDS = range(5)
CELLS = (
    Cell("NoIntegrity"),
    Cell("Wall"),
    *(Cell(defence, "Ghost", 1, "worst", budget) for defence in ("NoIntegrity", "Wall") for budget in (1.0, 4.0)),
)


def metrics(
    fp: float,
    *,
    trusted: bool = False,
    lied: bool = False,
    suspended_after_s: float | None = None,
    alarms: int = 0,
) -> dict[str, Any]:
    """metrics.json of a trial of 36 s with one agent that may lie and one that never does."""
    picture = {"fn": {"mean": 2.0}, "fp": {"mean": fp}, "ospa_m": {"mean": 1.0 + fp}}
    liar = {
        "first_lie_s": 4.0,
        "first_observable_s": 4.0,
        "suspended_after_s": suspended_after_s,
        "observed_s": None if not trusted else 6.0 if suspended_after_s is None else suspended_after_s,
    }
    found = suspended_after_s is not None
    content: dict[str, Any] = {
        "agents": {"ego": {"picture": picture}},
        "defence": {
            "lies": {"all": 4 * lied, "observable": 4 * lied, "detected": 2 * found},
            "agents": {"liar": liar} if lied else {},
            "false": {"identifiable": fp, "unidentifiable": 0.0},
            "honest_majority": 0.75 if lied else 1.0,
        },
    }
    if trusted:
        content["integrity"] = {
            "agents": {
                "liar": {"lied": lied, "suspicion": {"max": 3.0 if lied else -3.0}, "fault_alarms": 2},
                "honest": {"lied": False, "suspicion": {"max": -2.0}, "fault_alarms": 0},
            },
            "seconds": {"honest": {"trusted": 36.0, "suspended": 4.0}},
            "hours": 0.01,
            "false_alarms": alarms,
        }
    return content


@pytest.fixture
def matrix() -> DefenceMatrix:
    collection = Collection({cell.label: cell for cell in CELLS}, ["junction"], list(SEEDS))
    for seed in SEEDS:
        noise = 0.1 * seed
        trials = {
            Cell("NoIntegrity"): metrics(noise),
            Cell("Wall"): metrics(noise + 0.5, trusted=True, alarms=seed == 0),
            Cell("NoIntegrity", "Ghost", 1, "worst", 1.0): metrics(noise + 2.0, lied=True),
            Cell("NoIntegrity", "Ghost", 1, "worst", 4.0): metrics(noise + 4.0 + noise, lied=True),
            Cell("Wall", "Ghost", 1, "worst", 1.0): metrics(noise + 1.0 + noise, trusted=True, lied=True),
            Cell("Wall", "Ghost", 1, "worst", 4.0): metrics(noise, trusted=True, lied=True, suspended_after_s=1.0),
        }
        for cell, content in trials.items():
            collection.add(cell.label, "junction", seed, content)
    return collection.matrix()


def test_damage_is_relative_to_no_attack_and_no_defence_with_the_same_seed(matrix: DefenceMatrix) -> None:
    damage = matrix.row("NoIntegrity", "Ghost", 1, "worst").estimates["damage"]  # type: ignore[union-attr]
    assert damage.trial_mean == pytest.approx(4.2)
    assert damage.low < 4.2 < damage.high < 4.5, "paired, so that the seeds' own noise cancels"


def test_each_cell_has_the_budget_that_does_the_most_damage(matrix: DefenceMatrix) -> None:
    undefended, defended = (matrix.row(name, "Ghost", 1, "worst") for name in ("NoIntegrity", "Wall"))
    assert undefended is not None
    assert defended is not None
    assert (undefended.budget, defended.budget, defended.budgets) == (4.0, 1.0, 2)
    # 1.2 against the undefended run with the same budget, 2.0
    assert defended.estimates["fp_vs_undefended"].trial_mean == pytest.approx(1.2 - 2.0)


def test_the_cost_is_the_damage_without_an_attack(matrix: DefenceMatrix) -> None:
    alone = matrix.row("Wall", "Ghost", 0, "worst")
    assert alone is not None
    assert alone.attack == ""
    assert alone.estimates["fp_added"].trial_mean == pytest.approx(0.5)
    assert alone.estimates["honest_suspended_per_hour"].trial_mean == pytest.approx(100.0 / 5)
    assert alone.estimates["faulty_suspended_per_hour"].trial_mean == pytest.approx(200.0)


def test_delays_and_characteristics_are_over_all_trials_of_a_defence(matrix: DefenceMatrix) -> None:
    assert set(matrix.delays) == {"Wall"}, "without trust nobody is watched"
    delay = matrix.delays["Wall"]
    assert (delay.detections, delay.watched, delay.median_s) == (5, 10, 1.0)
    (curve,) = matrix.rocs
    assert (curve.defence, curve.auc) == ("Wall", 1.0)
    assert curve.hours == pytest.approx(15 * 0.01)


def test_a_failed_trial_leaves_its_seed_out() -> None:
    collection = Collection({cell.label: cell for cell in CELLS[:2]}, ["junction"], [0, 1])
    collection.add(CELLS[0].label, "junction", 0, metrics(1.0))
    collection.add(CELLS[1].label, "junction", 0, metrics(2.0, trusted=True))
    collection.add(CELLS[1].label, "junction", 1, metrics(9.0, trusted=True))
    estimate = collection.matrix().rows[1].estimates["fp_added"]
    assert (estimate.trial_mean, estimate.seeds, estimate.left_out) == (1.0, 1, 1)


def test_lies_are_not_detected_where_none_is_observable(matrix: DefenceMatrix) -> None:
    alone = matrix.row("Wall", "Ghost", 0, "worst")
    assert alone is not None
    assert math.isnan(alone.estimates["lies_detected"].trial_mean)


def test_tables_hold_every_cell(matrix: DefenceMatrix) -> None:
    text = tables.as_markdown(matrix)
    assert "| Ghost | 1 | 4.20 [" in text
    assert "| Wall | Ghost | 1 | worst | 1 |" in text
    assert "5 of 10" not in text, "the delays of a cell are of its own budget"
    rows = list(csv.DictReader(io.StringIO(tables.as_csv(matrix))))
    damage = [row for row in rows if row["measure"] == "damage"]
    assert [(row["defence"], row["n_adversaries"]) for row in damage] == [
        ("NoIntegrity", "0"),
        ("Wall", "0"),
        ("NoIntegrity", "1"),
        ("Wall", "1"),
    ]
    latex = tables.as_latex(matrix)
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") == 1
    assert "Ghost & 1 & 4.20" in latex


def test_figures_name_the_worst_adversary_in_words(matrix: DefenceMatrix) -> None:
    figures = figures_of_defences(matrix)
    assert list(figures) == ["defence_matrix", "damage_over_adversaries", "detection_delay", "roc"]
    assert "NoIntegrity: 4.20 by Ghost, 1 adversary" in figures["defence_matrix"].alt
