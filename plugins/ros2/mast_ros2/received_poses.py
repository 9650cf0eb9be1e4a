"""Poses of ROS 2 as ours: Odometry as a `pose`; TFMessage and all other poses as transforms between frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mast_ros2 import type_store
from mast_ros2.received_objects import MOST_SPEED
from mast_ros2.spatial import MOST_METRES, Transform, frame_of, is_unit, pose_rows, time_of, vector_rows
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body

#: Transforms of a message, at most: a vehicle has tens.
MOST_TRANSFORMS = 1000


class ReceivedPose(NamedTuple):
    """The pose of a vehicle.

    frame_id, child_frame_id: names of the frame of reference and of the vehicle's frame
    time_ns: ns, of the header
    columns: those of a `pose` message, in the frame of reference
    """

    frame_id: str
    child_frame_id: str
    time_ns: int
    columns: Body


class ReceivedTransforms(NamedTuple):
    """Transforms of a message that can be used, and the number of the others by reason."""

    transforms: tuple[Transform, ...]
    dropped: Mapping[str, int]


def received_pose(message: RosMessage) -> ReceivedPose:
    """The pose in an Odometry; its velocity is turned from the axes of the vehicle into the frame of reference.

    Raises MessageError for another type, an invalid header, and values that are not finite or absurd.
    """
    if message.__msgtype__ != type_store.ODOMETRY:
        raise MessageError(f"{message.__msgtype__}: expected {type_store.ODOMETRY}")
    pose, velocity = pose_rows([message.pose.pose])[0], vector_rows([message.twist.twist.linear])[0]
    reason = _reason(pose)
    if reason:
        raise MessageError(f"{type_store.ODOMETRY}: pose: {reason}")
    with np.errstate(over="ignore"):
        too_fast = not np.linalg.norm(velocity) <= MOST_SPEED
    if too_fast:
        raise MessageError(f"{type_store.ODOMETRY}: twist: velocity: not finite or beyond {MOST_SPEED:g} m/s")
    columns = {
        "position": pose[:3],
        "rotation": pose[3:],
        "velocity": rotation_from_quaternion(pose[3:]) @ velocity,
    }
    frame_id, child = frame_of(message.header.frame_id), frame_of(message.child_frame_id)
    return ReceivedPose(frame_id, child, time_of(message.header.stamp), columns)


def received_transforms(message: RosMessage) -> ReceivedTransforms:
    """The transforms in a TFMessage; raises MessageError for another type or too many of them."""
    if message.__msgtype__ != type_store.TF_MESSAGE:
        raise MessageError(f"{message.__msgtype__}: expected {type_store.TF_MESSAGE}")
    if len(message.transforms) > MOST_TRANSFORMS:
        found = len(message.transforms)
        raise MessageError(f"{type_store.TF_MESSAGE}: found {found} transforms, expected at most {MOST_TRANSFORMS}")
    transforms, dropped = [], Counter[str]()
    for stamped in message.transforms:
        try:
            transforms.append(_transform(stamped))
        except MessageError as error:
            dropped[str(error)] += 1
    return ReceivedTransforms(tuple(transforms), dict(dropped))


def stamped_poses(message: RosMessage) -> ReceivedTransforms:
    """The poses in a message of a type of POSES, as transforms; the child of a pose without one is "".

    A single pose that cannot be used is counted, as those of a TFMessage are. Raises MessageError for another type or
    too many transforms.
    """
    kind = message.__msgtype__
    if kind == type_store.TF_MESSAGE:
        return received_transforms(message)
    if kind not in POSES:
        raise MessageError(f"{kind}: expected {', '.join(POSES)}")
    try:
        if kind == _TRANSFORM_STAMPED:
            return ReceivedTransforms((_transform(message),), {})
        pose = message.pose if kind == _POSE_STAMPED else message.pose.pose
        child = message.child_frame_id.removeprefix("/") if kind == type_store.ODOMETRY else ""
        return ReceivedTransforms((_placed(message.header, child, pose.position, pose.orientation),), {})
    except MessageError as error:
        return ReceivedTransforms((), {str(error): 1})


_POSE_STAMPED, _TRANSFORM_STAMPED = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"
#: Types that `stamped_poses` reads.
POSES = (
    type_store.ODOMETRY,
    type_store.TF_MESSAGE,
    _POSE_STAMPED,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    _TRANSFORM_STAMPED,
)


def _transform(stamped: RosMessage) -> Transform:
    """A transform; raises MessageError with a reason without values that the sender chooses."""
    try:
        child = frame_of(stamped.child_frame_id)
    except MessageError:
        raise MessageError("frame_id: invalid") from None
    result = _placed(stamped.header, child, stamped.transform.translation, stamped.transform.rotation)
    if result.parent == child:
        raise MessageError("frame_id: a frame is its own parent")
    return result


def _placed(header: RosMessage, child: str, position: RosMessage, turn: RosMessage) -> Transform:
    """A position and a quaternion; raises MessageError with a reason without values that the sender chooses."""
    values = np.array([position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z])
    reason = _reason(values)
    if reason:
        raise MessageError(reason)
    try:
        return Transform(frame_of(header.frame_id), child, time_of(header.stamp), values[:3], values[3:])
    except MessageError as error:
        raise MessageError(str(error).partition(":")[0] + ": invalid") from None


def _reason(pose: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Why x y z and w x y z are no pose, or ""."""
    if not np.isfinite(pose).all():
        return "a value is not finite"
    if np.abs(pose[:3]).max() > MOST_METRES:
        return f"position: beyond {MOST_METRES:g} m"
    return "" if is_unit(pose[3:]) else "orientation: a quaternion whose length is not 1"
