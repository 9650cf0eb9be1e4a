"""Mission estimates: an agent's own tracks and the picture, as one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, uncontested
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.kernels import kernel
from mast_zenoh.pipelines.mission_ids import NONE, MissionIds
from mast_zenoh.tracking.classes import ACCELERATION
from mast_zenoh.tracking.covariance_repair import make_positive_definite

#: m^2, least variance of a horizontal position, both axes together, that a message can claim: 0.1 m per axis, as in
#: `fusion.CheckedCovariances`.
LEAST_VARIANCE = 0.02
#: Of the variance that a picture claims, how much its errors have: covariance intersection bounds them for any
#: correlation of the agents' errors. Measured: 0.2 to 0.4 (docs/tracking.md).
PICTURE_SHARE = 0.3
#: How much of an own track counts by its disagreement with the picture: this times their squared distance, relative to
#: the variance that both claim. Then a picture from badly surveyed sensors makes the estimate hardly worse.
DISAGREEMENT = 3.0
WEIGHTING = LEAST_VARIANCE, PICTURE_SHARE, DISAGREEMENT
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
    before only as far as the two disagree: `_OwnNews`. Of the variance that the picture claims, `PICTURE_SHARE` counts.

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
        means = _means(own)
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
    """(k,) m^2, variances of the horizontal positions of rows (k,) after `dt` s, as in `tracking.prediction`."""
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
        _means(picture), picture.yaw, picture.covariance, j, pairs, WEIGHTING
    )
    return picture.with_(position=position, size=size, velocity=velocity, yaw=yaw, covariance=covariance)


@kernel
def averaged(
    mean: Floats,
    yaw: Floats,
    covariance: Floats,
    j: Ints,
    pairs: tuple[Floats, ...],
    weighting: tuple[float, float, float],
) -> tuple[Floats, ...]:
    """The n objects of a picture after averaging p of them with own tracks, as in `_average_pairs`.

    Returns position, size and velocity (n, 3), yaw (n,) and covariance (n, 9, 9).

    mean (n, 9), yaw, covariance: of the picture, whose objects j (p,) are paired
    pairs: means (p, 9) and covariances (p, 9, 9) of the own tracks, claimed covariances (p, 9, 9) of the objects, yaws
        (p,) of the own tracks, share and change; weighting: WEIGHTING
    """
    own_mean, own_covariance, claimed, own_yaw, share, change = pairs
    least, picture_share, disagreement = weighting
    own_variance = np.maximum(_variance(own_covariance), least)
    picture_variance = np.maximum(_variance(claimed), least)
    paired = mean.take(j, 0)
    difference = own_mean - paired
    apart = difference[:, 0] * difference[:, 0] + difference[:, 1] * difference[:, 1]
    share = np.maximum(share, np.minimum(disagreement * apart / (own_variance + picture_variance), 1.0))
    picture_variance = np.maximum(picture_share * picture_variance, least)
    gain = picture_variance / (share * picture_variance + own_variance)
    weight = gain * share  # of the own track
    mean, yaw, covariance = mean.copy(), yaw.copy(), covariance.copy()
    mean[j] = paired + weight[:, None] * difference + (gain - weight)[:, None] * change
    covariance[j] = claimed + weight[:, None, None] * (own_covariance - claimed)
    nearer = (own_variance < picture_variance).nonzero()[0]
    yaw[j.take(nearer)] = own_yaw.take(nearer)
    position, size, velocity = (mean[:, part : part + 3].copy() for part in (0, 3, 6))
    return position, size, velocity, yaw, covariance


def _means(states: ObjectStates) -> Floats:
    """(n, 9) means, in the order of `states.COVARIANCE_ORDER`."""
    return np.concatenate([states.position, states.size, states.velocity], axis=1)


def _variance(covariance: Floats) -> Floats:
    """(n,) m^2, variance of the horizontal position, both axes together."""
    return np.asarray(covariance[:, 0, 0] + covariance[:, 1, 1])


def _by_id(states: ObjectStates) -> ObjectStates:
    """The rows in the order of their ids, so that no choice among equals depends on their order."""
    return states if (states.id[1:] > states.id[:-1]).all() else states.select(np.argsort(states.id))
