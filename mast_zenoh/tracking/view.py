"""The field of view of a sensor, with occlusion between objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import MAX_TABLE
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.kernels import kernel

#: m, half the extent of a road user: an object this close to the edge of the field of view is partly visible.
EDGE_M = 2.5

#: m, lower limit of distances and extents.
NEAREST_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """Field of view of a sensor at one time.

    position:  (3,) m, of the sensor in the world
    rotation:  (3, 3), active, sensor to world; the sensor looks along its x axis
    azimuth_min, azimuth_max:     rad, in the sensor frame, counter-clockwise from x; a full turn is -pi to pi
    elevation_min, elevation_max: rad, in the sensor frame, up from its x-y plane
    max_range: m
    detection_probability: of an object in full view; None: that of the tracker
    """

    position: Floats
    rotation: Floats
    azimuth_min: float
    azimuth_max: float
    elevation_min: float
    elevation_max: float
    max_range: float
    detection_probability: float | None = None

    def visible_fraction(self, boxes: Floats, occluders: Floats) -> Floats:
        """Visible fraction (k,) in [0, 1] of boxes (k, >= 6).

        A box counts as visible if it is in the field of view and not occluded; at the edge of the field of view, the
        fraction is 0.5. occluders: (n, >= 6), may include the boxes. Both begin with x y z l w h in m, world frame.
        """
        return visible_fraction(boxes, occluders, self, EDGE_M, NEAREST_M)


@kernel
def visible_fraction(boxes: Floats, occluders: Floats, view: SensorView, edge_m: float, nearest_m: float) -> Floats:
    """Visible fractions (k,) as in `SensorView.visible_fraction`.

    edge_m, nearest_m: m, EDGE_M, NEAREST_M
    """
    x, y, z = ((boxes[:, :3] - view.position) @ view.rotation).T
    ground = np.hypot(x, y)
    distance = np.hypot(ground, z)
    inside = view.max_range - distance
    if view.azimuth_max - view.azimuth_min < 2 * np.pi - 1e-6:
        angle = np.arctan2(y, x)
        inside = np.minimum(inside, np.minimum(angle - view.azimuth_min, view.azimuth_max - angle) * ground)
    angle = np.arctan2(z, ground)
    inside = np.minimum(inside, np.minimum(angle - view.elevation_min, view.elevation_max - angle) * distance)
    share = np.minimum(np.maximum(0.5 + (0.5 / edge_m) * inside, 0.0), 1.0)
    return np.asarray(share * ~_occluded(view.position, boxes[:, :6], occluders[:, :6], nearest_m))


def _occluded(origin: Floats, boxes: Floats, occluders: Floats, nearest_m: float) -> Bools:
    """Boxes (k,) that are occluded by a nearer one, seen from `origin` (3,) m.

    boxes: (k, 6); occluders: (n, 6)

    An object occludes boxes whose centres are in the azimuth sector of its footprint (a disc of its mean horizontal
    extent) and not above the line from the sensor over its top.
    """
    # The table of boxes and occluders is processed in pieces, so that a hostile source cannot exhaust memory.
    k, piece = len(boxes), max(1, MAX_TABLE // max(1, len(occluders)))
    if k > piece:
        starts = range(0, k, piece)
        return np.concatenate(
            [_occluded(origin, boxes[start : start + piece], occluders, nearest_m) for start in starts]
        )
    both = np.concatenate([boxes, occluders])
    both[:, :3] -= origin
    x, y, z, length, width, height = both.T
    ground = np.maximum(np.hypot(x, y), nearest_m)
    # Components across and along the line of sight to each box, times its distance.
    bearing = x + 1j * y
    relative = bearing[:k, None] * bearing[k:].conj()
    hides = np.abs(relative.imag) < ground[:k, None] * (0.25 * (length + width))[k:]
    hides &= relative.real > 0.0
    hides &= ground[:k, None] > (ground + 0.5 * width)[k:]
    top = (z + 0.5 * height) / ground
    hides &= top[:k, None] < top[k:]
    return np.asarray(hides.any(axis=1))
