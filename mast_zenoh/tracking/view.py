"""What a sensor can see: its field of view, and what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.neighbours import TABLE
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.kernels import kernel

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

    def expects(self, boxes: Floats, screens: Floats) -> Floats:
        """(k,) in [0, 1]: how much of each of k boxes (k, >= 6) is in the field of view and not behind another object.

        screens: (n, >= 6) what may hide them; the boxes themselves may be among them. Both begin with x y z l w h in m,
        in the world frame. A box at the edge of the field of view is half in.
        """
        return expected(boxes, screens, self, EDGE_M, NEAREST_M)


@kernel
def expected(boxes: Floats, screens: Floats, view: SensorView, edge_m: float, nearest_m: float) -> Floats:
    """(k,) how much of each box a sensor can see, as `SensorView.expects` returns it.

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
    return np.asarray(share * ~_hidden(view.position, boxes[:, :6], screens[:, :6], nearest_m))


def _hidden(origin: Floats, boxes: Floats, screens: Floats, nearest_m: float) -> Bools:
    """(k,) which of k `boxes` (k, 6) are behind a nearer one of n `screens` (n, 6), as seen from `origin` (3,) m.

    An object hides what has its centre in the sector of azimuth that the object's footprint fills (taken as a disc of
    its mean horizontal extent), and is not above the line from the sensor over its top.
    """
    # A table of boxes and screens, in pieces that fit into memory whatever a hostile source says is there.
    k, piece = len(boxes), max(1, TABLE // max(1, len(screens)))
    if k > piece:
        starts = range(0, k, piece)
        return np.concatenate([_hidden(origin, boxes[start : start + piece], screens, nearest_m) for start in starts])
    both = np.concatenate([boxes, screens])
    both[:, :3] -= origin
    x, y, z, length, width, height = both.T
    ground = np.maximum(np.hypot(x, y), nearest_m)
    # Across and along the line of sight to each box, times its distance.
    place = x + 1j * y
    aside = place[:k, None] * place[k:].conj()
    hides = np.abs(aside.imag) < ground[:k, None] * (0.25 * (length + width))[k:]
    hides &= aside.real > 0.0
    hides &= ground[:k, None] > (ground + 0.5 * width)[k:]
    top = (z + 0.5 * height) / ground
    hides &= top[:k, None] < top[k:]
    return np.asarray(hides.any(axis=1))
