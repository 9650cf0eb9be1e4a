"""Classes of all ROS 2 message types that are used here, their CDR bytes, and their hashes.

Message types that rosbags does not have: fields of vision_msgs 4 and autoware_perception_msgs 1.12.

Names, types and order of the fields decide the bytes and the hash of a type. Constants decide neither; the modules
that use one define it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_zenoh.errors import MessageError

_VISION: Mapping[str, str] = {
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}

_POSE = "geometry_msgs/PoseWithCovariance {0}pose_with_covariance\n"
_TWIST = "geometry_msgs/TwistWithCovariance {0}twist_with_covariance\n"
_ACCELERATION = "geometry_msgs/AccelWithCovariance {0}acceleration_with_covariance\n"


def _object(kinematics: str, *, identified: bool = True) -> str:
    """The fields of an object of Autoware."""
    return (
        ("unique_identifier_msgs/UUID object_id\n" if identified else "")
        + "float32 existence_probability\nautoware_perception_msgs/ObjectClassification[] classification\n"
        + f"autoware_perception_msgs/{kinematics} kinematics\nautoware_perception_msgs/Shape shape\n"
    )


_AUTOWARE: Mapping[str, str] = {
    "ObjectClassification": "uint8 label\nfloat32 probability\n",
    "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions\n",
    "PredictedPath": "geometry_msgs/Pose[] path\nbuiltin_interfaces/Duration time_step\nfloat32 confidence\n",
    "DetectedObjectKinematics": (
        _POSE.format("")
        + "bool has_position_covariance\nuint8 orientation_availability\n"
        + _TWIST.format("")
        + "bool has_twist\nbool has_twist_covariance\n"
    ),
    "TrackedObjectKinematics": (
        (_POSE + _TWIST + _ACCELERATION).format("") + "uint8 orientation_availability\nbool is_stationary\n"
    ),
    "PredictedObjectKinematics": (
        (_POSE + _TWIST + _ACCELERATION).format("initial_")
        + "autoware_perception_msgs/PredictedPath[] predicted_paths\n"
    ),
    "DetectedObject": _object("DetectedObjectKinematics", identified=False),
    "TrackedObject": _object("TrackedObjectKinematics"),
    "PredictedObject": _object("PredictedObjectKinematics"),
    **{
        f"{kind}Objects": f"std_msgs/Header header\nautoware_perception_msgs/{kind}Object[] objects\n"
        for kind in ("Detected", "Tracked", "Predicted")
    },
}

#: Fields by name of the type, such as `vision_msgs/msg/Detection3D`, in the language of `.msg` files.
DEFINITIONS: Mapping[str, str] = {
    f"{package}/msg/{name}": text
    for package, types in (("vision_msgs", _VISION), ("autoware_perception_msgs", _AUTOWARE))
    for name, text in types.items()
}


#: A message of rosbags' classes. `__msgtype__` is the name of its type, such as `std_msgs/msg/String`.
RosMessage = Any

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
CLOCK = "rosgraph_msgs/msg/Clock"
ODOMETRY = "nav_msgs/msg/Odometry"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
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
