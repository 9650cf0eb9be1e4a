"""What happens to the traffic behind a driven car."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import distance_along, wrap_angle
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.driving.braking import Brake, brakes_of, spans
from mast_zenoh.metrics.driving import STANDING_MPS, RoadUsers, VehicleCourse

#: m behind the car; half of the width of a lane, m; and rad, greatest angle to the way that the car drove.
_BEHIND_M, _HALF_LANE_M, _TURN = 100.0, 1.75, np.deg2rad(30.0)
#: s; who brakes later than this after the car ahead of it brakes for something else.
_RESPONSE_S = 5.0


class Onset(NamedTuple):
    """Where a car begins to brake: row of the frame, and m along the lane."""

    frame: int
    along_m: float


def behind(car: VehicleCourse, objects: RoadUsers) -> Floats:
    """How far behind the car, in its lane, each of n objects is, between the centres: (n,) m; inf: it is not.

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
    result = np.full(len(objects.yaw), np.inf)
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


def _on_way(parts: _Parts, along_m: float, half_m: float, objects: RoadUsers, rows: Ints) -> Floats:
    """How far each of some objects of one frame is behind the car, which is `along_m` along the way: (n,) m or inf."""
    offset = objects.position[rows, None, :2] - parts.begin
    ahead = np.clip((offset * parts.direction).sum(axis=2), 0.0, parts.length_m)
    distance = np.hypot(*np.moveaxis(offset - ahead[..., None] * parts.direction, 2, 0))
    part = distance.argmin(axis=1)
    row = np.arange(len(part))
    to_car = along_m - (parts.end_m[part] - parts.length_m[part] + ahead[row, part])
    turn = wrap_angle(objects.yaw[rows] - np.arctan2(parts.direction[part, 1], parts.direction[part, 0]))
    near = (distance[row, part] <= _HALF_LANE_M) & (np.abs(turn) <= _TURN)
    return np.where(near & (to_car > half_m) & (to_car <= _BEHIND_M), to_car, np.inf)


def behind_car(
    car: VehicleCourse, objects: RoadUsers, ids: Ints, period_s: float, hard_mps2: float, brakes: Sequence[Brake]
) -> dict[str, Any]:
    """The traffic behind a car, "behind" of metrics.json: see docs/explanation-driving.md. brakes: of the car"""
    to_car = behind(car, objects)
    mine = np.isfinite(to_car)
    along = distance_along(car.position)
    hard_brakes, hardest, standing, delay, cars = 0, 0.0, 0, 0.0, np.unique(ids[mine]).tolist()
    onsets = []
    for number in cars:
        rows = np.flatnonzero(ids == number)
        frame, speed = objects.frame[rows], np.hypot(objects.velocity[rows, 0], objects.velocity[rows, 1])
        follows, place = mine[rows], along[frame] - to_car[rows]
        changes = _changes(frame, speed, period_s)[follows[:-1]] if len(rows) > 1 else np.zeros(0)
        hard_brakes += len(spans(changes < -hard_mps2))
        hardest = max(hardest, float(-changes.min(initial=0.0)))
        standing += int(np.count_nonzero(speed[follows] <= STANDING_MPS))
        usual = np.maximum(np.maximum.accumulate(speed), STANDING_MPS)
        delay += float((1.0 - np.minimum(speed / usual, 1.0))[follows].sum() * period_s)
        began = [brake.first for brake in brakes_of(_changes(frame, speed, period_s), period_s)]
        onsets += [Onset(int(frame[row]), float(place[row])) for row in began if follows[row]]
    reached, wave_mps = shock_wave([Onset(each.first, float(along[each.first])) for each in brakes], onsets, period_s)
    return {
        "cars": len(cars),
        "hard_brakes": hard_brakes,
        "hardest_braking_mps2": hardest,
        "standing_s": standing * period_s,
        "delay_s": delay,
        "shock_wave_cars": reached,
        "shock_wave_mps": wave_mps,
    }


def shock_wave(own: Sequence[Onset], others: Sequence[Onset], period_s: float) -> tuple[int, float | None]:
    """The braking of a car that runs through most of the cars behind it.

    own: where the car begins to brake;  others: where those behind it do
    Each braking is followed by that of the nearest car behind that begins later, by 5 s at most.

    Returns the number of cars that it reaches, and its speed along the lane, m/s, negative backwards (a line through
    all places over time, by least squares); None: it reaches none.
    """
    best: list[Onset] = []
    for origin in own:
        wave = [origin]
        while True:
            last = wave[-1]
            late = last.frame + _RESPONSE_S / period_s
            later = [each for each in others if last.frame < each.frame <= late and each.along_m < last.along_m]
            if not later:
                break
            wave.append(max(later, key=lambda each: each.along_m))
        best = max(best, wave, key=len)
    if len(best) < 2:
        return 0, None
    time_s, place = np.array([each.frame for each in best]) * period_s, [each.along_m for each in best]
    return len(best) - 1, float(np.polyfit(time_s, place, 1)[0])


def _changes(frame: Ints, speed: Floats, period_s: float) -> Floats:
    """Acceleration (n - 1,) m/s^2 between an object's rows; 0 over frames without it."""
    return np.where(np.diff(frame) == 1, np.diff(speed) / period_s, 0.0)
