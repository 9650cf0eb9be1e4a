"""Physical limits, overlap and sudden appearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.disputes import on_ground, plausible_size
from mast_zenoh.integrity.memory import INDEPENDENT_S, NOW, BetaReputation, ObjectMemory
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import TOLERANCES
from mast_zenoh.tracking.tracks import ONE_OBJECT, overlap

#: Standard deviations that an error may have.
_SIGMAS = 3.0
#: Directions in which the surroundings of a new object are checked, and how many must be in view of any agent: one may
#: be hidden by the object itself.
_AROUND, _IN_VIEW = 8, 7
#: s after the first batch before which every object is new.
_START_S = 1.0
#: Alarms above which an object is withheld: one is a mistake, two in a row are not. They do not count on beyond MOST.
_ALARMS, _MOST_ALARMS = 1.5, 3.0


@dataclass(kw_only=True, eq=False)
class Plausibility(Integrity):
    """Withholds objects that move, overlap or appear as no road user does.

    The checks of F2MD (Kamel et al.: Simulation Framework for Misbehavior Detection in Vehicular Networks, IEEE
    Transactions on Vehicular Technology 2020), with its limits, for objects instead of beacons:

    - A track that is too fast, too large, too small or in the air is left out; an object of such tracks is withheld.
    - Speed and position a second apart must fit the greatest acceleration and braking, within three standard deviations
      of the tracks. Of two boxes that overlap too far, the one that fewer agents report is odd, then the younger. Each
      such alarm counts one, and one leaks away in `gap_s`: two in a row withhold an object.
    - An object that one agent reports where others have its surroundings in view is withheld for `gap_s`, or until a
      second agent reports it: they would have seen it come.

    speed_mps: m/s, greatest speed
    acceleration_mps2, braking_mps2: m/s², greatest acceleration and braking
    gap_s: s, within which messages are related
    approach_m: m around a new object that must be in view: 0.5 s, which trackers need to confirm it, at 60 km/h
    range_m: m, up to which an agent sees what is around new objects
    record_s: s, after which an outcome counts 1/e in an agent's trust

    F2MD also compares claims with the true positions of other vehicles, which no receiver knows: that is left out.

    Weaknesses: phantoms that keep to the limits are accepted `gap_s` after they appear, and tracks that claim large
    covariances may move as they like; a real object that comes out of a blind spot which no view shows is withheld for
    `gap_s`; agents are never excluded.
    """

    speed_mps: float = 40.0
    acceleration_mps2: float = 3.0
    braking_mps2: float = 4.5
    gap_s: float = 3.1
    approach_m: float = 8.0
    range_m: float = 40.0
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check("more than 0", speed_mps=self.speed_mps, gap_s=self.gap_s, approach_m=self.approach_m)
        self.reset()

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)
        # state: that the next one is compared to, see `_states`;  checked_ns: its time
        # sudden_ns: time until which an object is withheld
        self._objects = ObjectMemory(alarms=0.0, checked_ns=NOW, state=(np.nan,) * 8, sudden_ns=0)
        self._of = self._objects.of
        self._first_ns: int | None = None
        self._last_ns = 0

    def assess(self, batch: Batch) -> Assessment:
        time_ns, reported = batch.time_ns, batch.reported
        within = self._possible(batch)
        table = np.where(reported, within[batch.member] if len(within) else False, False)
        boxes = ClusterBoxes.of(batch, table)
        rows = self._follow(time_ns, boxes)
        witnesses = table.sum(axis=1)
        elapsed: Floats = (time_ns - self._of.checked_ns[rows]) * np.float64(1e-9)
        due = elapsed >= INDEPENDENT_S
        state = _states(batch, boxes, table)
        odd = self._moves_oddly(state, elapsed, self._of.state[rows])
        odd |= overlapping(boxes, witnesses, self._objects.age_s(time_ns)[rows])
        self._of.alarms[rows] = np.minimum(self._of.alarms[rows] + (odd & due), _MOST_ALARMS)
        due |= self._of.frames[rows] == 1
        self._of.state[rows[due]], self._of.checked_ns[rows[due]] = state[due], time_ns
        unexpected = self._appears(batch, boxes, rows)
        self._of.sudden_ns[rows[unexpected]] = time_ns + round(self.gap_s * 1e9)
        self._of.sudden_ns[rows[witnesses > 1]] = 0
        impossible = witnesses == 0
        withheld = impossible | (self._of.alarms[rows] > _ALARMS) | (self._of.sudden_ns[rows] > time_ns)
        upheld = table & (~withheld & (witnesses > 1))[:, None]
        mean = self._record.update(batch, upheld, reported & (~table | withheld[:, None]))
        trust = np.where(withheld, 0.25, np.where(witnesses > 1, 0.75, 0.5))
        members = reported.sum(axis=1)
        objects = ObjectTrust(trust, members, witnesses, members - witnesses, np.asarray(withheld))
        return Assessment(batch.weights(table), AgentTrust.of(mean), objects)

    def _follow(self, time_ns: int, boxes: ClusterBoxes) -> Ints:
        """(c,) rows of the objects; carries what is remembered of them."""
        if self._first_ns is None:
            self._first_ns = self._last_ns = time_ns
        rows = self._objects.follow(time_ns, boxes.position, boxes.velocity)
        leaked = (time_ns - self._last_ns) * 1e-9 / self.gap_s
        self._of.alarms = np.maximum(self._of.alarms - leaked, 0.0)
        self._last_ns = time_ns
        return rows

    def _possible(self, batch: Batch) -> Bools:
        """(n,) tracks within the physical limits."""
        states = batch.states
        slow = np.hypot(states.velocity[:, 0], states.velocity[:, 1]) <= self.speed_mps
        return np.asarray(slow & plausible_size(states) & on_ground(states, batch.agent, len(batch.agents)))

    def _moves_oddly(self, state: Floats, elapsed: Floats, before: Floats) -> Bools:
        """(c,) whether objects cannot have come from the states before, see `_states`, in `elapsed` (c,) s."""
        dt = np.maximum(elapsed, 1e-3)
        variance = state[:, 4:] + before[:, 4:]
        gained = (np.hypot(state[:, 2], state[:, 3]) - np.hypot(before[:, 2], before[:, 3])) / dt
        noise = _SIGMAS * np.sqrt(variance[:, 2:].sum(axis=1)) / dt
        odd = (gained > self.acceleration_mps2 + noise) | (gained < -self.braking_mps2 - noise)
        # Between the mean of both velocities and the fastest change from one to the other.
        offset = state[:, :2] - before[:, :2] - 0.5 * dt[:, None] * (state[:, 2:4] + before[:, 2:4])
        variance = variance[:, :2].sum(axis=1) + 0.25 * dt * dt * variance[:, 2:].sum(axis=1)
        reach = 0.25 * self.braking_mps2 * dt * dt + _SIGMAS * np.sqrt(variance)
        return np.asarray(odd | (np.hypot(offset[:, 0], offset[:, 1]) > reach))

    def _appears(self, batch: Batch, boxes: ClusterBoxes, rows: Ints) -> Bools:
        """(c,) new objects of one agent that others would have seen before."""
        new = (self._of.frames[rows] == 1) & (batch.reported.sum(axis=1) == 1)
        assert self._first_ns is not None
        new &= (batch.time_ns - self._first_ns) * 1e-9 >= _START_S
        result = np.zeros(len(rows), np.bool_)
        index = np.flatnonzero(new)
        seen = surroundings_in_view(boxes.position[index], self.approach_m, self.range_m, batch.views)
        seen &= ~batch.reported[index][..., None]
        result[index] = seen.any(axis=1).sum(axis=1) >= _IN_VIEW
        return result


def _states(batch: Batch, boxes: ClusterBoxes, use: Bools) -> Floats:
    """(c, 8) x y vx vy of boxes, and the mean variances of their members' x y vx vy."""
    variance = np.maximum(batch.states.covariance[:, [0, 1, 6, 7], [0, 1, 6, 7]], 0.0)
    used = np.where(use.any(axis=1, keepdims=True), use, batch.reported)
    count = np.maximum(used.sum(axis=1), 1)[:, None]
    mean = np.where(used[..., None], variance[batch.member], 0.0).sum(axis=1) / count
    return np.column_stack([boxes.position[:, :2], boxes.velocity[:, :2], mean])


