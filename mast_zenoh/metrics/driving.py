"""Open-loop driving analysis: corridor objects, times to collision, braking.

The corridor is along the path that the vehicle drove in the scene. Pure; docs/metrics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.metrics.braking import BrakingRule, SafeDistance, time_to_collision
from mast_zenoh.metrics.overlap import birdseye_intersection

#: m, spacing of points of the path; and maximum distance of the centre of an object that may reach into the corridor.
_STEP_M, _REACH_M = 1.0, 8.0
#: m, in the bird's-eye view; an object centred within this distance of the vehicle is the vehicle itself.
_SELF_M = 2.0
#: m2; outlines with a smaller intersection only touch.
_TOUCH_M2 = 1e-6


class Vehicle(NamedTuple):
    """A vehicle in f frames.

    position (f, 3) m, velocity (f, 3) m/s, world frame; heading (f,) rad; length, width m
    """

    position: Floats
    velocity: Floats
    heading: Floats
    length: float
    width: float


class Objects(NamedTuple):
    """n objects.

    frame (n,) int64, row of the vehicle's frames; position, velocity and size (n, 3); yaw (n,) rad
    """

    frame: Ints
    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats


class Ahead(NamedTuple):
    """k objects in the corridor of a vehicle.

    row: (k,) of the objects;  gap_m: (k,) m, along the path from the vehicle's front
    ttc_s: (k,) s, time to collision at constant speeds, inf: never;  brake: (k,) whether the vehicle has to brake
    overlapping: (j,) rows of the objects that overlap the vehicle and are not among these
    """

    row: Ints
    gap_m: Floats
    ttc_s: Floats
    brake: Bools
    overlapping: Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class Driving:
    """Settings of the driving analysis.

    rule:      braking rule; None: SafeDistance()
    horizon_m: m, length of the corridor ahead
    margin_m:  m, margin of the corridor on either side of the vehicle
    Raises ValueError for an invalid horizon or margin.
    """

    rule: BrakingRule | None = None
    horizon_m: float = 60.0
    margin_m: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 < self.horizon_m < np.inf:
            raise ValueError(f"horizon_m: found {self.horizon_m}, expected more than 0")
        if not 0.0 <= self.margin_m < np.inf:
            raise ValueError(f"margin_m: found {self.margin_m}, expected 0 or more")

    def ahead(self, vehicle: Vehicle, objects: Objects) -> Ahead:
        """The objects in the corridor, and the objects that overlap the vehicle itself.

        The corridor follows the path that the vehicle drove after each frame, and continues straight beyond its end.
        Overlapping objects are left out: they are the vehicle itself, or a collision that has already happened.
        """
        path, heading, along = _path(vehicle, self.horizon_m)
        driven = _distance_driven(vehicle)
        row, point = _near_path(objects, path, along, driven)
        frame = objects.frame[row]
        c, s = np.cos(heading[point]), np.sin(heading[point])
        offset = objects.position[row, :2] - path[point]
        longitudinal, lateral = c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]
        turn = objects.yaw[row] - heading[point]
        half_length, half_width = objects.size[row, 0] / 2.0, objects.size[row, 1] / 2.0
        half_extent_along = half_length * np.abs(np.cos(turn)) + half_width * np.abs(np.sin(turn))
        half_extent_across = half_length * np.abs(np.sin(turn)) + half_width * np.abs(np.cos(turn))
        centre = along[point] + longitudinal - driven[frame]
        gap = centre - half_extent_along - vehicle.length / 2.0
        overlaps = _overlaps(vehicle, objects, row)
        inside = np.abs(lateral) - half_extent_across <= vehicle.width / 2.0 + self.margin_m
        inside &= (centre > 0.0) & (gap <= self.horizon_m) & ~overlaps
        rows = inside.nonzero()[0]
        overlapping, row, gap = row[overlaps], row[rows], np.maximum(gap[rows], 0.0)
        speed = np.hypot(*vehicle.velocity[objects.frame[row], :2].T)
        ahead_speed = c[rows] * objects.velocity[row, 0] + s[rows] * objects.velocity[row, 1]
        rule = self.rule or SafeDistance()
        return Ahead(
            row, gap, time_to_collision(gap, speed, ahead_speed), rule.brakes(gap, speed, ahead_speed), overlapping
        )


def _overlaps(vehicle: Vehicle, objects: Objects, row: Ints) -> Bools:
    """Whether each of k objects (k,) overlaps the vehicle or is centred on it.

    Objects and vehicle are compared in the frame of each object.
    """
    offset = objects.position[row] - vehicle.position[objects.frame[row]]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    overlaps = distance <= _SELF_M
    reach = 0.5 * (np.hypot(vehicle.length, vehicle.width) + np.hypot(*objects.size[row, :2].T))
    near = (~overlaps & (distance <= reach + _SELF_M)).nonzero()[0]  # the outlines of others cannot meet
    row, zeros = row[near], np.zeros(len(near), np.int64)
    size = np.tile([vehicle.length, vehicle.width, 0.0], (len(near), 1))
    frame = objects.frame[row]
    own = Boxes(zeros, zeros, vehicle.position[frame], size, vehicle.heading[frame])
    other = Boxes(zeros, zeros, objects.position[row], objects.size[row], objects.yaw[row])
    overlaps[near] = birdseye_intersection(own, other) > _TOUCH_M2
    return np.asarray(overlaps)


def _near_path(objects: Objects, path: Floats, along: Floats, driven: Floats) -> tuple[Ints, Ints]:
    """Rows of the objects near the path, and the nearest path point of each.

    The points are ahead of the vehicle.
    along: (k,) m, arc lengths of the points;  driven: (f,) m, arc length of the vehicle in each frame
    """
    least = along.searchsorted(driven[objects.frame] - _STEP_M)
    point = nearest_points(np.ascontiguousarray(objects.position), path, least, _REACH_M)
    row = (point >= 0).nonzero()[0]
    return row, point[row]


@kernel
def nearest_points(position: Floats, path: Floats, least: Ints, reach_m: float) -> Ints:
    """Nearest point (n,) of a path to each position within `reach_m` of it, the first of several; -1: none.

    position: (n, >= 2) m; path: (k, 2) m; least: (n,) the first point that counts, k: none
    """
    nearest = np.full(len(position), -1)
    for row, (place, first) in enumerate(zip(position[:, :2], least.tolist(), strict=True)):
        offset = place - path[first:]
        squared = offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1]
        if len(squared) and squared.min() <= reach_m * reach_m:
            nearest[row] = first + squared.argmin()
    return nearest


def _path(vehicle: Vehicle, horizon_m: float) -> tuple[Floats, Floats, Floats]:
    """Points (k, 2) m along the path, headings (k,) rad and arc lengths (k,) m.

    At equal steps along the whole path and straight on.
    """
    last = vehicle.heading[-1]
    extension = (horizon_m + vehicle.length) * np.array([np.cos(last), np.sin(last)])
    corners = np.concatenate([vehicle.position[:, :2], vehicle.position[-1:, :2] + extension])
    length = np.concatenate([_distance_driven(vehicle), [0.0]])
    length[-1] = length[-2] + np.hypot(*extension)
    moved = np.diff(length, prepend=-1.0) > 1e-9
    along = np.arange(0.0, length[-1], _STEP_M)
    points = np.column_stack([np.interp(along, length[moved], corners[moved, axis]) for axis in (0, 1)])
    tangent = np.gradient(points, axis=0)
    return points, np.arctan2(tangent[:, 1], tangent[:, 0]), along


def _distance_driven(vehicle: Vehicle) -> Floats:
    """Distance driven (f,) m along the path in each frame."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vehicle.position[:, :2], axis=0).T))])
