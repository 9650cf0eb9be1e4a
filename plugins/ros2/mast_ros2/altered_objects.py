"""A message of objects, some of which an interposer has altered: the others keep every field that was sent."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mast_ros2 import type_store
from mast_ros2.object_messages import UUID_BYTES, detection_array, tracked_objects
from mast_ros2.received_objects import ReceivedObjects
from mast_ros2.spatial import time_of
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.states import ObjectStates

#: Types that can be altered.
ALTERABLE = (type_store.TRACKED_OBJECTS, type_store.DETECTIONS)

_UUID = type_store.TYPES["unique_identifier_msgs/msg/UUID"]


def altered(message: RosMessage, received: ReceivedObjects[ObjectStates], wanted: ObjectStates) -> RosMessage:
    """The message with the objects that are wanted instead of those that were received from it.

    received: by `received_tracks`;  wanted: in the same frame of reference, with the ids of those that stay

    An object that stays has the fields of the sender, but for the pose, velocity and size that differ. Objects that
    could not be received stay as they are. New ones come last, with ids of the sender's form.
    """
    is_tracked = message.__msgtype__ == type_store.TRACKED_OBJECTS
    sent: list[RosMessage] = list(message.objects if is_tracked else message.detections)
    index_of, rows = (
        {number: index for index, number in enumerate(received.objects.id.tolist())},
        received.rows.tolist(),
    )
    unreceived = set(range(len(sent))).difference(rows)
    result: dict[int, RosMessage] = {row: sent[row] for row in unreceived}
    of_wanted = _converted(message, wanted)
    added = []
    for index, (number, converted) in enumerate(zip(wanted.id.tolist(), of_wanted, strict=True)):
        if number in index_of:
            own, row = index_of[number], rows[index_of[number]]
            differing = _differences(received.objects, own, wanted, index)
            result[row] = (_tracked if is_tracked else _detected)(sent[row], converted, differing)
        else:
            added.append(_named(converted, number, sent, is_tracked))
    objects = [result[row] for row in sorted(result)] + added
    return replace(message, **{"objects" if is_tracked else "detections": objects})


def _converted(message: RosMessage, states: ObjectStates) -> Sequence[RosMessage]:
    """Objects as messages, with the header's stamp and frame."""
    where = time_of(message.header.stamp), message.header.frame_id
    if message.__msgtype__ == type_store.TRACKED_OBJECTS:
        tracked: Sequence[RosMessage] = tracked_objects(states, *where).objects
        return tracked
    detections: Sequence[RosMessage] = detection_array(states, *where).detections
    return detections


def _differences(own: ObjectStates, row: int, new: ObjectStates, new_row: int) -> frozenset[str]:
    """Which of position, yaw, velocity and size of an object, in a row, differ from another's."""
    names = ("position", "yaw", "velocity", "size")
    return frozenset(name for name in names if np.any(getattr(own, name)[row] != getattr(new, name)[new_row]))


def _tracked(sent: RosMessage, converted: RosMessage, differing: frozenset[str]) -> RosMessage:
    """A TrackedObject with what differs."""
    if not differing:
        return sent
    own, new = sent.kinematics, converted.kinematics
    pose = _pose(own.pose_with_covariance.pose, new.pose_with_covariance.pose, differing)
    kinematics = replace(own, pose_with_covariance=replace(own.pose_with_covariance, pose=pose))
    if differing & {"velocity", "yaw"}:  # it is in the axes of the object
        twist = replace(own.twist_with_covariance.twist, linear=new.twist_with_covariance.twist.linear)
        kinematics = replace(kinematics, twist_with_covariance=replace(own.twist_with_covariance, twist=twist))
    if "velocity" in differing:
        kinematics = replace(kinematics, is_stationary=new.is_stationary)
    shape = replace(sent.shape, dimensions=converted.shape.dimensions) if "size" in differing else sent.shape
    return replace(sent, kinematics=kinematics, shape=shape)


def _detected(sent: RosMessage, converted: RosMessage, differing: frozenset[str]) -> RosMessage:
    """A Detection3D with what differs; it has no velocity."""
    if not differing - {"velocity"}:
        return sent
    centre = _pose(sent.bbox.center, converted.bbox.center, differing)
    size = converted.bbox.size if "size" in differing else sent.bbox.size
    results = [
        replace(each, pose=replace(each.pose, pose=_pose(each.pose.pose, converted.bbox.center, differing)))
        for each in sent.results
    ]
    return replace(sent, bbox=replace(sent.bbox, center=centre, size=size), results=results)


def _pose(own: RosMessage, new: RosMessage, differing: frozenset[str]) -> RosMessage:
    return replace(
        own,
        position=new.position if "position" in differing else own.position,
        orientation=new.orientation if "yaw" in differing else own.orientation,
    )


def _named(converted: RosMessage, number: int, sent: Sequence[RosMessage], is_tracked: bool) -> RosMessage:
    """A new object with an id that looks like the sender's, equal in all messages."""
    digits = hashlib.blake2b(str(number).encode(), digest_size=UUID_BYTES)
    if is_tracked:
        return replace(converted, object_id=_UUID(np.frombuffer(digits.digest(), np.uint8)))
    if all(each.id.lstrip("-").isdecimal() for each in sent):
        return converted
    return replace(converted, id=digits.hexdigest()[: max(len(each.id) for each in sent) or None])
