"""What happened to a car, against independent computations: shapely, the text of RSS, plain Python."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.driving.consequences import HARD_BRAKING_MPS2, collisions, consequences
from mast_zenoh.metrics.driving import Drive, Driving, Objects, SafeDistance, Vehicle, time_to_collision

SIZE = (4.5, 1.9)


def car(x: list[float], speed: list[float]) -> Vehicle:
    """A car that drives east."""
    n = len(x)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    position[:, 0], velocity[:, 0] = x, speed
    return Vehicle(position, velocity, np.zeros(n), *SIZE)


def objects(rows: list[tuple[int, float, float, float]]) -> Objects:
    """Objects of 4 x 2 m, standing, by (frame, x, y, yaw)."""
    table = np.array(rows, np.float64).reshape(-1, 4)
    n = len(table)
    position = np.column_stack([table[:, 1:3], np.zeros(n)])
    return Objects(
        table[:, 0].astype(np.int64), position, np.zeros((n, 3)), np.tile([4.0, 2.0, 1.5], (n, 1)), table[:, 3]
    )


def outline(x: float, y: float, yaw: float, length: float, width: float) -> shapely.Polygon:
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return shapely.affinity.translate(shapely.affinity.rotate(box, math.degrees(yaw), origin=(0, 0)), x, y)


places = st.tuples(st.integers(0, 2), st.floats(-8, 8), st.floats(-8, 8), st.floats(-4, 4))


@given(st.lists(places, max_size=12))
def test_a_car_collides_with_what_its_outline_overlaps_in_the_same_frame(rows: list) -> None:
    own = car([0.0, 1.0, 2.0], [10.0] * 3)
    hit = set(collisions(own, objects(rows)).tolist())
    for row, (frame, x, y, yaw) in enumerate(rows):
        area = outline(float(frame), 0.0, 0.0, *SIZE).intersection(outline(x, y, yaw, 4.0, 2.0)).area
        if area > 1e-4 or area == 0.0:  # touching or not is a question of rounding
            assert (row in hit) is (area > 0.0)


speeds = st.floats(0.0, 60.0)


@given(rear=speeds, front=speeds, response=st.floats(0.0, 2.0), gas=st.floats(0.0, 4.0), brakes=st.floats(1.0, 9.0))
def test_the_safe_distance_is_that_of_the_definition(
    rear: float, front: float, response: float, gas: float, brakes: float
) -> None:
    """RSS, Definition 1: the distance such that both stop without contact, by integrating both motions."""
    rule = SafeDistance(response_s=response, acceleration=gas, braking=brakes, braking_ahead=8.0)
    (found,) = rule.distance_m(np.array([rear]), np.array([front])).tolist()
    during = (rear + (rear + gas * response)) / 2.0 * response
    stopping = (rear + gas * response) / 2.0 * ((rear + gas * response) / brakes)
    ahead = front / 2.0 * (front / 8.0)
    assert found == pytest.approx(max(during + stopping - ahead, 0.0), abs=1e-9, rel=1e-9)


@given(gap=st.floats(0.0, 200.0), rear=speeds, front=st.floats(-60.0, 60.0))
def test_the_time_to_collision_is_when_the_gap_is_closed(gap: float, rear: float, front: float) -> None:
    (found,) = time_to_collision(np.array([gap]), np.array([rear]), np.array([front])).tolist()
    if rear - front > 1e-9:
        assert gap + found * front == pytest.approx(found * rear, abs=1e-9 * max(1.0, found * max(rear, abs(front))))
    else:
        assert math.isinf(found)


def of(own: Vehicle, others: Objects, ids: list[int]) -> dict:
    """The consequences in frames from 10, 0.1 s apart."""
    n = len(own.heading)
    ahead = Driving().ahead(own, others)
    gap, ttc = np.full(n, np.inf), np.full(n, np.inf)
    np.minimum.at(gap, others.frame[ahead.row], ahead.gap_m)
    np.minimum.at(ttc, others.frame[ahead.row], ahead.ttc_s)
    brake = np.bincount(others.frame[ahead.row[ahead.brake]], minlength=n) > 0
    none, never = np.zeros(n, np.int64), np.zeros(n, bool)
    drive = Drive(none, none, none, none, gap, ttc, brake, never, never, never)
    return consequences(own, others, np.array(ids, np.int64), 10 + np.arange(n), drive, 0.1)


def test_the_first_contact_with_each_object_is_named_with_its_speed() -> None:
    own = car([0.0, 1.0, 2.0, 3.0], [10.0] * 4)
    rows = [(k, 5.5, 0.0, 0.0) for k in range(4)] + [(k, 20.0, 0.0, 0.0) for k in range(4)]
    found = of(own, objects(rows), [7] * 4 + [8] * 4)
    assert found["collisions"] == [{"object": 7, "frame": 12, "speed_mps": 10.0}]


def test_hard_braking_counts_by_episode_and_its_extremes_are_those_of_plain_differences() -> None:
    hard = HARD_BRAKING_MPS2 + 0.1
    changes = [0.0, -hard, -hard, 0.0, -1.0, -hard, 2.0]
    speed = [20.0]
    for change in changes:
        speed.append(speed[-1] + change * 0.1)
    x = np.cumsum([0.0, *[0.1 * value for value in speed[1:]]]).tolist()
    found = of(car(x, speed), objects([]), [])
    assert found["hard_brakes"] == 2
    assert found["hardest_braking_mps2"] == pytest.approx(hard)
    assert found["jerk_max_mps3"] == pytest.approx((2.0 + hard) / 0.1)
    assert found["progress_m"] == pytest.approx(x[-1] - x[0])
    assert (found["min_gap_m"], found["min_ttc_s"], found["collisions"]) == (None, None, [])


def test_standing_and_unsafe_times_are_sums_of_frames() -> None:
    own = car([0.0, 1.0, 1.2, 1.2, 1.2], [10.0, 8.0, 0.1, 0.0, 0.0])
    found = of(own, objects([(k, 14.0, 0.0, 0.0) for k in range(5)]), [3] * 5)
    assert found["standing_s"] == pytest.approx(0.3)
    assert found["unsafe_s"] == pytest.approx(0.2)
    assert found["min_gap_m"] == pytest.approx(14.0 - 1.2 - 2.25 - 2.0)
    assert found["min_ttc_s"] == pytest.approx(min((14.0 - 4.25) / 10.0, (13.0 - 4.25) / 8.0))
