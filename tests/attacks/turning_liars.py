"""Liars that turn rules of `ExistenceVotes` against what honest agents report. Threat model as in `informed_liars`."""

from dataclasses import replace

import numpy as np
from agreeing_liars import UnlimitedLiar
from informed_liars import CHANGED, EVERYWHERE_M, cars_at, nearest_m

from mast_zenoh.arrays.states import Floats, ObjectStates, concatenate
from mast_zenoh.attacks.adaptive import Lies, Moment
from mast_zenoh.attacks.imitation import typical
from mast_zenoh.attacks.surroundings import unlimited
from mast_zenoh.integrity.views import SweptView

CAR: Floats = np.array([4.5, 1.9, 1.5])


def invented(xy: Floats, yaw: Floats, moment: Moment, size: Floats, velocity: Floats) -> ObjectStates:
    """What an honest tracker would say of cars, see `cars_at`."""
    return typical(cars_at(xy, yaw, moment, size, velocity).with_(id=np.arange(len(xy))), moment.seen)


class Giant(UnlimitedLiar):
    """One box over all sensors, with the velocity of a car that drives: all else would hang on to it."""

    size = np.array([240.0, 240.0, 1.5])

    def lie(self, moment: Moment) -> Lies:
        known = concatenate([moment.seen, self.known_objects(moment)])
        cars = known.select(np.hypot(*known.velocity[:, :2].T) > 3.5)
        velocity = cars.velocity[[moment.frame % len(cars)]] if len(cars) else np.array([[10.0, 0.0, 0.0]])
        # A new place every few frames: a new object each time, which is never contradicted for long.
        angle = 2.4 * (moment.frame // 3)
        place = moment.position[:2] + 12.0 * np.array([np.cos(angle), np.sin(angle)])
        return Lies(inserted=invented(place[None], np.zeros(1), moment, self.size, velocity))


class Tailgate(UnlimitedLiar):
    """Reports, instead of what at most one honest agent sees, a car close before it that drives as one with it.

    Its view covers half a metre, so that nothing that it says is a claim, and nothing accuses it.
    """

    gap_m = 0.5

    def lie(self, moment: Moment) -> Lies:
        known = self.known_objects(moment)
        viewers = moment.coverage.honest_viewers(known)
        target = known.select((np.linalg.norm(known.position - moment.position, axis=1) > 4.0) & (viewers <= 1))
        ahead = np.column_stack([np.cos(target.yaw), np.sin(target.yaw)])
        reach = 0.5 * (target.size[:, :1] + CAR[0]) + self.gap_m
        ghosts = invented(target.position[:, :2] + reach * ahead, target.yaw, moment, CAR, target.velocity)
        hidden = np.flatnonzero(moment.established & (nearest_m(moment.seen, target) < 1.5))
        return Lies(inserted=ghosts, hidden=hidden, hidden_number=CHANGED + hidden)

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return replace(swept, view=replace(swept.view, max_range=0.5), free=np.zeros_like(swept.free))


class Pulse(UnlimitedLiar):
    """Lies in one frame of a second: it reports all objects metres too high, at their places, and sees through all."""

    every, raise_m = 10, 6.0

    def __init__(self, *, start_s: float = 4.0) -> None:
        super().__init__(start_s=start_s)
        self._lied = -1  # frame of the last lie

    def lie(self, moment: Moment) -> Lies:
        if moment.frame % self.every:
            return Lies()
        self._lied = moment.frame
        seen, known = moment.seen, self.known_objects(moment)
        others = typical(known.select(nearest_m(known, seen) > 2.0), seen)
        rows = np.arange(len(seen))
        others, claims = self._raised(others), self._raised(seen)
        return Lies(
            inserted=others.with_(id=np.arange(len(others))), changed=rows, claims=claims, changed_number=CHANGED + rows
        )

    def _raised(self, states: ObjectStates) -> ObjectStates:
        position = states.position.copy()
        position[:, 2] += self.raise_m
        return states.with_(position=position)

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        if frame != self._lied:
            return swept
        everywhere = replace(unlimited(swept.view.position), max_range=EVERYWHERE_M)
        return replace(swept, view=everywhere, free=np.full_like(swept.free, EVERYWHERE_M))
