"""The results of a search that was never carried out."""

from __future__ import annotations

import math
from typing import Any

from mast_zenoh.metrics.search_results import CandidateRow, SearchResults, SearchRow
from mast_zenoh.metrics.study_results import Estimate

BASELINE, DEFAULT, SEARCHED = "unattacked", "attacked", "searched"
SPACE = {
    "coordinator.coordination.selection.fraction_false_negatives": "0.0..1.0",
    "coordinator.coordination.selection.region": "in_view | victim_only | outnumbered | ego_path",
    "attack.budget": "0.5..4.0 log",
}


def estimate(mean: float, half: float = 0.2, seeds: int = 20) -> Estimate:
    return Estimate(mean, math.nan, mean, mean - half, mean + half, p=0.01, scenes=2, seeds=seeds)


def results(values: tuple[float, ...] = (2.5, math.nan, 3.25, 3.0, 3.25), **changes: Any) -> SearchResults:
    """A search whose third candidate is the result: 3.25 on its own seeds, 2.75 on others; 1.5 without attack."""
    best, candidates = math.nan, []
    for number, value in enumerate(values):
        best = value if math.isnan(best) else max(best, best if math.isnan(value) else value)
        settings = {
            "coordinator.coordination.selection.fraction_false_negatives": number / 10.0,
            "coordinator.coordination.selection.region": "in_view",
            "attack.budget": 1.23456789,
        }
        candidates.append(CandidateRow(number, number // 2, settings, value, best))
    rows = [
        SearchRow(BASELINE, 1.5, estimate(1.25)),
        SearchRow(DEFAULT, 2.0, estimate(1.75), estimate(0.5)),
        SearchRow(SEARCHED, 3.25, estimate(2.75), estimate(1.5), estimate(1.0)),
    ]
    content: dict[str, Any] = dict(
        name="made",
        objective="fn + fp",
        label="missed objects + false objects per frame, picture",
        maximise=True,
        sampler="TPE (Optuna 4.9.0)",
        space=SPACE,
        defaults={"attack.budget": 2.0},
        candidates=tuple(candidates),
        best=2,
        rows={row.label: row for row in rows},
        baseline=BASELINE,
        default=DEFAULT,
        searched=SEARCHED,
        search_seeds=(0, 1, 2),
        held_out_seeds=tuple(range(3, 23)),
        scenes=("intersection:8", "intersection:9"),
        frames=130,
    )
    return SearchResults(**content | changes)
