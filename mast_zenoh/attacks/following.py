"""Tracks all objects that an adversary sees, so that targets follow their objects.

All objects compete for the rows of a message. A target whose object is missing in a frame does not jump to a neighbour,
because the neighbour's own track takes that row.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.matching import MAX_TABLE, greedy_matching, neighbours
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
    """How far and how long an object is tracked.

    gate_m, gate_growth_mps: m, gate of an object whose velocity is known; m per s without being seen, by which it grows
    fastest_mps: m/s, the fastest road user: the gate of an object seen once grows with it
    forgotten_s, clutter_s: s, after which an object that is not a target is forgotten; and one that was seen only once
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

#: s; a track up to this age is new: it may be the object of a target that this victim had not seen before.
NEW_S = 0.5
#: m; a target whose object is missing and predicted farther than this from the target has lost it.
LOST_M = 2.5
#: m; the centres of distinct road users are farther apart than this.
SAME_PLACE_M = 1.0


class Follower:
    """Tracks the objects on one wire. All positions are in the world frame.

    assign_radius_m: m, the widest gate
    """

    def __init__(self, assign_radius_m: float) -> None:
        self._radius_m = assign_radius_m
        self._time_ns: int | None = None
        self._tracks = np.zeros((0, COLUMNS))
        self._objects = ObjectStates.empty()  # of the newest message
        self._messages = 0
        self._known: set[int] = set()  # targets of earlier calls

    def observe(self, objects: ObjectStates, time_ns: int) -> None:
        """Update by the objects of one message in canonical order.

        Ids below 0 do not identify objects.
        """
        elapsed_s = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns, self._objects, self._messages = time_ns, objects, self._messages + 1
        small = len(self._tracks) * len(objects) <= MAX_TABLE
        follow = track_observations if small else REFERENCES["track_observations"]  # the reference compares fewer pairs
        self._tracks = follow(
            self._tracks, objects.position, objects.velocity, objects.id, elapsed_s, self._radius_m, LIMITS
        )

    def follow(self, targets: Targets, attach_m: float) -> tuple[Targets, Ints, Ints]:
        """Move the targets to hide and displace to their objects.

        Also returns the row of each object, -1: none.
        The objects of all other targets are released. attach_m: m, see `locate`
        """
        n = len(targets.remove)
        both = concatenate([targets.remove, targets.move])
        self.release_others(both.id)
        if len(both) == 0:
            none = np.zeros(0, np.int64)
            return targets, none, none
        both, row = self.locate(both, attach_m)
        if n == len(both):
            remove, move = both, targets.move
        else:
            remove, move = both.select(slice(0, n)), both.select(slice(n, None))
        return replace(targets, remove=remove, move=move), row[:n], row[n:]

    def locate(self, targets: ObjectStates, attach_m: float) -> tuple[ObjectStates, Ints]:
        """The targets at their objects' positions, and their rows (k,); -1: missing.

        The rows belong to the newest message.

        A target without an object takes the nearest free one within `attach_m` m: any object in the first call with
        this target, later only one that has just appeared or is at the same position.
        """
        numbers = targets.id
        track = np.full(len(numbers), -1, np.int64)
        target_row, track_row = (numbers[:, None] == self._tracks[:, TARGET]).nonzero()
        track[target_row] = track_row
        self._release_lost(targets, track)
        unattached = (track < 0).nonzero()[0]
        if len(unattached):
            self._attach_tracks(targets, unattached, track, attach_m)
        self._known.update(numbers.tolist())
        attached = (track >= 0).nonzero()[0]
        row = np.full(len(numbers), -1, np.int64)
        if len(attached) == 0:
            return targets, row
        tracks = self._tracks[track[attached]]
        row[attached] = tracks[:, ROW]
        position, velocity = targets.position.copy(), targets.velocity.copy()
        position[attached], velocity[attached] = tracks[:, PLACE], tracks[:, VELOCITY]
        return targets.with_(position=position, velocity=velocity), row

    def velocities(self) -> Floats:
        """(n, 3) m/s, the velocities of the rows of the newest message, estimated where rows have none."""
        result = np.zeros((len(self._objects), 3))
        tracks = self._tracks[self._tracks[:, ROW] >= 0]
        result[tracks[:, ROW].astype(np.int64)] = tracks[:, VELOCITY]
        return result

    def established(self, messages: int) -> Bools:
        """Rows (n,) of the newest message with objects seen in `messages` messages.

        This excludes clutter.
        """
        tracks = self._tracks
        rows = tracks[(tracks[:, ROW] >= 0) & (tracks[:, HITS] >= min(messages, self._messages)), ROW]
        result = np.zeros(len(self._objects), bool)
        result[rows.astype(np.int64)] = True
        return result

    def release_others(self, numbers: Ints) -> None:
        """Release the objects of all other targets."""
        if self._known.issubset(numbers.tolist()):
            return
        self._known.intersection_update(numbers.tolist())
        self._tracks[~np.isin(self._tracks[:, TARGET], numbers), TARGET] = -1.0

    def _release_lost(self, targets: ObjectStates, track: Ints) -> None:
        """Release the tracks (k,) of targets that have lost their objects, and mark them as -1."""
        attached = (track >= 0).nonzero()[0]
        missing = attached[self._tracks[track[attached], ROW] < 0.0]
        if len(missing):
            tracks = track.take(missing)
            offset = self._tracks[tracks, :2] - targets.position[missing, :2]
            far = (offset * offset).sum(axis=1) > LOST_M**2
            self._tracks[tracks[far], TARGET] = -1.0
            track[missing[far]] = -1

    def _attach_tracks(self, targets: ObjectStates, unattached: Ints, track: Ints, attach_m: float) -> None:
        free = ((self._tracks[:, TARGET] < 0) & (self._tracks[:, ROW] >= 0)).nonzero()[0]
        positions = self._objects.position[self._tracks[free, ROW].astype(np.int64)]
        i, j, dx, dy = neighbours(
            targets.position[unattached], positions, np.full(len(unattached), attach_m, np.float64)
        )
        if len(i) == 0:
            return
        known = np.array([number in self._known for number in targets.id[unattached].tolist()], bool)
        new = self._tracks[free[j], AGE] <= NEW_S
        cost = dx * dx + dy * dy
        allowed = (~known[i] | new | (cost < SAME_PLACE_M**2)).nonzero()[0]
        i, j, cost = i[allowed], j[allowed], cost[allowed]
        chosen = greedy_matching(i, j, cost)
        track[unattached[i[chosen]]] = free[j[chosen]]
        self._tracks[free[j[chosen]], TARGET] = targets.id[unattached[i[chosen]]]


