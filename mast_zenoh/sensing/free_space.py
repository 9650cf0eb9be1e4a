"""Free space from the points of a lidar: how far a scan shows each direction to be free."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.sensing.ground import CLEARANCE_M, points_and_ground
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.raycast import SweepRays
from mast_zenoh.sensing.sensors import LidarSensor


def swept(scan: Mapping[str, NDArray[Any]], lidar: LidarSensor) -> dict[str, NDArray[Any]]:
    """The columns of a `sweep` message: m that each direction is free, over the limits of the view of a lidar.

    Free is up to the nearest return that is not of the ground; without one, to the farthest of the ground. Where
    nothing comes back, because of a clear sky or of an attack, nothing is known: 0.

    scan: the columns of a `points` message
    """
    rays, level = SweepRays.of(lidar), rotation_from_quaternion(scan["level_rotation"])
    points_mm, ground = points_and_ground(Points.from_columns(scan).turned(level).position)
    height = points_mm[:, 2] - ground.z_mm.reshape(-1)[points_mm[:, 3]]
    x, y, z = (points_mm[:, :3] @ level).T / 1000.0
    plan = np.hypot(x, y)
    turned = (np.arctan2(y, x) - np.radians(lidar.azimuth_min_deg)) % (2.0 * np.pi)
    raised = np.arctan2(z, plan) - np.radians(lidar.elevation_min_deg)
    sector = turned * (rays.sectors / np.radians(lidar.azimuth_max_deg - lidar.azimuth_min_deg))
    band = raised * (rays.bands / np.radians(lidar.elevation_max_deg - lidar.elevation_min_deg))
    shape = rays.bands, rays.sectors
    cell = np.ravel_multi_index((band.astype(int), sector.astype(int)), shape, mode="clip")
    distance, standing = np.hypot(plan, z), height > 1000.0 * CLEARANCE_M
    free, nearest = np.zeros(shape), np.full(shape, np.inf)
    np.maximum.at(free.reshape(-1), cell[~standing], distance[~standing])
    np.minimum.at(nearest.reshape(-1), cell[standing], distance[standing])
    return {"free": np.where(nearest < np.inf, nearest, free)}
