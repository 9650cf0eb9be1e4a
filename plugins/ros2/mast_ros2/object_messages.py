"""Objects as messages of ROS 2: Detection3DArray of vision_msgs, TrackedObjects and PredictedObjects of Autoware.

What these types cannot express is left out: variances of sizes, and covariances between position and velocity.

Ids of objects: our whole numbers, and the texts and UUIDs of ROS 2.

Objects as a MarkerArray: boxes that RViz shows.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mast_ros2 import type_store
from mast_ros2.spatial import duration, header, poses, turned, upper_left, vectors
from mast_ros2.type_store import TYPES, RosMessage, package
from mast_zenoh.arrays.geometry import rotation_from_quaternion, scalar_last_quaternions
from mast_zenoh.arrays.states import CLASSES, Detections, Floats, Ints, ObjectStates

#: Labels of Autoware's ObjectClassification by our classes.
AUTOWARE_LABELS: Mapping[str, int] = {
    "unknown": 0,
    "car": 1,
    "truck": 2,
    "bus": 3,
    "motorcycle": 5,
    "bicycle": 6,
    "pedestrian": 7,
}
#: Values of Autoware's constants: the orientation is known with its sign; the shape is a box.
ORIENTATION_AVAILABLE, BOUNDING_BOX = 2, 0

#: s, how far predicted paths reach and how far apart their poses are, as in Autoware's own prediction.
HORIZON_S, STEP_S = 10.0, 0.5

#: m/s, below which a tracked object is said to stand still.
_STANDSTILL = 0.1
_LABELS = [AUTOWARE_LABELS[name] for name in CLASSES]

_vision, _geometry, _autoware = map(package, ("vision_msgs", "geometry_msgs", "autoware_perception_msgs"))
_Uuid = TYPES["unique_identifier_msgs/msg/UUID"]

_ZERO = _geometry.Vector3(0.0, 0.0, 0.0)
_NO_ACCELERATION = _geometry.AccelWithCovariance(_geometry.Accel(_ZERO, _ZERO), np.zeros(36))


def states_of(detections: Detections) -> ObjectStates:
    """Detections as states whose ids are their rows, in the same frame."""
    covariance = np.zeros((len(detections), 9, 9))
    covariance[:, :3, :3] = detections.covariance
    return ObjectStates.of(
        detections.position,
        size=detections.size,
        yaw=detections.yaw,
        score=detections.score,
        class_id=detections.class_id,
        covariance=covariance,
    )


def detection_array(states: ObjectStates, time_ns: int, frame_id: str) -> RosMessage:
    """A Detection3DArray of objects in the frame `frame_id`.

    Each detection has one hypothesis: class, score, and the pose of the box with the covariance of its position.
    Raises ValueError for a time that ROS cannot express.
    """
    of_all = header(time_ns, frame_id)
    result = []
    for number, kind, score, pose, size in zip(
        states.id.tolist(),
        states.class_id.tolist(),
        states.score.tolist(),
        _poses_with_covariance(states),
        vectors(states.size),
        strict=True,
    ):
        hypothesis = _vision.ObjectHypothesisWithPose(_vision.ObjectHypothesis(CLASSES[kind], score), pose)
        result.append(_vision.Detection3D(of_all, [hypothesis], _vision.BoundingBox3D(pose.pose, size), str(number)))
    return TYPES[type_store.DETECTIONS](of_all, result)


def tracked_objects(states: ObjectStates, time_ns: int, frame_id: str) -> RosMessage:
    """TrackedObjects of objects in the frame `frame_id`; velocities are in the axes of each object.

    Raises ValueError for a time that ROS cannot express.
    """
    moving = (np.linalg.norm(states.velocity, axis=1) >= _STANDSTILL).tolist()
    kinematics = [
        _autoware.TrackedObjectKinematics(pose, twist, _NO_ACCELERATION, ORIENTATION_AVAILABLE, not moves)
        for pose, twist, moves in zip(_poses_with_covariance(states), _twists(states), moving, strict=True)
    ]
    objects = [_autoware.TrackedObject(*parts) for parts in _autoware_parts(states, kinematics)]
    return TYPES[type_store.TRACKED_OBJECTS](header(time_ns, frame_id), objects)


def predicted_objects(states: ObjectStates, time_ns: int, frame_id: str) -> RosMessage:
    """PredictedObjects of objects in the frame `frame_id`: one path each, straight on at constant velocity.

    The first pose of a path is the object's own. Raises ValueError for a time that ROS cannot express.
    """
    ahead_s = STEP_S * np.arange(int(HORIZON_S / STEP_S + 1e-6) + 1)
    places = states.position[:, None] + states.velocity[:, None] * ahead_s[:, None]
    turns = np.repeat(scalar_last_quaternions(states.yaw), len(ahead_s), axis=0)
    on_paths = poses(places.reshape(-1, 3), turns)
    step = duration(round(STEP_S * 1e9))
    kinematics = [
        _autoware.PredictedObjectKinematics(
            pose,
            twist,
            _NO_ACCELERATION,
            [_autoware.PredictedPath(on_paths[k * len(ahead_s) : (k + 1) * len(ahead_s)], step, 1.0)],
        )
        for k, (pose, twist) in enumerate(zip(_poses_with_covariance(states), _twists(states), strict=True))
    ]
    objects = [_autoware.PredictedObject(*parts) for parts in _autoware_parts(states, kinematics)]
    return TYPES[type_store.PREDICTED_OBJECTS](header(time_ns, frame_id), objects)


def _poses_with_covariance(states: ObjectStates) -> list[RosMessage]:
    """Poses of the boxes, with the covariances of their positions."""
    of_boxes = poses(states.position, scalar_last_quaternions(states.yaw))
    return list(map(_geometry.PoseWithCovariance, of_boxes, upper_left(states.covariance[:, :3, :3])))


def _twists(states: ObjectStates) -> list[RosMessage]:
    """Velocities and their covariances in the axes of each object, as Autoware has them."""
    into_object = np.swapaxes(_rotations(states.yaw), 1, 2)
    velocity = (into_object @ states.velocity[:, :, None])[:, :, 0]
    covariance = upper_left(turned(states.covariance[:, 6:, 6:], into_object))
    return [
        _geometry.TwistWithCovariance(_geometry.Twist(linear, _ZERO), own)
        for linear, own in zip(vectors(velocity), covariance, strict=True)
    ]


def _rotations(yaw: Floats) -> Floats:
    """(n, 3, 3) rotations about the vertical by yaw (n,)."""
    return np.asarray(rotation_from_quaternion(np.roll(scalar_last_quaternions(yaw), 1, axis=1)), np.float64)


def _autoware_parts(states: ObjectStates, kinematics: list[RosMessage]) -> list[tuple[RosMessage, ...]]:
    """The fields of Autoware's objects, in their order."""
    return [
        (
            _Uuid(uuid),
            score,
            [_autoware.ObjectClassification(_LABELS[kind], 1.0)],
            motion,
            _autoware.Shape(BOUNDING_BOX, _geometry.Polygon([]), size),
        )
        for uuid, score, kind, motion, size in zip(
            uuids(states.id),
            states.score.tolist(),
            states.class_id.tolist(),
            kinematics,
            vectors(states.size),
            strict=True,
        )
    ]


