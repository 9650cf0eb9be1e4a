"""Mission estimates: an agent's own tracks and the picture as one, with ids that stay with an object.

Both sources have ids that last (`fusion.group_tracking` sees to that in the picture). `MissionIds` decides which id of
one source is the object of which id of the other.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, neighbours, uncontested
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.base import state_vectors
from mast_zenoh.fusion.group_tracking import ReturningObjects
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import seen_through
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.classes import ACCELERATION
from mast_zenoh.tracking.kalman import make_positive_definite

#: ns after which an id that neither source has is forgotten: as long as the trackers remember (their `max_coast_s`).
FORGOTTEN_NS = 3_000_000_000
#: ns for which an object that both sources have lost may continue under a new id of theirs: constant velocity predicts
#: a car to within about a metre (`tracking.classes`).
RESUMED_NS = 1_000_000_000
#: s for which a lost object is remembered where it can be found by its motion: as in the picture (`group_tracking`).
RETURNING_S = 4.0
#: Largest number of lost objects that are remembered.
MAX_LOST = 1000

#: In place of an id: the object is not in this source.
NONE = -1


@dataclass(frozen=True, slots=True)
class _Estimate:
    """The n objects of one estimate: arguments and result of `MissionIds.assign`."""

    time_ns: int
    own: list[int]
    picture: list[int]
    position: Floats
    velocity: Floats
    ids: list[int]


class MissionIds:
    """Gives the objects of an estimate ids, from those that they have as own tracks and in the picture.

    An object keeps its id when the picture loses it or takes it over. Where the two sources have had different ids for
    what now is one object, it keeps that of the picture, which loses fewer objects than one agent alone, unless the
    picture's object should be elsewhere. Where they have had the same id for what now are two objects, it stays with
    the one nearer to where the object should be.

    radius: m, how far from there an object may be that continues with an id although its sources have new ones
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self._own = _IdMap()
        self._picture = _IdMap()
        self._lost: dict[int, tuple[int, Floats, Floats]] = {}  # by id: time, ns, position and velocity
        self._newest = _Estimate(0, [], [], np.zeros((0, 2)), np.zeros((0, 2)), [])
        self._settled = False  # the same objects would have the same ids again
        self._next = 0

    def same(self, own: Ints, picture: Ints) -> Bools:
        """Whether each of p own tracks last had the same id in the estimate as an object of the picture: (p,)."""
        of_own, of_picture = self._own.ids, self._picture.ids
        pairs = zip(own.tolist(), picture.tolist(), strict=True)
        return np.array([one in of_own and of_own[one] == of_picture.get(other) for one, other in pairs], bool)

    def assign(self, time_ns: int, own: Ints, picture: Ints, position: Floats, velocity: Floats) -> Ints:
        """Ids (n,) of n objects at a time. Independent of their order.

        own, picture: (n,) id of each as an own track, and in the picture; NONE: it is not in that source
        position, velocity: (n, 2) m and m/s, world frame
        """
        own_ids, picture_ids, before = own.tolist(), picture.tolist(), self._newest
        unchanged = own_ids == before.own and picture_ids == before.picture
        unclear: list[int] = []
        if unchanged and self._settled:
            ids = before.ids
        else:
            ids, unclear = self._known(own_ids, picture_ids)
            if unclear:
                self._decide(time_ns, own_ids, picture_ids, position, ids, unclear)
            self._settled = not unclear
        self._newest = _Estimate(time_ns, own_ids, picture_ids, position, velocity, ids)
        if unclear or not unchanged:
            self._note_lost(before)
            self._own.note_gone(before.time_ns, before.own, own_ids)
            self._picture.note_gone(before.time_ns, before.picture, picture_ids)
            self._forget(time_ns - FORGOTTEN_NS)
        return np.array(ids, np.int64)

    def _known(self, own: list[int], picture: list[int]) -> tuple[list[int], list[int]]:
        """The ids that the objects had, and the rows that are unclear: new ones, and those with different ids."""
        of_own, of_picture = self._own.ids, self._picture.ids
        ids, unclear = [], set[int]()
        for row, (own_id, picture_id) in enumerate(zip(own, picture, strict=True)):
            known = of_picture.get(picture_id, NONE)
            id_ = known if own_id == NONE else of_own.get(own_id, NONE)
            if id_ == NONE or (picture_id != NONE and known != id_):
                unclear.add(row)
            ids.append(id_)
        if len(set(ids)) < len(ids):
            count = Counter(ids)
            unclear |= {row for row, id_ in enumerate(ids) if count[id_] > 1}
        return ids, sorted(unclear)

    def _decide(
        self, time_ns: int, own: list[int], picture: list[int], position: Floats, ids: list[int], unclear: list[int]
    ) -> None:
        """Set the ids of the unclear rows, first of the objects that are where their id should be."""
        places = self._predicted(time_ns)
        choices = {row: self._choices(own[row], picture[row], position[row], places) for row in unclear}
        away = {row: _distance(places.get(c[0]) if c else None, position[row]) for row, c in choices.items()}
        order = sorted(unclear, key=lambda row: (away[row], own[row], picture[row]))
        taken = {id_ for row, id_ in enumerate(ids) if row not in choices}
        for row in order:
            ids[row] = next((id_ for id_ in choices[row] if id_ not in taken), NONE)
            taken.add(ids[row])
        new = [row for row in order if ids[row] == NONE]
        self._resume(position, ids, new, taken.union(*choices.values()), places)
        for row in unclear:
            if own[row] != NONE:
                self._own.ids[own[row]] = ids[row]
            if picture[row] != NONE:
                self._picture.ids[picture[row]] = ids[row]

    def _choices(
        self, own_id: int, picture_id: int, position: Floats, places: dict[int, tuple[float, float, int]]
    ) -> list[int]:
        """The ids that an object at `position` (2,) had, the one that it should keep first."""
        ids = self._picture.ids.get(picture_id), self._own.ids.get(own_id)
        known = [id_ for id_ in ids if id_ is not None]
        return sorted(known, key=lambda id_: _distance(places.get(id_), position) > self.radius)

    def _predicted(self, time_ns: int) -> dict[int, tuple[float, float, int]]:
        """Where the objects with ids should be now, m, and since when they are unseen, ns."""
        newest = self._newest
        elapsed_s = (time_ns - newest.time_ns) * 1e-9
        moved = (newest.position + newest.velocity * elapsed_s).tolist()
        places = {id_: (x, y, time_ns - newest.time_ns) for id_, (x, y) in zip(newest.ids, moved, strict=True)}
        for id_, (last_ns, position, velocity) in self._lost.items():
            x, y = (position + velocity * ((time_ns - last_ns) * 1e-9)).tolist()
            places[id_] = x, y, time_ns - last_ns
        return places

    def _resume(
        self,
        position: Floats,
        ids: list[int],
        new: list[int],
        others: set[int],
        places: dict[int, tuple[float, float, int]],
    ) -> None:
        """Give new objects the ids of lost ones that should be there, the nearest first, and the others new ids."""
        lost = sorted(id_ for id_, place in places.items() if id_ not in others and place[2] <= RESUMED_NS)
        if new and lost:
            there = np.array([places[id_][:2] for id_ in lost])
            i, j, dx, dy = neighbours(position[new], there, np.full(len(new), self.radius))
            chosen = greedy_matching(i, j, np.hypot(dx, dy))
            for row, which in zip(i[chosen].tolist(), j[chosen].tolist(), strict=True):
                ids[new[row]] = lost[which]
        for row in new:
            if ids[row] == NONE:
                ids[row], self._next = self._next, self._next + 1

    def _note_lost(self, before: _Estimate) -> None:
        """Remember where the objects were that the newest estimate no longer has."""
        present = set(self._newest.ids)
        for row, id_ in enumerate(before.ids):
            if id_ not in present and len(self._lost) < MAX_LOST:
                self._lost[id_] = before.time_ns, before.position[row], before.velocity[row]
        for id_ in present & self._lost.keys():
            del self._lost[id_]

    def _forget(self, limit_ns: int) -> None:
        """Forget what has been gone since before a time."""
        self._own.forget(limit_ns)
        self._picture.forget(limit_ns)
        for id_ in [id_ for id_, (last_ns, _, _) in self._lost.items() if last_ns < limit_ns]:
            del self._lost[id_]


