"""ROS 2 bags play as scenes: what is read is what was written, on frames of their own; what is left out is noted."""

import copy
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import junction
from mast_datasets import RosBag
from mast_ros2 import type_store
from mast_ros2.object_messages import tracked_objects
from mast_ros2.spatial import header
from reference_data import reference
from rosbag_writer import (
    START_NS,
    STORAGES,
    TYPES,
    Sent,
    detection_array,
    odometry,
    pose_stamped,
    transforms,
    write_bag,
    write_recording,
)
from typer.testing import CliRunner

import mast_zenoh as mast
from mast_zenoh.arrays.geometry import heading, rotation_from_yaw, to_world
from mast_zenoh.arrays.states import CLASS_INDEX, Detections
from mast_zenoh.cli.app import app
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Intersection, Recording
from mast_zenoh.scenes.making.sensor_types import Lidar, Radar
from mast_zenoh.scenes.recording import NO_MEASUREMENT
from mast_zenoh.sensing import DetectionModel
from mast_zenoh.sensing import to_world as detections_to_world

MS = 10**6
FRAME = 100 * MS
CAMERA = dict(kind="camera", frame="camera")
BODY = {"size": [4.0, 2.0, 1.5], "class": "car"}


@pytest.fixture(scope="module")
def measured() -> Recording:
    """A junction whose sensors measure between frames, and whose poles look down."""
    poles = (Lidar(rate_hz=5.0, phase_s=0.07), Radar(rate_hz=10.0, azimuth_deg=(-10.0, 10.0)))
    sensors = {"*": (Lidar(rate_hz=10.0, phase_s=0.03),), "infra_*": poles}
    scene = Intersection(scene_index=0, n_infrastructure=2, n_mobile=1, sensors=sensors, detector=DetectionModel())
    return scene.record(0, 12)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_recording_is_read_back_from_every_storage(storage: str, measured: Recording, tmp_path: Path) -> None:
    read = RosBag(path=str(write_recording(tmp_path / "bag", measured, storage, detections=True))).record(0, None)
    assert read.agent_names == measured.agent_names
    assert read.sensor_names == measured.sensor_names
    assert read.times_ns.tolist() == measured.times_ns.tolist()
    np.testing.assert_allclose(read.agent_position, measured.agent_position, atol=1e-9)
    np.testing.assert_allclose(read.agent_rotation, measured.agent_rotation, atol=1e-9)
    assert read.measurements is not None
    assert measured.measurements is not None
    np.testing.assert_array_equal(read.measurements.age_ns, measured.measurements.age_ns)
    np.testing.assert_allclose(read.measurements.position, measured.measurements.position, atol=1e-9)
    np.testing.assert_allclose(read.measurements.rotation, measured.measurements.rotation, atol=1e-9)
    np.testing.assert_array_equal(read.detection_start, measured.detection_start)
    for name in ("position", "size", "yaw", "score", "class_id", "covariance"):
        np.testing.assert_allclose(getattr(read.detections, name), getattr(measured.detections, name), atol=1e-9)
    assert (read.detection_truth_id == -1).all()
    for frame in range(len(read)):
        truth, expected = read.truth_at(frame), measured.truth_at(frame)
        nearest = np.linalg.norm(truth.position[:, None] - expected.position, axis=2).argmin(axis=1)
        assert sorted(nearest.tolist()) == list(range(len(expected)))
        np.testing.assert_allclose(truth.position, expected.position[nearest], atol=1e-5)
        np.testing.assert_allclose(truth.size, expected.size[nearest], atol=1e-5)
        assert truth.class_id.tolist() == expected.class_id[nearest].tolist()
    assert read.notes == ()


def bag(folder: Path, *messages: Sent, definitions: dict[str, str] | None = None) -> str:
    return str(write_bag(folder / "bag", sorted(messages, key=lambda each: each.received_ns), definitions=definitions))


def bag_map(**entries: Any) -> dict[str, Any]:
    """A map with an ego on /pose and a simulated lidar. entries: of the map, instead"""
    ego = dict(pose=dict(topic="/pose"), body=BODY, detections=dict(kind="lidar", position=[0.0, 0.0, 1.8]))
    return dict(frames=dict(map={}), agents=dict(ego=ego)) | entries


def with_detections(**entries: Any) -> dict[str, Any]:
    """A map with an ego on /pose whose detections are on /found. entries: of the detections"""
    return bag_map(agents=dict(ego=dict(pose=dict(topic="/pose"), detections=CAMERA | dict(topic="/found") | entries)))


