"""The shipped driver: follows its lane, the car ahead and lines, and brakes in an emergency."""

import numpy as np
import pytest
from roads import LENGTH, cars, situation, straight

from mast_zenoh.driving import CarLimits, FollowingDriver, RouteAhead
from mast_zenoh.driving.motion import drive

STEP_S = 0.1


def driven(speed: float, ahead, seconds: float, limit: float = 14.0, line: float = np.inf):
    """Position and speed of a car after a while on a straight lane."""
    driver, x, hardest = FollowingDriver(), 0.0, 0.0
    for _ in range(round(seconds / STEP_S)):
        stop = line - x - LENGTH / 2.0
        command = driver.drive(situation(x, speed, ahead, straight(x, limit, stop)))
        hardest = min(hardest, command.acceleration)
        new = max(speed + command.acceleration * STEP_S, 0.0)
        x += (speed + new) / 2.0 * STEP_S
        speed = new
    return x, speed, hardest


def test_it_stops_behind_a_standing_car_without_hard_braking() -> None:
    x, speed, hardest = driven(12.0, cars((80.0, 0.0, 0.0)), 60.0)
    assert speed < 0.1
    assert 80.0 - LENGTH - x == pytest.approx(2.0, abs=0.3)
    assert hardest > -3.0


def test_it_stops_before_the_line_and_not_far_from_it() -> None:
    x, speed, _ = driven(12.0, cars(), 60.0, line=90.0)
    assert speed < 0.1
    assert 0.3 < 90.0 - LENGTH / 2.0 - x < 1.5


def test_it_ignores_what_is_beside_its_lane_and_itself() -> None:
    alone = driven(8.0, cars(), 2.0)
    assert driven(8.0, cars((30.0, 3.5, 0.0), (20.0, -3.5, 0.0)), 2.0) == alone
    own = FollowingDriver().drive(situation(0.0, 8.0, cars((0.4, 0.1, 8.0)), straight(0.0, 14.0)))
    assert own == FollowingDriver().drive(situation(0.0, 8.0, cars(), straight(0.0, 14.0)))


def test_it_brakes_as_hard_as_it_can_when_a_collision_is_near() -> None:
    limits = CarLimits()
    near = situation(0.0, 12.0, cars((20.0, 0.0, 0.0)), straight(0.0, 14.0))
    assert FollowingDriver().drive(near).acceleration == -limits.braking
    far = situation(0.0, 12.0, cars((40.0, 0.0, 0.0)), straight(0.0, 14.0))
    assert -limits.braking < FollowingDriver().drive(far).acceleration < 0.0


def test_it_slows_down_in_time_for_a_bend() -> None:
    route = straight(0.0, 14.0)
    route.speed[30:] = 5.0
    fast = FollowingDriver().drive(situation(0.0, 14.0, cars(), route))
    assert fast.acceleration < -1.0
    assert FollowingDriver().drive(situation(0.0, 9.0, cars(), route)).acceleration > 0.0


def test_it_returns_to_the_middle_of_a_bend() -> None:
    """Pure pursuit on a circle of 20 m: the rest is what it cuts the corner by."""
    curvature, speed = 1.0 / 20.0, 6.0
    offset, turn, along = np.array([0.8]), np.array([0.1]), 0.0
    for _ in range(60):
        angles = (along + np.arange(60.0)) * curvature
        points = np.column_stack([np.sin(angles), 1.0 - np.cos(angles)]) / curvature
        here = angles[0]
        normal = np.array([-np.sin(here), np.cos(here)])
        place = points[0] + offset[0] * normal
        route = RouteAhead(points, np.full(60, speed), np.inf)
        at = situation(place[0], speed, cars(), route, place[1], here + float(turn[0]))
        command = FollowingDriver().drive(at)
        motion = drive(offset, turn, np.array([speed * 0.1]), np.array([command.curvature]), np.array([curvature]))
        along, offset, turn = along + float(motion.along[0]), motion.offset, motion.turn
    assert abs(offset[0]) < 0.5
