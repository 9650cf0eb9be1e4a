"""ROS 2 messages by ros2-pyterfaces, which is tested against ROS: a second encoder, with types defined again.

What it does not have is written down here: tf2_msgs, vision_msgs and autoware_perception_msgs.
"""

from dataclasses import dataclass
from types import new_class
from typing import Any

from ros2_pyterfaces.cyclone.builtin_interfaces.msg import Duration
from ros2_pyterfaces.cyclone.diagnostic_msgs.msg import DiagnosticArray
from ros2_pyterfaces.cyclone.geometry_msgs.msg import (
    AccelWithCovariance,
    Polygon,
    Pose,
    PoseWithCovariance,
    TransformStamped,
    TwistWithCovariance,
    Vector3,
)
from ros2_pyterfaces.cyclone.idl import IdlStruct, types
from ros2_pyterfaces.cyclone.nav_msgs.msg import Odometry
from ros2_pyterfaces.cyclone.rosgraph_msgs.msg import Clock
from ros2_pyterfaces.cyclone.std_msgs.msg import Header, String
from ros2_pyterfaces.cyclone.unique_identifier_msgs.msg import UUID
from ros2_pyterfaces.cyclone.visualization_msgs.msg import MarkerArray


def message(typename: str, **fields: Any) -> type[IdlStruct]:
    """A type of messages with these fields, in order."""
    name = typename.rpartition("/")[2]
    made = new_class(name, (IdlStruct,), {"typename": typename}, lambda own: own.update(__annotations__=fields))
    return dataclass(made)


TFMessage = message("tf2_msgs/msg/TFMessage", transforms=types.sequence[TransformStamped])
ObjectHypothesis = message("vision_msgs/msg/ObjectHypothesis", class_id=str, score=types.float64)
ObjectHypothesisWithPose = message(
    "vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=ObjectHypothesis, pose=PoseWithCovariance
)
BoundingBox3D = message("vision_msgs/msg/BoundingBox3D", center=Pose, size=Vector3)
Detection3D = message(
    "vision_msgs/msg/Detection3D",
    header=Header,
    results=types.sequence[ObjectHypothesisWithPose],
    bbox=BoundingBox3D,
    id=str,
)
Detection3DArray = message("vision_msgs/msg/Detection3DArray", header=Header, detections=types.sequence[Detection3D])
ObjectClassification = message(
    "autoware_perception_msgs/msg/ObjectClassification", label=types.uint8, probability=types.float32
)
Shape = message("autoware_perception_msgs/msg/Shape", type=types.uint8, footprint=Polygon, dimensions=Vector3)
DetectedObjectKinematics = message(
    "autoware_perception_msgs/msg/DetectedObjectKinematics",
    pose_with_covariance=PoseWithCovariance,
    has_position_covariance=bool,
    orientation_availability=types.uint8,
    twist_with_covariance=TwistWithCovariance,
    has_twist=bool,
    has_twist_covariance=bool,
)
DetectedObject = message(
    "autoware_perception_msgs/msg/DetectedObject",
    existence_probability=types.float32,
    classification=types.sequence[ObjectClassification],
    kinematics=DetectedObjectKinematics,
    shape=Shape,
)
DetectedObjects = message(
    "autoware_perception_msgs/msg/DetectedObjects", header=Header, objects=types.sequence[DetectedObject]
)
TrackedObjectKinematics = message(
    "autoware_perception_msgs/msg/TrackedObjectKinematics",
    pose_with_covariance=PoseWithCovariance,
    twist_with_covariance=TwistWithCovariance,
    acceleration_with_covariance=AccelWithCovariance,
    orientation_availability=types.uint8,
    is_stationary=bool,
)
TrackedObject = message(
    "autoware_perception_msgs/msg/TrackedObject",
    object_id=UUID,
    existence_probability=types.float32,
    classification=types.sequence[ObjectClassification],
    kinematics=TrackedObjectKinematics,
    shape=Shape,
)
TrackedObjects = message(
    "autoware_perception_msgs/msg/TrackedObjects", header=Header, objects=types.sequence[TrackedObject]
)
PredictedPath = message(
    "autoware_perception_msgs/msg/PredictedPath",
    path=types.sequence[Pose],
    time_step=Duration,
    confidence=types.float32,
)
PredictedObjectKinematics = message(
    "autoware_perception_msgs/msg/PredictedObjectKinematics",
    initial_pose_with_covariance=PoseWithCovariance,
    initial_twist_with_covariance=TwistWithCovariance,
    initial_acceleration_with_covariance=AccelWithCovariance,
    predicted_paths=types.sequence[PredictedPath],
)
PredictedObject = message(
    "autoware_perception_msgs/msg/PredictedObject",
    object_id=UUID,
    existence_probability=types.float32,
    classification=types.sequence[ObjectClassification],
    kinematics=PredictedObjectKinematics,
    shape=Shape,
)
PredictedObjects = message(
    "autoware_perception_msgs/msg/PredictedObjects", header=Header, objects=types.sequence[PredictedObject]
)

#: By name of a type, its class.
CLASSES: dict[str, type[IdlStruct]] = {
    kind.get_type_name(): kind
    for kind in (
        String,
        TFMessage,
        Clock,
        Odometry,
        MarkerArray,
        DiagnosticArray,
        Detection3DArray,
        DetectedObjects,
        TrackedObjects,
        PredictedObjects,
    )
}


def encode(type_name: str, plain: dict[str, Any]) -> bytes:
    """The bytes of a message that is a dict of its fields."""
    return CLASSES[type_name].from_core_message(plain).serialize()


def decode(type_name: str, payload: bytes) -> dict[str, Any]:
    """The message of bytes, as a dict of its fields."""
    return _numbers(CLASSES[type_name].deserialize(payload).to_core_message())


def _numbers(value: Any) -> Any:
    """The same with numbers for fields of the type byte."""
    if isinstance(value, dict):
        return {name: _numbers(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_numbers(each) for each in value]
    return value[0] if isinstance(value, bytes) else value
