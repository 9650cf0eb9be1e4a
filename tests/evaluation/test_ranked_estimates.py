"""Scores of tracks rank them, from the agents to the picture, and metrics.json says how well."""

from collections.abc import Callable

import numpy as np
import pytest
from played import Played


@pytest.fixture
def baseline(once: Callable[..., Played]) -> Played:
    return once("baseline")


def test_every_estimate_has_its_accuracy_over_recall(baseline: Played) -> None:
    for estimates in baseline.agents.values():
        for estimate, numbers in estimates.items():
            share = numbers["tp"]["mean"] / (numbers["tp"]["mean"] + numbers["fn"]["mean"])
            assert 0.9 * share - 0.05 < numbers["samota"] <= share, estimate
            assert 0.0 < numbers["amota"] < numbers["samota"]
            assert 0.05 < numbers["amotp_m"] < 1.2 * numbers["rmse_m"]


@pytest.mark.parametrize("estimate", ["local", "picture", "mission"])
def test_scores_differ_between_tracks_and_are_lower_for_false_ones(baseline: Played, estimate: str) -> None:
    table = baseline.table("objects")
    outcome, score = table["outcome"], table["score"]
    tracks = (table["kind"] == "track") & (table["estimator"] == estimate)
    assert (score[tracks] >= 0.0).all()
    assert (score[tracks] < 0.999).all()
    distinct, matched = len(np.unique(score[tracks])), np.count_nonzero(tracks & (outcome == "matched"))
    assert distinct > 0.5 * matched / len(baseline.agents)
    assert score[tracks & (outcome == "false")].mean() < score[tracks & (outcome == "matched")].mean() - 0.02
