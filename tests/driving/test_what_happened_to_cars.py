"""What happened to a car, against independent computations: shapely, the text of RSS, scipy, plain Python."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.driving.braking import Belief, Commands
from mast_zenoh.driving.consequences import DrivenCar, collisions, consequences, uncomfortable_s
from mast_zenoh.driving.corridor import in_corridor, needed_braking
from mast_zenoh.driving.motion import HARD_BRAKING_MPS2, RouteAhead
from mast_zenoh.metrics.driving import Driving, RoadUsers, VehicleCourse

SIZE = (4.5, 1.9)


def car(x: list[float], speed: list[float]) -> VehicleCourse:
    """A car that drives east."""
    n = len(x)
    position, velocity = np.zeros((n, 3)), np.zeros((n, 3))
    position[:, 0], velocity[:, 0] = x, speed
    return VehicleCourse(position, velocity, np.zeros(n), *SIZE)


def objects(rows: list[tuple[int, float, float, float]]) -> RoadUsers:
    """Objects of 4 x 2 m, standing, by (frame, x, y, yaw)."""
    table = np.array(rows, np.float64).reshape(-1, 4)
    n = len(table)
    position = np.column_stack([table[:, 1:3], np.zeros(n)])
    return RoadUsers(
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


@given(gap=st.floats(0.01, 200.0), rear=speeds, front=st.floats(-60.0, 60.0))
def test_the_braking_needed_closes_the_gap_exactly_when_both_are_equally_fast(gap, rear, front):
    (found,) = needed_braking(np.array([gap]), np.array([rear]), np.array([front])).tolist()
    if rear <= front:
        assert found == 0.0
    elif rear - front > 1e-6:
        until = (rear - front) / found
        assert rear * until - found * until**2 / 2.0 - front * until == pytest.approx(gap, rel=1e-9)


@given(x=st.floats(8.0, 50.0), y=st.floats(-6.0, 6.0), speed=st.floats(-20.0, 20.0), own=st.floats(0.5, 20.0))
def test_gap_and_time_to_collision_in_the_corridor_are_those_of_the_outlines(x, y, speed, own):
    """On a straight road, by shapely: the gap is the distance of the outlines along the road."""
    other = objects([(0, x, y, 0.0)])
    other.velocity[0, 0] = speed
    driver = car([0.0], [own])
    found = in_corridor(driver, {0: straight(0.0)}, other, Driving(margin_m=0.3))
    front, back = outline(0.0, 0.0, 0.0, *SIZE).bounds[2], outline(x, y, 0.0, 4.0, 2.0).bounds[0]
    if abs(abs(y) - (SIZE[1] / 2.0 + 1.0 + 0.3)) < 1e-6:
        return  # beside the corridor or in it: a question of rounding
    if abs(y) > SIZE[1] / 2.0 + 1.0 + 0.3:
        assert not len(found.row)
        return
    assert found.gap_m.tolist() == pytest.approx([back - front], abs=1e-9)
    if own - speed > 1e-6:
        assert found.ttc_s.tolist() == pytest.approx([(back - front) / (own - speed)], rel=1e-9)


def straight(x: float, stop_m: float = math.inf, limit: float = 50.0) -> RouteAhead:
    """A straight road to the east."""
    return RouteAhead(np.column_stack([x + np.arange(80.0), np.zeros(80)]), np.full(80, limit), stop_m)


def driven(own: VehicleCourse, others: RoadUsers, ids: list[int], **known: object) -> DrivenCar:
    """A car in frames from 10, 0.1 s apart, on a straight road, whose driver knows what is there."""
    n = len(own.heading)
    order = np.argsort(others.frame, kind="stable")
    others, numbers = RoadUsers(*(column[order] for column in others)), np.array(ids, np.int64)[order]
    return replace(
        DrivenCar(
            car=own,
            objects=others,
            ids=numbers,
            seen=np.ones(len(ids), bool),
            known=np.ones(len(ids), bool),
            frames=10 + np.arange(n),
            times_s=0.1 * (10 + np.arange(n)),
            period_s=0.1,
            routes={row: straight(x) for row, x in enumerate(own.position[:, 0].tolist())},
            believed=others,
            belief=Belief(numbers, numbers, np.full(len(ids), "", object)),
            commands=Commands(np.arange(n), np.ones(n, bool), [""] * n),
            look=Driving(),
        ),
        **known,
    )


def of(own: VehicleCourse, others: RoadUsers, ids: list[int], **known: object) -> dict:
    return consequences(driven(own, others, ids, **known))


def test_the_first_contact_with_each_object_is_named_with_its_speed() -> None:
    own = car([0.0, 1.0, 2.0, 3.0], [10.0] * 4)
    rows = [(k, 5.5, 0.0, 0.0) for k in range(4)] + [(k, 20.0, 0.0, 0.0) for k in range(4)]
    found = of(own, objects(rows), [7] * 4 + [8] * 4)
    assert found["collisions"] == [{"object": 7, "frame": 12, "speed_mps": 10.0, "hidden": False}]


def test_an_object_was_hidden_if_the_car_saw_it_and_its_driver_did_not_know_it() -> None:
    own = car([0.0, 1.0, 2.0, 3.0], [10.0] * 4)
    rows = objects([(k, 5.5, 0.0, 0.0) for k in range(4)])
    for seen, known, hidden in [(1, 0, True), (1, 1, False), (0, 0, False)]:
        facts = dict(seen=np.full(4, bool(seen)), known=np.full(4, bool(known)))
        (contact,) = of(own, rows, [7] * 4, **facts)["collisions"]
        assert contact["hidden"] is hidden


@pytest.mark.parametrize(("frames_seen", "hidden"), [(1, False), (5, False), (6, True), (9, True)])
def test_an_object_was_hidden_only_if_the_car_saw_it_for_most_of_the_second_before(frames_seen, hidden):
    own = car([float(row) for row in range(14)], [10.0] * 14)
    rows = objects([(row, 14.5, 0.0, 0.0) for row in range(14)])
    seen = np.arange(14) >= 11 - frames_seen
    (contact,) = of(own, rows, [7] * 14, seen=seen, known=np.zeros(14, bool))["collisions"]
    assert (contact["frame"], contact["hidden"]) == (10 + 11, hidden)


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


def test_standing_blocked_and_unsafe_times_are_sums_of_frames() -> None:
    own = car([0.0, 1.0, 1.2, 1.2, 1.2], [10.0, 8.0, 0.1, 0.0, 0.0])
    found = of(own, objects([(k, 14.0, 0.0, 0.0) for k in range(5)]), [3] * 5)
    assert found["standing_s"] == pytest.approx(0.3)
    assert found["blocked_s"] == pytest.approx(0.3)  # what is ahead is 8.55 m away
    assert found["stops"] == 1
    assert found["rss_unsafe_s"] == pytest.approx(0.2)
    assert found["min_gap_m"] == pytest.approx(14.0 - 1.2 - 2.25 - 2.0)
    assert found["min_ttc_s"] == pytest.approx(min((14.0 - 4.25) / 10.0, (13.0 - 4.25) / 8.0))


def test_a_car_is_not_blocked_by_a_red_light_or_by_what_stands_ahead_and_has_not_stopped_before_it_moved() -> None:
    own = car([0.0] * 4, [0.0] * 4)
    assert of(own, objects([(k, 8.0, 0.0, 0.0) for k in range(4)]), [3] * 4)["blocked_s"] == 0.0
    red = {row: straight(0.0, stop_m=1.0) for row in range(4)}
    found = of(own, objects([]), [], routes=red)
    assert (found["blocked_s"], found["stops"]) == (0.0, 0)


def test_near_misses_are_objects_that_were_not_hit() -> None:
    """The gap is 5.75 m at 10 m/s: contact in 0.6 s, avoided by 8.7 m/s^2."""
    close = objects([(0, 10.0, 0.0, 0.0)])
    assert of(car([0.0, 0.5], [10.0, 5.0]), close, [4])["near_misses"] == 1
    hit = objects([(0, 10.0, 0.0, 0.0), (1, 10.0, 0.0, 0.0)])
    assert of(car([0.0, 6.0], [10.0, 10.0]), hit, [4, 4])["near_misses"] == 0
    assert of(car([0.0, 0.1], [1.0, 1.0]), close, [4])["near_misses"] == 0


@given(st.lists(st.tuples(st.floats(0, 20), st.floats(-3, 3)), min_size=20, max_size=40))
def test_uncomfortable_times_are_those_of_differences_smoothed_by_scipy(rows: list) -> None:
    from scipy.signal import savgol_filter  # slow, and nothing else needs it

    speed, heading = np.array(rows).T
    velocity = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros(len(rows))])
    own = VehicleCourse(np.zeros((len(rows), 3)), velocity, heading, *SIZE)
    change = np.diff(velocity[:, :2], axis=0) / 0.1
    direction = np.column_stack([np.cos(heading), np.sin(heading)])[:-1]
    forward = np.array([a @ b for a, b in zip(change, direction, strict=True)])
    jerk = savgol_filter(forward, 15, polyorder=2, deriv=1, delta=0.1)[7:-7]
    found = uncomfortable_s(own, 0.1)
    assert found["braking"] == pytest.approx(0.1 * np.count_nonzero(forward < -4.05))
    assert found["acceleration"] == pytest.approx(0.1 * np.count_nonzero(forward > 2.40))
    if not np.isclose(np.abs(jerk), 4.13, atol=1e-6).any():
        assert found["longitudinal_jerk"] == pytest.approx(0.1 * np.count_nonzero(np.abs(jerk) > 4.13))
