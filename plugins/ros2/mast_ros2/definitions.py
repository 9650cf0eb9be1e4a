"""Message types that rosbags does not have: fields of vision_msgs 4 and autoware_perception_msgs 1.12.

Names, types and order of the fields decide the bytes and the hash of a type. Constants decide neither; the modules
that use one define it.
"""

from __future__ import annotations

from collections.abc import Mapping

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
