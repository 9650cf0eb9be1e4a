"""Mission estimates: an agent's own tracks and the picture, as one."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Ints, ObjectStates, concatenate
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.pipelines.identities import NONE, Identities


class MissionEstimator(ABC):
    """Makes the mission-critical estimate from own tracks and the newest picture."""

    def look(self, view: SweptView) -> None:  # noqa: B027 (a hook: most estimators need no view)
        """Set what the agent's own sensor covers, for the next estimate.

        Called only where agents get the sweeps of their sensors (keyexpr_maps/views.toml).
        """

    @abstractmethod
    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """Objects at the time of both inputs, world frame.

        Ids are unique, and stay with an object while it is in either input.
        """


class OwnAndPicture(MissionEstimator):
    """Pairs own tracks with the picture's objects, and averages each pair.

    radius: m, in the bird's-eye view, how far apart the two of a pair may be

    The weights are inverse to the variances of the horizontal positions: where the agent sees an object well itself,
    its own track has most of the weight, and errors of other agents' poses do little harm. The picture already contains
    this agent's tracks in an unknown proportion, so the covariance is the average of both with the same weights: it
    bounds that of the average whatever the correlation, because covariances are convex.
    """

    def __init__(self, *, radius: float = 2.0) -> None:
        self._pairs = _Pairs(radius)

    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        own, picture = _by_id(own), _by_id(picture)
        i, j, _ = self._pairs.find(own, picture)
        alone = np.ones(len(own), bool)
        alone[i] = False
        remaining = own.select(alone)
        of_own = np.full(len(picture), NONE)
        of_own[j] = own.id[i]
        return self._pairs.named(
            time_ns,
            concatenate([_averaged(own, picture, i, j), remaining]),
            np.concatenate([of_own, remaining.id]),
            np.concatenate([picture.id, np.full(len(remaining), NONE)]),
        )


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
        remaining = own.select(~near)
        partner = np.full(len(picture), NONE)
        partner[j] = own.id[i]
        return self._pairs.named(
            time_ns,
            concatenate([picture, remaining]),
            np.concatenate([partner, remaining.id]),
            np.concatenate([picture.id, np.full(len(remaining), NONE)]),
        )


class _Pairs:
    """Pairs of an own track and an object of the picture, and the ids of what they become.

    Pairs stay together while they are within `radius` m; others are made nearest first.
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self._identities = Identities(radius)

    def find(self, own: ObjectStates, picture: ObjectStates) -> tuple[Ints, Ints, Bools]:
        """Rows of own tracks (p,), rows of the picture (p,), and which own tracks (n,) have an object nearby."""
        i, j, dx, dy = neighbours(own.position, picture.position, np.full(len(own), self.radius))
        near = np.zeros(len(own), bool)
        near[i] = True
        together = self._identities.same(own.id[i], picture.id[j])
        chosen = greedy_matching(i, j, np.hypot(dx, dy) - self.radius * together)
        return i[chosen], j[chosen], near

    def named(self, time_ns: int, objects: ObjectStates, own: Ints, picture: Ints) -> ObjectStates:
        """The objects with their ids in the estimate; own, picture: (n,) ids in either source, see `Identities`."""
        ids = self._identities.assign(time_ns, own, picture, objects.position[:, :2], objects.velocity[:, :2])
        return objects.with_(id=ids)


def _averaged(own: ObjectStates, picture: ObjectStates, i: Ints, j: Ints) -> ObjectStates:
    """The picture's objects; where object j is paired with own track i, the weighted average of both."""
    one, other = own.covariance[i], picture.covariance[j]
    variance = other[:, 0, 0] + other[:, 1, 1]
    total = variance + one[:, 0, 0] + one[:, 1, 1]
    weight = np.divide(variance, total, out=np.full(len(i), 0.5), where=total > 0.0)  # of the own track
    covariance, yaw = picture.covariance.copy(), picture.yaw.copy()
    covariance[j] = other + weight[:, None, None] * (one - other)
    nearer = (weight > 0.5).nonzero()[0]
    yaw[j[nearer]] = own.yaw[i[nearer]]
    columns = {"covariance": covariance, "yaw": yaw}
    for name in ("position", "velocity", "size"):
        column = columns[name] = getattr(picture, name).copy()
        theirs = column[j]
        column[j] = theirs + weight[:, None] * (getattr(own, name)[i] - theirs)
    return picture.with_(**columns)


def _by_id(states: ObjectStates) -> ObjectStates:
    """The rows in the order of their ids, so that no choice among equals depends on their order."""
    return states if (states.id[1:] > states.id[:-1]).all() else states.select(np.argsort(states.id))
