"""The share of time in which each object is tracked."""

from __future__ import annotations

import json

import numpy as np
import pytest
from metric_worlds import cars

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.measures import summary_of
from mast_zenoh.metrics.record import Snapshot


def summary(truth: list[ObjectStates], picture: list[ObjectStates], scored: slice = slice(None)):
    record = Record(["ego"])
    for frame, (objects, believed) in enumerate(zip(truth, picture, strict=True)):
        record.add_truth(frame, objects, np.full((len(objects), 1), 9), np.zeros((1, 3)), np.array([-1]))
        record.add(frame, [Series("", "picture")], Snapshot.of(believed))
    return summary_of(Scorer().score(record), scored)["ego"]["picture"]


BOTH = cars((0.0, 0.0), (20.0, 0.0), id=[1, 2])
FIRST = cars((0.0, 0.0), id=[1])
NONE = ObjectStates.empty()


def test_completeness_is_the_mean_over_objects_of_their_matched_share() -> None:
    assert summary([BOTH] * 4, [BOTH, FIRST, FIRST, NONE])["completeness"] == pytest.approx((3 / 4 + 1 / 4) / 2)


def test_objects_have_equal_weight_however_long_they_are_seen() -> None:
    assert summary([BOTH, FIRST, FIRST, FIRST], [FIRST] * 4)["completeness"] == pytest.approx((1.0 + 0.0) / 2)


def test_only_scored_frames_count() -> None:
    assert summary([BOTH] * 4, [NONE, BOTH, BOTH, NONE], slice(1, 3))["completeness"] == 1.0


def test_without_objects_completeness_is_null_in_json() -> None:
    scores = summary([NONE, NONE], [FIRST, FIRST])
    assert scores["completeness"] is None
    json.dumps(scores, allow_nan=False)


def test_set_distances_are_computed_per_frame_and_summarised_like_counts() -> None:
    scores = summary([BOTH, BOTH], [BOTH, FIRST])
    assert scores["ospa_m"] == {"mean": pytest.approx(np.sqrt(25 / 2) / 2), "std": pytest.approx(np.sqrt(25 / 2) / 2)}
    assert scores["gospa_m"]["mean"] == pytest.approx(np.sqrt(25 / 2) / 2)