@kernel
def track_observations(
    tracks: Floats,
    position: Floats,
    velocity: Floats,
    id: Ints,
    elapsed_s: float,
    radius_m: float,
    limits: Limits,
) -> Floats:
    """Update the table of tracks (m, COLUMNS) by one message to (m', COLUMNS).

    position, velocity: (n, 3) m, m/s, of the rows of the message; velocity zero: not known. id: (n,), -1: none
    elapsed_s: s since the message before; radius_m: m, the widest gate

    Rows are matched to tracks by id, otherwise nearest pair first, within gates that grow with the time since an object
    was last seen. For rows without velocity, an alpha-beta filter with growing memory estimates it (Brookner, Tracking
    and Kalman Filtering Made Easy, 1998). Each unmatched row starts a track.
    """
    gate_m, growth, max_speed, drop_s, clutter_s, same_id_m, min_alpha, min_beta = limits
    t = tracks.copy()
    t[:, PLACE] += t[:, VELOCITY] * elapsed_s
    t[:, [UNSEEN, AGE]] += elapsed_s
    t[:, ROW] = -1.0
    taken = np.zeros(len(position), bool)
    a, b = (((t[:, ID, None] == id) & (id >= 0)) if len(t) and len(id) else np.zeros((0, 0), bool)).nonzero()
    offset = t[a, :2] - position[b, :2]
    same = offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1] < same_id_m * same_id_m
    for track, row in zip(a[same].tolist(), b[same].tolist(), strict=True):
        if t[track, ROW] < 0 and not taken[row]:
            t[track, ROW], taken[row] = row, True
    free, rows = (t[:, ROW] < 0).nonzero()[0], (~taken).nonzero()[0]
    gate = np.where(t[:, HITS] > 1, gate_m + growth * t[:, UNSEEN], max_speed * t[:, UNSEEN])
    i, j, dx, dy = neighbours(t[free, PLACE], position[rows], np.minimum(gate, radius_m)[free])
    chosen = greedy_matching(i, j, dx * dx + dy * dy)
    t[free[i[chosen]], ROW] = rows[j[chosen]]
    taken[rows[j[chosen]]] = True

    seen = (t[:, ROW] >= 0).nonzero()[0]
    row = t[seen, ROW].astype(np.int64)
    k, elapsed = t[seen, HITS], np.maximum(t[seen, UNSEEN], 1e-9)
    has_velocity = velocity[row].any(axis=1)[:, None]
    alpha = np.maximum(2.0 * (2.0 * k + 1.0) / ((k + 1.0) * (k + 2.0)), min_alpha)[:, None]
    beta = np.maximum(6.0 / ((k + 1.0) * (k + 2.0)), min_beta)
    innovation = position[row] - t[seen, PLACE]
    t[seen, PLACE] = np.where(has_velocity, position[row], t[seen, PLACE] + alpha * innovation)
    t[seen, VELOCITY] = np.where(
        has_velocity, velocity[row], t[seen, VELOCITY] + (beta / elapsed)[:, None] * innovation
    )
    t[seen, ID], t[seen, UNSEEN] = id[row], 0.0
    t[seen, HITS] += 1.0

    keep = (t[:, TARGET] >= 0) | (t[:, UNSEEN] <= np.where(t[:, HITS] > 1, drop_s, clutter_s))
    new_rows = (~taken).nonzero()[0]
    new = np.zeros((len(new_rows), COLUMNS))
    new[:, PLACE], new[:, VELOCITY], new[:, HITS] = position[new_rows], velocity[new_rows], 1.0
    new[:, ID], new[:, TARGET], new[:, ROW] = id[new_rows], -1.0, new_rows
    return np.concatenate([t[keep], new])
