"""Corridor, time to collision and braking, against shapely and simulation."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from metric_worlds import outline
from shapely import LineString

from mast_zenoh.metrics import Driving
from mast_zenoh.metrics.driving import (
    STANDING_MPS,
    RoadUsers,
    SafeDistance,
    TimeToCollision,
    VehicleCourse,
    time_to_collision,
)

LENGTH, WIDTH = 4.5, 1.8
PERIOD_S = 0.1


def vehicle(radius_m: float = math.inf, speed: float = 10.0, frames: int = 100, heading: float = 0.3) -> VehicleCourse:
    """A vehicle that drives a circle to the left, or straight ahead."""
    way = np.arange(frames) * PERIOD_S * speed
    turn = heading + way / radius_m
    if math.isinf(radius_m):
        place = way[:, None] * np.array([math.cos(heading), math.sin(heading)])
    else:
        place = radius_m * np.column_stack([np.sin(turn) - math.sin(heading), math.cos(heading) - np.cos(turn)])
    velocity = speed * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(frames)])
    return VehicleCourse(np.column_stack([place, np.zeros(frames)]), velocity, turn, LENGTH, WIDTH)


def objects(*rows: tuple[int, float, float, float, float, float], velocity=(0.0, 0.0)) -> RoadUsers:
    """Objects from (frame, x, y, yaw, length, width)."""
    table = np.array(rows, float).reshape(-1, 6)
    n = len(table)
    return RoadUsers(
        table[:, 0].astype(np.int64),
        np.column_stack([table[:, 1:3], np.zeros(n)]),
        np.tile([*velocity, 0.0], (n, 1)),
        np.column_stack([table[:, 4:6], np.full(n, 1.5)]),
        table[:, 3],
    )


def path_from(where: VehicleCourse, frame: int, horizon_m: float) -> LineString:
    """The path of a vehicle from a frame on, extended straight ahead."""
    last = where.heading[-1]
    end = where.position[-1, :2] + (horizon_m + LENGTH) * np.array([math.cos(last), math.sin(last)])
    return LineString([*where.position[frame:, :2], end])


@given(
    radius=st.sampled_from([math.inf, 12.0, 30.0, -15.0]),
    frame=st.integers(0, 60),
    forward=st.floats(-20.0, 60.0),
    lateral=st.floats(-7.0, 7.0),
    turn=st.sampled_from([0.0, math.pi / 2, math.pi, -math.pi / 2]),
    size=st.sampled_from([(4.5, 1.8), (8.0, 2.5), (0.6, 0.6)]),
)
def test_objects_that_touch_the_path_with_its_width_are_in_the_corridor(radius, frame, forward, lateral, turn, size):
    """Objects by arc length and offset from the path, without borderline cases."""
    speed = 5.0  # 50 m in 100 frames: less than a circle
    where = vehicle(radius, speed)
    margin, horizon = 0.3, 40.0
    way = path_from(where, frame, horizon)
    assume(0.0 < forward < way.length - 10.0 or forward < 0.0)
    if forward >= 0.0:
        at, beyond = way.interpolate(forward), way.interpolate(forward + 0.01)
        direction = math.atan2(beyond.y - at.y, beyond.x - at.x)
        x, y = at.x - lateral * math.sin(direction), at.y + lateral * math.cos(direction)
    else:
        direction = where.heading[frame]
        x = where.position[frame, 0] + forward * math.cos(direction) - lateral * math.sin(direction)
        y = where.position[frame, 1] + forward * math.sin(direction) + lateral * math.cos(direction)
    body = outline(x, y, direction + turn, *size)
    corridor = way.buffer(WIDTH / 2 + margin, cap_style="flat")
    doubt = corridor.boundary.distance(body) if not corridor.intersects(body) else corridor.intersection(body).area
    gap = forward - (size[0] if turn in (0.0, math.pi) else size[1]) / 2 - LENGTH / 2
    # A bend of the path beside a long object differs from its tangent, by this area.
    assume(doubt > max(0.05 if math.isinf(radius) else 1.0, size[0] ** 3 / (24.0 * abs(radius))))
    assume(abs(gap - horizon) > 1.0)
    assume(abs(forward) > 3.0)
    assume(math.hypot(x - where.position[frame, 0], y - where.position[frame, 1]) > 2.5)
    obstacles = Driving(horizon_m=horizon, margin_m=margin).ahead(
        where, objects((frame, x, y, direction + turn, *size))
    )
    itself = outline(*where.position[frame, :2], where.heading[frame], LENGTH, WIDTH)
    overlaps = itself.intersection(body).area > 1e-6
    assume(overlaps or itself.distance(body) > 0.01)
    expected = corridor.intersects(body) and forward > 0.0 and gap <= horizon and not overlaps
    assert len(obstacles.row) == expected
    assert len(obstacles.overlapping) == overlaps
    if expected:
        assert obstacles.gap_m[0] == pytest.approx(max(gap, 0.0), abs=0.05 if math.isinf(radius) else 0.6)


def test_an_object_beside_a_self_crossing_path_is_reached_on_the_return() -> None:
    """A circle of 75 m: from frame 100 (50 m) the object at the start is 25 m ahead."""
    obstacles = Driving().ahead(vehicle(12.0, 5.0, 200, 0.0), objects((100, 0.0, 0.0, 0.0, 4.5, 1.8)))
    assert obstacles.gap_m == pytest.approx([2 * math.pi * 12.0 - 50.0 - 4.5], abs=0.6)


@pytest.mark.parametrize(
    ("velocity", "closing"), [((0.0, 0.0), 10.0), ((10.0, 0.0), 0.0), ((0.0, 8.0), 10.0), ((-5.0, 0.0), 15.0)]
)
def test_closing_speed_is_measured_along_the_path(velocity: tuple[float, float], closing: float) -> None:
    ahead = Driving().ahead(vehicle(heading=0.0), objects((0, 30.0, 0.0, 0.0, 4.5, 1.8), velocity=velocity))
    assert ahead.ttc_s == pytest.approx([(30.0 - 4.5) / closing if closing else math.inf])


SPEED = st.floats(0.0, 40.0)


@given(gap=st.floats(0.0, 200.0), own=SPEED, other=st.floats(-20.0, 40.0))
def test_the_gap_closes_after_the_time_to_collision(gap: float, own: float, other: float) -> None:
    assume(abs(own - other) > 1e-6)
    seconds = time_to_collision(*(np.array([value]) for value in (gap, own, other)))[0]
    assert math.isinf(seconds) == (other > own)
    if not math.isinf(seconds):
        assert gap + (other - own) * seconds == pytest.approx(0.0, abs=1e-6)
    brakes = TimeToCollision(threshold_s=2.0).brakes(*(np.array([value]) for value in (gap, own, other)))[0]
    assert brakes == (own > STANDING_MPS and seconds < 2.0)


def stopping_gap(own: float, other: float, rule: SafeDistance, step_s: float = 2e-4) -> float:
    """The used gap, m, in the worst case of Responsibility-Sensitive Safety."""
    used = max_used = time_s = 0.0
    while own > 0.0 or time_s < rule.response_s:
        rate = rule.acceleration if time_s < rule.response_s else -rule.braking
        faster = max(0.0, own + rate * step_s)
        slower = max(0.0, other - rule.braking_ahead * step_s)
        used += ((own + faster) - (other + slower)) / 2.0 * step_s
        own, other, time_s = faster, slower, time_s + step_s
        max_used = max(max_used, used)
    return max_used


@given(
    own=st.floats(1.0, 30.0),
    other=st.floats(0.0, 30.0),
    response=st.floats(0.1, 1.5),
    acceleration=st.floats(0.0, 3.0),
    braking=st.floats(3.0, 6.0),
)
def test_the_safe_distance_is_that_of_the_worst_case(own, other, response, acceleration, braking):
    rule = SafeDistance(response_s=response, acceleration=acceleration, braking=braking, braking_ahead=8.0)
    used = stopping_gap(own, other, rule)
    assume(used > 0.1)
    for gap, brakes in ((used - 0.05, True), (used + 0.05, False)):
        assert rule.brakes(np.array([gap]), np.array([own]), np.array([other]))[0] == brakes


@given(gap=st.floats(0.0, 100.0), own=SPEED, other=st.floats(-20.0, 0.0))
def test_an_approaching_object_is_treated_as_stationary(gap: float, own: float, other: float) -> None:
    near, standing = (
        SafeDistance().brakes(np.array([gap]), np.array([own]), np.array([each])) for each in (other, 0.0)
    )
    assert near == standing


@given(own=st.floats(0.5, 40.0), other=SPEED, gap=st.floats(0.0, 100.0), more=st.floats(0.0, 50.0))
def test_braking_is_monotonic_in_speed_and_gap(own: float, other: float, gap: float, more: float) -> None:
    for rule in (SafeDistance(), TimeToCollision()):
        brakes = [
            bool(rule.brakes(np.array([g]), np.array([v]), np.array([other]))[0])
            for g, v in ((gap + more, own), (gap, own), (gap, own + more))
        ]
        assert brakes == sorted(brakes)
