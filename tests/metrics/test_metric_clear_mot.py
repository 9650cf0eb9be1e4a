"""Precision, recall and MOTA of a run."""

import json

import numpy as np
import pytest
from metric_worlds import cars

from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.measures import summary_of
from mast_zenoh.metrics.record import Snapshot

FIRST, SECOND, FAR = (0.0, 0.0), (10.0, 0.0), (40.0, 0.0)


def summary(truth: list, picture: list, scored: slice = slice(None)) -> dict:
    record = Record(["ego"])
    for frame, (objects, tracks) in enumerate(zip(truth, picture, strict=True)):
        seen = np.full((len(objects), 1), 10)
        record.add_truth(frame, cars(*objects), seen, np.zeros((1, 3)), np.array([-1]))
        record.add(frame, [Series("", "picture")], Snapshot.of(cars(*tracks.values(), id=list(tracks))))
    return summary_of(Scorer().score(record), scored)["ego"]["picture"]


def test_precision_recall_and_mota_count_all_scored_frames_together() -> None:
    truth = [[FIRST, SECOND]] * 4
    # 5 pairs, 3 missed objects, 1 false track, and one identity switch: track 3 takes over the first object.
    picture = [{1: FIRST, 2: SECOND}, {1: FIRST}, {3: FIRST, 4: FAR}, {3: FIRST}]
    numbers = summary(truth, picture)
    assert numbers["precision"] == pytest.approx(5 / 6)
    assert numbers["recall"] == pytest.approx(5 / 8)
    assert numbers["mota"] == pytest.approx(1 - (3 + 1 + 1) / 8)
    numbers = summary(truth, picture, slice(0, 2))
    assert (numbers["precision"], numbers["recall"], numbers["mota"]) == (1.0, 0.75, 0.75)


def test_more_errors_than_objects_make_mota_negative() -> None:
    numbers = summary([[FIRST]], [{1: SECOND, 2: FAR}])
    assert (numbers["precision"], numbers["recall"], numbers["mota"]) == (0.0, 0.0, -2.0)


def test_without_objects_or_tracks_they_are_null_in_json() -> None:
    numbers = json.loads(json.dumps(summary([[]], [{}])))
    assert [numbers[name] for name in ("precision", "recall", "mota")] == [None] * 3
    numbers = summary([[FIRST]], [{}])
    assert (numbers["precision"], numbers["recall"], numbers["mota"]) == (None, 0.0, 0.0)
