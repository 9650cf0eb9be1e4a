"""Keeps every target with its object: a small tracker of all objects that an adversary sees, targets or not.

All objects compete for the rows of a message, so that a target whose object is not seen in a frame does not jump to a
neighbour: the neighbour's own track takes that row.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.matching import greedy
from mast_zenoh.states import Bools, Ints, ObjectStates
from mast_zenoh.tracking.neighbours import neighbours

#: m, gate of an object whose velocity is known, at once; and m per s without being seen.
GATE_M, GATE_GROWTH_MPS = 1.5, 3.0
#: m/s, the fastest road user; the gate of an object seen once grows with it.
FASTEST_MPS = 20.0
#: s, after which an object that is no target is forgotten.
FORGOTTEN_S = 1.0
#: m; a row with the id of a track is that track unless it is farther from it than this.
SAME_ID_M = 8.0
#: s; a track is new for so long: it may be the object of a target that this victim did not see before.
NEW_S = 0.5
#: Least gains of the filter: position, velocity.
LEAST_GAINS = 0.5, 0.15

_NO_ROWS = np.zeros(0, np.int64)


class Follower:
    """Tracks the objects on one wire; see the module. All positions are in the world frame.

    assign_radius_m: m, the widest gate
    """

    def __init__(self, assign_radius_m: float) -> None:
        self._radius_m = assign_radius_m
        self._time_ns: int | None = None
        self._position = np.zeros((0, 3))
        self._velocity = np.zeros((0, 3))
        self._unseen_s = np.zeros(0)
        self._age_s = np.zeros(0)
        self._hits = np.zeros(0, np.int64)
        self._id = _NO_ROWS  # of the victim's rows; -1: the wire has none
        self._target = _NO_ROWS  # number of the target that it is the object of; -1: none
        self._row = _NO_ROWS  # of the newest message; -1: not seen in it
        self._known: set[int] = set()  # targets that were asked for before

    def observe(self, objects: ObjectStates, time_ns: int) -> None:
        """Take the objects of one message, in canonical order; ids below 0 carry no identity."""
        dt = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        self._position += self._velocity * dt
        self._unseen_s += dt
        self._age_s += dt
        self._row = self._match(objects)
        self._update(objects)
        stale = (self._target < 0) & (self._unseen_s > np.where(self._hits > 1, FORGOTTEN_S, 0.35))
        fresh = np.ones(len(objects), bool)
        fresh[self._row[self._row >= 0]] = False
        if stale.any() or fresh.any():
            self._renew(~stale, objects, fresh.nonzero()[0])

    def locate(self, targets: ObjectStates, attach_m: float) -> tuple[ObjectStates, Ints]:
        """The targets where their objects are, and (k,) the row of the newest message that each is; -1: not seen.

        A target that has no object yet takes the nearest one within `attach_m` m that is no other's: any object when
        the target is asked for the first time, afterwards only one that has just appeared.
        """
        numbers = targets.id
        track = self._tracks_of(numbers)
        loose = (track < 0).nonzero()[0]
        if len(loose):
            self._attach(targets, loose, track, attach_m)
        self._known.update(numbers.tolist())
        held = (track >= 0).nonzero()[0]
        row = np.full(len(numbers), -1, np.int64)
        row[held] = self._row[track[held]]
        position, velocity = targets.position.copy(), targets.velocity.copy()
        position[held], velocity[held] = self._position[track[held]], self._velocity[track[held]]
        return targets.with_(position=position, velocity=velocity), row

    def keep(self, numbers: Ints) -> None:
        """Release the objects of all targets but these."""
        self._known.intersection_update(numbers.tolist())
        if len(self._target):
            self._target[~np.isin(self._target, numbers)] = -1

    def _tracks_of(self, numbers: Ints) -> Ints:
        """(k,) the track of each target; -1: it has none."""
        track = np.full(len(numbers), -1, np.int64)
        k, t = (numbers[:, None] == self._target).nonzero()
        track[k] = t
        return track

    def _attach(self, targets: ObjectStates, loose: Ints, track: Ints, attach_m: float) -> None:
        asked = np.array([number in self._known for number in targets.id[loose].tolist()], bool)
        free = ((self._target < 0) & (self._row >= 0)).nonzero()[0]
        i, j, dx, dy = neighbours(
            targets.position[loose], self._position[free], np.full(len(loose), attach_m, np.float64)
        )
        new = self._age_s[free[j]] <= NEW_S
        allowed = (~asked[i] | new).nonzero()[0]
        i, j, cost = i[allowed], j[allowed], (dx * dx + dy * dy)[allowed]
        chosen = greedy(i, j, cost)
        track[loose[i[chosen]]] = free[j[chosen]]
        self._target[free[j[chosen]]] = targets.id[loose[i[chosen]]]

    def _match(self, objects: ObjectStates) -> Ints:
        """(m,) the row of each track, -1 for none: equal ids first, then the nearest pair within the gates."""
        row = np.full(len(self._id), -1, np.int64)
        if len(row) == 0 or len(objects) == 0:
            return row
        taken = np.zeros(len(objects), bool)
        if objects.id[0] >= 0:
            same_id: Bools = self._id[:, None] == objects.id
            t, r = same_id.nonzero()
            jump = self._position[t, :2] - objects.position[r, :2]
            same = (np.einsum("ij,ij->i", jump, jump) < SAME_ID_M**2).nonzero()[0]
            row[t[same]] = r[same]
            taken[r[same]] = True
        tracks, rows = (row < 0).nonzero()[0], (~taken).nonzero()[0]
        if len(tracks) and len(rows):
            gate = np.where(self._hits > 1, GATE_M + GATE_GROWTH_MPS * self._unseen_s, FASTEST_MPS * self._unseen_s)
            gate = np.minimum(gate, self._radius_m)[tracks]
            i, j, dx, dy = neighbours(self._position[tracks], objects.position[rows], gate)
            chosen = greedy(i, j, dx * dx + dy * dy)
            row[tracks[i[chosen]]] = rows[j[chosen]]
        return row

    def _update(self, objects: ObjectStates) -> None:
        """Move the tracks to their rows: an alpha-beta filter with growing memory where rows have no velocity."""
        seen = (self._row >= 0).nonzero()[0]
        if len(seen) == 0:
            return
        row = self._row[seen]
        there, velocity = objects.position.take(row, 0), objects.velocity.take(row, 0)
        shows: Bools = np.asarray(velocity.any(axis=1))
        if shows.all():
            self._position[seen], self._velocity[seen] = there, velocity
        else:
            k = self._hits[seen].astype(np.float64)
            alpha = np.maximum(2.0 * (2.0 * k + 1.0) / ((k + 1.0) * (k + 2.0)), LEAST_GAINS[0])
            beta = np.maximum(6.0 / ((k + 1.0) * (k + 2.0)), LEAST_GAINS[1])
            elapsed = np.maximum(self._unseen_s[seen], 1e-9)
            surprise = there - self._position[seen]
            estimate = self._velocity[seen] + (beta / elapsed)[:, None] * surprise
            self._position[seen] = np.where(shows[:, None], there, self._position[seen] + alpha[:, None] * surprise)
            self._velocity[seen] = np.where(shows[:, None], velocity, estimate)
        self._id[seen] = objects.id.take(row)
        self._unseen_s[seen] = 0.0
        self._hits[seen] += 1

    def _renew(self, kept: Bools, objects: ObjectStates, fresh: Ints) -> None:
        """Forget the tracks that are not kept, and begin one at each of the `fresh` rows."""
        n = len(fresh)

        def with_new(old: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([old[kept], new])

        self._position = with_new(self._position, objects.position.take(fresh, 0))
        self._velocity = with_new(self._velocity, objects.velocity.take(fresh, 0))
        self._unseen_s = with_new(self._unseen_s, np.zeros(n))
        self._age_s = with_new(self._age_s, np.zeros(n))
        self._hits = with_new(self._hits, np.ones(n, np.int64))
        self._id = with_new(self._id, objects.id.take(fresh))
        self._target = with_new(self._target, np.full(n, -1, np.int64))
        self._row = with_new(self._row, fresh)
