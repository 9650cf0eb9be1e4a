"""Drivers that differ: how fast, how close behind each other and how late each drives is drawn per vehicle.

Time headways are log-normal, as measured ones are; the parameters are chosen so that the time gaps of moving followers
are about those of the clips of NGSIM: 20 % are below 1 s (15 % in the clips), and 5 % below 0.67 s, as in the clips.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.scenes.generated.junction import ROAD
from mast_zenoh.scenes.generated.signals import SHORT
from mast_zenoh.scenes.generated.traffic import Movers

#: s, median of the time headway of a driver, its spread (of the logarithm), and its least and greatest value.
_HEADWAY = (0.46, 0.66, (0.18, 2.5))
#: s, the same of the reaction time.
_REACTION = (0.6, 0.35, (0.3, 1.2))
#: The same of factors on the usual desired speed and acceleration of a kind of vehicle.
_SPEED = (1.0, 0.1, (0.8, 1.15))
_ACCELERATION = (1.1, 0.2, (0.7, 1.6))
#: m/s, the slowest desired speed: green phases are made for it.
_SLOWEST = 8.0
#: How many cars a platoon has, and s, the headway in it.
_PLATOON, _PLATOON_HEADWAY_S = (3, 5), 0.5
_PLATOON_SPEED = 0.8  # of its first car; the others would be faster
_PLATOON_CHANCE = 0.5  # in each scene


def with_differing_drivers(movers: Movers, random: np.random.Generator) -> Movers:
    """The movers with vehicles whose drivers differ, in some scenes with a platoon among them."""
    road = movers.user == ROAD

    def factors(median: float, spread: float, limits: tuple[float, float]) -> Floats:
        return np.asarray(np.clip(median * np.exp(spread * random.standard_normal(len(road))), *limits))

    headway = factors(*_HEADWAY)
    reaction = factors(*_REACTION)
    speed = np.maximum(movers.speed * factors(*_SPEED), _SLOWEST)
    acceleration = movers.acceleration * factors(*_ACCELERATION)
    platoon = _platoon(movers, random) if random.random() < _PLATOON_CHANCE else np.zeros(0, np.int64)
    guide = movers.guide.copy()
    if len(platoon):
        guide[platoon] = platoon[0]
        speed[platoon[0]] = max(_PLATOON_SPEED * movers.speed[platoon[0]], _SLOWEST)
        headway[platoon[1:]] = _PLATOON_HEADWAY_S
    return replace(
        movers,
        headway=np.where(road, headway, movers.headway),
        reaction=np.where(road, reaction, movers.reaction),
        speed=np.where(road, speed, movers.speed),
        acceleration=np.where(road, acceleration, movers.acceleration),
        guide=guide,
        exact_headway=True,
    )


def _platoon(movers: Movers, random: np.random.Generator) -> Ints:
    """(k,) cars that start one behind the other in a lane, the first one first; empty if no lane has as many."""
    length = int(random.integers(_PLATOON[0], _PLATOON[1] + 1))
    runs = []
    for lane in np.unique(movers.path[movers.user == ROAD]):
        rows = np.flatnonzero((movers.user == ROAD) & (movers.path == lane))
        rows = rows[np.argsort(-movers.start[rows])]
        short = movers.size_class[rows] == SHORT
        runs += [rows[k : k + length] for k in range(len(rows) - length + 1) if short[k : k + length].all()]
    return runs[int(random.integers(len(runs)))] if runs else np.zeros(0, np.int64)
