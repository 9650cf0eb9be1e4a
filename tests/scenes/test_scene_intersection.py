"""The generated junction: plausible traffic and independent randomness."""

from functools import cache

import numpy as np
import pytest
import shapely

from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector

pytestmark = pytest.mark.heavy


@cache
def junction(scene_index: int, seed: int = 0) -> Recording:
    return Intersection(scene_index=scene_index).record(seed, None)


def by_object(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position (F, n, 3), velocity (F, n, 3) and yaw (F, n) of permanent objects."""
    frames, n = len(recording), len(recording.truth_at(0))
    truth = recording.truth
    yaw = np.unwrap(truth.yaw.reshape(frames, n), axis=0)
    return truth.position.reshape(frames, n, 3), truth.velocity.reshape(frames, n, 3), yaw


def footprints(recording: Recording, frame: int) -> np.ndarray:
    truth = recording.truth_at(frame)
    return shapely.polygons(box_corners(truth.position, truth.size, truth.yaw)[:, :4, :2])


@pytest.mark.parametrize("scene_index", range(10))
def test_no_boxes_overlap_each_other_or_a_building(scene_index: int) -> None:
    recording = junction(scene_index)
    houses = shapely.STRtree(shapely.polygons(np.array(recording.buildings)))
    for frame in range(0, len(recording), 3):
        boxes = footprints(recording, frame)
        one, other = shapely.STRtree(boxes).query(boxes, predicate="intersects")
        assert (one == other).all(), f"frame {frame}: {one[one != other]} and {other[one != other]}"
        assert houses.query(boxes, predicate="intersects").size == 0


@pytest.mark.parametrize("scene_index", range(10))
def test_motion_is_plausible(scene_index: int) -> None:
    position, velocity, yaw = by_object(junction(scene_index))
    speed = np.linalg.norm(velocity, axis=2)
    along, across = np.diff(speed, axis=0) / 0.1, speed[1:] * np.diff(yaw, axis=0) / 0.1
    assert np.abs(along).max() <= 8.0
    assert np.abs(across).max() <= 6.0
    assert speed.max() < 17.0
    # Everything moves along its heading, and positions integrate velocities.
    heading = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    np.testing.assert_allclose(velocity, heading * speed[..., None], atol=1e-9)
    np.testing.assert_allclose(np.diff(position, axis=0), (velocity[1:] + velocity[:-1]) * 0.05, atol=0.03)


@pytest.mark.parametrize("scene_index", range(10))
def test_there_is_traffic_and_the_ego_drives_through_it(scene_index: int) -> None:
    recording = junction(scene_index)
    position, velocity, _ = by_object(recording)
    distance = np.hypot(position[..., 0], position[..., 1])
    assert 25 <= (distance < 100).sum(axis=1).mean() <= 75
    assert (np.linalg.norm(velocity, axis=2).max(axis=0) > 0.5).mean() > 0.4
    present = {CLASSES[k] for k in recording.truth_at(0).class_id}
    assert {"car", "bicycle", "pedestrian"} <= present
    ego = distance[:, recording.agents[0].object_id]
    assert ego.min() < 15
    assert ego[-1] > ego.min() + 10
    assert ego[0] > ego.min() + 10


def test_junctions_differ() -> None:
    outlines = {scene_index: junction(scene_index) for scene_index in range(10)}
    assert len({recording.buildings[0].tobytes() for recording in outlines.values()}) == 10
    assert len({len(recording.truth_at(0)) for recording in outlines.values()}) >= 4
    assert {"truck", "bus"} <= {CLASSES[k] for recording in outlines.values() for k in recording.truth.class_id}


def test_another_seed_gives_different_traffic_at_the_same_junction() -> None:
    one, other = junction(0), Intersection(scene_index=0).record(1, 1)
    np.testing.assert_array_equal(one.buildings[0], other.buildings[0])
    assert not np.array_equal(one.truth_at(0).position[:10], other.truth_at(0).position[:10])


def test_a_shorter_recording_is_the_start_of_a_longer_one() -> None:
    short, whole = Intersection(scene_index=0).record(0, 20), junction(0)
    assert len(short) == 20
    np.testing.assert_array_equal(short.truth_at(19).position, whole.truth_at(19).position)
    np.testing.assert_array_equal(short.detections_at(19, 2).position, whole.detections_at(19, 2).position)


def test_more_agents_change_neither_traffic_nor_other_detections() -> None:
    few = Intersection(scene_index=2, n_infrastructure=1).record(0, 15)
    many = Intersection(scene_index=2, n_infrastructure=6, n_mobile=3).record(0, 15)
    assert many.agent_names == ("ego", *(f"mobile_{k}" for k in (1, 2, 3)), *(f"infra_{k}" for k in range(1, 7)))
    np.testing.assert_array_equal(few.truth.position, many.truth.position)
    for name in few.agent_names:
        a, b = few.agent_names.index(name), many.agent_names.index(name)
        np.testing.assert_array_equal(few.points[:, a], many.points[:, b])
        for frame in range(15):
            np.testing.assert_array_equal(
                few.detections_at(frame, a).position, many.detections_at(frame, b).position, err_msg=name
            )


def test_mobile_agents_are_where_their_vehicles_are() -> None:
    recording = Intersection(scene_index=1, n_mobile=20, n_infrastructure=0).record(0, 5)
    ids = [agent.object_id for agent in recording.agents]
    assert len(set(ids)) == 21
    truth = recording.truth_at(3)
    np.testing.assert_allclose(recording.agent_position[3, :, :2], truth.position[ids, :2])
    np.testing.assert_allclose(recording.agent_velocity[3], truth.velocity[ids])
    assert (recording.points_at(3)[ids, range(21)] == 0).all()


def test_poles_are_15_m_high_next_to_the_road_and_face_the_centre() -> None:
    recording = Intersection(scene_index=4, n_infrastructure=16).record(0, 1)
    position, forward = recording.agent_position[0, 1:], recording.agent_rotation[0, 1:, :, 0]
    np.testing.assert_allclose(position[:, 2], 15.0)
    np.testing.assert_allclose(forward[:, 2], -np.sin(np.radians(30)))
    to_middle = -position[:, :2] / np.hypot(*position[:, :2].T)[:, None]
    np.testing.assert_allclose((forward[:, :2] * to_middle).sum(axis=1), np.cos(np.radians(30)))
    houses = shapely.STRtree(shapely.polygons(np.array(recording.buildings)))
    assert houses.query(shapely.points(position[:, :2]), predicate="intersects").size == 0


def test_most_traffic_is_seen_and_poles_see_objects_hidden_from_the_ego() -> None:
    recording = junction(3)
    seen = recording.points >= 5
    assert seen.any(axis=1).mean() > 0.6
    assert seen.any(axis=1).sum() > 1.1 * seen[:, 0].sum()


def test_detections_at_a_typical_junction_are_as_good_as_those_of_real_detectors() -> None:
    ids = np.concatenate([junction(scene_index).detection_truth_id for scene_index in range(3)])
    assert 0.75 <= (ids >= 0).mean() <= 0.9


def test_a_clean_detector_detects_every_seen_object() -> None:
    recording = Intersection(scene_index=0, detector=CleanDetector()).record(0, 10)
    assert len(recording.detections) == (recording.points >= 5).sum()


def test_scenes_may_be_long_empty_slow_or_fast() -> None:
    assert len(Intersection(n_infrastructure=0, n_vehicles=1, n_bicycles=0, n_pedestrians=0).record(0, 400)) == 400
    fast = Intersection(n_infrastructure=0, rate_hz=20.0).record(0, 10)
    assert fast.period_ns == 50_000_000
    assert fast.times_ns.tolist() == [k * 50_000_000 for k in range(10)]


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"n_infrastructure": -1}, "n_infrastructure is -1, expected 0 to 88"),
        ({"n_infrastructure": 89}, "n_infrastructure is 89, expected 0 to 88"),
        ({"n_infrastructure": 67, "scene_index": 1}, "n_infrastructure is 67, expected 0 to 66"),
        ({"n_mobile": -1}, "n_mobile is -1, expected 0 or more"),
        ({"n_vehicles": 3, "n_mobile": 3}, "n_vehicles is 3, expected 4 or more"),
        ({"rate_hz": 0.0}, "rate_hz is 0.0"),
        ({"scene_index": -1}, "scene_index is -1, expected 0 or more"),
    ],
)
def test_invalid_parameters_are_refused_by_name(parameters: dict, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        Intersection(**parameters)


def test_as_many_agents_as_fit() -> None:
    most = 55
    recording = Intersection(scene_index=3, n_mobile=most, n_infrastructure=88).record(0, 1)
    assert len(recording.agents) == 1 + most + 88
    assert len({agent.object_id for agent in recording.agents if agent.kind == "mobile"}) == 1 + most
    poles = recording.agent_position[0, 1 + most :, :2]
    apart = np.hypot(*(poles[:, None] - poles).transpose(2, 0, 1)) + 1e9 * np.eye(len(poles))
    assert apart.min() > 3.0
    houses = shapely.STRtree(shapely.polygons(np.array(recording.buildings)))
    assert houses.query(shapely.points(poles), predicate="intersects").size == 0
    boxes = footprints(recording, 0)
    one, other = shapely.STRtree(boxes).query(boxes, predicate="intersects")
    assert (one == other).all()
    few = Intersection(scene_index=3, n_infrastructure=16).record(0, 1)
    np.testing.assert_array_equal(few.agent_position[0, 1:, :2], poles[:16])
    with pytest.raises(ConfigurationError, match=rf"no room for {most + 2}, expected at most {most + 1} motor"):
        Intersection(scene_index=3, n_mobile=most + 1).record(0, 1)


@pytest.mark.parametrize(
    ("users", "most"),
    [("vehicles", "85 motor vehicles"), ("bicycles", r"\d+ bicycles"), ("pedestrians", r"\d+ pedestrians")],
)
def test_too_many_road_users_are_refused(users: str, most: str) -> None:
    with pytest.raises(ConfigurationError, match=f"no room for 5000, expected at most {most}"):
        Intersection(**{f"n_{users}": 5000}).record(0, 1)
