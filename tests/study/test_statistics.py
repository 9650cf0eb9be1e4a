"""Intervals of means and rates over trials, and their simulated coverage."""

from __future__ import annotations

import interval_coverage
import numpy as np
import pytest
from scipy import stats

from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.study.statistics import (
    Moments,
    clopper_pearson,
    over_scenes,
    over_seeds,
    p_value_of_zero_mean,
    pooled_moments,
    rate_interval,
    value_range,
)


def sample(scenes: int, seeds: int, of: int = 0) -> np.ndarray:
    return np.random.default_rng(of).normal(3.0, 1.0, (scenes, seeds))


def test_pooled_moments_of_trials_equal_the_moments_of_all_frames() -> None:
    rng = np.random.default_rng(0)
    trials = [rng.normal(k, 1.0 + k, 5 + 3 * k) for k in range(4)]
    everything = np.concatenate(trials)
    result = pooled_moments([Moments(len(t), float(t.mean()), float(t.std())) for t in trials])
    assert result == pytest.approx((everything.mean(), everything.std()))
    assert np.isnan(pooled_moments([])).all()


def test_interval_over_seeds_is_students_t_over_the_averages_of_the_seeds() -> None:
    values = sample(3, 20)
    averages = values.mean(axis=0)
    expected = stats.t.interval(0.95, 19, averages.mean(), stats.sem(averages))
    assert over_seeds(values) == pytest.approx(expected)
    assert p_value_of_zero_mean(values) == pytest.approx(stats.ttest_1samp(averages, 0.0).pvalue)


@pytest.mark.parametrize("interval", [over_seeds, rate_interval, over_scenes])
def test_fewer_than_five_seeds_have_no_interval(interval) -> None:
    assert np.isnan(interval(np.array([[0.0, 1.0, 1.0, 0.0]] * 6))).all()
    assert not np.isnan(interval(np.array([[0.0, 1.0, 1.0, 0.0, 1.0]] * 6))).any()


def test_equal_seeds_have_no_interval_of_the_mean_and_no_test() -> None:
    for values in (np.zeros((3, 8)), np.full((3, 8), 2.5), np.full((1, 5), 0.1) + 0.2):
        assert np.isnan(over_seeds(values)).all()
        assert np.isnan(p_value_of_zero_mean(values))


def test_interval_for_other_scenes_is_wider_than_over_seeds_if_scenes_differ() -> None:
    values = sample(8, 20) + np.linspace(-4.0, 4.0, 8)[:, None]
    low, high = over_scenes(values)
    inner_low, inner_high = over_seeds(values)
    assert low < inner_low < inner_high < high


def test_interval_for_other_scenes_includes_effects_shared_by_all_scenes_of_a_seed() -> None:
    """With independent seeds the variance is that of the seed averages."""
    values = np.repeat(sample(1, 20), 8, axis=0)
    assert over_scenes(values) == pytest.approx(over_seeds(values))


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (3, 20), (20, 20), (5, 5)])
def test_rate_of_one_scene_has_the_interval_of_clopper_and_pearson(successes: int, trials: int) -> None:
    values = (np.arange(trials) < successes).astype(np.float64)[None]
    expected = stats.binomtest(successes, trials).proportion_ci(0.95, "exact")
    assert rate_interval(values) == pytest.approx((expected.low, expected.high))


def test_rate_of_independent_scenes_counts_each_trial() -> None:
    values = (np.random.default_rng(1).random((10, 60)) < 0.4).astype(np.float64)
    expected = stats.binomtest(int(values.sum()), 600).proportion_ci(0.95, "exact")
    assert rate_interval(values) == pytest.approx((expected.low, expected.high), abs=0.02)


def test_rates_of_0_and_1_have_intervals_of_positive_width() -> None:
    assert rate_interval(np.zeros((3, 10))) == pytest.approx((0.0, 0.308), abs=1e-3), "of 10 seeds, not of 30 trials"
    assert rate_interval(np.ones((3, 10))) == pytest.approx((0.692, 1.0), abs=1e-3)
    assert rate_interval(np.zeros((1, 10))).low == 0.0


def test_batched_intervals_equal_individual_ones() -> None:
    values = np.stack([sample(6, 12, of) for of in range(4)])
    for interval in (over_seeds, over_scenes):
        np.testing.assert_allclose(np.transpose(interval(values)), [interval(each) for each in values])
    hits = (values > 3.0).astype(np.float64)
    np.testing.assert_allclose(np.transpose(rate_interval(hits)), [rate_interval(each) for each in hits])


def test_the_interval_of_an_effective_number_of_trials_is_between_those_of_whole_numbers() -> None:
    widths = [interval.high - interval.low for interval in (clopper_pearson(n / 4, n) for n in (8.0, 8.5, 9.0))]
    assert widths[0] > widths[1] > widths[2]


Coverage = dict[str, dict[tuple[int, int], float]]


@pytest.fixture(scope="module")
def simulated() -> Coverage:
    return interval_coverage.table()


@pytest.mark.heavy
@pytest.mark.parametrize("world", list(interval_coverage.worlds()), ids=lambda world: world.name)
def test_claimed_intervals_cover_93_to_97_per_cent(simulated: Coverage, world: interval_coverage.World) -> None:
    claimed = {
        cell: percent
        for cell, percent in simulated[world.name].items()
        if world.claimed is not None and cell[1] >= world.claimed
    }
    assert all(93.0 <= percent <= 97.0 for percent in claimed.values()), claimed


@pytest.mark.heavy
def test_intervals_of_success_rates_cover_at_least_95_per_cent(simulated: Coverage) -> None:
    rates = {name: cells for name, cells in simulated.items() if name.startswith("success rate")}
    assert len(rates) == 6
    assert min(min(cells.values()) for cells in rates.values()) >= 95.0


@pytest.mark.heavy
def test_intervals_of_added_missed_objects_cover_at_least_93_per_cent_with_any_number_of_seeds(
    simulated: Coverage,
) -> None:
    """A t interval for every mean covers 78 % with five seeds."""
    for attack in ("uncoordinated-2", "coordinated-2"):
        assert min(simulated[f"missed objects added, {attack}"].values()) >= 93.0
    assert simulated["missed objects added, uncoordinated-2, t for every mean"][1, 5] < 80.0


@pytest.mark.heavy
def test_three_correlated_scenes_of_twenty_seeds_are_covered(simulated: Coverage) -> None:
    """A bootstrap that treats scenes and seeds as independent covers 71 % here."""
    assert 93.0 <= simulated["normal, scenes of a seed correlate at 0.98"][3, 20] <= 97.0


def test_shares_of_pictures_and_of_the_channel_end_at_one() -> None:
    assert value_range(StudySeries("all", "pictures", "deceived.share")) == (0.0, 1.0)
    assert value_range(StudySeries("all", "channel", "busy_ratio")) == (0.0, 1.0)
    assert value_range(StudySeries("all", "pictures", "difference_gospa_m")) == (0.0, np.inf)