class _IdMap:
    """The ids in the estimate, by the ids of one source."""

    def __init__(self) -> None:
        self.ids: dict[int, int] = {}
        self._gone: dict[int, int] = {}  # since when, ns

    def note_gone(self, time_ns: int, before: list[int], now: list[int]) -> None:
        """Remember which ids of the source are gone since a time, and which are back."""
        present = set(now)
        self._gone |= dict.fromkeys(set(before) - present - {NONE}, time_ns)
        for source_id in present & self._gone.keys():
            del self._gone[source_id]

    def forget(self, limit_ns: int) -> None:
        """Forget the ids of the source that have been gone since before a time."""
        for source_id in [source_id for source_id, since_ns in self._gone.items() if since_ns < limit_ns]:
            del self._gone[source_id], self.ids[source_id]


def _distance(place: tuple[float, float, int] | None, position: Floats) -> float:
    """m, from a place to a position (2,)."""
    return math.inf if place is None else math.hypot(place[0] - position[0], place[1] - position[1])


#: m^2, least variance of a horizontal position, both axes together, that a message can claim: 0.1 m per axis, as in
#: `fusion.CheckedCovariances`.
LEAST_VARIANCE = 0.02
#: How much of an own track counts by its disagreement with the picture: this times their squared distance, relative to
#: the variance that both claim. Then a picture from badly surveyed sensors makes the estimate hardly worse.
DISAGREEMENT = 0.5
WEIGHTING = LEAST_VARIANCE, DISAGREEMENT
#: Estimates whose own tracks are remembered: a picture's age in frames, at most.
MAX_EARLIER = 16
#: Where a flat covariance has the terms of a horizontal position's variance after some time: those of its x, then of y.
_GROWING = np.array([0, 6, 60, 10, 16, 70])
_ACCELERATED = (2.0 / 3.0) * ACCELERATION


