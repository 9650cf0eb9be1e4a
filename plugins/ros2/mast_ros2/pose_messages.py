"""Poses as TFMessage and Odometry, and times as Clock."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mast_ros2 import type_store
from mast_ros2.spatial import Transform, header, quaternion, stamp, vectors
from mast_ros2.type_store import TYPES, RosMessage
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.messages.schemas import Body

_Transform, _TransformStamped, _Vector, _Point, _Pose, _PoseWithCovariance, _Twist, _TwistWithCovariance = (
    TYPES[f"geometry_msgs/msg/{name}"]
    for name in (
        "Transform",
        "TransformStamped",
        "Vector3",
        "Point",
        "Pose",
        "PoseWithCovariance",
        "Twist",
        "TwistWithCovariance",
    )
)


def transform_message(transforms: Iterable[Transform]) -> RosMessage:
    """A TFMessage; raises ValueError for a time that ROS cannot express."""
    return TYPES[type_store.TF_MESSAGE](
        [
            _TransformStamped(
                header(transform.time_ns, transform.parent),
                transform.child,
                _Transform(*vectors(transform.position[None]), quaternion(transform.rotation)),
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
    place = _Pose(_Point(*pose["position"].tolist()), quaternion(pose["rotation"]))
    twist = _Twist(_Vector(*velocity.tolist()), _Vector(0.0, 0.0, 0.0))
    return TYPES[type_store.ODOMETRY](
        header(time_ns, frame_id),
        child_frame_id,
        _PoseWithCovariance(place, np.zeros(36)),
        _TwistWithCovariance(twist, np.zeros(36)),
    )


def clock(time_ns: int) -> RosMessage:
    """A Clock, for nodes with `use_sim_time`; raises ValueError for a time that ROS cannot express."""
    return TYPES[type_store.CLOCK](stamp(time_ns))
