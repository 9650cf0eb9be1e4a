"""What happens to the traffic behind a driven car."""

from __future__ import annotations

from typing import Any

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
    moved = length > 1e-6
    begin, step, length = corner[:-1][moved], step[moved], length[moved]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corner, axis=0).T))])[1:]  # (f,) of the car
    at = np.concatenate([[0.0], np.cumsum(length)])[:-1]
    direction = step / length[:, None]
    offset = objects.position[:, None, :2] - begin
    ahead = np.clip((offset * direction).sum(axis=2), 0.0, length)
    distance = np.hypot(*np.moveaxis(offset - ahead[..., None] * direction, 2, 0))
    part = distance.argmin(axis=1)
    row = np.arange(len(part))
    to_car = along[objects.frame] - (at[part] + ahead[row, part])
    turn = wrap_angle(objects.yaw - np.arctan2(direction[part, 1], direction[part, 0]))
    near = (distance[row, part] <= _HALF_LANE_M) & (np.abs(turn) <= _TURN)
    return np.asarray(near & (to_car > 0.5 * car.length) & (to_car <= _BEHIND_M))


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
