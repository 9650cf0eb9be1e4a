"""Objects that are sent as ROS 2 messages have the right values, and come back; what cannot be used is counted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mast_ros2 import received_objects, type_store
from mast_ros2.object_messages import (
    detection_array,
    id_of_text,
    id_of_uuid,
    marker_array,
    predicted_objects,
    tracked_objects,
    uuids,
)
from mast_ros2.received_objects import received_detections, received_tracks
from mast_ros2.spatial import clock
from mast_ros2.type_store import TYPES
from ros2_messages import random_message, random_states, set_to, through
from scipy.spatial.transform import Rotation

from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Detections, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message

TIME_NS = 3_000_000_007
N = 20


@pytest.fixture(scope="module")
def states() -> ObjectStates:
    return random_states(np.random.default_rng(1), N)


def xyz(value: Any) -> list[float]:
    return [value.x, value.y, value.z]


def turn(value: Any) -> Rotation:
    return Rotation.from_quat([value.x, value.y, value.z, value.w])


# -- out ---------------------------------------------------------------------------------------------------------------


def test_a_detection_array_has_boxes_classes_scores_and_covariances(states: ObjectStates) -> None:
    array = through(detection_array(states, TIME_NS, "map"))
    assert (array.header.frame_id, array.header.stamp.sec, array.header.stamp.nanosec) == ("map", 3, 7)
    for k, each in enumerate(array.detections):
        assert each.header == array.header
        assert int(each.id) == states.id[k]
        assert xyz(each.bbox.center.position) == states.position[k].tolist()
        assert xyz(each.bbox.size) == states.size[k].tolist()
        np.testing.assert_allclose(
            turn(each.bbox.center.orientation).as_euler("xyz"), [0, 0, states.yaw[k]], atol=1e-12
        )
        (result,) = each.results
        assert result.hypothesis.class_id == CLASSES[states.class_id[k]]
        assert result.hypothesis.score == states.score[k]
        assert result.pose.pose == each.bbox.center
        covariance = result.pose.covariance.reshape(6, 6)
        assert np.array_equal(covariance[:3, :3], states.covariance[k, :3, :3])
        assert not covariance[3:].any()
        assert not covariance[:, 3:].any()


def test_velocities_of_tracked_objects_are_in_their_own_axes(states: ObjectStates) -> None:
    for k, each in enumerate(through(tracked_objects(states, TIME_NS, "map")).objects):
        twist = each.kinematics.twist_with_covariance
        into_world = Rotation.from_euler("z", states.yaw[k]).as_matrix()
        np.testing.assert_allclose(into_world @ xyz(twist.twist.linear), states.velocity[k], atol=1e-12)
        covariance = into_world @ twist.covariance.reshape(6, 6)[:3, :3] @ into_world.T
        np.testing.assert_allclose(covariance, states.covariance[k, 6:, 6:], atol=1e-12)
        assert each.kinematics.orientation_availability == 2
        assert not each.kinematics.is_stationary
        assert each.classification[0].label == [0, 1, 2, 3, 5, 6, 7][states.class_id[k]]
        assert each.existence_probability == np.float32(states.score[k])


def test_a_car_that_drives_ahead_has_a_velocity_along_x_and_one_that_stands_is_stationary() -> None:
    states = ObjectStates.of(
        np.zeros((2, 3)), velocity=np.array([[0.0, 8.0, 0.0], [0.0, 0.0, 0.0]]), yaw=np.full(2, np.pi / 2)
    )
    driving, standing = (each.kinematics for each in tracked_objects(states, 0, "map").objects)
    np.testing.assert_allclose(xyz(driving.twist_with_covariance.twist.linear), [8.0, 0.0, 0.0], atol=1e-12)
    assert (driving.is_stationary, standing.is_stationary) == (False, True)


def test_predicted_paths_lead_straight_on_from_where_the_object_is(states: ObjectStates) -> None:
    message = through(predicted_objects(states, TIME_NS, "map"))
    for k, each in enumerate(message.objects):
        (path,) = each.kinematics.predicted_paths
        assert (path.time_step.sec, path.time_step.nanosec, path.confidence) == (0, 500_000_000, 1.0)
        assert len(path.path) == 21, "as of Autoware: ten seconds"
        for step, pose in enumerate(path.path):
            np.testing.assert_allclose(
                xyz(pose.position), states.position[k] + 0.5 * step * states.velocity[k], atol=1e-9
            )
            assert pose.orientation == path.path[0].orientation
        assert xyz(path.path[0].position) == xyz(each.kinematics.initial_pose_with_covariance.pose.position)


def test_markers_are_coloured_boxes_after_one_that_removes_all(states: ObjectStates) -> None:
    colours = np.random.default_rng(2).integers(256, size=(N, 3))
    first, *boxes = through(marker_array(states, colours, TIME_NS, "map")).markers
    assert first.action == 3
    for k, each in enumerate(boxes):
        assert (each.type, each.action, each.id) == (1, 0, states.id[k] % 2**31)
        assert xyz(each.pose.position) == states.position[k].tolist()
        assert xyz(each.scale) == states.size[k].tolist()
        np.testing.assert_allclose(np.multiply([each.color.r, each.color.g, each.color.b], 255), colours[k], atol=1e-4)


@pytest.mark.parametrize("time_ns", [-1, 2**31 * 10**9])
def test_a_time_that_ros_cannot_express_is_refused(states: ObjectStates, time_ns: int) -> None:
    for build in (detection_array, tracked_objects, predicted_objects):
        with pytest.raises(ValueError, match="time: found"):
            build(states, time_ns, "map")


def test_no_objects_are_messages_too() -> None:
    nothing = ObjectStates.empty()
    for build in (detection_array, tracked_objects, predicted_objects):
        assert len(type_store.encode(build(nothing, 0, "map"))) < 40
    assert len(received_detections(through(detection_array(nothing, 0, "map"))).objects) == 0
    assert len(received_tracks(through(tracked_objects(nothing, 0, "map"))).objects) == 0


# -- out and in again --------------------------------------------------------------------------------------------------


def assert_same_boxes(found: Detections | ObjectStates, states: ObjectStates) -> None:
    np.testing.assert_array_equal(found.position, states.position)
    np.testing.assert_array_equal(found.size, states.size)
    np.testing.assert_allclose(found.yaw, states.yaw, atol=1e-12)
    np.testing.assert_array_equal(found.class_id, states.class_id)
    np.testing.assert_allclose(found.score, states.score, atol=1e-7)  # float32 in Autoware


def test_objects_of_a_detection_array_come_back_as_detections(states: ObjectStates) -> None:
    received = received_detections(through(detection_array(states, TIME_NS, "lidar")))
    assert (received.frame_id, received.time_ns, received.dropped, received.unclassified) == ("lidar", TIME_NS, {}, 0)
    assert_same_boxes(received.objects, states)
    np.testing.assert_allclose(received.objects.covariance, states.covariance[:, :3, :3], atol=1e-12)


def test_tracked_objects_come_back_as_tracks(states: ObjectStates) -> None:
    received = received_tracks(through(tracked_objects(states, TIME_NS, "map")))
    assert (received.frame_id, received.time_ns, received.dropped, received.unclassified) == ("map", TIME_NS, {}, 0)
    tracks = received.objects
    assert_same_boxes(tracks, states)
    np.testing.assert_array_equal(tracks.id, states.id)
    np.testing.assert_allclose(tracks.velocity, states.velocity, atol=1e-12)
    for first, end in ((0, 3), (6, 9)):
        part = np.s_[:, first:end, first:end]
        np.testing.assert_allclose(tracks.covariance[part], states.covariance[part], atol=1e-12)
    np.testing.assert_array_equal(tracks.covariance[:, 3:6, 3:6], np.broadcast_to(np.eye(3) * 0.25, (N, 3, 3)))


def test_received_tracks_and_detections_are_valid_messages_of_ours(states: ObjectStates) -> None:
    origin, rotation = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    tracks = received_tracks(through(tracked_objects(states, TIME_NS, "map"))).objects.columns()
    detections = received_detections(through(detection_array(states, TIME_NS, "lidar"))).objects.columns()
    for schema, body in (
        ("tracks", tracks | {"origin": origin, "rotation": rotation}),
        ("detections", detections | {"mount_position": origin, "mount_rotation": rotation}),
    ):
        data = codec.encode(Message(Header(schema, "ros", 0, TIME_NS, 0), body))
        assert np.array_equal(codec.decode(data, schema).body["position"], states.position)


def test_an_id_survives_in_a_uuid_and_in_a_text() -> None:
    ids = np.array([0, 1, -1, 255, 2**62, np.iinfo(np.int64).min, np.iinfo(np.int64).max])
    assert [id_of_uuid(uuid.tobytes()) for uuid in uuids(ids)] == ids.tolist()
    assert [id_of_text(str(number)) for number in ids.tolist()] == ids.tolist()


@pytest.mark.parametrize("text", ["", "007", "car-7", "\uff19", str(2**63), "-0", "\udc80"])
def test_another_text_becomes_a_positive_number_that_stays_the_same(text: str) -> None:
    assert 0 <= id_of_text(text) == id_of_text(text) < 2**63
    assert id_of_text(text) != id_of_text(text + "x")


def test_random_uuids_become_different_positive_numbers() -> None:
    random = np.random.default_rng(1)
    numbers = [id_of_uuid(random.bytes(16)) for _ in range(1000)]
    assert len(set(numbers)) == 1000
    assert min(numbers) >= 0
    assert max(numbers) < 2**63


# -- in ----------------------------------------------------------------------------------------------------------------


POSE = "kinematics.pose_with_covariance.pose"
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_to(f"{POSE}.position.y", NAN), "a value is not finite"),
        (set_to("kinematics.twist_with_covariance.twist.linear.x", INF), "a value is not finite"),
        (set_to("existence_probability", NAN), "a value is not finite"),
        (set_to("kinematics.pose_with_covariance.covariance", np.full(36, NAN)), "a value is not finite"),
        (set_to(f"{POSE}.position.x", 1e8), "position: beyond 1e+07 m"),
        (set_to(f"{POSE}.orientation", 0.0, 0.0, 0.0, 0.0), "orientation: a quaternion whose length is not 1"),
        (set_to(f"{POSE}.orientation", 0.0, 0.0, 1.0, 1.0), "orientation: a quaternion whose length is not 1"),
        (set_to(f"{POSE}.orientation", 1e200, 0.0, 0.0, 0.0), "orientation: a quaternion whose length is not 1"),
        (set_to(f"{POSE}.orientation", 1.0, 0.0, 0.0, 0.0), "orientation: the box is tilted by more than 45 degrees"),
        (set_to("shape.dimensions.z", 0.0), "size: not above 0 and at most 300 m"),
        (set_to("shape.dimensions.x", -2.0), "size: not above 0 and at most 300 m"),
        (set_to("shape.dimensions.x", 301.0), "size: not above 0 and at most 300 m"),
        (set_to("shape.type", 2), "size: not above 0 and at most 300 m"),  # a polygon without points
        (set_to("kinematics.twist_with_covariance.twist.linear.z", -151.0), "velocity: beyond 150 m/s"),
        (set_to("existence_probability", 1.5), "score: not from 0 to 1"),
        (set_to("kinematics.pose_with_covariance.covariance", -np.eye(6).ravel()), "covariance of the position"),
        (set_to("kinematics.pose_with_covariance.covariance", np.full(36, 1e300)), "covariance of the position"),
        (set_to("kinematics.twist_with_covariance.covariance", -np.eye(6).ravel()), "covariance of the velocity"),
        (set_to("object_id.uuid", "of another"), "id: occurs twice"),
    ],
)
def test_an_object_that_cannot_be_used_is_counted_and_the_others_stay(states, change, reason) -> None:
    message = through(tracked_objects(states, TIME_NS, "map"))
    change(message.objects[3])
    if reason == "id: occurs twice":
        message.objects[3].object_id.uuid = message.objects[0].object_id.uuid
    received = received_tracks(message)
    ((counted, number),) = received.dropped.items()
    assert counted.startswith(reason)
    assert number == 1
    np.testing.assert_array_equal(received.objects.id, np.delete(states.id, 3))


def test_reasons_are_counted_apart(states: ObjectStates) -> None:
    message = through(tracked_objects(states, TIME_NS, "map"))
    for k in (0, 1):
        message.objects[k].existence_probability = 2.0
    message.objects[2].shape.dimensions.x = NAN
    received = received_tracks(message)
    assert received.dropped == {"a value is not finite": 1, "score: not from 0 to 1": 2}
    assert received.rows.tolist() == list(range(3, len(states))), "the others are told by their place in the message"


def test_too_many_objects_are_refused_as_a_whole(states: ObjectStates) -> None:
    message = detection_array(states, 0, "map")
    message.detections *= 1 + received_objects.MOST_OBJECTS // N
    with pytest.raises(MessageError, match=r"Detection3DArray: found 1020 objects, expected at most 1000"):
        received_detections(message)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_to("header.frame_id", ""), "frame_id: found '', expected a name"),
        (set_to("header.frame_id", "x" * 300), "frame_id: found 'xxx"),
        (set_to("header.stamp.sec", -1), "stamp: found -1 s"),
        (set_to("header.stamp.nanosec", 10**9), "stamp: found 3 s and 1000000000 ns"),
    ],
)
def test_an_invalid_header_is_refused(states: ObjectStates, change: Callable[[Any], None], reason: str) -> None:
    for build, read in ((detection_array, received_detections), (tracked_objects, received_tracks)):
        message = through(build(states, TIME_NS, "map"))
        change(message)
        with pytest.raises(MessageError) as refusal:
            read(message)
        assert reason in str(refusal.value)


def test_a_message_of_another_type_is_refused(states: ObjectStates) -> None:
    with pytest.raises(MessageError, match=r"TrackedObjects: expected vision_msgs/msg/Detection3DArray or"):
        received_detections(tracked_objects(states, 0, "map"))
    with pytest.raises(MessageError, match=r"Clock: expected autoware_perception_msgs/msg/TrackedObjects or"):
        received_tracks(clock(0))


def test_detections_without_ids_are_no_tracks(states: ObjectStates) -> None:
    message = through(detection_array(states, TIME_NS, "map"))
    for each in message.detections[:3]:
        each.id = ""
    received = received_tracks(message)
    assert received.objects.id.tolist() == states.id[3:].tolist()
    assert received.dropped == {"id: none": 3}


def test_a_detection_array_with_ids_can_be_tracks_without_velocities(states: ObjectStates) -> None:
    received = received_tracks(through(detection_array(states, TIME_NS, "map")))
    assert received.objects.id.tolist() == states.id.tolist()
    np.testing.assert_array_equal(received.objects.position, states.position)
    assert not received.objects.velocity.any()
    np.testing.assert_allclose(received.objects.covariance[:, 6, 6], 2.0**2)


@pytest.mark.parametrize(
    ("word", "kind", "unclassified"),
    [
        ("Car", "car", 0),
        (" person ", "pedestrian", 0),
        ("cyclist", "bicycle", 0),
        ("trailer", "truck", 0),
        ("unknown", "unknown", 0),
        ("traffic_cone", "unknown", 1),
        ("", "unknown", 1),
        ("3", "unknown", 1),
    ],
)
def test_classes_of_detectors_are_ours_or_counted(states, word, kind, unclassified) -> None:
    message = through(detection_array(states, 0, "map"))
    message.detections[5].results[0].hypothesis.class_id = word
    received = received_detections(message)
    assert CLASSES[received.objects.class_id[5]] == kind
    assert received.unclassified == unclassified
    assert len(received.objects) == N


@pytest.mark.parametrize(
    ("label", "kind", "unclassified"), [(4, "truck", 0), (0, "unknown", 0), (8, "unknown", 1), (255, "unknown", 1)]
)
def test_labels_of_autoware_are_ours_or_counted(states: ObjectStates, label: int, kind: str, unclassified: int) -> None:
    message = through(tracked_objects(states, 0, "map"))
    message.objects[5].classification[0].label = label
    received = received_tracks(message)
    assert (CLASSES[received.objects.class_id[5]], received.unclassified) == (kind, unclassified)


def test_the_hypothesis_with_the_highest_score_counts_and_none_is_unknown(states: ObjectStates) -> None:
    message = through(detection_array(states.with_(score=np.full(N, 0.5)), 0, "map"))
    other = through(detection_array(states, 0, "map")).detections[1].results[0]
    other.hypothesis.class_id, other.hypothesis.score = "bus", 0.9
    message.detections[0].results.append(other)
    message.detections[1].results.clear()
    found = received_detections(message).objects
    assert (found.class_id[0], found.score[0]) == (CLASS_INDEX["bus"], 0.9)
    assert (found.class_id[1], found.score[1]) == (CLASS_INDEX["unknown"], 1.0)
    assert not found.covariance[1].any()


def detected(states: ObjectStates) -> Any:
    """DetectedObjects with the boxes of objects."""
    random = np.random.default_rng(1)
    objects = []
    for each in through(tracked_objects(states, TIME_NS, "lidar")).objects:
        own = random_message("autoware_perception_msgs/msg/DetectedObject", random)
        own.existence_probability, own.classification, own.shape = (
            each.existence_probability,
            each.classification,
            each.shape,
        )
        own.kinematics.pose_with_covariance = each.kinematics.pose_with_covariance
        own.kinematics.has_position_covariance, own.kinematics.orientation_availability = True, 2
        objects.append(own)
    header = detection_array(states, TIME_NS, "lidar").header
    return through(TYPES[type_store.DETECTED_OBJECTS](header, objects))


def test_detected_objects_are_detections(states: ObjectStates) -> None:
    message = detected(states)
    message.objects[0].kinematics.has_position_covariance = False
    received = received_detections(message)
    assert (received.frame_id, received.dropped) == ("lidar", {})
    assert_same_boxes(received.objects, states)
    assert not received.objects.covariance[0].any()
    np.testing.assert_allclose(received.objects.covariance[1:], states.covariance[1:, :3, :3], atol=1e-12)


def test_an_object_without_an_orientation_has_none_to_be_checked(states: ObjectStates) -> None:
    message = detected(states)
    message.objects[2].kinematics.orientation_availability = 0
    set_to(f"{POSE}.orientation", 0.0, 0.0, 0.0, 0.0)(message.objects[2])
    received = received_detections(message)
    assert received.dropped == {}
    assert received.objects.yaw[2] == 0.0


def test_a_cylinder_is_as_wide_as_long_and_a_polygon_is_enclosed(states: ObjectStates) -> None:
    message = detected(states)
    cylinder, polygon = message.objects[:2]
    cylinder.shape.type, cylinder.shape.dimensions.x, cylinder.shape.dimensions.y = 1, 0.6, 0.0
    polygon.shape.type, polygon.shape.dimensions.x, polygon.shape.dimensions.y = 2, 0.0, 0.0
    point = TYPES["geometry_msgs/msg/Point32"]
    polygon.shape.footprint.points.extend([point(1.0, -1.0, 0.0), point(3.0, 0.0, 0.0), point(1.5, 2.0, 0.0)])
    found = received_detections(message).objects
    assert found.size[0].tolist() == [0.6, 0.6, states.size[0, 2]]
    assert found.size[1].tolist() == [2.0, 3.0, states.size[1, 2]]
    c, s = np.cos(states.yaw[1]), np.sin(states.yaw[1])
    centre = states.position[1] + [c * 2.0 - s * 0.5, s * 2.0 + c * 0.5, 0.0]
    np.testing.assert_allclose(found.position[1], centre, atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_absurd_values_are_refused_without_a_warning(states: ObjectStates) -> None:
    message = detected(states)
    message.objects[0].shape.type = 2
    message.objects[0].shape.footprint.points.append(TYPES["geometry_msgs/msg/Point32"](1.0, -1.0, 0.0))
    set_to(f"{POSE}.orientation", 1e308, 1e308, 0.0, 0.0)(message.objects[0])
    assert received_detections(message).dropped == {"orientation: a quaternion whose length is not 1": 1}


def test_what_a_tracker_does_not_state_is_assumed(states: ObjectStates) -> None:
    message = through(tracked_objects(states, 0, "map"))
    kinematics = message.objects[0].kinematics
    kinematics.pose_with_covariance.covariance = np.zeros(36)
    partial = np.zeros((6, 6))
    partial[:2, :2] = [[0.5, 0.1], [0.1, 0.5]]
    kinematics.twist_with_covariance.covariance = partial.ravel()
    covariance = received_tracks(message).objects.covariance[0]
    np.testing.assert_array_equal(covariance[:3, :3], np.eye(3))
    assert covariance[8, 8] == 4.0
    np.testing.assert_allclose(np.trace(covariance[6:8, 6:8]), 1.0)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_tilted_boxes_have_the_heading_of_their_length_axis() -> None:
    states = random_states(np.random.default_rng(3), 1)
    message = through(detection_array(states, 0, "map"))
    x, y, z, w = Rotation.from_euler("ZYX", [0.7, 0.2, 0.1]).as_quat()
    for pose in (message.detections[0].bbox.center, message.detections[0].results[0].pose.pose):
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = x, y, z, w
    np.testing.assert_allclose(received_detections(message).objects.yaw, [0.7], atol=1e-12)


@pytest.mark.parametrize("type_name", [type_store.DETECTIONS, type_store.DETECTED_OBJECTS, type_store.TRACKED_OBJECTS])
def test_random_messages_never_crash_and_what_is_left_is_valid(type_name: str) -> None:
    random = np.random.default_rng(6)
    read: Callable[[Any], Any] = received_tracks if type_name == type_store.TRACKED_OBJECTS else received_detections
    outcomes = set()
    for _ in range(60):
        message = random_message(type_name, random)
        try:
            received = read(message)
        except MessageError:
            outcomes.add("refused")
            continue
        outcomes.add("read")
        number = len(message.detections if type_name == type_store.DETECTIONS else message.objects)
        assert len(received.objects) + sum(received.dropped.values()) == number
        for column in received.objects.columns().values():
            assert np.isfinite(column).all()
    assert outcomes == {"refused", "read"}
