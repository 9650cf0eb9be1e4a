"""Scores equal those of py-motmetrics on all shipped scenarios."""

import numpy as np
import pytest
from played import Played
from scoring_oracle import Row, Series, by_motmetrics, frames_of

pytestmark = pytest.mark.heavy

ESTIMATORS = {"local", "received", "picture", "picture_received", "picture_on_arrival", "mission"}


def assert_equal(played: Played, scores: dict[Series, list[Row]]) -> None:
    """Every frame of metrics.parquet, and the summary in metrics.json."""
    table = played.table("metrics")
    first, last = played.metrics["scored_frames"]
    np.testing.assert_array_equal(table["scored"], (table["frame"] >= first) & (table["frame"] <= last))
    for (agent, estimator), rows in scores.items():
        selected = (table["agent"] == agent) & (table["estimator"] == estimator)
        for name, values in zip(Row._fields, zip(*rows, strict=True), strict=True):
            np.testing.assert_allclose(
                table[name][selected], values, rtol=0.0, atol=1e-9, err_msg=f"{agent} {estimator} {name}"
            )
        counted, summary = rows[first : last + 1], played.agents[agent][estimator]
        for name in ("fn", "fp", "tp"):
            values = [getattr(row, name) for row in counted]
            assert summary[name]["mean"] == pytest.approx(np.mean(values), abs=1e-9)
            assert summary[name]["std"] == pytest.approx(np.std(values), abs=1e-9)
        squares = [row.rmse_m**2 * row.tp for row in counted if row.tp]
        assert summary["rmse_m"] == pytest.approx(np.sqrt(sum(squares) / sum(row.tp for row in counted)), abs=1e-9)
        switches = sum(row.id_switches for row in counted)
        assert summary["id_switches"] == switches
        fn, fp, tp = (sum(getattr(row, name) for row in counted) for name in ("fn", "fp", "tp"))
        assert summary["precision"] == (pytest.approx(tp / (tp + fp)) if tp + fp else None)
        assert summary["recall"] == (pytest.approx(tp / (tp + fn)) if tp + fn else None)
        assert summary["mota"] == (pytest.approx(1 - (fn + fp + switches) / (tp + fn)) if tp + fn else None)


def test_scores_equal_those_of_motmetrics(shipped, variant):
    played, _ = shipped(variant)
    frames = frames_of(played.folder)
    without_broker = {"received"} if variant[0] in ("congested", "peers", "two_centres") else set()
    assert {estimator for _, estimator in frames} == ESTIMATORS - without_broker
    assert {agent for agent, _ in frames} == set(played.agents)
    scores = by_motmetrics(frames)
    assert_equal(played, scores)
    assert sum(row.tp for rows in scores.values() for row in rows) > 0