class MissionEstimator(ABC):
    """Makes the mission-critical estimate from own tracks and the newest picture."""

    def look(self, view: SweptView) -> None:  # noqa: B027 (a hook: most estimators need no view)
        """Set what the agent's own sensor covers, for the next estimate.

        Called only where agents get the sweeps of their sensors (keyexpr_maps/views.toml).
        """

    def date_picture(self, time_ns: int) -> None:  # noqa: B027 (a hook: most estimators need no age)
        """Set the time for which the picture of the next estimate was made; otherwise that of the last estimate."""

    @abstractmethod
    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """Objects at the time of both inputs, world frame.

        Ids are unique, and stay with an object while it is in either input.
        """


class OwnAndPicture(MissionEstimator):
    """Pairs own tracks with the picture's objects, and averages each pair.

    radius: m, in the bird's-eye view, how far apart the two of a pair may be

    The weights are inverse to the variances of the horizontal positions: where the agent sees an object well itself,
    its own track has most of the weight, and errors of other agents' poses do little harm. But the picture already
    contains what this agent saw until the picture was made. So what it has seen since counts fully, and what it saw
    before only as far as the two disagree: `_OwnNews`.

    The covariance is an average of both, with the weights of the positions. It bounds that of the average whatever the
    correlation, because covariances are convex.
    """

    def __init__(self, *, radius: float = 2.0) -> None:
        self._pairs = _Pairs(radius)
        self._news = _OwnNews()

    def date_picture(self, time_ns: int) -> None:
        self._news.since_ns = time_ns

    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        own, picture = _by_id(own), _by_id(picture)
        i, j, _ = self._pairs.find(own, picture)
        alone = np.ones(len(own), bool)
        alone[i] = False
        means = state_vectors(own)
        share, change = self._news.update(time_ns, own, means, i)
        objects = _average_pairs(own, picture, means.take(i, 0), i, j, share, change)
        return self._pairs.with_ids(time_ns, own, objects, i, j, alone)


class PictureFirst(MissionEstimator):
    """Takes the picture, and own tracks only where it has no object nearby.

    radius: m, in the bird's-eye view, within which one of the agent's own tracks is left out
    """

    def __init__(self, *, radius: float = 2.0) -> None:
        self._pairs = _Pairs(radius)

    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        own, picture = _by_id(own), _by_id(picture)
        i, j, near = self._pairs.find(own, picture)
        return self._pairs.with_ids(time_ns, own, picture, i, j, ~near)


