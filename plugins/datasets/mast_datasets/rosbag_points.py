"""Reads the points of lidars from the messages of a bag, sensor_msgs/msg/PointCloud2."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
from mast_ros2 import type_store
from mast_ros2.type_store import RosMessage
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from mast_datasets.point_files import MAX_FIELDS, points_of_columns
from mast_datasets.rosbag import PointsEntry
from mast_datasets.rosbag_storage import MAX_MESSAGE_BYTES, Bag
from mast_zenoh.errors import MessageError, SceneError
from mast_zenoh.scenes.recorded_scans import MAX_POINTS
from mast_zenoh.sensing import Points

#: Numbers of a PointField by its `datatype`.
_KINDS: Mapping[int, str] = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_STORE = get_typestore(Stores.ROS2_JAZZY)
_STORE.max_sequence_length = MAX_MESSAGE_BYTES


class ScanStamp(NamedTuple):
    """The header of a message: ns, and the name of its frame."""

    time_ns: int
    frame_id: str


def stamp_of_scan(payload: bytes) -> ScanStamp:
    """The header with which a payload begins. Raises MessageError if it has none."""
    try:
        order = "<" if payload[1] & 1 else ">"
        s, ns, length = struct.unpack_from(f"{order}iII", payload, 4)
        name = payload[16 : 16 + length].rstrip(b"\0").decode()
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise MessageError(f"{type_store.POINT_CLOUD}: {len(payload)} bytes: {error}") from None
    return ScanStamp(s * 10**9 + ns, name)


def read_scans(bag: Bag, entry: PointsEntry, wanted: Collection[int]) -> dict[int, Points]:
    """The points of the messages of a topic with some numbers, from 0.

    Raises SceneError, with bag, topic and message, for one that cannot be read, or whose numbers cannot be.
    """
    result = {}
    for number, (connection, received_ns, payload) in enumerate(bag.messages({entry.topic})):
        if number not in wanted:
            continue
        place = f"{bag.path}: {connection.topic}: message {number}, received at {received_ns} ns"
        try:
            message = _STORE.deserialize_cdr(payload, type_store.POINT_CLOUD)
        except (SerdeError, ValueError) as error:
            raise SceneError(f"{place}, cannot be read: {error}") from None
        result[number] = points_of(message, place, entry.most_intensity)
    return result


def points_of(message: RosMessage, place: str, most_intensity: float = 1.0) -> Points:
    """The points of a PointCloud2, without those at 0, 0, 0 and those that are no numbers, which are no returns.

    place: of it, for messages;  most_intensity: becomes 1, as do all above

    Times and channels are kept together, or neither. Raises SceneError for a message that cannot be.
    """
    return points_of_columns(_columns(message, place), place, most_intensity)


def _columns(message: RosMessage, place: str) -> dict[str, NDArray[Any]]:
    """The fields of one number a point by name, (n,) each."""
    count, step, row = message.width * message.height, message.point_step, message.row_step
    if count > MAX_POINTS:
        raise SceneError(f"{place}: found {count} points, expected at most {MAX_POINTS}")
    if row < message.width * step or len(message.data) != row * message.height:
        found = f"{len(message.data)} bytes for {message.height} rows of {message.width} points of {step} bytes"
        raise SceneError(f"{place}: found {found}, row_step {row}, expected as many bytes as that")
    if len(message.fields) > MAX_FIELDS:
        raise SceneError(f"{place}: found {len(message.fields)} fields, expected at most {MAX_FIELDS}")
    order = ">" if message.is_bigendian else "<"
    result = {}
    content = np.asarray(message.data, np.uint8).reshape(message.height, row)[:, : message.width * step]
    content = np.ascontiguousarray(content).reshape(count, step)
    for field in message.fields:
        kind = np.dtype(order + _KINDS[field.datatype]) if field.datatype in _KINDS else None
        if kind is None or field.count > 1:
            continue
        if field.offset + kind.itemsize > step:
            raise SceneError(f"{place}: {field.name!r:.80} is at byte {field.offset}, expected it in {step} bytes")
        part = np.ascontiguousarray(content[:, field.offset : field.offset + kind.itemsize])
        result[field.name] = part.view(kind).reshape(count)
    return result
