"""Intervals and crossings of the studies of limits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.study.defences.crossing import crossing
from mast_zenoh.study.defences.limit_intervals import bootstrap, share


def random() -> np.random.Generator:
    return np.random.default_rng(0)


def test_a_share_has_the_interval_of_clopper_and_pearson() -> None:
    # Textbook values: 8 of 10, and no failure in 10 trials, whose lower bound is the 10th root of 2.5 %.
    assert (share(8, 10).low, share(8, 10).high) == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert (share(10, 10).low, share(10, 10).high) == pytest.approx((0.025**0.1, 1.0))
    assert share(0, 10).low == 0.0


def test_a_share_of_nothing_is_unknown() -> None:
    assert not share(0, 0).known


def test_a_bootstrap_of_equal_units_has_no_spread() -> None:
    measured = bootstrap([2.0] * 5, lambda units: float(np.mean(units)), random())
    assert (measured.value, measured.low, measured.high) == (2.0, 2.0, 2.0)


def test_a_bootstrap_covers_the_values_of_its_units() -> None:
    measured = bootstrap([0.0, 1.0] * 50, lambda units: float(np.mean(units)), random())
    assert (measured.low, measured.high) == pytest.approx((0.4, 0.6), abs=0.02)


def test_a_statistic_beyond_what_was_watched_stays_infinite() -> None:
    measured = bootstrap([1.0, math.inf, math.inf], max, random())
    assert (measured.value, measured.high) == (math.inf, math.inf)


def test_one_unit_has_no_interval() -> None:
    assert math.isnan(bootstrap([1.0], max, random()).low)


def test_a_crossing_lies_between_its_neighbours() -> None:
    assert crossing([0.2, 0.4, 0.6], [0.0, 0.25, 0.75]) == pytest.approx(0.5)
    assert crossing([0.2, 0.4], [0.0, 0.5]) == pytest.approx(0.4)


def test_a_crossing_is_the_first_one() -> None:
    assert crossing([0.0, 0.2, 0.4, 0.6], [0.0, 1.0, 0.0, 1.0]) == pytest.approx(0.1)


def test_what_is_never_reached_is_infinite() -> None:
    assert crossing([0.0, 0.5], [0.0, 0.49]) == math.inf


def test_what_is_reached_from_the_beginning_is_there() -> None:
    assert crossing([0.0, 0.5], [0.7, 1.0]) == 0.0


def test_a_crossing_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="x: found no points"):
        crossing([], [])


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=10))
def test_a_crossing_is_never_before_a_point_below_the_level(shares: list[float]) -> None:
    x = np.arange(len(shares), dtype=float)
    found = crossing(x, shares)
    reached = [index for index, each in enumerate(shares) if each >= 0.5 - 1e-12]
    assert (found == math.inf) == (not reached)
    if reached:
        assert max(0, reached[0] - 1) <= found <= reached[0]
