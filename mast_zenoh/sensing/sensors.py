"""Lidars and cameras: beam directions, fields of view, calibration, and transforms between sensor, agent and world."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mast_zenoh.arrays import geometry
from mast_zenoh.arrays.geometry import to_local
from mast_zenoh.arrays.states import Bools, Detections, Floats
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


#: Limits on what can be simulated.
MAX_CHANNELS, MAX_BEAMS, MAX_RANGE_M = 4096, 10_000_000, 10_000.0


@dataclass(frozen=True, eq=False)
class LidarSensor:
    """A spinning or sector lidar; by default the paper's roof lidar of mobile agents.

    mount_position:    (3,) m, of the lidar in the agent's frame
    mount_rotation:    (3, 3), active, lidar to agent
    azimuth_*_deg:     the sector, counter-clockwise from x; one beam in the middle of every step
    elevation_*_deg:   the lowest and the highest channel, both included, evenly spaced
    max_range_m:       maximum range of a return
    """

    mount_position: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.8]))
    mount_rotation: Floats = field(default_factory=lambda: np.eye(3))
    azimuth_min_deg: float = -180.0
    azimuth_max_deg: float = 180.0
    azimuth_step_deg: float = 0.2
    elevation_min_deg: float = -17.6
    elevation_max_deg: float = 2.4
    channels: int = 64
    max_range_m: float = 100.0

    def __post_init__(self) -> None:
        angles = self.azimuth_min_deg, self.azimuth_max_deg, self.elevation_min_deg, self.elevation_max_deg
        mount = np.concatenate([np.ravel(self.mount_position), np.ravel(self.mount_rotation)])
        for name, valid, expected in (
            ("mount_position", np.shape(self.mount_position) == (3,), "3 numbers"),
            ("mount_rotation", np.shape(self.mount_rotation) == (3, 3), "3 x 3 numbers"),
            ("mount_position, mount_rotation", bool(np.isfinite(mount).all()), "finite numbers"),
            ("azimuth_*_deg, elevation_*_deg", bool(np.isfinite(angles).all()), "finite numbers"),
            ("azimuth_step_deg", 0.0 < self.azimuth_step_deg <= 360.0, "more than 0, at most 360"),
            ("azimuth_max_deg", 0.0 < self.azimuth_max_deg - self.azimuth_min_deg <= 360.0, "a sector of at most 360"),
            ("elevation_max_deg", -90.0 <= self.elevation_min_deg <= self.elevation_max_deg <= 90.0, "-90 to 90"),
            ("channels", 1 <= self.channels <= MAX_CHANNELS, f"1 to {MAX_CHANNELS}"),
            ("max_range_m", 0.0 < self.max_range_m <= MAX_RANGE_M, f"more than 0, at most {MAX_RANGE_M:.0f}"),
        ):
            if not valid:
                values = [np.ravel(getattr(self, each)).tolist() for each in name.split(", ") if hasattr(self, each)]
                found = ", ".join(str(each[0] if len(each) == 1 else each) for each in values or [list(angles)])
                raise ValueError(f"LidarSensor: {name}: found {found}, expected {expected}")
        beams = self.channels * (self.azimuth_max_deg - self.azimuth_min_deg) / self.azimuth_step_deg
        if beams > MAX_BEAMS:
            raise ValueError(f"LidarSensor: azimuth_step_deg: found {beams:.0f} beams, expected at most {MAX_BEAMS}")

    @classmethod
    def infrastructure(cls) -> LidarSensor:
        """The paper's pole lidar: a 90 degree sector, -25 to 30 degrees elevation.

        In the frame of the (pitched) agent.
        """
        return cls(np.zeros(3), np.eye(3), -45.0, 45.0, 0.2, -25.0, 30.0, 64, 100.0)

    @cached_property
    def azimuths(self) -> Floats:
        """(m,) rad, ascending, of the beams in one channel; not to be written to."""
        count = round((self.azimuth_max_deg - self.azimuth_min_deg) / self.azimuth_step_deg)
        azimuths: Floats = np.radians(self.azimuth_min_deg + self.azimuth_step_deg * (np.arange(count) + 0.5))
        azimuths.flags.writeable = False
        return azimuths

    @cached_property
    def elevations(self) -> Floats:
        """(channels,) rad, ascending; not to be written to."""
        elevations: Floats = np.radians(np.linspace(self.elevation_min_deg, self.elevation_max_deg, self.channels))
        elevations.flags.writeable = False
        return elevations


def in_view(points_world: Floats, sensor_position: Floats, sensor_rotation: Floats, lidar: LidarSensor) -> Bools:
    """Whether world points (n, 3) are in the field of view and range of a lidar.

    sensor_position (3,) m, sensor_rotation (3, 3) active, of the lidar itself (`sensing.sensor_pose`). Occlusion is
    ignored.
    """
    local = to_local(np.asarray(points_world, np.float64), sensor_position, sensor_rotation)
    horizontal = np.hypot(local[:, 0], local[:, 1])
    elevation = np.degrees(np.arctan2(local[:, 2], horizontal))
    azimuth = np.degrees(np.arctan2(local[:, 1], local[:, 0]))
    # The sector may begin below -180 degrees, so azimuths are counted from its beginning.
    sector_angle = (azimuth - lidar.azimuth_min_deg) % 360.0
    return (
        (np.hypot(horizontal, local[:, 2]) <= lidar.max_range_m)
        & (elevation >= lidar.elevation_min_deg)
        & (elevation <= lidar.elevation_max_deg)
        & (sector_angle <= lidar.azimuth_max_deg - lidar.azimuth_min_deg)
    )


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera that looks along the x axis of its own frame (y left, z up).

    mount_position: (3,) m, of the camera in the agent's frame
    mount_rotation: (3, 3), active, camera to agent
    width, height:  px
    focal:          px; 400 px at 800 px width is a field of view of 90 degrees
    """

    mount_position: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.6]))
    mount_rotation: Floats = field(default_factory=lambda: np.eye(3))
    width: int = 800
    height: int = 600
    focal: float = 400.0

    def project(self, points_world: Floats, agent_position: Floats, agent_rotation: Floats) -> tuple[Floats, Floats]:
        """Pixels (n, 2) and depth (n,) m of world points (n, 3) for an agent's pose.

        agent_position: (3,) m; agent_rotation: (3, 3)

        Pixels count u to the right and v down from the upper left corner. A point behind the camera has a depth <= 0
        and NaN pixels; a point outside the image has pixels outside [0, width) x [0, height).
        """
        position = geometry.to_world(self.mount_position[None], agent_position, agent_rotation)[0]
        local = geometry.to_local(np.asarray(points_world, np.float64), position, agent_rotation @ self.mount_rotation)
        depth = local[:, 0]
        scale = self.focal / np.where(depth > 0.0, depth, np.nan)
        pixels = np.stack([self.width / 2 - scale * local[:, 1], self.height / 2 - scale * local[:, 2]], axis=1)
        return pixels, depth
