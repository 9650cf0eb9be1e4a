"""All kinds of traffic with the tracker's default parameters."""

import numpy as np
import pytest
from tracking_worlds import changing_lanes, speeding_up, straight, turning, watch

from mast_zenoh.streams import stream
from mast_zenoh.tracking import GreedyAssignment, KalmanBoxTracker3D


def motorway(random):
    lanes = [(2.0, 0.0, 25.0), (5.5, 0.0, 33.0), (-2.0, np.pi, 28.0), (-5.5, np.pi, 36.0)]
    return [
        ("truck" if y == 2.0 and row % 3 == 0 else "car", straight(-np.cos(yaw) * (75 + 45 * row), y, yaw, speed))
        for y, yaw, speed in lanes
        for row in range(8)
    ]


def stop_and_go(random):
    return [
        ("car", speeding_up(-60.0 + 12.0 * row, 3.5 * lane, 0.0, 6.0, 5.0, 8.0))
        for lane in range(2)
        for row in range(8)
    ]


def junction(random):
    """From each of four arms a car turns left, one after the other."""
    cars = []
    for k, yaw in enumerate([0.0, np.pi / 2, np.pi, -np.pi / 2]):
        x, y = -45.0 - 25.0 * k, -3.0
        start = (x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw))
        cars.append(("car", turning(*start, yaw, 9.0, 12.0, (-9.0 - x) / 9.0)))
    return cars


def pavement(random):
    places, ways = random.uniform(-30, 30, (15, 2)), random.uniform(-np.pi, np.pi, 15)
    return [("pedestrian", straight(x, y, yaw, 1.4)) for (x, y), yaw in zip(places, ways, strict=True)]


def lane_changes(random):
    return [("car", changing_lanes(straight(-75.0 - 40 * row, 0.0, 0.0, 20.0), 2.0 + 2 * row, 3.2)) for row in range(5)]


def run(world, assignment=None, **sensor):
    random = stream(5, world.__name__)
    tracker = KalmanBoxTracker3D() if assignment is None else KalmanBoxTracker3D(assignment=assignment)
    return watch(tracker, world(random), 150, random, **sensor)


@pytest.mark.parametrize("world", [motorway, stop_and_go, junction, pavement])
def test_few_objects_are_missed_or_false_and_ids_persist(world):
    result = run(world)
    assert result["fn"] <= 0.10
    assert result["fp"] <= 0.15
    assert result["switches"] <= 1
    assert result["rmse_m"] <= 0.40


def test_a_lane_change_in_one_step_keeps_the_id():
    assert run(lane_changes)["switches"] <= 1


@pytest.mark.parametrize("error", [0.3, 0.8, np.pi / 2])
def test_cars_with_wrong_measured_headings_are_tracked(error):
    def askew(random):
        return [("car", (lambda t, y=8.0 * row: (15.0 * t - 60.0, y - 20.0, error))) for row in range(6)]

    result = run(askew, flips=0.0, clutter=0.0)
    assert result["fn"] <= 0.1
    assert result["switches"] == 0
    assert result["rmse_m"] <= 0.7


def test_greedy_assignment_does_nearly_as_well():
    result = run(junction, GreedyAssignment())
    assert result["fn"] <= 0.2
    assert result["switches"] <= 2


def test_clutter_alone_creates_hardly_any_track():
    random = np.random.default_rng(0)
    result = watch(
        KalmanBoxTracker3D(), [("car", straight(500.0, 0.0, 0.0, 0.0)), *pavement(random)[:1]], 300, random, clutter=3.0
    )
    assert result["fp"] <= 0.1