UUID_BYTES = 16
_OWN = bytes(8)  # how our UUIDs begin: random ones do not
_DECIMAL = re.compile(r"0|-?[1-9][0-9]{0,18}")
_INT64 = np.iinfo(np.int64)


def uuids(ids: Ints) -> NDArray[np.uint8]:
    """(n, 16) bytes: eight of 0, then the id (n,), highest byte first."""
    result = np.zeros((len(ids), UUID_BYTES), np.uint8)
    result[:, 8:] = ids.astype(">i8").view(np.uint8).reshape(-1, 8)
    return result


def id_of_uuid(uuid: bytes) -> int:
    """The id in one of our UUIDs; a number from the hash of another, equal for equal UUIDs."""
    if uuid.startswith(_OWN):
        return int.from_bytes(uuid[8:], "big", signed=True)
    return _hashed(uuid)


def id_of_text(text: str) -> int:
    """The whole number that a text is, such as `-7`; a number from the hash of another, equal for equal texts."""
    if _DECIMAL.fullmatch(text) and _INT64.min <= int(text) <= _INT64.max:
        return int(text)
    return _hashed(text.encode(errors="surrogatepass"))


def _hashed(data: bytes) -> int:
    """A number of 63 bits."""
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "big") >> 1


#: Values of constants of Marker.
CUBE, ADD, DELETE_ALL = 1, 0, 3
#: Of boxes: what is behind them stays visible.
_OPACITY = 0.6

_shown, _interfaces = map(package, ("visualization_msgs", "builtin_interfaces"))
_Colour, _Image = TYPES["std_msgs/msg/ColorRGBA"], TYPES["sensor_msgs/msg/CompressedImage"]

_NO_BYTES = np.zeros(0, np.uint8)
_NOWHERE = _geometry.Pose(_geometry.Point(0.0, 0.0, 0.0), _geometry.Quaternion(0.0, 0.0, 0.0, 1.0))


def marker_array(states: ObjectStates, colours: NDArray[np.int64], time_ns: int, frame_id: str) -> RosMessage:
    """A MarkerArray of a box for each object, after a marker that removes those of the message before.

    colours: (n, 3) red, green and blue, 0 to 255

    Raises ValueError for a time that ROS cannot express.
    """
    of_all = header(time_ns, frame_id)
    markers = [_marker(of_all, 0, DELETE_ALL, _NOWHERE, _geometry.Vector3(0.0, 0.0, 0.0), _Colour(0.0, 0.0, 0.0, 0.0))]
    for number, pose, size, colour in zip(
        states.id.tolist(),
        poses(states.position, scalar_last_quaternions(states.yaw)),
        vectors(states.size),
        (colours / 255).tolist(),
        strict=True,
    ):
        # ROS has 32 bits for the number
        markers.append(_marker(of_all, number % 2**31, ADD, pose, size, _Colour(*colour, _OPACITY)))
    return TYPES[type_store.MARKER_ARRAY](markers)


def _marker(
    of_all: RosMessage, number: int, action: int, pose: RosMessage, size: RosMessage, colour: RosMessage
) -> RosMessage:
    """A box; all fields of other markers are empty."""
    return _shown.Marker(
        header=of_all,
        ns="",
        id=number,
        type=CUBE,
        action=action,
        pose=pose,
        scale=size,
        color=colour,
        lifetime=_interfaces.Duration(0, 0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=_Image(of_all, "", _NO_BYTES),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_shown.MeshFile("", _NO_BYTES),
        mesh_use_embedded_materials=False,
    )