class _Pairs:
    """Pairs of an own track and an object of the picture, and the ids of what they become.

    Pairs stay together while they are within `radius` m; others are made nearest first.
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self._ids = MissionIds(radius)
        self._returning = ReturningObjects(RETURNING_S)

    def find(self, own: ObjectStates, picture: ObjectStates) -> tuple[Ints, Ints, Bools]:
        """Rows of own tracks (p,), rows of the picture (p,), and which own tracks (n,) have an object nearby."""
        i, j, dx, dy = neighbours(own.position, picture.position, np.full(len(own), self.radius))
        near = np.zeros(len(own), bool)
        near[i] = True
        if uncontested(i, j).all():
            return i, j, near
        together = self._ids.same(own.id[i], picture.id[j])
        chosen = greedy_matching(i, j, np.hypot(dx, dy) - self.radius * together)
        return i[chosen], j[chosen], near

    def with_ids(
        self, time_ns: int, own: ObjectStates, picture: ObjectStates, i: Ints, j: Ints, alone: Bools
    ) -> ObjectStates:
        """The objects of the picture, and the own tracks that are `alone` (n,), with their ids in the estimate.

        i, j: (p,) rows of own tracks and of the picture that are pairs
        """
        remaining = own.select(alone)
        objects = concatenate([picture, remaining])
        own_ids = np.concatenate([np.full(len(picture), NONE), remaining.id])
        own_ids[j] = own.id[i]
        picture_ids = np.concatenate([picture.id, np.full(len(remaining), NONE)])
        ids = self._ids.assign(time_ns, own_ids, picture_ids, objects.position[:, :2], objects.velocity[:, :2])
        order = ids.argsort()
        ids[order] = self._returning.ids_for(time_ns, objects.with_(id=ids).select(order))
        return objects.with_(id=ids)


class _OwnNews:
    """What an agent has seen since the picture was made.

    since_ns: time of the picture; None: that of the last estimate
    """

    def __init__(self) -> None:
        self.since_ns: int | None = None
        self._earlier: deque[tuple[int, ObjectStates, Floats]] = deque(maxlen=MAX_EARLIER)  # tracks and their means

    def update(self, time_ns: int, own: ObjectStates, means: Floats, rows: Ints) -> tuple[Floats, Floats]:
        """What is new of own tracks `rows` (p,): which share (p,), and the change (p, 9) of their means by it.

        The share is that of the certainty of their positions which they have gained; 1 for tracks that are new, whose
        change is 0: all of them is. means: (n, 9) of all own tracks, see `_means`
        """
        while self._earlier and self._earlier[-1][0] == time_ns:  # made again
            self._earlier.pop()
        since_ns = time_ns if self.since_ns is None else self.since_ns
        then = next((each for each in reversed(self._earlier) if each[0] <= since_ns), None)
        self._earlier.append((time_ns, own, means))
        self.since_ns = None
        share, change = np.ones(len(rows)), np.zeros((len(rows), 9))
        if then is None or not len(then[1]) or not len(rows):
            return share, change
        then_ns, before, means_before = then
        ids = own.id.take(rows)
        place = before.id.searchsorted(ids)
        known = (before.id.take(place, mode="clip") == ids).nonzero()[0]
        dt, place, rows = (time_ns - then_ns) * 1e-9, place.take(known), rows.take(known)
        variance = np.maximum(_grown_variance(before, place, dt), LEAST_VARIANCE)
        now = _variance(own.covariance).take(rows)
        share[known] = np.minimum(np.maximum(1.0 - now / variance, 0.0), 1.0)
        expected = means_before.take(place, 0)
        expected[:, :3] += dt * expected[:, 6:]
        change[known] = means.take(rows, 0) - expected
        return share, change


def _grown_variance(states: ObjectStates, rows: Ints, dt: float) -> Floats:
    """(k,) m^2, variances of the horizontal positions of rows (k,) after `dt` s, as in `tracking.kalman`."""
    P = states.covariance.reshape(-1, 81).take(rows, 0).take(_GROWING, 1)
    coefficients = np.empty((len(rows), 4))  # of the powers of dt
    coefficients[:, :3] = P[:, :3] + P[:, 3:]
    coefficients[:, 3] = _ACCELERATED.take(states.class_id.take(rows))
    return np.asarray(coefficients @ np.array([1.0, 2.0 * dt, dt * dt, dt**3]))


def _average_pairs(
    own: ObjectStates, picture: ObjectStates, own_mean: Floats, i: Ints, j: Ints, share: Floats, change: Floats
) -> ObjectStates:
    """The picture's objects; where object j is paired with own track i, the weighted average of both.

    own_mean: (p, 9) of the own tracks i;  share, change: (p,) and (p, 9) of them, see `_OwnNews`

    Class and score are those of the picture, the heading that of the more certain one.
    """
    if len(i) == 0:
        return picture
    own_covariance = make_positive_definite(own.covariance.take(i, 0))
    claimed = make_positive_definite(picture.covariance.take(j, 0))
    pairs = own_mean, own_covariance, claimed, own.yaw.take(i), share, change
    position, size, velocity, yaw, covariance = averaged(
        state_vectors(picture), picture.yaw, picture.covariance, j, pairs, WEIGHTING
    )
    return picture.with_(position=position, size=size, velocity=velocity, yaw=yaw, covariance=covariance)


@kernel
def averaged(
    mean: Floats,
    yaw: Floats,
    covariance: Floats,
    j: Ints,
    pairs: tuple[Floats, ...],
    weighting: tuple[float, float],
) -> tuple[Floats, ...]:
    """The n objects of a picture after averaging p of them with own tracks, as in `_average_pairs`.

    Returns position, size and velocity (n, 3), yaw (n,) and covariance (n, 9, 9).

    mean (n, 9), yaw, covariance: of the picture, whose objects j (p,) are paired
    pairs: means (p, 9) and covariances (p, 9, 9) of the own tracks, claimed covariances (p, 9, 9) of the objects, yaws
        (p,) of the own tracks, share and change; weighting: WEIGHTING
    """
    own_mean, own_covariance, claimed, own_yaw, share, change = pairs
    least, disagreement = weighting
    own_variance = np.maximum(_variance(own_covariance), least)
    picture_variance = np.maximum(_variance(claimed), least)
    paired = mean.take(j, 0)
    difference = own_mean - paired
    apart = difference[:, 0] * difference[:, 0] + difference[:, 1] * difference[:, 1]
    share = np.maximum(share, np.minimum(disagreement * apart / (own_variance + picture_variance), 1.0))
    gain = picture_variance / (share * picture_variance + own_variance)
    weight = gain * share  # of the own track
    mean, yaw, covariance = mean.copy(), yaw.copy(), covariance.copy()
    mean[j] = paired + weight[:, None] * difference + (gain - weight)[:, None] * change
    covariance[j] = claimed + weight[:, None, None] * (own_covariance - claimed)
    nearer = (own_variance < picture_variance).nonzero()[0]
    yaw[j.take(nearer)] = own_yaw.take(nearer)
    position, size, velocity = (mean[:, part : part + 3].copy() for part in (0, 3, 6))
    return position, size, velocity, yaw, covariance


def _variance(covariance: Floats) -> Floats:
    """(n,) m^2, variance of the horizontal position, both axes together."""
    return np.asarray(covariance[:, 0, 0] + covariance[:, 1, 1])


def _by_id(states: ObjectStates) -> ObjectStates:
    """The rows in the order of their ids, so that no choice among equals depends on their order."""
    return states if (states.id[1:] > states.id[:-1]).all() else states.select(np.argsort(states.id))


class FreeSpaceVeto(MissionEstimator):
    """Leaves out objects of the picture whose place the agent's own sensor sees through.

    mission: makes the estimate of own tracks and the objects that are left

    The idea of CAD (Zhang et al., USENIX Security 2024), applied by the receiver, which trusts its own sensor.
    Own tracks are never left out. Agents must have a sweep in each frame (keyexpr_maps/views.toml); without one,
    nothing is left out.

    Weaknesses: objects stay that the sensor does not see the place of, that are displaced by less than about a metre,
    or that are more than 70 m away.
    """

    def __init__(self, *, mission: MissionEstimator) -> None:
        self.mission = mission
        self._view: SweptView | None = None

    def look(self, view: SweptView) -> None:
        self._view = view
        self.mission.look(view)

    def date_picture(self, time_ns: int) -> None:
        self.mission.date_picture(time_ns)

    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        boxes = ClusterBoxes(picture.position, picture.velocity, picture.size, picture.yaw)
        through = seen_through(boxes, (self._view,))
        self._view = None
        return self.mission.estimate(time_ns, own, picture.select(~through[:, 0]))
