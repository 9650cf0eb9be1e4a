"""Free space of a lidar: how far it sees in each direction before something stands in the way.

The directions are the cells of a grid over the sensor's field of view. A cell is free up to the nearest road user or
wall on one of its rays, or to the end of the range; the ground does not count, as lidar pipelines remove it. The grid
is coarser than the beams, so that it fits into a message: a cell that an edge goes through counts as blocked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.sensing.lidar import LidarSensor
from mast_zenoh.sensing.raycast import Walls, first_hits

#: deg, approximate width and height of a cell.
CELL_DEG = (2.0, 2.0)
#: Least number of cells from the lowest to the highest channel.
MIN_BANDS = 16
#: Rays through a cell, across and up.
RAYS = (4, 2)


@dataclass(frozen=True, slots=True, eq=False)
class SweepRays:
    """The rays that sample the free space of a lidar.

    lidar: with the rays as its beams; bands, sectors: numbers of cells up and across
    """

    lidar: LidarSensor
    bands: int
    sectors: int

    @classmethod
    def of(cls, lidar: LidarSensor) -> SweepRays:
        """The rays of a lidar."""
        width = lidar.azimuth_max_deg - lidar.azimuth_min_deg
        height = lidar.elevation_max_deg - lidar.elevation_min_deg
        sectors, bands = max(1, round(width / CELL_DEG[0])), max(MIN_BANDS, round(height / CELL_DEG[1]))
        height /= bands * RAYS[1]
        return cls(
            replace(
                lidar,
                azimuth_step_deg=width / (sectors * RAYS[0]),
                elevation_min_deg=lidar.elevation_min_deg + height / 2,
                elevation_max_deg=lidar.elevation_max_deg - height / 2,
                channels=bands * RAYS[1],
            ),
            bands,
            sectors,
        )

    def directions(self) -> Floats:
        """(rays, 3) unit vectors in the sensor frame, by azimuth, then channel."""
        azimuth, elevation = self.lidar.azimuths[:, None], self.lidar.elevations[None, :]
        parts = (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation + 0.0 * azimuth),
        )
        return np.stack(parts, axis=-1).reshape(-1, 3)

    def background(self, position: Floats, rotation: Floats, walls: Walls) -> Floats:
        """(rays,) m to the nearest wall or the end of the range.

        position: (3,) m, rotation: (3, 3) active: the sensor's pose in the world
        """
        directions = self.directions() @ rotation.T
        depth = np.full(len(directions), self.lidar.max_range_m)
        bearing = np.arctan2(directions[:, 1], directions[:, 0])
        order = np.argsort(bearing)
        start, end = walls.start - position[:2], walls.end - position[:2]
        for row in np.flatnonzero(_distance_to(start, end) <= self.lidar.max_range_m):
            rays = order[_within(bearing[order], start[row], end[row])]
            distance = _distance_along(directions[rays], start[row], end[row], walls.top[row] - position[2])
            depth[rays] = np.minimum(depth[rays], distance)
        return depth

    def sweep(
        self,
        background: Floats,
        position: Floats,
        rotation: Floats,
        boxes: tuple[Floats, Floats, Floats],
        own: int = -1,
    ) -> Floats:
        """(bands, sectors) m that each cell is free.

        background: (rays,) m, see `background`; position, rotation: of the sensor in the world
        boxes: position (n, 3) m, size (n, 3) m and yaw (n,) rad of the road users, world frame
        own: row of the box that carries the sensor; -1: none
        """
        depth = background.copy()
        beam, distance = first_hits(self.lidar, position, rotation, *boxes, own)
        depth[beam] = np.minimum(depth[beam], distance)
        cells = depth.reshape(self.sectors, RAYS[0], self.bands, RAYS[1]).min(axis=(1, 3))
        return np.ascontiguousarray(cells.T)


def _distance_to(start: Floats, end: Floats) -> Floats:
    """(w,) m from the origin to segments (w, 2)."""
    span = end - start
    length = np.maximum(np.einsum("ij,ij->i", span, span), 1e-12)
    along = np.clip(-np.einsum("ij,ij->i", start, span) / length, 0.0, 1.0)
    nearest: Floats = np.linalg.norm(start + along[:, None] * span, axis=1)
    return nearest


def _within(bearing: Floats, start: Floats, end: Floats) -> Ints:
    """Rows of `bearing` (m,) rad, ascending, between the bearings of two points (2,)."""
    first, last = np.arctan2(start[1], start[0]), np.arctan2(end[1], end[0])
    low, high = min(first, last), max(first, last)
    left, right = np.searchsorted(bearing, (low, high))
    if high - low <= np.pi:
        return np.arange(left, right)
    return np.concatenate([np.arange(left), np.arange(right, len(bearing))])  # across the negative x axis


def _distance_along(directions: Floats, start: Floats, end: Floats, top: float) -> Floats:
    """(m,) m along unit vectors (m, 3) to a wall from `start` to `end` (2,), relative to the sensor; infinite: misses.

    top: m, height of its upper edge above the sensor
    """
    span = end - start
    cross = directions[:, 0] * span[1] - directions[:, 1] * span[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (start[0] * span[1] - start[1] * span[0]) / cross
        met = (along > 0.0) & (along * directions[:, 2] <= top)
    return np.where(met, along, np.inf)
