"""Where the outlines of a car and of objects overlap: at the same time, and one after the other."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.rectangles import overlapping
from mast_zenoh.arrays.states import Ints
from mast_zenoh.metrics.driving import RoadUsers, VehicleCourse

#: s; a longer time between two that use the same place is no encounter.
_LONGEST_S = 5.0
#: rad; who comes at a smaller angle follows, and does not cross.
_CROSSING = np.deg2rad(30.0)


def collisions(car: VehicleCourse, objects: RoadUsers) -> Ints:
    """Rows (k,) of the n objects whose outlines overlap that of the car in the same frame, ascending."""
    return _overlapping(car, objects, np.arange(len(objects.frame)), objects.frame)


def post_encroachment_s(car: VehicleCourse, objects: RoadUsers, period_s: float) -> float | None:
    """The shortest post-encroachment time of a car and the objects that cross its way, s; None: above 5 s.

    It is the time between the last moment at which one of the two is at a place, and the first at which the other is;
    here between two frames, so that it is too long by less than two. Who follows the car, or is followed, does not
    count.

    Source: Allen, Shin and Cooper, Analysis of traffic conflicts and collisions (Transportation Research Record 667,
    1978).
    """
    frames = len(car.position)
    for apart in range(round(_LONGEST_S / period_s) + 1):
        for shift in {apart, -apart}:
            row = objects.frame + shift
            rows = np.flatnonzero((row >= 0) & (row < frames))
            met = _overlapping(car, objects, rows, row[rows])
            if (np.abs(wrap_angle(objects.yaw[met] - car.heading[row[met]])) >= _CROSSING).any():
                return apart * period_s
    return None


def _overlapping(car: VehicleCourse, objects: RoadUsers, rows: Ints, at: Ints) -> Ints:
    """Of (k,) rows of objects, those whose outlines overlap that of the car in its frames `at` (k,)."""
    offset = objects.position[rows, :2] - car.position[at, :2]
    own = np.broadcast_to([car.length, car.width], offset.shape)
    return rows[overlapping(offset, own, car.heading[at], objects.size[rows], objects.yaw[rows])]
