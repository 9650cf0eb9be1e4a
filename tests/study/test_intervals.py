"""Intervals over trials, and times until detection."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mast_zenoh.metrics.study_results import (
    BINOMIAL,
    BOOTSTRAP,
    MOSTLY_ZERO,
    OVER_SCENES,
    STUDENT,
    TWO_WAY,
    Statistic,
)
from mast_zenoh.study import statistics
from mast_zenoh.study.statistics import kaplan_meier, trial_estimate

NAN = math.nan


def test_the_interval_of_a_mean_is_students_t_over_seeds_as_in_all_studies() -> None:
    values = np.random.default_rng(2).normal(3.0, 2.0, (3, 8))
    measured = statistics.mean(values.ravel(), scenes=3, paired=True)
    expected = trial_estimate(values, (-math.inf, math.inf), paired=True)
    assert measured.interval == STUDENT
    assert (*measured[:3], measured.p) == (expected.value, expected.low, expected.high, expected.p)


def test_of_few_seeds_an_interval_is_one_to_other_scenes_and_says_so() -> None:
    values = np.random.default_rng(2).normal(3.0, 2.0, (8, 4))
    two, four = (statistics.mean(values[:, :seeds].ravel(), scenes=8, paired=True) for seeds in (2, 4))
    of_scenes = trial_estimate(values[:, :2].T, (-math.inf, math.inf))
    assert (two.interval, four.interval) == (OVER_SCENES, TWO_WAY)
    assert two[1:3] == (of_scenes.low, of_scenes.high)
    assert not np.isnan(statistics.over_scenes(np.hstack([values, values[:, :1]])).low)


@pytest.mark.parametrize(
    ("seeds", "scenes", "of_seed", "of_scene"), [(3, 5, 1.0, 0.3), (4, 8, 1.0, 0.5), (3, 8, 0.0, 1.0)]
)
def test_of_few_seeds_and_many_scenes_an_interval_contains_the_true_mean_whatever_they_share(
    seeds: int, scenes: int, of_seed: float, of_scene: float
) -> None:
    rng, found = np.random.default_rng(4), []
    for _ in range(600):
        shared = of_seed * rng.normal(size=(1, seeds)) + of_scene * rng.normal(size=(scenes, 1))
        each = statistics.mean((shared + 0.3 * rng.normal(size=(scenes, seeds))).ravel(), scenes=scenes, paired=True)
        found.append((each.low <= 0.0 <= each.high, each.p > 0.05))
    assert (np.mean(found, axis=0) > 0.92).all()


@pytest.mark.parametrize("rate", [0.3, 0.7, 1.0, 2.0])
def test_the_interval_of_rare_misses_contains_the_true_mean_as_often_as_it_says(rate: float) -> None:
    """Ten pairs; a bootstrap covers 66 to 85 % here. Where most pairs agree, there is no interval."""
    rng = np.random.default_rng(3)
    pairs = rng.poisson(rate, (600, 10)) - rng.poisson(0.1, (600, 10))
    drawn = [statistics.mean(each, paired=True) for each in pairs]
    known = [each for each in drawn if each.interval == STUDENT]
    assert np.mean([each.low <= rate - 0.1 <= each.high for each in known]) >= 0.9
    assert {each.interval for each in drawn} - {STUDENT} <= {MOSTLY_ZERO, ""}


@pytest.mark.parametrize(
    ("measured", "value", "low"),
    [
        (statistics.mean([1.0, 2.0, 3.0, 4.0]), 2.5, NAN),  # fewer than five trials have no interval
        (statistics.mean([1.0], (0.0, 1.0)), 1.0, NAN),  # of shares, too
        (statistics.share([0.0] * 4, [7.0] * 4), 0.0, NAN),
        (statistics.mean([0.3] * 10), 0.3, NAN),  # nor have equal ones, as their spread is unknown
        (statistics.mean([NAN]), NAN, NAN),
        (statistics.share(0.1 * np.arange(1, 7), np.arange(1.0, 7.0)), 0.1, NAN),  # equal in all trials
        (statistics.share([0.0, 0.0], [0.0, 0.0]), NAN, NAN),
        (statistics.share_of_runs([[], []]), NAN, NAN),
        (statistics.pooled(lambda rows: 1.0 - 1e-16 * float(rows[0]), 6), 1.0, NAN),  # rounding errors
        (statistics.pooled(lambda rows: 1.0 if rows[0] == 0 else NAN, 5), 1.0, NAN),  # mostly undefined
        (statistics.share([7.0] * 20, [7.0] * 20), 1.0, 0.025 ** (1 / 20)),  # exact, as binomial
        (statistics.rate(0, 0.0, 0), NAN, NAN),
    ],
)
def test_an_interval_is_unknown_where_the_spread_of_trials_is(measured: Statistic, value: float, low: float) -> None:
    assert (measured.value, measured.low) == pytest.approx((value, low), nan_ok=True)


def test_a_number_says_how_its_bounds_were_computed_and_nothing_without_bounds() -> None:
    methods = [
        (statistics.mean([1.0, 2.0, 3.0, 4.0, 5.0]), STUDENT),
        (statistics.mean([0.0] * 6 + [1.0], paired=True), MOSTLY_ZERO),
        (statistics.mean([1.0, 2.0]), ""),
        (statistics.mean([0.3] * 10), ""),
        (statistics.mean([0.0] * 6, (0.0, 1.0)), BINOMIAL),
        (statistics.share([1.0, 0.0, 9.0, 3.0, 2.0], [1.0, 5.0, 10.0, 4.0, 2.0]), BOOTSTRAP),
        (statistics.share([0.0] * 6, [7.0] * 6), BINOMIAL),
        (statistics.share([1.0, 2.0], [2.0, 3.0]), ""),
        (statistics.pooled(lambda rows: float(rows.mean()), 5), BOOTSTRAP),
        (statistics.pooled(lambda rows: float(rows.mean()), 4), ""),
    ]
    assert [measured.interval for measured, _ in methods] == [expected for _, expected in methods]


def test_a_statistic_that_is_equal_in_each_trial_has_no_interval() -> None:
    equal = statistics.pooled(lambda rows: 2.0, 6)
    assert (equal.value, equal.interval) == (2.0, "")
    assert math.isnan(equal.low)
    values = np.array([2.0] * 20 + [9.0])
    measured = statistics.pooled(lambda rows: float(np.median(values[rows])), len(values))
    assert measured[:3] == (2.0, 2.0, 2.0), "one trial differs"


def test_a_trial_without_the_value_is_left_out() -> None:
    measured = statistics.mean([1.0, NAN, 3.0])
    assert (measured.value, measured.trials, measured.left_out) == (2.0, 2, 1)
    assert statistics.mean([1.0, 2.0, 3.0, 4.0]).trials == 4


def test_a_share_is_that_of_all_trials_together_and_a_trial_is_drawn_with_all_its_lies() -> None:
    measured = statistics.share([1.0, 0.0, 9.0, 3.0, 2.0], [1.0, 5.0, 10.0, 4.0, 2.0])
    assert measured.value == pytest.approx(15 / 22)
    assert 0.0 < measured.low < measured.value < measured.high <= 1.0
    # Nine trials with 1 lie each, one with 1000: the share depends on whether that one is drawn.
    measured = statistics.share([1.0] * 9 + [0.0], [1.0] * 9 + [1000.0])
    assert measured.low < 0.01
    assert measured.high == 1.0
    never = statistics.share([0.0] * 20, [7.0] * 20)
    assert (never.value, never.high) == (0.0, pytest.approx(1.0 - 0.025 ** (1 / 20)))


def test_rates_have_garwoods_interval() -> None:
    for events, low, high in ((0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)):  # Garwood (1936), table
        measured = statistics.rate(events, 3.0, 180)
        assert measured[:3] == pytest.approx((events / 3.0, low / 3.0, high / 3.0), rel=1e-3)


def test_several_runs_of_a_trial_count_as_one_in_the_interval() -> None:
    single, fourfold = (
        statistics.share_of_runs([[True], *[[False]] * 9]),
        statistics.share_of_runs([[True] * 4, *[[False] * 4] * 9]),
    )
    assert (single.value, single.low, single.high) == (0.1, *fourfold[1:3])
    assert single.high == pytest.approx(0.445, abs=1e-3), "Clopper and Pearson's for one of ten"
    assert (fourfold.value, fourfold.trials) == (0.1, 40)
    none = statistics.share_of_runs([[False]] * 72)
    assert none[:3] == (0.0, 0.0, pytest.approx(1.0 - 0.025 ** (1 / 72))), "fewer than 5 %"


def test_an_infinite_draw_makes_the_bound_infinite() -> None:
    times = np.array([1.0, 1.0, 1.0, math.inf, math.inf])
    assert statistics.pooled(lambda rows: float(np.median(times[rows])), 5)[:3] == (1.0, 1.0, math.inf)


@pytest.mark.parametrize(
    ("times", "detected", "time_s", "undetected", "median_s"),
    [
        ([1.0, 2.0, 3.0, 4.0], [True] * 4, [0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 0.75, 0.5, 0.25, 0.0], 2.0),
        # At 1 s one of four is detected; one is lost at 2 s; at 3 s one of the remaining two is detected.
        ([1.0, 2.0, 3.0, 5.0], [True, False, True, False], [0.0, 1.0, 3.0, 5.0], [1.0, 0.75, 0.375, 0.375], 3.0),
        ([1.0, 5.0, 6.0], [True, False, False], [0.0, 1.0, 6.0], [1.0, 2 / 3, 2 / 3], NAN),
        ([2.0, 2.0], [True, False], [0.0, 2.0], [1.0, 0.5], 2.0),  # both were watched until then
        ([], [], [0.0], [1.0], NAN),
    ],
)
def test_a_censored_time_counts_as_watched_until_then(
    times: list[float], detected: list[bool], time_s: list[float], undetected: list[float], median_s: float
) -> None:
    curve = kaplan_meier(times, detected)
    assert curve.time_s.tolist() == time_s
    assert curve.undetected.tolist() == pytest.approx(undetected)
    assert curve.median_s == pytest.approx(median_s, nan_ok=True)
    assert (curve.detections, curve.watched) == (sum(detected), len(times))


def test_negative_and_unknown_times_are_refused() -> None:
    for time_s in (-1.0, NAN):
        with pytest.raises(ValueError, match="time_s"):
            kaplan_meier([time_s], [True])
