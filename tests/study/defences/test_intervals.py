"""Intervals over trials, and times until detection."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mast_zenoh.metrics.study_results import BOOTSTRAP
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.defences.intervals import kaplan_meier


def test_the_same_trials_have_the_same_interval() -> None:
    values = np.random.default_rng(1).normal(size=30)
    assert intervals.mean(values) == intervals.mean(values)


def test_the_bootstrap_of_a_mean_is_as_wide_as_its_standard_error() -> None:
    values = np.random.default_rng(2).normal(3.0, 2.0, 400)
    measured = intervals.mean(values)
    error = values.std() / 20.0
    assert measured.interval == BOOTSTRAP
    assert measured.value - measured.low == pytest.approx(1.96 * error, rel=0.1)
    assert measured.high - measured.value == pytest.approx(1.96 * error, rel=0.1)


def test_the_bootstrap_contains_the_true_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    drawn = [intervals.mean(rng.normal(5.0, 1.0, 24)) for _ in range(300)]
    assert 0.90 <= np.mean([each.low <= 5.0 <= each.high for each in drawn]) <= 0.98


def test_fewer_than_five_trials_have_no_interval() -> None:
    measured = intervals.mean([1.0, 2.0, 3.0, 4.0])
    assert (measured.value, measured.trials) == (2.5, 4)
    assert math.isnan(measured.low)


def test_equal_trials_have_no_interval_because_their_spread_is_unknown() -> None:
    assert math.isnan(intervals.mean([0.3] * 10).low)


def test_a_trial_without_the_value_is_left_out() -> None:
    measured = intervals.mean([1.0, math.nan, 3.0])
    assert (measured.value, measured.trials, measured.left_out) == (2.0, 2, 1)
    assert math.isnan(intervals.mean([math.nan]).value)


def test_a_share_is_that_of_all_trials_together() -> None:
    measured = intervals.share([1.0, 0.0, 9.0, 3.0, 2.0], [1.0, 5.0, 10.0, 4.0, 2.0])
    assert measured.value == pytest.approx(15 / 22)
    assert 0.0 < measured.low < measured.value < measured.high <= 1.0


def test_a_trial_counts_as_often_as_it_is_drawn_and_its_lies_are_never_split() -> None:
    # Nine trials with 1 lie each, one with 1000: the share depends on whether that one is drawn.
    measured = intervals.share([1.0] * 9 + [0.0], [1.0] * 9 + [1000.0])
    assert measured.low < 0.01
    assert measured.high == 1.0


@pytest.mark.parametrize(("part", "bound"), [(1.0, 0.025 ** (1 / 20)), (0.0, 1.0 - 0.025 ** (1 / 20))])
def test_a_share_that_is_the_same_extreme_in_all_trials_has_the_exact_binomial_bound(part: float, bound: float) -> None:
    measured = intervals.share([part * 7.0] * 20, [7.0] * 20)
    assert measured.value == part
    assert (measured.low if part else measured.high) == pytest.approx(bound)


def test_a_share_that_is_equal_in_all_trials_has_no_interval() -> None:
    measured = intervals.share([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert measured.value == pytest.approx(0.1)
    assert math.isnan(measured.low)


def test_rounding_errors_are_no_spread() -> None:
    area = intervals.pooled(lambda rows: 1.0 - 1e-16 * float(rows[0]), 6, (0.0, 1.0))
    assert math.isnan(area.low)


def test_a_share_of_nothing_is_unknown() -> None:
    assert math.isnan(intervals.share([0.0, 0.0], [0.0, 0.0]).value)


@pytest.mark.parametrize(
    ("events", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)]
)  # Garwood (1936), table
def test_rates_have_garwoods_interval(events: int, low: float, high: float) -> None:
    measured = intervals.rate(events, 3.0, 180)
    assert measured.value == pytest.approx(events / 3.0)
    assert (measured.low, measured.high) == (pytest.approx(low / 3.0, rel=1e-3), pytest.approx(high / 3.0, rel=1e-3))


def test_without_hours_there_is_no_rate() -> None:
    assert math.isnan(intervals.rate(0, 0.0, 0).value)


def test_no_event_in_72_trials_is_fewer_than_five_per_cent() -> None:
    measured = intervals.share_of_runs([[False]] * 72)
    assert (measured.value, measured.low) == (0.0, 0.0)
    assert measured.high == pytest.approx(1.0 - 0.025 ** (1 / 72))
    assert 0.049 < measured.high < 0.05


def test_several_runs_of_a_trial_count_as_one_in_the_interval() -> None:
    single, fourfold = (
        intervals.share_of_runs([[True], *[[False]] * 9]),
        intervals.share_of_runs([[True] * 4, *[[False] * 4] * 9]),
    )
    assert (single.value, single.low, single.high) == (0.1, *fourfold[1:3])
    assert single.high == pytest.approx(0.445, abs=1e-3), "Clopper and Pearson's for one of ten"
    assert (fourfold.value, fourfold.trials) == (0.1, 40)


def test_without_runs_there_is_no_share_of_them() -> None:
    assert math.isnan(intervals.share_of_runs([[], []]).value)


def test_an_infinite_draw_makes_the_bound_infinite_and_an_undefined_one_is_left_out() -> None:
    times = np.array([1.0, 1.0, 1.0, math.inf, math.inf])
    median = intervals.pooled(lambda rows: float(np.median(times[rows])), 5)
    assert (median.value, median.low, median.high) == (1.0, 1.0, math.inf)
    mostly_undefined = intervals.pooled(lambda rows: 1.0 if rows[0] == 0 else math.nan, 5)
    assert (mostly_undefined.value, math.isnan(mostly_undefined.low)) == (1.0, True)


def test_without_censoring_it_is_the_share_left() -> None:
    curve = kaplan_meier([1.0, 2.0, 3.0, 4.0], [True] * 4)
    assert curve.time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert curve.undetected.tolist() == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.0])
    assert curve.median_s == 2.0


def test_a_censored_time_counts_as_watched_until_then() -> None:
    # At 1 s one of four is detected; one is lost at 2 s; at 3 s one of the remaining two is detected.
    curve = kaplan_meier([1.0, 2.0, 3.0, 5.0], [True, False, True, False])
    assert curve.undetected.tolist() == pytest.approx([1.0, 0.75, 0.375, 0.375])
    assert curve.time_s.tolist() == [0.0, 1.0, 3.0, 5.0]
    assert (curve.median_s, curve.detections, curve.watched) == (3.0, 2, 4)


def test_the_median_is_unknown_if_fewer_than_half_are_detected() -> None:
    curve = kaplan_meier([1.0, 5.0, 6.0], [True, False, False])
    assert np.isnan(curve.median_s)
    assert curve.time_s[-1] == 6.0


def test_a_tie_of_detection_and_censoring_counts_both_as_watched() -> None:
    assert kaplan_meier([2.0, 2.0], [True, False]).undetected.tolist() == [1.0, 0.5]


def test_nothing_watched_is_an_empty_curve() -> None:
    curve = kaplan_meier([], [])
    assert (curve.time_s.tolist(), curve.undetected.tolist(), curve.watched) == ([0.0], [1.0], 0)


@pytest.mark.parametrize("times", [[-1.0], [float("nan")]])
def test_negative_and_unknown_times_are_refused(times: list[float]) -> None:
    with pytest.raises(ValueError, match="time_s"):
        kaplan_meier(times, [True])
