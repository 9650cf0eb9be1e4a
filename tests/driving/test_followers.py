"""The traffic behind a driven car: who is in its lane, and how they brake."""

import tracemalloc

import numpy as np
import pytest

from mast_zenoh.driving.followers import Onset, behind, behind_car, shock_wave
from mast_zenoh.metrics.driving import RoadUsers, VehicleCourse
from tests.driving.test_what_happened_to_cars import SIZE, car, objects


def test_who_is_behind_in_the_lane_and_points_the_same_way() -> None:
    own = car([0.0, 10.0], [10.0, 10.0])
    cases = [
        ((1, 0.0, 0.0, 0.0), True),
        ((1, -60.0, 1.5, 0.1), True),
        ((1, 30.0, 0.0, 0.0), False),  # ahead
        ((1, 0.0, 3.5, 0.0), False),  # in the next lane
        ((1, 0.0, 0.0, np.pi), False),  # comes the other way
        ((1, -120.0, 0.0, 0.0), False),  # far away
        ((0, 5.0, 0.0, 0.0), False),  # where the car will have been
    ]
    found = behind(own, objects([row for row, _ in cases]))
    assert np.isfinite(found).tolist() == [expected for _, expected in cases]


def test_the_lane_behind_a_car_that_turned_is_the_bend_that_it_drove() -> None:
    angle = np.linspace(0.0, np.pi / 2.0, 40)
    position = np.column_stack([20.0 * np.sin(angle), 20.0 * (1.0 - np.cos(angle)), np.zeros(40)])
    own = VehicleCourse(position, np.tile([10.0, 0.0, 0.0], (40, 1)), angle, *SIZE)
    there, straight_on = (39, 20.0 * np.sin(0.7), 20.0 * (1.0 - np.cos(0.7)), 0.7), (39, 30.0, 0.0, 0.0)
    assert np.isfinite(behind(own, objects([there, straight_on]))).tolist() == [True, False]


def test_hard_brakes_and_standing_times_of_followers_are_sums_over_cars() -> None:
    own = car([50.0] * 6, [0.0] * 6)
    rows = objects([(row, x, 0.0, 0.0) for x in (30.0, 20.0, 90.0) for row in range(6)])
    speed = np.array([10.0, 9.0, 9.0, 8.0, 8.0, 8.0, 1.0, 0.5, 0.2, 0.0, 0.0, 0.0, *[9.0, 1.0] * 3])
    velocity = np.column_stack([speed, np.zeros(18), np.zeros(18)])
    others = RoadUsers(rows.frame, rows.position, velocity, rows.size, rows.yaw)
    found = behind_car(own, others, np.repeat([1, 2, 3], 6), 0.1, 4.05, [])
    assert (found["cars"], found["hard_brakes"]) == (2, 3)
    assert found["hardest_braking_mps2"] == pytest.approx(10.0)
    assert found["standing_s"] == pytest.approx(0.4)


def test_a_long_run_needs_no_memory_for_every_pair_of_an_object_and_a_place_of_the_car() -> None:
    frames = 1500
    x = np.arange(float(frames))
    own = car(x.tolist(), [10.0] * frames)
    others = objects([(row, row - 20.0, 0.0, 0.0) for row in range(frames)])
    tracemalloc.start()
    try:
        assert behind(own, others).all()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < frames * frames * 8 / 4, "less than a quarter of one number for each pair"


def test_a_shock_wave_runs_through_the_cars_that_brake_one_after_the_other() -> None:
    own = [Onset(5, 80.0), Onset(10, 100.0)]
    chain = [Onset(20, 82.0), Onset(32, 65.0), Onset(41, 45.0)]
    elsewhere = [Onset(8, 60.0), Onset(15, 120.0), Onset(200, 20.0)]  # before, ahead, and much later
    reached, speed = shock_wave(own, [*elsewhere, *chain], 0.1)
    assert reached == 3
    expected = np.polyfit([1.0, 2.0, 3.2, 4.1], [100.0, 82.0, 65.0, 45.0], 1)[0]
    assert speed == pytest.approx(expected)
    assert speed < -15.0


def test_the_delay_of_followers_is_the_time_lost_against_their_greatest_speed_until_then() -> None:
    own = car([50.0] * 5, [0.0] * 5)
    rows = objects([(row, 30.0, 0.0, 0.0) for row in range(5)])
    velocity = np.column_stack([[5.0, 10.0, 5.0, 0.0, 20.0], np.zeros(5), np.zeros(5)])
    others = RoadUsers(rows.frame, rows.position, velocity, rows.size, rows.yaw)
    found = behind_car(own, others, np.ones(5, np.int64), 0.1, 4.05, [])
    assert found["delay_s"] == pytest.approx(0.1 * (0.5 + 1.0))
