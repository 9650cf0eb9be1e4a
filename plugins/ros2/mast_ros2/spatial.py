"""Parts of ROS 2 messages: times, headers, vectors, poses, and covariances of six components.

A pose has 36 covariances, rows of x y z roll pitch yaw; a twist those of velocities and rates of rotation. Our objects
have variances of neither angles nor rates: they are 0 in what is written, and not read.

Poses as TFMessage and Odometry, times as Clock, and scans of lidars as PointCloud2.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from mast_ros2 import type_store
from mast_ros2.type_store import TYPES, RosMessage, package
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body
from mast_zenoh.runs.scans import CLOUD, LidarScan

#: Largest absolute value of a coordinate that is read, m: maps in UTM coordinates are within.
MOST_METRES = 1e7
#: Largest deviation of a quaternion's length from 1 that is read; many publishers round it to float32.
_LENGTH_TOLERANCE = 1e-2

_SECOND = 10**9
_geometry, _interfaces = package("geometry_msgs"), package("builtin_interfaces")
_HEADER = TYPES["std_msgs/msg/Header"]


class Transform(NamedTuple):
    """Where a frame is in its parent.

    parent, child: names of frames
    time_ns:       ns
    position:      (3,) m, of the child's origin
    rotation:      (4,) active quaternion w x y z, child to parent
    """

    parent: str
    child: str
    time_ns: int
    position: Floats
    rotation: Floats


def stamp(time_ns: int) -> RosMessage:
    """A Time of int ns; raises ValueError for one that its 32 bits of seconds do not hold."""
    s, ns = divmod(time_ns, _SECOND)
    if not 0 <= s < 2**31:
        raise ValueError(f"time: found {time_ns} ns, expected 0 to 2**31 s")
    return _interfaces.Time(s, ns)


def duration(time_ns: int) -> RosMessage:
    """A Duration of int ns."""
    return _interfaces.Duration(*divmod(time_ns, _SECOND))


def header(time_ns: int, frame_id: str) -> RosMessage:
    """A Header: int ns, and the name of the frame of reference."""
    return _HEADER(stamp(time_ns), frame_id)


def vectors(values: Floats) -> list[RosMessage]:
    """n Vector3 of (n, 3)."""
    return [_geometry.Vector3(x, y, z) for x, y, z in values.tolist()]


def poses(position: Floats, quaternion: Floats) -> list[RosMessage]:
    """n Pose of positions (n, 3) m and quaternions (n, 4) x y z w."""
    pairs = zip(position.tolist(), quaternion.tolist(), strict=True)
    return [_geometry.Pose(_geometry.Point(*place), _geometry.Quaternion(*turn)) for place, turn in pairs]


def quaternion(rotation: Floats) -> RosMessage:
    """A Quaternion of (4,) w x y z, of any length but 0."""
    w, x, y, z = (rotation / np.linalg.norm(rotation)).tolist()
    return _geometry.Quaternion(x, y, z, w)


def upper_left(covariance: Floats) -> Floats:
    """(n, 36): covariances (n, 3, 3) of the first three components, 0 for the others."""
    result = np.zeros((len(covariance), 6, 6))
    result[:, :3, :3] = covariance
    return result.reshape(-1, 36)


def turned(covariance: Floats, rotation: Floats) -> Floats:
    """Covariances (n, 3, 3) of vectors after rotations (n, 3, 3)."""
    return np.asarray(rotation @ covariance @ np.swapaxes(rotation, -1, -2), np.float64)


def time_of(message: RosMessage) -> int:
    """ns of a Time; raises MessageError for one before 0 or with too many nanoseconds."""
    if message.sec < 0 or message.nanosec >= _SECOND:
        raise MessageError(f"stamp: found {message.sec} s and {message.nanosec} ns, expected 0 or more, below 1e9 ns")
    return int(message.sec * _SECOND + message.nanosec)


def frame_of(name: str) -> str:
    """The name of a frame, without the slash of old publishers; raises MessageError if it is empty or very long."""
    result = name.removeprefix("/")
    if not 0 < len(result) <= 255:
        raise MessageError(f"frame_id: found {name!r:.80}, expected a name of 1 to 255 characters")
    return result


def pose_rows(messages: Sequence[RosMessage]) -> Floats:
    """(n, 7) x y z of positions and w x y z of quaternions of n Pose."""
    return np.array(
        [
            (p.x, p.y, p.z, q.w, q.x, q.y, q.z)
            for p, q in ((message.position, message.orientation) for message in messages)
        ],
        np.float64,
    ).reshape(-1, 7)


def vector_rows(messages: Sequence[RosMessage]) -> Floats:
    """(n, 3) of n Vector3 or Point."""
    return np.array([(v.x, v.y, v.z) for v in messages], np.float64).reshape(-1, 3)


def is_unit(quaternions: Floats) -> Bools:
    """(...,) whether quaternions (..., 4) have length 1, nearly."""
    with np.errstate(over="ignore"):
        return np.asarray(np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0) <= _LENGTH_TOLERANCE)


def transform_message(transforms: Iterable[Transform]) -> RosMessage:
    """A TFMessage; raises ValueError for a time that ROS cannot express."""
    return TYPES[type_store.TF_MESSAGE](
        [
            _geometry.TransformStamped(
                header(transform.time_ns, transform.parent),
                transform.child,
                _geometry.Transform(*vectors(transform.position[None]), quaternion(transform.rotation)),
            )
            for transform in transforms
        ]
    )


def odometry(pose: Body, time_ns: int, frame_id: str, child_frame_id: str) -> RosMessage:
    """The Odometry of an agent, of the columns of a `pose` message.

    frame_id: of the world;  child_frame_id: of the agent, in whose axes the velocity is

    A `pose` has no covariances: all are 0. Raises ValueError for a time that ROS cannot express.
    """
    velocity = pose["velocity"] @ rotation_from_quaternion(pose["rotation"])
    place = _geometry.Pose(_geometry.Point(*pose["position"].tolist()), quaternion(pose["rotation"]))
    twist = _geometry.Twist(_geometry.Vector3(*velocity.tolist()), _geometry.Vector3(0.0, 0.0, 0.0))
    return TYPES[type_store.ODOMETRY](
        header(time_ns, frame_id),
        child_frame_id,
        _geometry.PoseWithCovariance(place, np.zeros(36)),
        _geometry.TwistWithCovariance(twist, np.zeros(36)),
    )


def clock(time_ns: int) -> RosMessage:
    """A Clock, for nodes with `use_sim_time`; raises ValueError for a time that ROS cannot express."""
    return TYPES[type_store.CLOCK](stamp(time_ns))


#: Of PointField: numbers of the types of values.
POINT_TYPES = {"<f4": 7, "<u2": 4}


def point_cloud(scan: LidarScan, time_ns: int, frame_id: str) -> RosMessage:
    """The PointCloud2 of a scan: x y z, intensity, t (s, from the time of the scan) and ring.

    frame_id: of the lidar. Raises ValueError for a time that ROS cannot express.
    """
    sensors, count = package("sensor_msgs"), len(scan.points)
    columns = [
        sensors.PointField(name, offset, POINT_TYPES[kind.str], 1)
        for name, (kind, offset, *_) in (CLOUD.fields or {}).items()
    ]
    data, size = scan.cloud().view(np.uint8).reshape(-1), CLOUD.itemsize
    return sensors.PointCloud2(header(time_ns, frame_id), 1, count, columns, False, size, size * count, data, True)
