"""Recordings are made from boxes and paths in any order, and what cannot be is refused."""

from dataclasses import replace

import numpy as np
import pytest

from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import SceneAgent
from mast_zenoh.scenes.making.assembly import (
    AgentPath,
    SceneBoxes,
    assemble,
    ground_level,
    poles,
    vehicle,
    vehicles_throughout,
)
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Camera, CleanDetector, LidarSensor

FRAMES = 4
TIMES = 7_000_000_000 + 100_000_000 * np.arange(FRAMES)


def road() -> SceneBoxes:
    """Two cars, ids 3 and 8, 20 m apart, east at 10 m/s on ground 5 m high; 8 is in front."""
    frame = np.tile(np.arange(FRAMES), 2)
    number = np.repeat([3, 8], FRAMES)
    position = np.stack([frame + np.where(number == 8, 20.0, 0.0), np.zeros(8), np.full(8, 5.75)], axis=1)
    size = np.tile([4.5, 1.9, 1.5], (8, 1))
    return SceneBoxes(frame, number, position, size, np.zeros(8), np.ones(8, np.uint8), np.full((8, 3), np.nan))


def recorded(boxes: SceneBoxes, paths: list[AgentPath], **options) -> Recording:
    return assemble("road", TIMES, boxes, paths, CleanDetector(), seed=0, **options)


def test_the_order_of_boxes_makes_no_difference() -> None:
    boxes = road()
    order = np.random.default_rng(0).permutation(len(boxes))
    one = recorded(boxes, [vehicle("ego", boxes, 3)])
    other = recorded(boxes.select(order), [vehicle("ego", boxes.select(order), 3)])
    assert one.truth.id.tolist() == [3, 8] * FRAMES
    for name, values in one.truth.columns().items():
        np.testing.assert_array_equal(values, other.truth.columns()[name])
    np.testing.assert_array_equal(one.detections.position, other.detections.position)


def test_velocities_come_from_positions_and_times_begin_at_zero() -> None:
    recording = recorded(road(), [vehicle("ego", road(), 3)])
    np.testing.assert_allclose(recording.truth.velocity, np.tile([10.0, 0.0, 0.0], (8, 1)))
    np.testing.assert_allclose(recording.agent_velocity[:, 0], np.tile([10.0, 0.0, 0.0], (FRAMES, 1)))
    assert recording.times_ns.tolist() == [0, 100_000_000, 200_000_000, 300_000_000]


def test_a_car_sees_the_one_ahead_and_not_itself() -> None:
    recording = recorded(road(), [vehicle("ego", road(), 3)])
    assert recording.points_at(0)[0, 0] == 0
    assert recording.points_at(0)[1, 0] > 50
    np.testing.assert_allclose(recording.detections_at(0, 0).position, [[20.0, 0.0, 0.75 - 1.8]])


def test_given_lidar_returns_are_kept_in_the_order_of_the_boxes() -> None:
    boxes = road()
    path = replace(vehicle("ego", boxes, 3), points=np.arange(8, dtype=np.int32))
    recording = recorded(boxes, [path])
    assert recording.points[:, 0].tolist() == [0, 4, 1, 5, 2, 6, 3, 7]


def test_a_shorter_recording_has_the_velocities_of_the_whole() -> None:
    whole, short = (recorded(road(), [vehicle("ego", road(), 3)], frames=n) for n in (None, 2))
    assert len(short) == 2
    np.testing.assert_array_equal(short.truth.velocity, whole.truth.velocity[:4])
    with pytest.raises(ConfigurationError, match=r"road.*frames requested"):
        recorded(road(), [vehicle("ego", road(), 3)], frames=5)


def test_poles_stand_15_m_above_the_ground_beside_the_route() -> None:
    route = road().position[:FRAMES, :2]
    (pole, _) = poles(road(), route, np.zeros(FRAMES), 2)
    np.testing.assert_allclose(pole.position[0, 1:], [16.0, 20.0])
    assert recorded(road(), [vehicle("ego", road(), 3), pole]).points[:, 1].max() >= 5


def test_vehicles_that_leave_are_not_there_throughout() -> None:
    boxes = road()
    keep = ~((boxes.id == 8) & (boxes.frame == 2))
    assert vehicles_throughout(boxes, FRAMES).tolist() == [3, 8]
    assert vehicles_throughout(boxes.select(keep), FRAMES).tolist() == [3]


def test_the_ground_is_below_the_boxes_nearby() -> None:
    assert ground_level(road(), np.zeros(2)) == 5.0
    assert ground_level(road().select(np.zeros(0, np.intp)), np.zeros(2)) == 0.0


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("frame", 4, "4, object 3"),
        ("id", -2, r"object -2.*-2"),
        ("position", np.nan, r"1.*3: position"),
        ("size", 0.0, "finite numbers above"),
        ("yaw", np.inf, r"yaw.*inf.*finite"),
        ("velocity", np.inf, r"velocity.*numbers.*NaN"),
        ("class_id", 200, "class_id is 200"),
        ("frame", 0, "0, object 3"),
    ],
)
def test_an_impossible_box_is_refused(field: str, value: float, message: str) -> None:
    boxes = road()
    values = getattr(boxes, field).copy()
    values[1] = value
    with pytest.raises(SceneError, match=f"road: .*{message}"):
        recorded(replace(boxes, **{field: values}), [vehicle("ego", boxes, 3)])


def pole() -> AgentPath:
    agent = SceneAgent("ego", "static", -1, LidarSensor(), Camera())
    return AgentPath(agent, np.zeros((FRAMES, 3)), np.tile(np.eye(3), (FRAMES, 1, 1)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(position=np.zeros((3, 3))), r"shape \(3, 3\)"),
        (dict(position=np.full((FRAMES, 3), np.nan)), r"position contains.*number"),
        (dict(rotation=np.tile(2 * np.eye(3), (FRAMES, 1, 1))), r"rotation.*orthonormal"),
        (dict(points=np.zeros(3, np.int32)), r"points.*\(3,\).*\(8,\)"),
        (dict(points=np.full(8, -1, np.int32)), r"points.*number below"),
        (dict(agent=replace(pole().agent, object_id=5)), r"frame 0.*object"),
    ],
)
def test_an_impossible_path_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=f"road.*ego: .*{message}"):
        recorded(road(), [replace(pole(), **changes)])


class Percent(CleanDetector):
    """Gives scores from 0 to 100, or one id of an object too few."""

    def __init__(self, *, fault: str) -> None:
        super().__init__()
        self.fault = fault

    def detect(self, *sensed):
        found, ids = super().detect(*sensed)
        return (found, ids[1:]) if self.fault == "ids" else (replace(found, score=100.0 * found.score), ids)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("score", r"score 100.*100"),
        ("ids", r"detections.*objects.*numbers"),
    ],
)
def test_what_a_detector_must_not_return_names_it_and_its_sensor(fault: str, message: str) -> None:
    boxes = road()
    with pytest.raises(SceneError, match=f"Percent.*0: .*{message}"):
        assemble("road", TIMES, boxes, [vehicle("ego", boxes, 3)], Percent(fault=fault), seed=0)
