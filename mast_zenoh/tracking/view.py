"""What a sensor can see: its field of view, and what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.geometry import to_local, wrap_angle
from mast_zenoh.states import Floats

#: m; half the extent of a road user, over which an object at the edge of the field of view is seen in part.
EDGE_M = 2.5

#: m; less than this in distance or extent is taken as this.
NEAREST_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """Field of view of a sensor at one time.

    position:  (3,) m, of the sensor in the world
    rotation:  (3, 3), active, sensor to world; the sensor looks along its x axis
    azimuth_min, azimuth_max:     rad, in the sensor frame, counter-clockwise from x; a full turn is -pi to pi
    elevation_min, elevation_max: rad, in the sensor frame, up from its x-y plane
    max_range: m
    """

    position: Floats
    rotation: Floats
    azimuth_min: float
    azimuth_max: float
    elevation_min: float
    elevation_max: float
    max_range: float

    def expects(self, points: Floats) -> Floats:
        """(n,) in [0, 1]: how much of an object at `points` (n, 3) in the world is in the field of view.

        One at the edge is half in.
        """
        local = to_local(points, self.position, self.rotation)
        x, y, z = local[:, 0], local[:, 1], local[:, 2]
        ground = np.hypot(x, y)
        distance = np.hypot(ground, z)
        inside = self.max_range - distance
        if self.azimuth_max - self.azimuth_min < 2 * np.pi - 1e-6:
            azimuth = np.arctan2(y, x)
            edge = np.minimum(azimuth - self.azimuth_min, self.azimuth_max - azimuth)
            inside = np.minimum(inside, edge * ground)
        elevation = np.arctan2(z, ground)
        edge = np.minimum(elevation - self.elevation_min, self.elevation_max - elevation)
        inside = np.minimum(inside, edge * distance)
        share: Floats = np.minimum(np.maximum(0.5 + 0.5 * inside / EDGE_M, 0.0), 1.0)
        return share


def unblocked(origin: Floats, position: Floats, size: Floats, screens: Floats, screen_size: Floats) -> Floats:
    """(k,) in [0, 1]: how much of each object no nearer one hides from a sensor.

    origin: (3,) m, the sensor; position, size: (k, 3) m, centres and length width height of the objects in question
    screens, screen_size: (n, 3) m, of all that may hide them; the objects themselves may be among them

    An object hides the sector of azimuth that its footprint (taken as a disc of its mean horizontal extent) fills, for
    what lies behind it and not above the line from the sensor over its top.
    """
    if len(position) == 0 or len(screens) == 0:
        return np.ones(len(position))
    offset = np.concatenate([position, screens]) - origin
    length, width, height = np.concatenate([size, screen_size]).T
    ground = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), NEAREST_M)
    # As seen from the sensor: azimuth, half the width (rad), slope of the line over the top.
    azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    half = np.arctan2(np.maximum(0.25 * (length + width), NEAREST_M), ground)
    top = (offset[:, 2] + 0.5 * height) / ground
    k = len(position)
    own = half[:k, None]
    apart = np.abs(wrap_angle(azimuth[:k, None] - azimuth[k:]))
    covered = np.minimum(own + half[k:] - apart, 2.0 * np.minimum(own, half[k:])) / (2.0 * own)
    hides = (ground[:k, None] > (ground + 0.5 * width)[k:]) & (top[:k, None] < top[k:])
    share: Floats = 1.0 - np.maximum(covered * hides, 0.0).max(axis=1)
    return share
