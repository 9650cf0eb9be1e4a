"""Real objects that an attack lies about, from one message to the next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate, propagate
from mast_zenoh.attacks.adaptive.base import Moment
from mast_zenoh.attacks.adaptive.budget import Budget
from mast_zenoh.attacks.attack import OWN_TARGET_M
from mast_zenoh.attacks.following import Follower

#: s after which an object that is no longer seen is given up.
UNSEEN_S = 1.0


class ChosenObjects:
    """The objects that an attack has chosen; each keeps its number for as long as it is seen.

    follower, budget: those of the attack; numbers: gives unused numbers
    """

    def __init__(self, follower: Follower, budget: Budget, numbers: Callable[[int], Ints]) -> None:
        self._follower, self.budget, self.numbers = follower, budget, numbers
        self._targets = ObjectStates.empty()
        self._seen_ns: Ints = np.zeros(0, np.int64)

    def clear(self) -> None:
        """Give up all objects."""
        self._targets, self._seen_ns = ObjectStates.empty(), np.zeros(0, np.int64)

    def update(self, moment: Moment, cost: Floats) -> tuple[Ints, Ints]:
        """The numbers (k,) of the chosen objects in a message, and their rows (k,) of `Moment.seen`.

        cost: (n,) objects with the least are chosen first, those without a finite one never; they are given up when
        their cost becomes infinite
        """
        self._targets = propagate(self._targets, moment.elapsed_s)
        row = self._located(moment)
        given_up = (row >= 0) & ~np.isfinite(cost[row]) if len(cost) else np.zeros(len(row), bool)
        given_up |= moment.time_ns - self._seen_ns > UNSEEN_S * 1e9
        row = self._keep(~given_up, row)
        allowed = self.budget.admit(len(row), len(row) + len(cost))
        row = self._keep(np.arange(len(row)) < allowed, row)
        if allowed > len(row):
            free = np.isfinite(cost) & moment.established
            free[row[row >= 0]] = False
            rows = np.flatnonzero(free)
            new = rows[np.argsort(cost[rows], kind="stable")][: allowed - len(row)]
            if len(new):
                states = moment.seen.select(new).with_(id=self.numbers(len(new)))
                self._targets = concatenate([self._targets, states])
                self._seen_ns = np.concatenate([self._seen_ns, np.full(len(new), moment.time_ns, np.int64)])
                row = self._located(moment)
        present = row >= 0
        return self._targets.id[present], row[present]

    def _located(self, moment: Moment) -> Ints:
        """(k,) row of each chosen object, -1: not in the message."""
        self._follower.release_others(self._targets.id)
        if len(self._targets) == 0:
            return np.zeros(0, np.int64)
        self._targets, row = self._follower.locate(self._targets, OWN_TARGET_M)
        self._seen_ns = np.where(row >= 0, moment.time_ns, self._seen_ns)
        return row

    def _keep(self, rows: Bools, row: Ints) -> Ints:
        if rows.all():
            return row
        self._targets, self._seen_ns = self._targets.select(rows), self._seen_ns[rows]
        return row[rows]


def distance_to_ego(moment: Moment) -> Floats:
    """(n,) m from the ego on its route, from the victim without a route; infinite for the ego itself."""
    ego = moment.coverage.surroundings.ego_sensor
    centre = moment.position if ego is None else ego.route.at(moment.time_s)[0]
    offset = moment.seen.position[:, :2] - centre[:2]
    distance: Floats = np.hypot(offset[:, 0], offset[:, 1])
    return distance if ego is None else np.where(distance < 3.0, np.inf, distance)
