"""Means and their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from mast_zenoh.study.statistics import Moments, interval, pooled


def test_moments_of_trials_pool_to_those_of_all_their_frames() -> None:
    rng = np.random.default_rng(0)
    trials = [rng.normal(k, 1.0 + k, 5 + 3 * k) for k in range(4)]
    everything = np.concatenate(trials)
    found = pooled([Moments(len(t), float(t.mean()), float(t.std())) for t in trials])
    assert found == pytest.approx((everything.mean(), everything.std()))
    assert np.isnan(pooled([])).all()


def test_the_interval_is_the_same_every_time_and_another_for_another_seed() -> None:
    values = np.random.default_rng(1).exponential(size=20)
    assert interval(values, 0, "fp") == interval(values, 0, "fp")
    assert interval(values, 0, "fp") != interval(values, 1, "fp")
    low, high = interval(values, 0, "fp")
    assert low < values.mean() < high


def test_the_interval_covers_the_mean_about_as_often_as_it_says() -> None:
    """200 samples of 20: the number that cover is 190 in theory; below 176 has a chance of one in ten thousand."""
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        low, high = interval(rng.normal(3.0, 1.0, 20), 0)
        hits += low <= 3.0 <= high
    assert hits >= 176


def test_of_one_trial_there_is_no_interval_and_of_equal_ones_it_is_a_point() -> None:
    assert np.isnan(interval(np.array([1.0]), 0)).all()
    assert interval(np.full(5, 2.5), 0) == (2.5, 2.5)
