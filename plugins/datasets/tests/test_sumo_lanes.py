"""Where a driven car goes in SUMO's lanes, how fast, and where it has to stop."""

from __future__ import annotations

import numpy as np
import pytest
from mast_datasets.sumo_lanes import HORIZON_M, Priority, StopLine, SumoLane, way_from
from mast_datasets.sumo_simulation import Foe

#: A street of 100 m to the east, a junction of 10 m, and then 100 m to the east or to the north.
LANES = {
    "in_0": SumoLane(np.array([[0.0, 0.0], [100.0, 0.0]]), 14.0, [("left_0", ":J_1_0", "l"), ("on_0", ":J_0_0", "s")]),
    ":J_0_0": SumoLane(np.array([[100.0, 0.0], [110.0, 0.0]]), 14.0, [("on_0", "", "s")]),
    ":J_1_0": SumoLane(np.array([[100.0, 0.0], [107.0, 3.0], [110.0, 10.0]]), 14.0, [("left_0", "", "l")]),
    "on_0": SumoLane(np.array([[110.0, 0.0], [210.0, 0.0]]), 8.0, []),
    "left_0": SumoLane(np.array([[110.0, 10.0], [110.0, 110.0]]), 14.0, [("in_0", "", "s")]),
}
LINE = StopLine(100.0, "in_0", 1, ":J_0_0")


def foe(**other: object) -> Foe:
    usual = dict(name="other", distance=22.0, foe_distance=22.0, exit=28.0, foe_exit=28.0)
    return Foe(**usual | dict(lane=":J_0_0", yields=True, is_inside=False) | other)  # type: ignore[arg-type]


def stop(priority: Priority, distance: float, state: str, speed: float, foes: list[tuple[Foe, float]]) -> float:
    return priority.stop([(LINE, distance, state)], speed, 4.5, foes)


def test_a_way_follows_the_route_of_its_car() -> None:
    way = way_from("in_0", ["left", "in"], 150.0, LANES.__getitem__)
    assert way.lanes == ["in_0", ":J_1_0", "left_0"]
    assert way.edges == ["in", "left"]
    assert not way.is_dead_end
    assert [(line.lane, line.link, line.via) for line in way.lines] == [("in_0", 0, ":J_1_0")]


def test_a_way_without_a_route_goes_straight_on_until_its_lanes_end() -> None:
    way = way_from("in_0", ["elsewhere"], 500.0, LANES.__getitem__)
    assert way.lanes == ["in_0", ":J_0_0", "on_0"]
    assert way.is_dead_end
    assert way.length == pytest.approx(210.0)
    assert [way.lane_at(along) for along in (0.0, 99.0, 105.0, 300.0)] == [("in", 0), ("in", 0), (":J_0", 0), ("on", 0)]


def test_points_of_a_way_are_a_metre_apart_and_begin_beside_the_car() -> None:
    way = way_from("in_0", ["left"], 150.0, LANES.__getitem__)
    position, _ = way.ahead(20.25)
    np.testing.assert_allclose(position[0], [20.25, 0.0])
    assert len(position) == HORIZON_M + 1
    assert np.hypot(*np.diff(position, axis=0).T) == pytest.approx(1.0, abs=0.15)


def test_a_way_is_slower_in_and_before_a_bend_and_where_the_limit_is_lower() -> None:
    _, straight = way_from("in_0", ["on"], 300.0, LANES.__getitem__).ahead(40.0)
    _, bend = way_from("in_0", ["left"], 150.0, LANES.__getitem__).ahead(40.0)
    assert straight[0] == 14.0
    assert straight[75] == 8.0
    assert bend.min() < 5.0
    np.testing.assert_array_less(-2.0 * 1.5 - 1e-9, np.diff(bend**2))  # what braking at 1.5 m/s^2 reaches


def test_a_car_beside_its_way_is_where_the_way_is_nearest() -> None:
    way = way_from("in_0", ["left"], 150.0, LANES.__getitem__)
    assert way.along(np.array([30.4, 2.0]), near=28.0) == pytest.approx(30.4)
    assert way.along(np.array([111.0, 30.0]), near=128.0) == pytest.approx(way.start[2] + 20.0, abs=0.5)


def test_at_the_end_of_a_way_two_points_are_left() -> None:
    position, speed = way_from("on_0", [], 500.0, LANES.__getitem__).ahead(250.0)
    assert (position.shape, len(speed)) == ((2, 2), 2)
    assert np.hypot(*(position[1] - position[0])) == pytest.approx(1.0)


def test_a_car_stops_for_red_and_for_yellow_if_it_can() -> None:
    assert stop(Priority(0.1), 30.0, "r", 10.0, []) == 30.0
    assert stop(Priority(0.1), 30.0, "y", 10.0, []) == 30.0
    assert stop(Priority(0.1), 10.0, "y", 10.0, []) == np.inf
    assert stop(Priority(0.1), 10.0, "G", 10.0, []) == np.inf


def test_a_car_gives_way_to_those_it_would_meet() -> None:
    assert stop(Priority(0.1), 20.0, "m", 10.0, [(foe(), 10.0)]) == 20.0
    assert stop(Priority(0.1), 20.0, "m", 10.0, [(foe(yields=False), 10.0)]) == np.inf
    assert stop(Priority(0.1), 20.0, "M", 10.0, [(foe(yields=False, is_inside=True), 10.0)]) == 20.0
    assert stop(Priority(0.1), 20.0, "m", 10.0, [(foe(lane=":J_1_0"), 10.0)]) == np.inf
    assert stop(Priority(0.1), 20.0, "m", 10.0, [(foe(foe_distance=-1.0, foe_exit=1.0), 10.0)]) == np.inf
    assert stop(Priority(0.1), 20.0, "m", 14.0, [(foe(foe_distance=79.0, foe_exit=85.0), 5.0)]) == np.inf


def test_a_car_stands_at_a_stop_sign_before_it_goes_on() -> None:
    priority = Priority(0.1)
    assert stop(priority, 20.0, "s", 10.0, []) == 20.0
    assert stop(priority, 1.0, "s", 0.0, []) == np.inf
    assert stop(priority, 0.8, "s", 1.0, []) == np.inf


def test_a_car_that_has_waited_goes_before_those_that_stand() -> None:
    priority = Priority(1.0)
    standing = foe(foe_distance=3.0), 0.0
    stops = [stop(priority, 1.0, "=", 0.0, [standing]) for _ in range(12)]
    assert stops[0] == 1.0
    assert stops[-1] == np.inf
    assert stop(priority, 1.0, "=", 0.0, [(foe(foe_distance=3.0), 5.0)]) == 1.0