def overlapping(boxes: ClusterBoxes, witnesses: Ints, age_s: Floats) -> Bools:
    """(c,) boxes that overlap one which more agents report; among equals, one that is older.

    witnesses: (c,) number of agents; age_s: (c,) s
    """
    result = np.zeros(len(age_s), np.bool_)
    reach = ONE_OBJECT * np.maximum(boxes.size[:, 0], boxes.size[:, 1])
    i, j, dx, dy = neighbours(boxes.position, boxes.position, reach)
    distinct = i != j
    i, j, offset = i[distinct], j[distinct], np.column_stack([dx[distinct], dy[distinct]])
    same = overlap(offset, boxes.size[i], boxes.yaw[i], boxes.size[j], boxes.yaw[j], ONE_OBJECT)
    i, j = i[same], j[same]
    first = (witnesses[i] > witnesses[j]) | (
        (witnesses[i] == witnesses[j]) & ((age_s[i] > age_s[j]) | ((age_s[i] == age_s[j]) & (i < j)))
    )
    result[np.where(first, j, i)] = True
    return result


def surroundings_in_view(position: Floats, radius_m: float, range_m: float, views: Sequence[SweptView | None]) -> Bools:
    """(c, a, _AROUND) whether an agent sees the places around positions (c, 3), up to `range_m`."""
    c = len(position)
    seen = np.zeros((c, len(views), _AROUND), np.bool_)
    if c == 0:
        return seen
    angle = np.arange(_AROUND) * (2.0 * np.pi / _AROUND)
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_AROUND)]) * radius_m
    points = (position[:, None, :] + around).reshape(-1, 3)
    for column, view in enumerate(views):
        if view is None:
            continue
        distance, free, inside = view.ranges(points)
        with np.errstate(invalid="ignore"):
            clear = (inside & ~(free < distance)).reshape(c, _AROUND)
        away = np.hypot(*(position[:, :2] - view.view.position[:2]).T)
        seen[:, column] = clear & ((away > TOLERANCES.own_m) & (away <= range_m))[:, None]
    return seen
