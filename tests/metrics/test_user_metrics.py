"""User-defined metrics: their inputs, valid results and summaries."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from metric_worlds import LOCAL, cars, recorded

from mast_zenoh.mesh.control.failures import location
from mast_zenoh.metrics import AttributionLimits, Attributor, Estimate, FrameMetric, RunMetric, Scorer
from mast_zenoh.metrics.causes import Manipulations
from mast_zenoh.metrics.measures import ScoredRun, check, measured
from mast_zenoh.metrics.named_metrics import ErrorsNearby, LongestMiss
from mast_zenoh.metrics.scoring import estimates_of


class Told(FrameMetric):
    """A metric that returns preset values and records its inputs."""

    def __init__(self, value: Any) -> None:
        self.what = value
        self.given: list[Estimate] = []

    def per_frame(self, estimate: Estimate) -> Any:
        self.given.append(estimate)
        return self.what


class ToldForRun(RunMetric):
    """The same for a metric per run."""

    def __init__(self, value: Any) -> None:
        self.what = value

    def per_run(self, estimate: Estimate) -> Any:
        return self.what


def no_manipulations(n_series: int) -> Manipulations:
    """Manipulations without rows."""
    zero, nowhere = np.zeros(0, np.int64), np.zeros((0, 3))
    no_reach = np.zeros((0, n_series), bool)
    columns = (zero, zero, zero, zero, zero, nowhere, nowhere, nowhere, zero, np.zeros(0, bool))
    return Manipulations((), no_reach, no_reach, no_reach, no_reach.astype(np.int64), *columns)


def computed(metrics: list[Any], tracked: list[list[bool]], scored: list[bool] | None = None):
    """(summary, table) of a run; the ego's objects are at 10 m, 20 m, …"""
    n = len(tracked[0])
    places = [(10.0 * (k + 1), 0.0) for k in range(n)]
    local = [cars(*(place for place, there in zip(places, which, strict=True) if there)) for which in tracked]
    record = recorded([cars(*places)] * len(tracked), {LOCAL: local})
    scores = Scorer().score(record)
    manipulations = no_manipulations(len(scores.series))
    labels = Attributor(AttributionLimits(), scores, manipulations, 0.1).labels()
    counts = np.ones(len(tracked), bool) if scored is None else np.array(scored)
    estimates = estimates_of(scores, labels, counts, 0.1)
    summary, table, errors = measured(metrics, ScoredRun(scores, counts, estimates))
    for error in errors.values():
        raise error
    return summary["ego"]["local"], table


TRACKED = st.integers(1, 4).flatmap(
    lambda n: st.lists(st.lists(st.booleans(), min_size=n, max_size=n), min_size=1, max_size=12)
)


@given(TRACKED, st.data())
def test_the_longest_miss_is_the_longest_series_of_missed_scored_frames_of_an_object(tracked, data) -> None:
    scored = data.draw(st.lists(st.booleans(), min_size=len(tracked), max_size=len(tracked)))
    longest = 0
    for column in zip(*tracked, strict=True):
        run = 0
        for there, counts in zip(column, scored, strict=True):
            run = run + 1 if counts and not there else 0
            longest = max(longest, run)
    summary, table = computed([LongestMiss()], tracked, scored)
    assert summary["longest_miss"] == pytest.approx(0.1 * longest)
    assert "longest_miss" not in table, "a value per run has no column in the table of frames"


@given(TRACKED, st.floats(1.0, 60.0))
def test_nearby_errors_are_missed_objects_within_a_distance(tracked, distance: float) -> None:
    near = [k for k in range(len(tracked[0])) if 10.0 * (k + 1) <= distance]
    values = [sum(not which[k] for k in near) for which in tracked]
    summary, table = computed([ErrorsNearby(distance_m=distance)], tracked)
    assert table["errors_nearby"].tolist() == values
    assert summary["errors_nearby"] == {"mean": pytest.approx(np.mean(values)), "std": pytest.approx(np.std(values))}


@given(st.lists(st.tuples(st.one_of(st.floats(-1e3, 1e3), st.just(math.nan)), st.booleans()), min_size=1, max_size=10))
def test_unscored_and_undefined_frames_do_not_count(rows) -> None:
    values, scored = (list(column) for column in zip(*rows, strict=True))
    summary, table = computed([Told(np.array(values))], [[True]] * len(rows), scored)
    np.testing.assert_array_equal(table["told"], values)
    known = [value for value, counts in rows if counts and not math.isnan(value)]
    assert summary["told"]["mean"] == (pytest.approx(sum(known) / len(known)) if known else None)


def test_an_estimate_has_the_judged_boxes_and_their_causes() -> None:
    metric = Told(np.zeros(2))
    computed([metric], [[True, False], [False, False]], [False, True])
    (estimate,) = metric.given
    assert (estimate.agent, estimate.estimator, estimate.period_s) == ("ego", "local", 0.1)
    assert estimate.frames.tolist() == [0, 1]
    assert estimate.scored.tolist() == [False, True]
    boxes = zip(estimate.frame, estimate.is_track, estimate.outcome, estimate.range_m, estimate.cause, strict=True)
    assert [(int(f), bool(t), str(o), float(r), str(c)) for f, t, o, r, c in boxes] == [
        (0, False, "matched", 10.0, ""),
        (0, False, "missed", 20.0, "lag"),
        (0, True, "matched", 10.0, ""),
        (1, False, "missed", 10.0, "lag"),
        (1, False, "missed", 20.0, "lag"),
    ]


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (Told(np.zeros(3)), r"Told.per_frame.*\(3,\).*\(2,\)"),
        (Told(1.0), r"Told.per_frame.*shape.*\(2,\)"),
        (ToldForRun("many"), r"ToldForRun.per_run.*number.*None"),
        (ToldForRun(np.zeros(2)), r"ToldForRun.per_run.*ndarray.*number"),
    ],
)
def test_invalid_metric_values_are_refused(metric: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        computed([metric], [[True], [True]])


@pytest.mark.parametrize("value", [None, 3, 2.5, np.float64(2.5), np.int64(3)])
def test_a_metric_per_run_is_a_number_or_null(value: Any) -> None:
    summary, _ = computed([ToldForRun(value)], [[True]])
    assert summary["told_for_run"] == value
    assert value is None or type(summary["told_for_run"]) is float


def test_metric_names_come_from_classes_or_parameters_and_are_unique() -> None:
    class FPNear30m(FrameMetric):
        def per_frame(self, estimate: Estimate) -> Any: ...

    class Named(FPNear30m):
        name = "rmse_m"

    assert FPNear30m().label == "fpnear30m"
    with pytest.raises(ValueError, match=r"'rmse_m'.*name.*built-in"):
        check([Named()])
    with pytest.raises(ValueError, match="'longest_miss' twice"):
        check([LongestMiss(), LongestMiss()])
    check([LongestMiss(), ErrorsNearby()])


@pytest.mark.parametrize("value", [["a"] * 2, [None, "b"], np.zeros(3)], ids=["text", "None and text", "too many"])
def test_an_error_about_a_returned_value_is_located_in_the_users_file(value: Any) -> None:
    with pytest.raises(ValueError, match=r"Told\.per_frame: found ") as caught:
        computed([Told(value)], [[True], [True]])
    assert location(caught.value, type) == f"{__file__}:{Told.per_frame.__code__.co_firstlineno}"
