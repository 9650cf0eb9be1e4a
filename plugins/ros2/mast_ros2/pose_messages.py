"""Poses as TFMessage and Odometry, and times as Clock."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mast_ros2 import type_store
from mast_ros2.spatial import Transform, header, quaternion, stamp, vectors
from mast_ros2.type_store import TYPES, RosMessage, package
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.messages.schemas import Body

_geometry = package("geometry_msgs")


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
