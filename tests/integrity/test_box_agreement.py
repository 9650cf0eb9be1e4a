"""Two sets of boxes agree as far as their boxes are matched."""

import numpy as np
import plain_boxes as plain
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.integrity.consensus import agreement, outline_iou

CAR: plain.Box = (0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0)


def at(x: float, y: float) -> plain.Box:
    return (x, y, *CAR[2:])


@given(one=plain.boxes, other=plain.boxes)
def test_the_overlap_of_two_boxes_is_that_of_their_clipped_outlines(one: plain.Box, other: plain.Box) -> None:
    a, b = plain.boxes_of([one]), plain.boxes_of([other])
    found = outline_iou(b.position[:, :2] - a.position[:, :2], a.size, a.yaw, b.size, b.yaw)
    assert found == pytest.approx([plain.iou(one, other)], abs=1e-6)


@given(
    one=st.lists(plain.boxes, max_size=4),
    other=st.lists(plain.boxes, max_size=5),
    least_iou=st.sampled_from([0.1, 0.3, 0.5]),
)
def test_the_index_is_that_of_the_best_of_all_matchings(one, other, least_iou):
    found = agreement(plain.boxes_of(one), plain.boxes_of(other), least_iou)
    assert found == pytest.approx(plain.jaccard(one, other, least_iou))


def test_boxes_move_with_their_velocities() -> None:
    cars = plain.boxes_of([at(0.0, 0.0)])
    cars.velocity[:] = (10.0, -5.0, 0.0)
    assert cars.moved(0.2).position == pytest.approx(np.array([[2.0, -1.0, 0.75]]))
