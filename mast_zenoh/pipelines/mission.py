"""Mission estimates: an agent's own tracks and the picture, as one."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Ints, ObjectStates, concatenate
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.pipelines.mission_ids import NONE, MissionIds
from mast_zenoh.tracking.covariance_repair import make_positive_definite

#: m^2, least variance of a horizontal position, both axes together, that a message can claim: 0.1 m per axis, as in
#: `fusion.CheckedCovariances`.
LEAST_VARIANCE = 0.02


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
        return self._pairs.with_ids(time_ns, own, _average_pairs(own, picture, i, j), i, j, alone)


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


def _average_pairs(own: ObjectStates, picture: ObjectStates, i: Ints, j: Ints) -> ObjectStates:
    """The picture's objects; where object j is paired with own track i, the weighted average of both.

    Class and score are those of the picture, the heading that of the more certain one.
    """
    own_covariance = make_positive_definite(own.covariance[i])
    picture_covariance = make_positive_definite(picture.covariance[j])
    variances = [
        np.maximum(covariance[:, 0, 0] + covariance[:, 1, 1], LEAST_VARIANCE)
        for covariance in (own_covariance, picture_covariance)
    ]
    weight = variances[1] / (variances[0] + variances[1])  # of the own track
    covariance, yaw = picture.covariance.copy(), picture.yaw.copy()
    covariance[j] = picture_covariance + weight[:, None, None] * (own_covariance - picture_covariance)
    nearer = (weight > 0.5).nonzero()[0]
    yaw[j[nearer]] = own.yaw[i[nearer]]
    columns = {"covariance": covariance, "yaw": yaw}
    for name in ("position", "velocity", "size"):
        column = columns[name] = getattr(picture, name).copy()
        of_picture = column[j]
        column[j] = of_picture + weight[:, None] * (getattr(own, name)[i] - of_picture)
    return picture.with_(**columns)


def _by_id(states: ObjectStates) -> ObjectStates:
    """The rows in the order of their ids, so that no choice among equals depends on their order."""
    return states if (states.id[1:] > states.id[:-1]).all() else states.select(np.argsort(states.id))
