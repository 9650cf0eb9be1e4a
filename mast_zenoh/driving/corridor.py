"""The corridor of a car: its outline along its lane, and what is ahead in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.driving.motion import RouteAhead
from mast_zenoh.metrics.driving import Driving, Objects, Vehicle


def along_route(position: Floats, velocity: Floats, heading: float, size: Floats, route: RouteAhead) -> Vehicle:
    """A car now, and then along its route: the corridor in which its driver looks for objects.

    position: (3,) m, velocity: (3,) m/s, heading: rad, of the car; size: (2,) m, its length and width
    """
    place = np.concatenate([position[None, :2], route.position[1:]])
    step = np.diff(place, axis=0)
    return Vehicle(
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


def in_corridor(car: Vehicle, routes: Mapping[int, RouteAhead], objects: Objects, look: Driving) -> InCorridor:
    """What is ahead of a car in each of f frames, along the route of that frame.

    routes: by row of the car's frames; a frame without one has no corridor
    objects: ascending by frame; look: how far and how wide the corridor is
    """
    parts: list[InCorridor] = []
    size = np.array([car.length, car.width])
    first, last = (objects.frame.searchsorted(np.arange(len(car.heading)), side) for side in ("left", "right"))
    for frame, route in routes.items():
        here = slice(int(first[frame]), int(last[frame]))
        if here.start == here.stop:
            continue
        now = along_route(car.position[frame], car.velocity[frame], float(car.heading[frame]), size, route)
        count = here.stop - here.start
        ahead = look.ahead(now, Objects(np.zeros(count, np.int64), *(column[here] for column in objects[1:])))
        own = np.full(len(ahead.row), np.hypot(*car.velocity[frame, :2]))
        at = np.full(len(ahead.row), frame)
        parts.append(InCorridor(at, here.start + ahead.row, ahead.gap_m, ahead.speed_mps, own, ahead.ttc_s))
    nothing = InCorridor(np.zeros(0, np.int64), np.zeros(0, np.int64), *(np.zeros(0) for _ in range(4)))
    return InCorridor(*(np.concatenate(column) for column in zip(nothing, *parts, strict=True)))


def needed_braking(gap_m: Floats, own_mps: Floats, ahead_mps: Floats) -> Floats:
    """Constant deceleration (n,) m/s^2 that just avoids contact with objects that keep their speed (DRAC); 0: none.

    Source: Almqvist, Hyden and Risser, Use of speed limiters in cars for increased safety and a better environment
    (Transportation Research Record 1318, 1991). Without a gap it is infinite.
    """
    closing = np.maximum(own_mps - ahead_mps, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0.0, closing**2 / (2.0 * gap_m), 0.0)
