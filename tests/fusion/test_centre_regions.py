"""Regions of centres cover the ground without gaps, and each point belongs to one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mast_zenoh.fusion.regions import Around, Rectangle

POINTS = arrays(np.float64, (5, 2), elements=st.floats(-1e4, 1e4))


@given(POINTS, st.floats(-100, 100))
def test_a_border_divides_the_ground(points: np.ndarray, border: float) -> None:
    west, east = Rectangle(x_max_m=border), Rectangle(x_min_m=border)
    assert (west.contains(points) ^ east.contains(points)).all()
    assert (west.contains(points, 1.0) | east.contains(points, 1.0)).all()


@given(POINTS, st.floats(0.0, 50.0))
def test_a_margin_only_adds_points(points: np.ndarray, margin: float) -> None:
    for region in (Rectangle(-10.0, 10.0, -5.0, 5.0), moved(Around(20.0))):
        assert region.contains(points, margin)[region.contains(points)].all()


def moved(region: Around, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Around:
    region.move_to(np.array(place))
    return region


def test_a_circle_moves_with_its_agent_and_is_empty_before() -> None:
    points = np.array([[0.0, 0.0], [100.0, 0.0]])
    region = Around(30.0)
    assert region.contains(points).tolist() == [False, False]
    assert moved(region).contains(points).tolist() == [True, False]
    assert moved(region, (90.0, 0.0, 5.0)).contains(points).tolist() == [False, True]