def play(folder: Path, messages: list[Sent], **options: Any) -> Recording:
    """What is read of a bag with these messages, by default with an ego on /pose."""
    return RosBag(path=bag(folder, *messages), **dict(topics=bag_map()) | options).record(0, None)


def straight(frames: int = 6, topic: str = "/pose", speed: float = 10.0) -> list[Sent]:
    """Poses every 100 ms on the way east."""
    times = [frame * FRAME for frame in range(frames)]
    return [Sent(topic, time, pose_stamped(time, "map", (speed * time / 1e9, 0.0, 0.0))) for time in times]


def found(*position: tuple[float, float, float]) -> Detections:
    n = len(position)
    boxes = np.array(position, float).reshape(n, 3), np.tile([4.0, 2.0, 1.5], (n, 1)), np.zeros(n)
    return Detections(*boxes, np.full(n, 0.9), np.ones(n, np.uint8), np.tile(0.04 * np.eye(3), (n, 1, 1)))


def detections_at(*times: int) -> list[Sent]:
    """One detection ahead at each of some times, further away each time."""
    places = [found((10.0 + row, 0.0, 0.0)) for row in range(len(times))]
    return [Sent("/found", t, detection_array(t, "camera", place)) for t, place in zip(times, places, strict=True)]


def test_poses_between_messages_are_interpolated(tmp_path: Path) -> None:
    later = pose_stamped(400 * MS, "map", (4.0, 8.0, 0.0), rotation_from_yaw(np.pi / 2))
    read = play(tmp_path, [*straight(1), Sent("/pose", 400 * MS, later)])
    np.testing.assert_allclose(read.agent_position[:, 0], np.outer(np.arange(5), [1.0, 2.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(np.degrees(heading(read.agent_rotation[:, 0])), [0.0, 22.5, 45.0, 67.5, 90.0])
    np.testing.assert_allclose(read.truth.velocity, np.tile([10.0, 20.0, 0.0], (5, 1)), atol=1e-9)


def test_a_gap_in_the_poses_of_an_agent_is_refused_unless_it_is_outside_the_chosen_part(tmp_path: Path) -> None:
    messages = [message for message in straight(30) if not 500 * MS < message.received_ns < 1500 * MS]
    path, topics = bag(tmp_path, *messages), bag_map(max_gap_s=0.5)
    with pytest.raises(SceneError, match=r"agent ego: /pose: found no pose for 1.000 s, 0.600 s after the first frame"):
        RosBag(path=path, topics=topics).record(0, None)
    assert len(RosBag(path=path, topics=topics, duration_s=0.5).record(0, None)) == 6
    assert len(RosBag(path=path, topics=topics, start_s=1.5).record(0, None)) == 15
    with pytest.raises(ConfigurationError, match=r"start_s is 3, expected 0 to 2\.9"):
        RosBag(path=path, topics=topics, start_s=3.0).record(0, None)


def test_an_object_without_poses_for_a_while_is_not_there_and_noted(tmp_path: Path) -> None:
    chair = [message for message in straight(20, "/chair", 0.0) if not 500 * MS < message.received_ns < 1500 * MS]
    truth = dict(chair={"topic": "/chair", "size": [0.5, 0.5, 0.9], "class": "unknown", "centre": [0.0, 0.0, 0.45]})
    read = play(tmp_path, [*straight(20), *chair], topics=bag_map(truth=truth))
    assert [len(read.truth_at(frame)) for frame in range(20)] == [2] * 6 + [1] * 9 + [2] * 5
    np.testing.assert_allclose(read.truth_at(0).position[1], [0.0, 0.0, 0.45])
    assert "chair: not there in 9 of 20 frames, which have no pose of it" in read.notes


def test_an_agent_with_fewer_poses_limits_the_frames_and_is_named(tmp_path: Path) -> None:
    late = [message for message in straight(20, "/late") if 300 * MS <= message.received_ns <= 1200 * MS]
    agents = bag_map()["agents"]
    agents["mobile_1"] = agents["ego"] | dict(pose=dict(topic="/late"))
    scene = RosBag(path=bag(tmp_path, *straight(20), *late), topics=bag_map(agents=agents))
    read = scene.record(0, None)
    assert len(read) == 10
    assert {
        "frames begin with the poses of mobile_1, 0.300 s after those of others",
        "frames end with the poses of mobile_1, 0.700 s before those of others",
    } <= set(read.notes)
    alone = RosBag(path=scene.path, topics=scene.topics, n_mobile=0).record(0, None)
    assert alone.agent_names == ("ego",)
    np.testing.assert_array_equal(alone.agent_position[:, 0], read.agent_position[:, 0])
    assert alone.truth.id.tolist() == read.truth.id.tolist(), "an agent that does not play stays an object"


def test_times_are_those_of_headers_or_of_recording_with_an_offset(tmp_path: Path) -> None:
    late = [each._replace(received_ns=each.received_ns + 30 * MS) for each in (*detections_at(120 * MS, 220 * MS),)]
    path = bag(tmp_path, *straight(), *late)

    def ages(**entries: Any) -> list[int]:
        read = RosBag(path=path, topics=with_detections(**entries)).record(0, None)
        assert read.measurements is not None
        return [int(age) // MS if age != NO_MEASUREMENT else -1 for age in read.measurements.age_ns[:, 0]]

    assert ages() == [-1, -1, 80, 80, -1, -1]
    assert ages(time="received") == [-1, -1, 50, 50, -1, -1]
    assert ages(offset_s=-0.02) == [-1, 0, 0, -1, -1, -1]
    read = RosBag(path=path, topics=with_detections() | dict(time="received")).record(0, None)
    assert read.age_ns_at(2, 0) == 50 * MS


def test_the_newest_measurement_of_a_frame_counts_and_others_are_noted(tmp_path: Path) -> None:
    times = [-50 * MS, 110 * MS, 180 * MS, 250 * MS, 700 * MS]
    read = play(tmp_path, [*straight(), *detections_at(*times)], topics=with_detections())
    assert [len(read.detections_at(frame, 0)) for frame in range(6)] == [0, 0, 1, 1, 0, 0]
    assert read.detections_at(2, 0).position[0, 0] == 12.0
    outside, older = (f"ego/camera: {n} of 5 measurements left out: " for n in (2, 1))
    assert [note.startswith(start) for note, start in zip(read.notes, (outside, older), strict=True)] == [True, True]
    faster = RosBag(path=str(tmp_path / "bag"), topics=with_detections() | dict(rate_hz=20.0)).record(0, None)
    assert len(faster.detections) == 3


def test_odometry_transforms_and_stamped_poses_are_the_same(tmp_path: Path) -> None:
    turn = rotation_from_yaw(0.3)
    messages = []
    for time in range(0, 6 * FRAME, FRAME):
        place = (time / FRAME, 1.0, 0.0)
        messages += [
            Sent("/pose", time, pose_stamped(time, "map", place, turn)),
            Sent("/odometry", time, odometry(time, "map", place, turn)),
            Sent("/tf", time, transforms(time, "map", {"other": ((9, 9, 9), np.eye(3)), "base": (place, turn)})),
        ]
    poses = dict(a=dict(topic="/pose"), b=dict(topic="/odometry"), c=dict(topic="/tf", child="base"))
    agents = {name: dict(pose=pose, detections=dict(kind="lidar")) for name, pose in poses.items()}
    read = play(tmp_path, messages, topics=bag_map(agents=agents))
    for column in (1, 2):
        np.testing.assert_allclose(read.agent_position[:, column], read.agent_position[:, 0])
        np.testing.assert_allclose(read.agent_rotation[:, column], read.agent_rotation[:, 0])


def test_a_chain_of_transforms_is_followed_down(tmp_path: Path) -> None:
    quarter, messages = rotation_from_yaw(np.pi / 2), []
    for time in range(0, 11 * FRAME, FRAME):
        messages.append(Sent("/tf", time, transforms(time, "odom", {"base": ((time / 1e9, 0.0, 0.0), quarter)})))
        if time % (5 * FRAME) == 0 and time < 10 * FRAME:
            messages.append(Sent("/tf", time, transforms(time, "map", {"odom": ((10.0, time / 1e9, 0.0), quarter)})))
    path = bag(tmp_path, *messages)

    def scene(child: Any) -> RosBag:
        agents = dict(ego=dict(pose=dict(topic="/tf", child=child), detections=dict(kind="lidar")))
        return RosBag(path=path, topics=bag_map(agents=agents))

    read = scene(["odom", "base"]).record(0, None)
    seconds = np.arange(6) / 10
    np.testing.assert_allclose(read.agent_position[:, 0, :2], np.stack([0.0 * seconds + 10.0, 2.0 * seconds], axis=1))
    np.testing.assert_allclose(np.abs(heading(read.agent_rotation[:, 0])), np.pi)
    assert "/tf: left out: a pose without one of a frame above it in the chain: 5 in 13 messages" in read.notes
    with pytest.raises(ConfigurationError, match="is in the frame 'odom', expected one of `frames`"):
        scene("base").record(0, None)
    with pytest.raises(ConfigurationError, match="child: /tf: 'odom' is in the frame 'map', expected 'other'"):
        scene(["other", "odom"]).record(0, None)
    with pytest.raises(SceneError, match="/tf: found 13 messages, none for each of odom, wheel"):
        scene(["odom", "wheel"]).record(0, None)


def test_frames_and_origins_place_poses_in_the_world(tmp_path: Path) -> None:
    path = bag(tmp_path, *straight())
    place = dict(position=[100.0, 50.0, 0.0], yaw_deg=90.0)
    by_frame = RosBag(path=path, topics=bag_map(frames=dict(map=place))).record(0, None)
    np.testing.assert_allclose(by_frame.agent_position[5, 0], [100.0, 55.0, 0.0])
    np.testing.assert_allclose(heading(by_frame.agent_rotation[:, 0]), np.pi / 2)
    agents = dict(ego=dict(pose=dict(topic="/pose", origin=place), detections=dict(kind="lidar")))
    by_origin = RosBag(path=path, topics=bag_map(frames={}, agents=agents)).record(0, None)
    np.testing.assert_array_equal(by_origin.agent_position, by_frame.agent_position)


def test_detections_in_a_fixed_frame_become_those_of_the_sensor(tmp_path: Path) -> None:
    times = 130 * MS, 230 * MS
    in_map = [Sent("/found", time, detection_array(time, "map", found((30.0, 5.0, 1.0)))) for time in times]
    mount = dict(position=[1.0, 0.0, 1.5], yaw_deg=20.0, pitch_deg=10.0)
    frames = dict(map=dict(position=[7.0, 0.0, 0.0], yaw_deg=45.0))
    topics = with_detections(frame="map", **mount) | dict(frames=frames)
    read = play(tmp_path, [*straight(), *in_map], topics=topics)
    expected = to_world(np.array([30.0, 5.0, 1.0]), np.array([7.0, 0.0, 0.0]), rotation_from_yaw(np.pi / 4))
    for frame in (2, 3):
        position, rotation = read.mount_at(frame, 0)
        now, turn = read.agent_position[frame, 0], read.agent_rotation[frame, 0]
        placed = detections_to_world(read.detections_at(frame, 0), now + turn @ position, turn @ rotation)
        np.testing.assert_allclose(placed.position[0], expected, atol=1e-9)
        np.testing.assert_allclose(placed.yaw, np.pi / 4, atol=1e-9)
        np.testing.assert_allclose(placed.covariance[0], 0.04 * np.eye(3), atol=1e-12)


def test_detected_objects_of_autoware_are_detections(tmp_path: Path) -> None:
    states = junction(n_infrastructure=0, n_mobile=0, frames=4).truth_at(0)
    objects = []
    for tracked in tracked_objects(states, 0, "camera").objects:
        pose = tracked.kinematics.pose_with_covariance
        twist = tracked.kinematics.twist_with_covariance
        kinematics = TYPES["autoware_perception_msgs/msg/DetectedObjectKinematics"](pose, True, 2, twist, False, False)
        make = TYPES["autoware_perception_msgs/msg/DetectedObject"]
        objects.append(make(tracked.existence_probability, tracked.classification, kinematics, tracked.shape))
    message = TYPES[type_store.DETECTED_OBJECTS](header(START_NS + FRAME, "camera"), objects)
    path = bag(tmp_path, *straight(), Sent("/found", FRAME, message))
    read = RosBag(path=path, topics=with_detections()).record(0, None)
    only = read.detections_at(1, 0)
    np.testing.assert_allclose(only.position, states.position, atol=1e-9)
    assert only.class_id.tolist() == states.class_id.tolist()
    with pytest.raises(ConfigurationError, match="DetectedObjects has no use for `axes`"):
        RosBag(path=path, topics=with_detections(axes=["z", "-x", "-y"])).record(0, None)


OWN = {
    "lab_msgs/msg/Found": "std_msgs/Header header\nlab_msgs/Thing[] things\n",
    "lab_msgs/msg/Thing": (
        "int32[2] pixel\nlab_msgs/Guess[] guesses\ngeometry_msgs/Point32 place\nfloat32[3] extent\nstring note\n"
    ),
    "lab_msgs/msg/Guess": "string class\nfloat64 score\n",
}
FIELDS = dict(list="things", position="place", size="extent", score="guesses.0.score")
FIELDS |= {"class": "guesses.0.class"}  # a word of Python


def own_message(store: Any, time_ns: int) -> Any:
    guess = store.types["lab_msgs/msg/Guess"]("56", 0.75)
    point = store.types["geometry_msgs/msg/Point32"]
    extent = np.array([1.0, 2.0, 3.0], np.float32)
    thing = store.types["lab_msgs/msg/Thing"]
    things = [
        thing(np.array([1, 2], np.int32), [guess], point(-0.5, 0.25, 4.0), extent, "näher"),
        thing(np.array([3, 4], np.int32), [], point(0.0, 0.0, 0.0), extent, ""),
    ]
    return store.types["lab_msgs/msg/Found"](header(START_NS + time_ns, "camera"), things)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_detections_of_a_users_own_type_are_read_by_paths(storage: str, tmp_path: Path) -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN.items():
        store.register(get_types_from_msg(text, name))
    messages = [*straight(), Sent("/found", FRAME, own_message(store, FRAME))]
    path = str(write_bag(tmp_path / "bag", sorted(messages, key=lambda each: each.received_ns), storage, OWN))
    entries = dict(fields=FIELDS, axes=["z", "-x", "y"], classes={"56": "pedestrian"}, nearest_m=0.1)
    read = RosBag(path=path, topics=with_detections(**entries)).record(0, None)
    only = read.detections_at(1, 0)
    np.testing.assert_allclose(only.position, [[4.0, 0.5, 0.25]])
    np.testing.assert_allclose(only.size, [[3.0, 1.0, 2.0]])
    assert (only.score.tolist(), only.class_id.tolist()) == ([0.75], [CLASS_INDEX["pedestrian"]])
    assert "/found: left out: nearer than nearest_m, 0.1 m: 1 in 1 messages" in read.notes
    fixed = RosBag(path=path, topics=with_detections(**entries, size=[0.5, 0.5, 1.0])).record(0, None)
    np.testing.assert_allclose(fixed.detections.size, [[0.5, 0.5, 1.0]])
    for changed, message in (
        (dict(position="plaice"), "plaice of lab_msgs/msg/Thing: found no 'plaice', .* did you mean 'place'"),
        (dict(score="guesses.score"), "found no 'score', expected one of a number"),
        (dict(score="guesses.0.score.x"), "found no 'x', expected one of no step"),
        (dict(list="header"), "header of lab_msgs/msg/Found is no list of messages"),
    ):
        topics = with_detections(**entries | dict(fields=FIELDS | changed))
        with pytest.raises(ConfigurationError, match=f"detections.fields: /found: .*{message}"):
            RosBag(path=path, topics=topics).record(0, None)


def test_truth_in_lists_keeps_the_same_objects(tmp_path: Path) -> None:
    source = junction(n_infrastructure=0, n_mobile=0, frames=6)
    own = source.agents[0].object_id
    messages = straight()
    for frame, time in enumerate(range(0, 6 * FRAME, FRAME)):
        truth = source.truth_at(frame)
        columns = truth.position, truth.size, truth.yaw, truth.score, truth.class_id, truth.covariance[:, :3, :3]
        names = [f"object {number}" for number in truth.id]
        messages.append(Sent("/tracked", time, tracked_objects(truth, START_NS + time, "map")))
        messages.append(Sent("/boxes", time, detection_array(time, "map", Detections(*columns), ids=names)))
    path = bag(tmp_path, *messages)
    agents = dict(ego=dict(pose=dict(topic="/pose"), detections=dict(kind="lidar")))
    for topic, without in (("/tracked", own), ("/boxes", f"object {own}")):
        truth_map = dict(all=dict(topic=topic, without=[without]))
        read = RosBag(path=path, topics=bag_map(agents=agents, truth=truth_map)).record(0, None)
        kept = source.truth.id != own
        assert len(np.unique(read.truth.id)) == len(np.unique(source.truth.id[kept]))
        assert len(read.truth) == kept.sum()
        for number in np.unique(read.truth.id):
            rows = read.truth.id == number
            distance = np.linalg.norm(source.truth.position[:, None] - read.truth.position[rows], axis=2)
            assert len(np.unique(source.truth.id[distance.argmin(axis=0)])) == 1, "an object stays the same one"


def test_a_scene_in_which_nothing_moves_has_the_times_of_its_data(tmp_path: Path) -> None:
    pole = dict(pose=dict(position=[0.0, 0.0, 5.0], pitch_deg=20.0), detections=CAMERA | dict(topic="/found"))
    read = play(tmp_path, detections_at(0, FRAME, 2 * FRAME), topics=bag_map(agents=dict(infra_1=pole)))
    assert (len(read), read.agents[0].kind, len(read.truth)) == (3, "static", 0)
    assert [read.age_ns_at(frame, 0) for frame in range(3)] == [0, 0, 0]


def test_what_cannot_be_used_is_left_out_and_counted(tmp_path: Path) -> None:
    low = found((5.0, 0.0, 0.0), (6.0, 0.0, 0.0))
    low.size[1] = 0.0
    messages = [Sent("/pose", 250 * MS, pose_stamped(250 * MS, "map", (np.nan, 0.0, 0.0)))]
    messages.append(Sent("/pose", 210 * MS, pose_stamped(200 * MS, "map", (77.0, 0.0, 0.0))))
    messages.append(Sent("/found", FRAME, detection_array(FRAME, "camera", low)))
    read = play(tmp_path, [*straight(), *messages], topics=with_detections())
    np.testing.assert_allclose(read.agent_position[:, 0, 0], np.arange(6.0))
    assert len(read.detections) == 1
    assert read.notes == (
        "/pose: left out: a pose at the time of another one: 1 in 8 messages",
        "/pose: left out: a value is not finite: 1 in 8 messages",
        "/found: left out: size: not above 0 and at most 300 m: 1 in 1 messages",
    )


def test_notes_are_in_the_description_and_in_the_file_of_a_scene(tmp_path: Path) -> None:
    scene = mast.scene(dict(type="RosBag", path=bag(tmp_path, *straight()), topics=bag_map()))
    line = "note        ego/lidar: no detections in the bag, those of DetectionModel instead"
    assert line in scene.description.splitlines()
    scene.save(tmp_path / "scene.npz")
    assert Recording.load(tmp_path / "scene.npz").notes == scene.recording.notes


def test_without_a_map_the_topics_of_the_bag_are_listed(tmp_path: Path) -> None:
    path = bag(tmp_path, *straight(), *detections_at(FRAME))
    with pytest.raises(ConfigurationError) as error:
        RosBag(path=path).record(0, None)
    lines = str(error.value).splitlines()
    assert lines[0].startswith(f"{path}: found no map of its topics, expected {path}/topics.toml, or `topics`")
    assert lines[1:] == ["  /found  vision_msgs/msg/Detection3DArray  1", "  /pose  geometry_msgs/msg/PoseStamped  6"]


def test_a_map_that_names_its_bag_is_a_scene(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "bag", junction(frames=4))
    content = (folder / "topics.toml").read_text()
    (tmp_path / "map.toml").write_text(f'bag = "bag"\n{content}')
    scene = RosBag(path=str(tmp_path / "map.toml"))
    assert scene.inputs() == (folder, tmp_path / "map.toml")
    read = scene.record(0, None)
    assert read.name == "bag"
    np.testing.assert_array_equal(read.truth.position, RosBag(path=str(folder)).record(0, None).truth.position)
    with pytest.raises(ConfigurationError, match="topics are given, expected None"):
        RosBag(path=scene.path, topics={}).record(0, None)
    (tmp_path / "map.toml").write_text(content)
    with pytest.raises(ConfigurationError, match=r"map\.toml: bag is missing"):
        scene.record(0, None)

    (tmp_path / "alone.db3").write_bytes((folder / "bag.db3").read_bytes())
    (tmp_path / "alone.toml").write_bytes((folder / "topics.toml").read_bytes())
    alone = RosBag(path=str(tmp_path / "alone.db3")).record(0, None)
    named = RosBag(path=str(folder), topics=str(tmp_path / "alone.toml")).record(0, None)
    np.testing.assert_array_equal(alone.truth.position, named.truth.position)
    assert (alone.name, named.name) == ("alone.db3", "bag")
    scene = RosBag(path=str(tmp_path / "alone.db3"))
    assert scene.inputs() == (tmp_path / "alone.db3", tmp_path / "alone.toml"), "a changed map is not in the cache"


@pytest.fixture(scope="module")
def detected(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A bag with poses of an ego and one detection."""
    return bag(tmp_path_factory.mktemp("detected"), *straight(), *detections_at(FRAME))


EGO = bag_map()["agents"]["ego"]


#: Entries of detections that cannot be.
DETECTIONS = [
    (dict(frame="lidar"), "frame: /found: is in the frame 'camera', expected 'lidar'"),
    (dict(kind="sonar"), "kind: .* invalid enum value 'sonar'"),
    (dict(axes=["x", "x", "z"]), "axes: expected three different axes"),
    (dict(axes=["x", "y", "up"]), r"axes\[2\]: .* invalid enum value 'up'"),
    (dict(classes={"0": "person"}), "classes.*: .* invalid enum value 'person'"),
    (dict(fields=dict(list="detections")), "missing required field `position`"),
    (dict(range_m=0.0), "max_range_m"),
    (dict(azimuth_deg=[10.0]), "azimuth_deg: .* expected `array` of length 2, got 1"),
    (dict(origin={}), "no origin of detections"),
    (dict(topic="/pose"), "PoseStamped', expected vision_msgs.*`fields` reads other types"),
]


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (dict(agents={}), "agents: .* expected `object` of length >= 1"),
        (dict(agent=EGO), "contains unknown field `agent`"),
        (dict(agents=dict(ego=EGO | dict(pose=dict(topic="/pos")))), r"agents.ego.pose: no topic '/pos' .*'/pose'.*\n"),
        (dict(agents=dict(ego=EGO | dict(pose=dict(topic="/found")))), "Detection3DArray', expected nav_msgs"),
        (dict(agents=dict(ego=EGO | dict(pose=dict(topic="/pose", child="base")))), "expected no `child`"),
        (dict(agents={"e/go": EGO}), "`\\$.agents.*e/go.* expected `str` matching"),
        (dict(agents=dict(ego=EGO | dict(body=BODY | dict(size=[4, 0, 1])))), r"body.size\[1\]: found .*, expected"),
        (dict(agents=dict(ego=EGO | dict(body=BODY | {"class": "chair"}))), "body.class: .* invalid enum value"),
        (dict(frames={}), r"/pose: is in the frame 'map', expected one of `frames` of the map \(none\), or `origin`"),
        (dict(frames=dict(mapp={})), "did you mean 'mapp'"),
        (dict(frames=dict(map=dict(position=[0.0, 0.0]))), "frames.map.position: .* expected `array` of length 3, got"),
        (dict(rate_hz=0.0), "rate_hz: .* expected `float` >= 0.01"),
        (dict(time="sent"), "time: .* invalid enum value 'sent'"),
        (dict(truth=dict(a=dict(topic="/pose"))), "an object with a pose needs `size` and `class`"),
        (dict(types={"a/msg/B": "int32"}), "types: the definition of 'a/msg/B' cannot be read"),
        *((with_detections(**entries), message) for entries, message in DETECTIONS),
    ],
)
def test_a_map_that_cannot_be_is_refused_with_its_place(entries: dict[str, Any], message: str, detected: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RosBag(path=detected, topics=bag_map(**entries)).record(0, None)


PAGE = Path(__file__).parents[3] / "docs" / "how-to-data-sets.md"
BLOCKS = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), flags=re.S | re.M)
FIRST, TIERS = map(tomllib.loads, BLOCKS)


def test_the_first_map_of_the_page_plays(tmp_path: Path) -> None:
    source = junction(n_infrastructure=0, n_mobile=0, frames=6)
    messages = []
    for frame, time in enumerate(range(0, 6 * FRAME, FRAME)):
        objects = source.truth_at(frame)
        objects = objects.with_(id=np.arange(7, 7 + len(objects)))
        now = {
            "/ego/odom": odometry(time, "map", (time / 1e8, 0.0, 0.0)),
            "/ego/detections": detection_array(time, "ego/lidar", found((9.0, 0.0, -1.0))),
            "/pole/detections": detection_array(time, "map", found((9.0, 1.0, 1.0), (5.0, 1.0, 1.0))),
            "/ground_truth": tracked_objects(objects, START_NS + time, "map"),
            "/mocap/visitor/pose": pose_stamped(time, "map", (3.0, 3.0, 0.9)),
        }
        messages += [Sent(topic, time, message) for topic, message in now.items()]
    read = play(tmp_path, messages, topics=FIRST)
    assert read.agent_names == ("ego", "infra_1")
    assert [len(read.detections_at(2, agent)) for agent in range(2)] == [1, 2]
    assert len(read.truth_at(2)) == len(source.truth_at(2)) - 1 + 2, "without 7, with the visitor and the ego"
    assert read.notes == ()


@pytest.fixture(scope="module")
def tiers() -> Path:
    return reference("tiers_multirobot")


def robots(*names: str, chairs: tuple[str, ...] = ("chair2", "chair_final")) -> dict[str, Any]:
    """The map of the page for some robots and chairs."""
    agents = {}
    for name in names:
        agent = copy.deepcopy(TIERS["agents"]["turtle05"])
        agent["pose"]["topic"] = f"/vrpn_client_node/turtlebot{int(name[-2:])}_cap/pose"
        agent["detections"]["topic"] = f"/{name}/color/yolov4_Spatial_detections"
        agents[name] = agent
    assert all(agents[name] == entry for name, entry in TIERS["agents"].items() if name in names)
    return TIERS | dict(agents=agents, truth={name: TIERS["truth"][name] for name in chairs})


@pytest.mark.heavy
def test_four_real_robots_detect_what_the_page_says(tiers: Path) -> None:
    topics = robots("turtle05", "turtle01", "turtle03", "turtle04")
    read = RosBag(path=str(tiers / "shortbag_20221011.db3"), topics=topics).record(0, None)
    assert (len(read), read.agent_names) == (687, ("turtle05", "turtle01", "turtle03", "turtle04"))
    assert read.measurements is not None
    new = (read.measurements.age_ns != NO_MEASUREMENT).sum(axis=0)
    assert new.tolist() == [336, 336, 337, 337], "all but those before the first pose of the last robot"
    first, last = read.truth_at(1), read.truth_at(600)
    assert first.id.tolist() == [1, 2, 3, 4, 5, 6]
    assert np.linalg.norm(last.position[4:] - first.position[4:], axis=1).max() < 0.01, "chairs stand"
    offsets = []
    for frame in range(len(read)):
        seen = read.detections_at(frame, 0)
        position, rotation = read.mount_at(frame, 0)
        turn = read.agent_rotation[frame, 0]
        placed = detections_to_world(seen, read.agent_position[frame, 0] + turn @ position, turn @ rotation)
        offset = placed.position[:, None, :2] - read.truth_at(frame).position[None, -2:, :2]
        offsets += np.linalg.norm(offset, axis=2).min(axis=1, initial=np.inf).tolist()
    assert 0.3 < np.median(offsets) < 0.5, "of its detections from the nearest chair, m"
    assert [len(read.detections_at(frame, 2)) for frame in range(len(read))] == [0] * len(read)
    assert any("nearest_m, 0.3 m: 40 in 342 messages" in note for note in read.notes)


@pytest.mark.heavy
def test_runs_of_real_robots_track_their_chairs(tiers: Path, tmp_path: Path) -> None:
    pair = dict(topics=robots("turtle03", "turtle01", chairs=("chair_final",)))
    four = dict(topics=robots("turtle05", "turtle01", "turtle03", "turtle04"))
    for file, options, ego, tracked, error_m in (
        ("shortbag_20221011", four, "turtle05", 2, 0.45),
        ("2robots_chair_camera_06_20220923", pair, "turtle03", 1, 0.6),
    ):
        scene = dict(type="RosBag", path=str(tiers / f"{file}.db3"), **options)
        local = []
        for scenario, attack in (("baseline", {}), ("coordinated", dict(n_adversaries=1))):
            run = mast.run(scenario, scene=scene, seed=0, out=tmp_path / file / scenario, report=False, **attack)
            local.append(run.summary["agents"][ego]["local"])
        assert tracked - 0.2 < local[0]["tp"]["mean"] <= tracked
        assert local[0]["rmse_m"] < error_m
        assert local[0] == local[1], "attacks do not reach an agent's own tracks"


def test_an_exported_run_plays_with_the_same_truth(tmp_path: Path) -> None:
    scene = dict(type="Intersection", scene_index=1, n_infrastructure=1)
    mast.run("baseline", scene=scene, frames=4, out=tmp_path / "run", report=False)
    result = CliRunner().invoke(app, ["export", str(tmp_path / "run"), "--to", "rosbag2", "-o", str(tmp_path / "bag")])
    assert result.exit_code == 0, result.output
    ego = dict(pose=dict(topic="/tf", child="ego"))
    ego["detections"] = CAMERA | dict(topic="/agent/ego/tracks", frame="world")
    topics = dict(frames=dict(world={}), agents=dict(ego=ego), truth=dict(all=dict(topic="/scene/truth")))
    read = RosBag(path=str(tmp_path / "bag"), topics=topics).record(0, None)
    original = mast.scene(scene, frames=4).recording
    assert len(read.truth) == len(original.truth)
    np.testing.assert_allclose(read.agent_position[:, 0], original.agent_position[:, 0], atol=1e-9)
    for frame in range(4):
        offset = read.truth_at(frame).position[:, None] - original.truth_at(frame).position
        assert np.linalg.norm(offset, axis=2).min(axis=1).max() < 1e-5
