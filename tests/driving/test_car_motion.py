"""A car along its lane and beside it: arcs, lanes, and what it can do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.driving.motion import CarLimits, Command, drive

ZERO = np.zeros(1)


def test_a_car_on_a_straight_lane_drives_circles_of_its_curvature() -> None:
    radius, angle = 12.0, 1.2
    motion = drive(ZERO, ZERO, np.array([radius * angle]), np.array([1.0 / radius]), ZERO)
    assert motion.along[0] == pytest.approx(radius * np.sin(angle), abs=1e-8)
    assert motion.offset[0] == pytest.approx(radius * (1.0 - np.cos(angle)), abs=1e-8)
    assert motion.turn[0] == pytest.approx(angle, abs=1e-12)


def test_a_car_with_the_curvature_of_its_lane_stays_in_its_middle() -> None:
    lanes = np.array([0.0, 0.1, -0.05])
    motion = drive(np.zeros(3), np.zeros(3), np.full(3, 7.0), lanes, lanes)
    assert motion.along == pytest.approx(7.0, abs=1e-12)
    assert motion.offset == pytest.approx(0.0, abs=1e-12)
    assert motion.turn == pytest.approx(0.0, abs=1e-12)


def test_a_car_inside_a_bend_gets_ahead_of_one_in_the_middle() -> None:
    lane, offset = 0.05, 2.0
    concentric = lane / (1.0 - lane * offset)
    motion = drive(np.array([offset]), ZERO, np.array([9.0]), np.array([concentric]), np.array([lane]))
    assert motion.offset[0] == pytest.approx(offset, abs=1e-9)
    assert motion.along[0] == pytest.approx(9.0 / (1.0 - lane * offset), abs=1e-9)


@given(
    offset=st.floats(-2.0, 2.0),
    turn=st.floats(-1.0, 1.0),
    parts=st.lists(st.floats(0.0, 3.0), min_size=1, max_size=4),
    curvature=st.floats(-0.1, 0.1),
    lane=st.floats(-0.1, 0.1),
)
def test_a_way_in_parts_leads_to_the_same_place(offset, turn, parts, curvature, lane):
    at, heading, along = np.array([offset]), np.array([turn]), 0.0
    once = drive(at, heading, np.array([sum(parts)]), np.array([curvature]), np.array([lane]))
    for part in parts:
        motion = drive(at, heading, np.array([part]), np.array([curvature]), np.array([lane]))
        along, at, heading = along + float(motion.along[0]), motion.offset, motion.turn
    assert [along, *at, *heading] == pytest.approx([once.along[0], once.offset[0], once.turn[0]], abs=1e-5)


@given(acceleration=st.floats(-1e6, 1e6), curvature=st.floats(-1e3, 1e3))
def test_the_nearest_command_is_never_refused_and_any_other_is_unless_it_is_the_nearest(acceleration, curvature):
    limits = CarLimits()
    nearest = limits.nearest(acceleration, curvature)
    assert limits.refusal(nearest) == ""
    assert bool(limits.refusal(Command(acceleration, curvature))) is (nearest != (acceleration, curvature))
