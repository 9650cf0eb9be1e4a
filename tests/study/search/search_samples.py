"""The results of a search that was never carried out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import optuna

from mast_zenoh.metrics.study_results import Row, Statistic
from mast_zenoh.study.definition import Configuration, Study, StudyScene
from mast_zenoh.study.search.plan import SEARCHED, SearchPlan, parse_objective, parse_space
from mast_zenoh.study.search.results import ESTIMATES, SearchResults

BASELINE, DEFAULT = "unattacked", "attacked"
SPACE = {
    "coordinator.coordination.selection.fraction_false_negatives": "0.0..1.0",
    "coordinator.coordination.selection.region": ["in_view", "victim_only", "outnumbered", "ego_path"],
    "attack.budget": "0.5..4.0 log",
}


def estimate(mean: float, half: float = 0.2, seeds: int = 20) -> Statistic:
    return Statistic(
        mean=mean, std=math.nan, value=mean, low=mean - half, high=mean + half, p=0.01, scenes=2, seeds=seeds
    )


def search_row(label: str, search: float = math.nan, *estimates: Statistic) -> Row:
    numbers = dict.fromkeys(ESTIMATES, Statistic()) | dict(zip(ESTIMATES, estimates, strict=False))
    return Row({"configuration": label}, 0, numbers | {"search": Statistic(search)})


def changed(row: Row, **numbers: Statistic) -> Row:
    return replace(row, numbers={**row.numbers, **numbers})


def results(values: tuple[float, ...] = (2.5, math.nan, 3.25, 3.0, 3.25), *, maximise: bool = True) -> SearchResults:
    """A search whose third candidate is the result: 3.25 on its own seeds, 2.75 on others; 1.5 without attack."""
    space = parse_space(SPACE, "p")
    plan = SearchPlan(
        run=DEFAULT,
        default={},
        space=space,
        objective=parse_objective("fn + fp", "p"),
        maximise=maximise,
        candidates=len(values),
        batch=2,
    )
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    candidates = optuna.create_study(direction="maximize" if maximise else "minimize")
    for number, value in enumerate(values):
        params = dict(zip(SPACE, (number / 10.0, "in_view", 1.23456789), strict=True))
        state = optuna.trial.TrialState.FAIL if math.isnan(value) else optuna.trial.TrialState.COMPLETE
        known = None if math.isnan(value) else value
        candidates.add_trial(
            optuna.trial.create_trial(state=state, value=known, params=params, distributions=dict(space))
        )
    study = Study(
        path=Path("made.py"),
        name="made",
        configurations=tuple(Configuration(each, each, "x", (), ()) for each in (BASELINE, DEFAULT, SEARCHED)),
        baseline=BASELINE,
        scenes=(StudyScene("intersection:8", ()), StudyScene("intersection:9", ())),
        trials=20,
        seed=0,
        frames=130,
        runtime="inproc",
        search=plan,
    )
    rows = (
        search_row(BASELINE, 1.5, estimate(1.25)),
        search_row(DEFAULT, 2.0, estimate(1.75), estimate(0.5)),
        search_row(SEARCHED, 3.25, estimate(2.75), estimate(1.5), estimate(1.0)),
    )
    return SearchResults(study, candidates, {row.of["configuration"]: row for row in rows}, {"attack.budget": 2.0}, 20)


def with_rows(made: SearchResults, changed: Mapping[str, Row]) -> SearchResults:
    """The results with other rows of some configurations."""
    return replace(made, rows={**made.rows, **changed})
