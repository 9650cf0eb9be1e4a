"""Transforms between sensor, agent and world frames."""

from __future__ import annotations

from dataclasses import replace

from mast_zenoh.arrays import geometry
from mast_zenoh.arrays.states import Detections, Floats
from mast_zenoh.kernels import kernel


def sensor_pose(
    agent_position: Floats, agent_rotation: Floats, mount_position: Floats, mount_rotation: Floats
) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of a sensor in the world.

    The agent's pose, followed by the mount.
    """
    return agent_position + agent_rotation @ mount_position, agent_rotation @ mount_rotation


def to_world(detections: Detections, sensor_position: Floats, sensor_rotation: Floats) -> Detections:
    """Transform detections from a sensor's frame to the world.

    sensor_position: (3,) m; sensor_rotation: (3, 3) active

    The yaw of a detection is about the world's vertical in both frames (`states.Detections`), so only the sensor's
    heading is added, even if the sensor is pitched.
    """
    position, yaw, covariance = rigid_transform(
        detections.position, detections.yaw, detections.covariance, sensor_position, sensor_rotation
    )
    return Detections(position, detections.size, yaw, detections.score, detections.class_id, covariance)


@kernel
def rigid_transform(
    position: Floats, yaw: Floats, covariance: Floats, origin: Floats, rotation: Floats
) -> tuple[Floats, Floats, Floats]:
    """Transform positions (n, 3), yaws (n,) and covariances (n, 3, 3).

    The source frame is at `origin` (3,) with `rotation` (3, 3).
    """
    return (
        geometry.to_world(position, origin, rotation),
        geometry.wrap_angle(yaw + geometry.heading(rotation)),
        rotation @ covariance @ rotation.T,
    )


def to_sensor(detections: Detections, sensor_position: Floats, sensor_rotation: Floats) -> Detections:
    """Transform detections from the world to a sensor's frame; inverse of `to_world`."""
    return replace(
        detections,
        position=geometry.to_local(detections.position, sensor_position, sensor_rotation),
        yaw=geometry.wrap_angle(detections.yaw - geometry.heading(sensor_rotation)),
        covariance=sensor_rotation.T @ detections.covariance @ sensor_rotation,
    )
