"""The corridor of a car: its outline along its lane, what is ahead in it, and what comes into it from the side."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import along_and_across
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.driving.motion import RouteAhead
from mast_zenoh.metrics.driving import STANDING_MPS, Driving, RoadUsers, VehicleCourse

#: s; what comes into the corridor later crosses too late to matter, as for ProposalDriver; and s between two looks.
CROSSING_S, _LOOK_S = 4.0, 0.2
#: s; a car that gets to a place by so much later than what crosses there still brakes for it. Source: see
#: `metrics.driving.TimeToCollision`.
_AFTER_S = 1.5


def along_route(position: Floats, velocity: Floats, heading: float, size: Floats, route: RouteAhead) -> VehicleCourse:
    """A car now, and then along its route: the corridor in which its driver looks for objects.

    position: (3,) m, velocity: (3,) m/s, heading: rad, of the car; size: (2,) m, its length and width
    """
    place = np.concatenate([position[None, :2], route.position[1:]])
    step = np.diff(place, axis=0)
    return VehicleCourse(
        np.column_stack([place, np.full(len(place), position[2])]),
        np.tile(velocity, (len(place), 1)),
        np.concatenate([[heading], np.arctan2(step[:, 1], step[:, 0])]),
        float(size[0]),
        float(size[1]),
    )


class InCorridor(NamedTuple):
    """n objects in the corridor of a car.

    frame: (n,) row of the car's frames; row: (n,) of the objects; gap_m: (n,) m, from the car's front
    ahead_mps: (n,) m/s, of the object along the corridor; own_mps: (n,) m/s, of the car; ttc_s: (n,) s, inf: never
    """

    frame: Ints
    row: Ints
    gap_m: Floats
    ahead_mps: Floats
    own_mps: Floats
    ttc_s: Floats


def in_corridor(car: VehicleCourse, routes: Mapping[int, RouteAhead], objects: RoadUsers, look: Driving) -> InCorridor:
    """What is ahead of a car in each of f frames, along the route of that frame.

    routes: by row of the car's frames; a frame without one has no corridor
    objects: ascending by frame; look: how far and how wide the corridor is
    """
    parts: list[InCorridor] = []
    for frame, now, start, present in _frames(car, routes, objects):
        ahead = look.ahead(now, present)
        own = np.full(len(ahead.row), np.hypot(*car.velocity[frame, :2]))
        at = np.full(len(ahead.row), frame)
        parts.append(InCorridor(at, start + ahead.row, ahead.gap_m, ahead.speed_mps, own, ahead.ttc_s))
    return _joined(parts)


def crossing(car: VehicleCourse, routes: Mapping[int, RouteAhead], objects: RoadUsers, look: Driving) -> InCorridor:
    """What comes into the corridor of a car while the car gets there, both at constant velocity, in each of f frames.

    What is in the corridor already, or follows the car, is not among these. `gap_m` is to where it comes in (at the
    first look at which the two could meet), and `ttc_s` the time until then.

    routes: by row of the frames that are asked about; the others as in `in_corridor`
    """
    parts: list[InCorridor] = []
    times = np.arange(0.0, CROSSING_S + _LOOK_S / 2.0, _LOOK_S)
    for frame, now, start, present in _frames(car, routes, objects):
        own = float(np.hypot(*car.velocity[frame, :2]))
        moving = np.flatnonzero(_could_cross(now, present, look))
        repeated = np.repeat(moving, len(times))
        time = np.tile(times, len(moving))
        there = RoadUsers._make(column[repeated] for column in present)
        ahead = look.ahead(now, there._replace(position=there.position + time[:, None] * there.velocity))
        at, when = repeated[ahead.row], time[ahead.row]
        already = np.isin(at, at[when == 0.0])
        # What goes along meets the front half of the car, or goes behind or beside it.
        passed = own * when - np.where(ahead.speed_mps > 0.0, 0.5, 1.0) * car.length
        meets = ~already & (ahead.gap_m >= passed) & (ahead.gap_m <= own * (when + _AFTER_S))
        found = np.flatnonzero(meets)
        found = found[np.unique(at[found], return_index=True)[1]]  # the first look of each
        rows = start + at[found]
        same = np.full(len(found), own)
        parts.append(
            InCorridor(np.full(len(found), frame), rows, ahead.gap_m[found], ahead.speed_mps[found], same, when[found])
        )
    return _joined(parts)


def _joined(parts: Iterable[InCorridor]) -> InCorridor:
    """Several tables of objects as one."""
    nothing = InCorridor(np.zeros(0, np.int64), np.zeros(0, np.int64), *(np.zeros(0) for _ in range(4)))
    return InCorridor(*(np.concatenate(column) for column in zip(nothing, *parts, strict=True)))


def _frames(
    car: VehicleCourse, routes: Mapping[int, RouteAhead], objects: RoadUsers
) -> Iterator[tuple[int, VehicleCourse, int, RoadUsers]]:
    """Yield each frame with a route and objects: its row, the car along its route, and the objects and their first row.

    The frames of the objects are 0: they are there now.
    """
    size = np.array([car.length, car.width])
    first, last = (objects.frame.searchsorted(np.arange(len(car.heading)), side) for side in ("left", "right"))
    for frame, route in routes.items():
        here = slice(int(first[frame]), int(last[frame]))
        if here.start < here.stop:
            now = along_route(car.position[frame], car.velocity[frame], float(car.heading[frame]), size, route)
            present = RoadUsers._make(column[here] for column in objects)
            yield frame, now, here.start, present._replace(frame=np.zeros_like(present.frame))


def _could_cross(now: VehicleCourse, objects: RoadUsers, look: Driving) -> Bools:
    """Whether each of n objects (n,) moves, is not too far away, and does not follow the car in its lane."""
    offset = objects.position[:, :2] - now.position[0, :2]
    speed = np.hypot(objects.velocity[:, 0], objects.velocity[:, 1])
    along, across = along_and_across(offset, np.full(len(offset), now.heading[0])).T
    beside = 0.5 * (now.width + np.hypot(objects.size[:, 0], objects.size[:, 1])) + look.margin_m
    follows = (along < 0.0) & (np.abs(across) < beside)
    reach = look.horizon_m + now.length + CROSSING_S * speed
    return np.asarray((speed > STANDING_MPS) & ~follows & (np.hypot(along, across) <= reach))


def needed_braking(gap_m: Floats, own_mps: Floats, ahead_mps: Floats) -> Floats:
    """Constant deceleration (n,) m/s^2 that just avoids contact with objects that keep their speed (DRAC); 0: none.

    Source: Almqvist, Hyden and Risser, Use of speed limiters in cars for increased safety and a better environment
    (Transportation Research Record 1318, 1991). Without a gap it is infinite.
    """
    closing = np.maximum(own_mps - ahead_mps, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0.0, closing**2 / (2.0 * gap_m), 0.0)
