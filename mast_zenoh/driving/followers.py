"""What happens to the traffic behind a driven car."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.driving.braking import spans
from mast_zenoh.metrics.driving import STANDING_MPS, Objects, Vehicle

#: m behind the car; half of the width of a lane, m; and rad, greatest angle to the way that the car drove.
_BEHIND_M, _HALF_LANE_M, _TURN = 100.0, 1.75, np.deg2rad(30.0)


def behind(car: Vehicle, objects: Objects) -> Bools:
    """Whether each of n objects is behind the car, in its lane: (n,).

    The lane behind it is the way that it drove until the object's frame, and straight back before its first frame. An
    object is on it if its centre is within half a lane of it, and if it points the same way.
    """
    start, heading = car.position[0, :2], car.heading[0]
    back = start - _BEHIND_M * np.array([np.cos(heading), np.sin(heading)])
    corner = np.concatenate([back[None], car.position[:, :2]])
    step = np.diff(corner, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    along = np.cumsum(length)  # (f,) of the car
    moved = np.flatnonzero(length > 1e-6)
    parts = _Parts(corner[moved], step[moved] / length[moved, None], length[moved], along[moved])
    result = np.zeros(len(objects.yaw), np.bool_)
    for rows in np.split(np.arange(len(result)), np.flatnonzero(np.diff(objects.frame)) + 1):
        if len(rows):
            frame = int(objects.frame[rows[0]])
            first = parts.end_m.searchsorted(along[frame] - _BEHIND_M)
            driven = _Parts(*(column[first : moved.searchsorted(frame, "right")] for column in parts))
            result[rows] = _on_way(driven, float(along[frame]), 0.5 * car.length, objects, rows)
    return result


class _Parts(NamedTuple):
    """Straight parts of a way, each (k, ...): begin (k, 2) m, direction (k, 2), length m, and end along the way, m."""

    begin: Floats
    direction: Floats
    length_m: Floats
    end_m: Floats


def _on_way(parts: _Parts, along_m: float, half_m: float, objects: Objects, rows: Ints) -> Bools:
    """Whether each of some objects of one frame is on the way up to the car, which is `along_m` along it: (n,)."""
    offset = objects.position[rows, None, :2] - parts.begin
    ahead = np.clip((offset * parts.direction).sum(axis=2), 0.0, parts.length_m)
    distance = np.hypot(*np.moveaxis(offset - ahead[..., None] * parts.direction, 2, 0))
    part = distance.argmin(axis=1)
    row = np.arange(len(part))
    to_car = along_m - (parts.end_m[part] - parts.length_m[part] + ahead[row, part])
    turn = wrap_angle(objects.yaw[rows] - np.arctan2(parts.direction[part, 1], parts.direction[part, 0]))
    near = (distance[row, part] <= _HALF_LANE_M) & (np.abs(turn) <= _TURN)
    return np.asarray(near & (to_car > half_m) & (to_car <= _BEHIND_M))


def behind_car(car: Vehicle, objects: Objects, ids: Ints, period_s: float, hard_mps2: float) -> dict[str, Any]:
    """The traffic behind a car, "behind" of metrics.json: see `consequences.consequences`."""
    mine = behind(car, objects)
    hard_brakes, hardest, standing, cars = 0, 0.0, 0, np.unique(ids[mine]).tolist()
    for number in cars:
        rows = np.flatnonzero(ids == number)
        frame, speed = objects.frame[rows], np.hypot(objects.velocity[rows, 0], objects.velocity[rows, 1])
        follows = mine[rows]
        changes = _changes(frame, speed, period_s)[follows[:-1]] if len(rows) > 1 else np.zeros(0)
        hard_brakes += len(spans(changes < -hard_mps2))
        hardest = max(hardest, float(-changes.min(initial=0.0)))
        standing += int(np.count_nonzero(speed[follows] <= STANDING_MPS))
    return {
        "cars": len(cars),
        "hard_brakes": hard_brakes,
        "hardest_braking_mps2": hardest,
        "standing_s": standing * period_s,
    }


def _changes(frame: Ints, speed: Floats, period_s: float) -> Floats:
    """Acceleration (n - 1,) m/s^2 between an object's rows; 0 over frames without it."""
    return np.where(np.diff(frame) == 1, np.diff(speed) / period_s, 0.0)
