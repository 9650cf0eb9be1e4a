"""Keeps every target with its object: a small tracker of all objects that an adversary sees, targets or not.

All objects compete for the rows of a message, so that a target whose object is not seen in a frame does not jump to a
neighbour: the neighbour's own track takes that row.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.matching import greedy
from mast_zenoh.arrays.neighbours import TABLE, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.kernels import REFERENCES, kernel
from mast_zenoh.kernels import table_columns as columns

#: Columns of the table of tracks, see `kernels.table_columns`.
PLACE, VELOCITY = slice(0, columns.FOLLOWED_VX), slice(columns.FOLLOWED_VX, columns.FOLLOWED_UNSEEN)
UNSEEN, AGE, HITS = columns.FOLLOWED_UNSEEN, columns.FOLLOWED_AGE, columns.FOLLOWED_HITS
ID, TARGET, ROW = columns.FOLLOWED_ID, columns.FOLLOWED_TARGET, columns.FOLLOWED_ROW
COLUMNS = columns.FOLLOWED_COLUMNS


class Limits(NamedTuple):
    """How far and how long an object is followed.

    gate_m, gate_growth_mps: m, gate of an object whose velocity is known; m per s without being seen, by which it grows
    fastest_mps: m/s, the fastest road user: the gate of an object seen once grows with it
    forgotten_s, clutter_s: s, after which an object that is no target is forgotten; and one that was seen only once
    same_id_m: m; a row with the id of a track is that track unless it is farther from it than this: the victim's
               tracker mixes up neighbours at times
    least_alpha, least_beta: least gains of the filter for position and velocity
    """

    gate_m: float = 1.5
    gate_growth_mps: float = 3.0
    fastest_mps: float = 20.0
    forgotten_s: float = 1.0
    clutter_s: float = 0.35
    same_id_m: float = 2.5
    least_alpha: float = 0.5
    least_beta: float = 0.15


LIMITS = Limits()

#: s; a track is new for so long: it may be the object of a target that this victim did not see before.
NEW_S = 0.5
#: m; a target whose object is not seen, and was expected farther than this from where the target is, has lost it.
LOST_M = 2.5
#: m; no two road users have their middles so near each other.
SAME_PLACE_M = 1.0


class Follower:
    """Tracks the objects on one wire; see the module. All positions are in the world frame.

    assign_radius_m: m, the widest gate
    """

    def __init__(self, assign_radius_m: float) -> None:
        self._radius_m = assign_radius_m
        self._time_ns: int | None = None
        self._tracks = np.zeros((0, COLUMNS))
        self._objects = ObjectStates.empty()  # of the newest message
        self._messages = 0
        self._known: set[int] = set()  # targets that were asked for before

    def observe(self, objects: ObjectStates, time_ns: int) -> None:
        """Take the objects of one message, in canonical order; ids below 0 carry no identity."""
        elapsed_s = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns, self._objects, self._messages = time_ns, objects, self._messages + 1
        small = len(self._tracks) * len(objects) <= TABLE
        follow = followed if small else REFERENCES["followed"]  # which looks at fewer pairs
        self._tracks = follow(
            self._tracks, objects.position, objects.velocity, objects.id, elapsed_s, self._radius_m, LIMITS
        )

    def bring(self, targets: Targets, attach_m: float) -> tuple[Targets, Ints, Ints]:
        """The targets to hide and displace where their objects are, and by target the row of its object; -1: none.

        The objects of all other targets are released. attach_m: m, see `locate`
        """
        n = len(targets.remove)
        both = concatenate([targets.remove, targets.move])
        self.keep(both.id)
        if len(both) == 0:
            none = np.zeros(0, np.int64)
            return targets, none, none
        both, row = self.locate(both, attach_m)
        located = replace(targets, remove=both.select(slice(0, n)), move=both.select(slice(n, None)))
        return located, row[:n], row[n:]

    def locate(self, targets: ObjectStates, attach_m: float) -> tuple[ObjectStates, Ints]:
        """The targets where their objects are, and (k,) the row of the newest message that each is; -1: not seen.

        A target that has no object yet takes the nearest one within `attach_m` m that is no other's: any object when
        the target is asked for the first time, afterwards only one that has just appeared, or is at the same place.
        """
        numbers = targets.id
        track = np.full(len(numbers), -1, np.int64)
        k, t = (numbers[:, None] == self._tracks[:, TARGET]).nonzero()
        track[k] = t
        track[self._lost(targets, track)] = -1
        loose = (track < 0).nonzero()[0]
        if len(loose):
            self._attach(targets, loose, track, attach_m)
        self._known.update(numbers.tolist())
        held = (track >= 0).nonzero()[0]
        row = np.full(len(numbers), -1, np.int64)
        if len(held) == 0:
            return targets, row
        mine = self._tracks[track[held]]
        row[held] = mine[:, ROW]
        position, velocity = targets.position.copy(), targets.velocity.copy()
        position[held], velocity[held] = mine[:, PLACE], mine[:, VELOCITY]
        return targets.with_(position=position, velocity=velocity), row

    def established(self, messages: int) -> Bools:
        """(n,) which rows of the newest message are of objects seen in so many messages: clutter does not last."""
        tracks = self._tracks
        rows = tracks[(tracks[:, ROW] >= 0) & (tracks[:, HITS] >= min(messages, self._messages)), ROW]
        result = np.zeros(len(self._objects), bool)
        result[rows.astype(np.int64)] = True
        return result

    def keep(self, numbers: Ints) -> None:
        """Release the objects of all targets but these."""
        if self._known.issubset(numbers.tolist()):
            return
        self._known.intersection_update(numbers.tolist())
        self._tracks[~np.isin(self._tracks[:, TARGET], numbers), TARGET] = -1.0

    def _lost(self, targets: ObjectStates, track: Ints) -> Bools:
        """(k,) which targets have lost their objects, so that the tracks (k,) that they had are those of no target."""
        held = (track >= 0).nonzero()[0]
        mine = self._tracks[track[held]]
        offset = mine[:, PLACE][:, :2] - targets.position[held, :2]
        lost = np.zeros(len(track), bool)
        lost[held] = (mine[:, ROW] < 0) & ((offset * offset).sum(axis=1) > LOST_M**2)
        self._tracks[track[lost], TARGET] = -1.0
        return lost

    def _attach(self, targets: ObjectStates, loose: Ints, track: Ints, attach_m: float) -> None:
        asked = np.array([number in self._known for number in targets.id[loose].tolist()], bool)
        free = ((self._tracks[:, TARGET] < 0) & (self._tracks[:, ROW] >= 0)).nonzero()[0]
        there = self._objects.position[self._tracks[free, ROW].astype(np.int64)]
        i, j, dx, dy = neighbours(targets.position[loose], there, np.full(len(loose), attach_m, np.float64))
        new = self._tracks[free[j], AGE] <= NEW_S
        cost = dx * dx + dy * dy
        allowed = (~asked[i] | new | (cost < SAME_PLACE_M**2)).nonzero()[0]
        i, j, cost = i[allowed], j[allowed], cost[allowed]
        chosen = greedy(i, j, cost)
        track[loose[i[chosen]]] = free[j[chosen]]
        self._tracks[free[j[chosen]], TARGET] = targets.id[loose[i[chosen]]]


@kernel
def followed(
    tracks: Floats,
    position: Floats,
    velocity: Floats,
    id: Ints,
    elapsed_s: float,
    radius_m: float,
    limits: Limits,
) -> Floats:
    """The table of tracks (m', COLUMNS) after one more message, of that before it (m, COLUMNS).

    position, velocity: (n, 3) m, m/s, of the rows of the message; velocity zero: not known. id: (n,), -1: none
    elapsed_s: s since the message before; radius_m: m, the widest gate

    Rows with the id of a track are its own. The others are joined nearest pair first, within gates that grow with the
    time that an object was not seen. Where rows have no velocity, an alpha-beta filter with growing memory estimates it
    (Brookner, Tracking and Kalman Filtering Made Easy, 1998). Each row of no track begins one.
    """
    gate_m, growth, fastest, forgotten, clutter, same_id_m, least_alpha, least_beta = limits
    t = tracks.copy()
    t[:, PLACE] += t[:, VELOCITY] * elapsed_s
    t[:, [UNSEEN, AGE]] += elapsed_s
    t[:, ROW] = -1.0
    taken = np.zeros(len(position), bool)
    a, b = (((t[:, ID, None] == id) & (id >= 0)) if len(t) and len(id) else np.zeros((0, 0), bool)).nonzero()
    apart = t[a, :2] - position[b, :2]
    near = apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1] < same_id_m * same_id_m
    for track, row in zip(a[near].tolist(), b[near].tolist(), strict=True):
        if t[track, ROW] < 0 and not taken[row]:
            t[track, ROW], taken[row] = row, True
    free, rows = (t[:, ROW] < 0).nonzero()[0], (~taken).nonzero()[0]
    gate = np.where(t[:, HITS] > 1, gate_m + growth * t[:, UNSEEN], fastest * t[:, UNSEEN])
    i, j, dx, dy = neighbours(t[free, PLACE], position[rows], np.minimum(gate, radius_m)[free])
    chosen = greedy(i, j, dx * dx + dy * dy)
    t[free[i[chosen]], ROW] = rows[j[chosen]]
    taken[rows[j[chosen]]] = True

    seen = (t[:, ROW] >= 0).nonzero()[0]
    row = t[seen, ROW].astype(np.int64)
    k, elapsed = t[seen, HITS], np.maximum(t[seen, UNSEEN], 1e-9)
    shows = velocity[row].any(axis=1)[:, None]
    alpha = np.maximum(2.0 * (2.0 * k + 1.0) / ((k + 1.0) * (k + 2.0)), least_alpha)[:, None]
    beta = np.maximum(6.0 / ((k + 1.0) * (k + 2.0)), least_beta)
    surprise = position[row] - t[seen, PLACE]
    t[seen, PLACE] = np.where(shows, position[row], t[seen, PLACE] + alpha * surprise)
    t[seen, VELOCITY] = np.where(shows, velocity[row], t[seen, VELOCITY] + (beta / elapsed)[:, None] * surprise)
    t[seen, ID], t[seen, UNSEEN] = id[row], 0.0
    t[seen, HITS] += 1.0

    kept = (t[:, TARGET] >= 0) | (t[:, UNSEEN] <= np.where(t[:, HITS] > 1, forgotten, clutter))
    fresh = (~taken).nonzero()[0]
    new = np.zeros((len(fresh), COLUMNS))
    new[:, PLACE], new[:, VELOCITY], new[:, HITS] = position[fresh], velocity[fresh], 1.0
    new[:, ID], new[:, TARGET], new[:, ROW] = id[fresh], -1.0, fresh
    return np.concatenate([t[kept], new])
