"""The stages of a command centre, and the members of clusters in an order that does not depend on their arrival."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES, Floats, Ints, ObjectStates, row_order
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.base import Innovations
from mast_zenoh.tracking.kalman import make_positive_definite
from mast_zenoh.tracking.tracks import known_class


class Clusterer(ABC):
    """Groups the tracks of different agents by object."""

    @abstractmethod
    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        """(n,) int64: the cluster of each track, 0 to c-1.

        states: n tracks in the world frame at one time; agent: (n,) int64, which agent each track came from

        (agent, id) must be unique. A cluster has at most one member of an agent. The order of the rows does not
        matter: clusters are numbered in the order of their least member by (agent, id).
        """


class Fusion(ABC):
    """Fuses the members of each cluster into one state."""

    @abstractmethod
    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        """One row per cluster, in the order of the labels 0 to c-1; ids are the labels.

        states: n tracks, world frame, one time; labels: (n,) int64
        weights: (n,) >= 0, how far each member is trusted; 0 excludes it; a cluster without members is left
        out of the result. None: all equal.
        """


class GroupTracker(ABC):
    """Turns clusters of tracks into the picture: objects with persistent ids."""

    @property
    def innovations(self) -> Innovations | None:
        """How far clusters were from what was expected, see `Tracker`; None: it does not tell."""
        return None

    def name_agents(self, agents: tuple[str, ...]) -> None:  # noqa: B027 (a hook: most need no names)
        """Set the names of the agents of the next steps; `agent` has their rows.

        A group tracker that remembers tracks needs them, since the rows change when agents come and go. If it is never
        called, the rows are taken for names.
        """

    @abstractmethod
    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        """The picture and the support of its objects at `time_ns`.

        The picture is sorted by id; support (n,) is the number of agents with a track in each object's cluster.
        """

    @property
    def clusters(self) -> Ints:
        """(n,) int64: the cluster behind each object of the last picture; -1: none.

        Integrity stages need it to withhold objects from the picture. Raises NotImplementedError by default.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define `clusters`, which integrity stages need")

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""


@dataclass(frozen=True, slots=True)
class Members:
    """n members of c clusters; members of the same cluster are adjacent.

    states: n rows; their covariances are positive definite
    weight: (n,) > 0, sums to 1 over a cluster
    start:  (c,) row of each cluster's first member
    cluster: (n,) 0 to c-1
    label:  (c,) int64, labels of the clusters in the input
    """

    states: ObjectStates
    weight: Floats
    start: Ints
    cluster: Ints
    label: Ints

    @classmethod
    def of(cls, states: ObjectStates, labels: Ints, weights: Floats | None) -> Members:
        """The members of clusters `labels` (n,) with positive weight; default weight 1."""
        order = row_order(
            states.position[:, 0], labels, ties=lambda: (states.id, *states.velocity.T, *states.position.T[:0:-1])
        )
        if weights is None:
            weight = np.ones(len(order))
        else:
            order = order[weights[order] > 0.0]
            weight = weights[order]
        label = labels.take(order)
        first = np.ones(len(label), bool)
        first[1:] = label[1:] != label[:-1]
        states = states.select(order)
        states = states.with_(covariance=make_positive_definite(states.covariance))
        return cls(states, weight, first.nonzero()[0], first.cumsum() - 1, label[first]).weighted(weight)

    def weighted(self, weight: Floats) -> Members:
        """The same members with other weights (n,), normalised in each cluster."""
        return Members(self.states, weight / self.sum(weight)[self.cluster], self.start, self.cluster, self.label)

    @property
    def relative_weight(self) -> Floats:
        """(n,) weights relative to the greatest in their clusters, in (0, 1]."""
        greatest = np.maximum.reduceat(self.weight, self.start) if len(self.start) else self.weight
        return np.asarray(self.weight / greatest[self.cluster])

    def sum(self, values: Floats) -> Floats:
        """(c, ...) sums of (n, ...) values over the members of each cluster."""
        return np.asarray(np.add.reduceat(values, self.start)) if len(self.start) else values

    def fused(self, mean: Floats, covariance: Floats) -> ObjectStates:
        """One row per cluster at `mean` (c, 9) with `covariance` (c, 9, 9).

        Heading: weighted mean of the members' axes, in the direction of the greater weight. Class: weighted majority.
        Existence: the maximum over the members, as they may share the evidence.
        """
        s = self.states
        yaw, class_id, score = fused_attributes(s.yaw, s.class_id, s.score, self.weight, self.start)
        return ObjectStates(
            id=self.label,
            position=mean[:, 0:3],
            velocity=mean[:, 6:9],
            size=mean[:, 3:6],
            yaw=yaw,
            covariance=covariance,
            score=score,
            class_id=class_id,
        )


@kernel
def fused_attributes(
    yaw: Floats, class_id: NDArray[np.uint8], score: Floats, weight: Floats, start: Ints
) -> tuple[Floats, NDArray[np.uint8], Floats]:
    """Headings, classes and scores (c,) of clusters from those (n,) of their members.

    See `Members.fused`.
    """
    n = len(yaw)
    # Doubling the angles makes opposite headings equal; the other columns are class votes.
    terms = np.zeros((n, 2 + len(CLASSES)))
    double = 2.0 * yaw
    terms[:, 0], terms[:, 1] = np.cos(double), np.sin(double)
    terms[np.arange(n), 2 + known_class(class_id)] = 1.0
    terms *= weight[:, None]
    sums = np.add.reduceat(terms, start)
    axis = 0.5 * np.arctan2(sums[:, 1], sums[:, 0])
    cluster_axis = np.repeat(axis, np.diff(start, append=n))
    direction = np.add.reduceat(weight * np.copysign(1.0, np.cos(yaw - cluster_axis)), start)
    heading = wrap_angle(axis + np.pi * (direction < 0.0))
    return heading, sums[:, 2:].argmax(axis=1).astype(np.uint8), np.maximum.reduceat(score, start)


def trusted_rows(agent: Ints, labels: Ints, weights: Floats | None) -> Ints:
    """Rows (k,) of the tracks with positive weight, by cluster, then agent: sums then do not depend on their order.

    agent, labels: (n,) of each track, at most one of an agent in a cluster; weights: (n,); None: all positive
    """
    rows = np.lexsort((agent, labels))
    return rows if weights is None else rows[weights[rows] > 0.0]


def state_vectors(states: ObjectStates) -> Floats:
    """State vectors (n, 9) [x y z l w h vx vy vz]."""
    return np.concatenate([states.position, states.size, states.velocity], axis=1)
