"""Classes of all ROS 2 message types that are used here, their CDR bytes, and their hashes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_ros2.definitions import DEFINITIONS
from mast_zenoh.errors import MessageError

#: A message of rosbags' classes. `__msgtype__` is the name of its type, such as `std_msgs/msg/String`.
RosMessage = Any

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
CLOCK = "rosgraph_msgs/msg/Clock"
ODOMETRY = "nav_msgs/msg/Odometry"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
DETECTED_OBJECTS = "autoware_perception_msgs/msg/DetectedObjects"
TRACKED_OBJECTS = "autoware_perception_msgs/msg/TrackedObjects"
PREDICTED_OBJECTS = "autoware_perception_msgs/msg/PredictedObjects"

#: Largest number of elements of a sequence in a received message.
MOST_ELEMENTS = 100_000

#: rosbags' store. The types that are used have the same fields in all versions from Humble to Lyrical.
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.max_sequence_length = MOST_ELEMENTS
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, _name))

#: By name of a type, its class. Its arguments are the fields in their order.
TYPES: Mapping[str, Callable[..., RosMessage]] = STORE.types


def package(name: str) -> SimpleNamespace:
    """The classes of the messages of a package, by their names."""
    begin = f"{name}/msg/"
    return SimpleNamespace(**{kind.removeprefix(begin): cls for kind, cls in TYPES.items() if kind.startswith(begin)})


def encode(message: RosMessage) -> bytes:
    """The payload of a message: CDR, little endian, with its header of four bytes."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def decode(type_name: str, payload: bytes) -> RosMessage:
    """The message of a type in a payload of CDR, of either byte order.

    Raises MessageError for bytes that are none, or that have more than MOST_ELEMENTS elements in a sequence.
    """
    if type_name not in TYPES:
        raise MessageError(f"unknown message type {type_name!r:.120}: expected one such as {DETECTIONS!r}")
    try:
        return STORE.deserialize_cdr(payload, type_name)
    except SerdeError as error:
        raise MessageError(f"{type_name}: {len(payload)} bytes: {error}") from None


@cache
def type_hash(type_name: str) -> str:
    """The hash of a type as keys write it, `RIHS01_` and 64 hexadecimal digits (REP 2011).

    Raises KeyError for an unknown type.
    """
    return STORE.hash_rihs01(type_name)
