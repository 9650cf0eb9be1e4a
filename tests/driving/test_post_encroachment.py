"""The time between a car and what crosses its way, against a computation with shapely over all pairs of frames."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh.driving.consequences import post_encroachment_s
from tests.driving.test_what_happened_to_cars import SIZE, car, objects, outline

FRAMES, PERIOD_S = 24, 0.25


def crossing(speed: float, x: float, start: float, yaw: float = math.pi / 2) -> list[tuple[int, float, float, float]]:
    """An object that drives along `yaw` through (x, 0), `start` m before it at first."""
    along = [speed * PERIOD_S * row - start for row in range(FRAMES)]
    return [(row, x + at * math.cos(yaw), at * math.sin(yaw), yaw) for row, at in enumerate(along)]


def eastward(speed: float) -> list[float]:
    return [speed * PERIOD_S * row for row in range(FRAMES)]


def test_it_is_the_time_from_the_end_of_one_to_the_beginning_of_the_other() -> None:
    # The car's rear leaves x = 11 m, the far side of the other's way, at 13.25 m / 10 m/s; the other's front reaches
    # the near side of the car's way, y = -0.95 m, after 27.05 m at 10 m/s.
    own = car(eastward(10.0), [10.0] * FRAMES)
    found = post_encroachment_s(own, objects(crossing(10.0, 10.0, 30.0)), PERIOD_S)
    assert found == pytest.approx((27.05 - 13.25) / 10.0, abs=PERIOD_S)


def test_who_follows_and_who_is_far_away_in_time_does_not_count() -> None:
    own = car(eastward(10.0), [10.0] * FRAMES)
    assert post_encroachment_s(own, objects(crossing(10.0, 0.0, 12.0, yaw=0.0)), PERIOD_S) is None
    assert post_encroachment_s(own, objects(crossing(0.5, 0.0, 40.0)), PERIOD_S) is None
    assert post_encroachment_s(own, objects([]), PERIOD_S) is None


def test_a_collision_is_a_time_of_zero() -> None:
    own = car(eastward(10.0), [10.0] * FRAMES)
    assert post_encroachment_s(own, objects(crossing(10.0, 20.0, 20.0)), PERIOD_S) == 0.0


@settings(max_examples=15)
@given(st.floats(2.0, 15.0), st.floats(2.0, 15.0), st.floats(0.0, 40.0), st.floats(0.7, 2.4))
def test_it_agrees_with_all_pairs_of_outlines(own_mps: float, mps: float, start: float, yaw: float) -> None:
    own, rows = car(eastward(own_mps), [own_mps] * FRAMES), crossing(mps, 15.0, start, yaw)
    cars = [outline(x, 0.0, 0.0, *SIZE) for x in own.position[:, 0]]
    others = [outline(x, y, yaw, 4.0, 2.0) for _, x, y, _ in rows]
    areas = np.array([[mine.intersection(other).area for other in others] for mine in cars])
    if ((areas > 0.0) & (areas < 1e-4)).any():  # touching or not is a question of rounding
        return
    apart = [abs(i - j) for i, j in np.argwhere(areas > 0.0).tolist()]
    expected = min((each for each in apart if each * PERIOD_S <= 5.0), default=None)
    found = post_encroachment_s(own, objects(rows), PERIOD_S)
    assert found == (None if expected is None else expected * PERIOD_S)
