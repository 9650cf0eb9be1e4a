"""Poses, times and trust as ROS 2 messages, and poses that come back."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mast_ros2 import received_poses, type_store
from mast_ros2.received_poses import received_pose, received_transforms, stamped_poses
from mast_ros2.run_messages import diagnostic_array
from mast_ros2.spatial import Transform, clock, odometry, transform_message
from ros2_messages import random_message, set_to, through
from scipy.spatial.transform import Rotation

from mast_zenoh.errors import MessageError
from mast_zenoh.integrity import STATES
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body, Header, Message, text

TIME_NS = 12_345_000_000
NAN = float("nan")


def random_rotation(random: np.random.Generator) -> Any:
    """(4,) w x y z"""
    x, y, z, w = Rotation.random(random_state=int(random.integers(2**31))).as_quat()
    return np.array([w, x, y, z])


@pytest.fixture
def pose() -> Body:
    random = np.random.default_rng(1)
    return {
        "position": random.normal(size=3) * 100.0,
        "rotation": random_rotation(random),
        "velocity": random.normal(size=3) * 10.0,
    }


@pytest.fixture
def transforms() -> list[Transform]:
    random = np.random.default_rng(2)
    return [
        Transform("map", f"agent_{k}", TIME_NS + k, random.normal(size=3), random_rotation(random)) for k in range(5)
    ]


def test_the_velocity_of_an_odometry_is_in_the_axes_of_the_vehicle(pose: Body) -> None:
    message = through(odometry(pose, TIME_NS, "map", "ego"))
    w, x, y, z = pose["rotation"]
    linear = message.twist.twist.linear
    in_world = Rotation.from_quat([x, y, z, w]).apply([linear.x, linear.y, linear.z])
    np.testing.assert_allclose(in_world, pose["velocity"], atol=1e-12)
    assert (message.header.frame_id, message.child_frame_id) == ("map", "ego")


def test_a_pose_comes_back_from_its_odometry_and_is_a_valid_message(pose: Body) -> None:
    received = received_pose(through(odometry(pose, TIME_NS, "map", "ego")))
    assert (received.frame_id, received.child_frame_id, received.time_ns) == ("map", "ego", TIME_NS)
    for name, values in pose.items():
        np.testing.assert_allclose(received.columns[name], values, atol=1e-12)
    codec.decode(codec.encode(Message(Header("pose", "ros", 0, TIME_NS, 0), received.columns)), "pose")


def test_a_rotation_is_normalised_before_it_is_sent(pose: Body) -> None:
    longer = dict(pose) | {"rotation": pose["rotation"] * 3.0}
    orientation = odometry(longer, 0, "map", "ego").pose.pose.orientation
    np.testing.assert_allclose([orientation.w, orientation.x, orientation.y, orientation.z], pose["rotation"])


def test_transforms_come_back(transforms: list[Transform]) -> None:
    received = received_transforms(through(transform_message(transforms)))
    assert received.dropped == {}
    for found, original in zip(received.transforms, transforms, strict=True):
        assert found[:3] == original[:3]
        np.testing.assert_array_equal(found.position, original.position)
        np.testing.assert_allclose(found.rotation, original.rotation, atol=1e-15)


def test_the_slash_before_a_frame_of_an_old_publisher_is_removed(transforms: list[Transform]) -> None:
    (found,) = received_transforms(transform_message([transforms[0]._replace(parent="/map")])).transforms
    assert found.parent == "map"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_to("transform.translation.x", NAN), "a value is not finite"),
        (set_to("transform.translation.z", -1e9), "position: beyond 1e+07 m"),
        (set_to("transform.rotation.w", 7.0), "orientation: a quaternion whose length is not 1"),
        (set_to("header.frame_id", ""), "frame_id: invalid"),
        (set_to("child_frame_id", "y" * 256), "frame_id: invalid"),
        (set_to("child_frame_id", "map"), "frame_id: a frame is its own parent"),
        (set_to("header.stamp.sec", -5), "stamp: invalid"),
    ],
)
def test_a_transform_that_cannot_be_used_is_counted_and_the_others_stay(transforms, change, reason) -> None:
    message = through(transform_message(transforms))
    change(message.transforms[2])
    received = received_transforms(message)
    assert received.dropped == {reason: 1}
    assert [each.child for each in received.transforms] == ["agent_0", "agent_1", "agent_3", "agent_4"]


def test_too_many_transforms_are_refused_as_a_whole(transforms: list[Transform]) -> None:
    message = transform_message(transforms)
    message.transforms *= 1 + received_poses.MOST_TRANSFORMS // len(transforms)
    with pytest.raises(MessageError, match=r"TFMessage: found 1005 transforms, expected at most 1000"):
        received_transforms(message)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_to("pose.pose.position.y", NAN), "nav_msgs/msg/Odometry: pose: a value is not finite"),
        (set_to("pose.pose.orientation.w", 9.0), "nav_msgs/msg/Odometry: pose: orientation: a quaternion whose length"),
        (set_to("twist.twist.linear.x", 200.0), "nav_msgs/msg/Odometry: twist: velocity: not finite or beyond 150 m/s"),
        (set_to("twist.twist.linear.x", NAN), "nav_msgs/msg/Odometry: twist: velocity: not finite or beyond 150 m/s"),
        (set_to("child_frame_id", ""), "frame_id: found ''"),
        (set_to("header.stamp.nanosec", 2**32 - 1), "stamp: found 12 s and 4294967295 ns"),
    ],
)
def test_an_odometry_that_cannot_be_used_is_refused_with_the_reason(pose, change, reason) -> None:
    message = through(odometry(pose, TIME_NS, "map", "ego"))
    change(message)
    with pytest.raises(MessageError) as refusal:
        received_pose(message)
    assert reason in str(refusal.value)


@pytest.mark.parametrize("kind", received_poses.POSES)
def test_a_pose_of_any_type_is_a_transform(kind: str, pose: Body) -> None:
    whole = odometry(pose, TIME_NS, "map", "ego")
    covered, (stamped,) = whole.pose, transform_message([Transform("map", "ego", TIME_NS, *_placed(pose))]).transforms
    fields = {
        type_store.ODOMETRY: (whole.child_frame_id, covered, whole.twist),
        type_store.TF_MESSAGE: (),
        "geometry_msgs/msg/PoseStamped": (covered.pose,),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (covered,),
        "geometry_msgs/msg/TransformStamped": (stamped.child_frame_id, stamped.transform),
    }[kind]
    head = [[stamped]] if kind == type_store.TF_MESSAGE else [whole.header]
    message = through(type_store.TYPES[kind](*head, *fields))
    (found,) = stamped_poses(message).transforms
    has_child = kind in (type_store.ODOMETRY, type_store.TF_MESSAGE, "geometry_msgs/msg/TransformStamped")
    assert found[:3] == ("map", "ego" if has_child else "", TIME_NS)
    np.testing.assert_allclose(found.position, pose["position"])
    np.testing.assert_allclose(found.rotation, pose["rotation"], atol=1e-15)


def _placed(pose: Body) -> tuple[Any, Any]:
    return pose["position"], pose["rotation"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (set_to("pose.pose.position.y", NAN), "a value is not finite"),
        (set_to("header.frame_id", ""), "frame_id: invalid"),
        (set_to("header.stamp.sec", -1), "stamp: invalid"),
    ],
)
def test_a_single_pose_that_cannot_be_used_is_counted(pose: Body, change: Callable[[Any], None], reason: str) -> None:
    message = through(odometry(pose, TIME_NS, "map", "ego"))
    change(message)
    assert stamped_poses(message) == ((), {reason: 1})


def test_a_message_of_another_type_is_no_pose() -> None:
    with pytest.raises(MessageError, match="Clock: expected nav_msgs/msg/Odometry, "):
        stamped_poses(clock(0))
    for read, expected in ((received_pose, type_store.ODOMETRY), (received_transforms, type_store.TF_MESSAGE)):
        with pytest.raises(MessageError, match=f"Clock: expected {expected}"):
            read(clock(0))


def test_random_poses_and_transforms_never_crash() -> None:
    random = np.random.default_rng(3)
    for _ in range(100):
        message = random_message(type_store.TF_MESSAGE, random)
        received = received_transforms(message)
        assert len(received.transforms) + sum(received.dropped.values()) == len(message.transforms)
        with pytest.raises(MessageError):  # random quaternions are not of length 1
            received_pose(random_message(type_store.ODOMETRY, random))


@pytest.fixture
def trust() -> Body:
    random = np.random.default_rng(4)
    a, n = len(STATES), 6
    return {
        "agents": text([f"agent_{k}" for k in range(a)]),
        "mean": random.uniform(size=a),
        "log_odds": random.normal(size=a),
        "state": np.arange(a, dtype=np.uint8),
        "reason": text(["", "", "drifts", "adds objects", ""]),
        "fault_offset": random.normal(size=(a, 2)),
        "fault_turn": random.normal(size=a),
        "fault_delay": random.uniform(size=a),
        "fault_loss": random.uniform(size=a),
        "id": np.arange(10, 10 + n),
        "position": np.zeros((n, 3)),
        "size": np.ones((n, 3)),
        "yaw": np.zeros(n),
        "trust": random.uniform(size=n),
        "expected": np.ones(n, np.int64),
        "confirming": np.ones(n, np.int64),
        "contradicting": np.array([0, 1, 0, 2, 0, 0]),
        "withheld": np.array([0, 1, 0, 1, 0, 0], np.uint8),
    }


def test_trust_in_each_agent_is_a_status_with_its_level(trust: Body) -> None:
    array = through(diagnostic_array(trust, TIME_NS, "command_center"))
    *agents, _ = array.status
    assert array.header.stamp.sec == 12
    levels = {each.message: each.level for each in agents}
    assert levels == {"unknown": 0, "trusted": 0, "faulty: drifts": 1, "suspended: adds objects": 2, "undecided": 1}
    for k, each in enumerate(agents):
        assert (each.name, each.hardware_id) == (f"command_center: agent_{k}", f"agent_{k}")
        values = {pair.key: pair.value for pair in each.values}
        assert float(values["mean"]) == pytest.approx(trust["mean"][k], rel=1e-5)
        assert float(values["fault_delay"].removesuffix(" s")) == pytest.approx(trust["fault_delay"][k], rel=1e-5)
        offset = [float(value) for value in values["fault_offset"].removesuffix(" m").split()]
        np.testing.assert_allclose(offset, trust["fault_offset"][k], rtol=1e-5)


def test_withheld_objects_are_a_warning_with_their_ids(trust: Body) -> None:
    status = through(diagnostic_array(trust, TIME_NS, "command_center")).status[-1]
    assert (status.name, status.level) == ("command_center: objects", 1)
    assert status.message == "2 of 6 objects withheld"
    values = {pair.key: pair.value for pair in status.values}
    assert values == {"objects": "6", "contradicted": "2", "withheld": "11 13"}
    none = dict(trust) | {"withheld": np.zeros(6, np.uint8)}
    assert diagnostic_array(none, TIME_NS, "command_center").status[-1].level == 0
