"""Where a curve reaches one half."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.study.defences.breakdown import crossing


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
    crossed = crossing(x, shares)
    reached = [index for index, each in enumerate(shares) if each >= 0.5 - 1e-12]
    assert (crossed == math.inf) == (not reached)
    if reached:
        assert max(0, reached[0] - 1) <= crossed <= reached[0]
