"""The members of clusters, in an order that does not depend on how they came in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.geometry import wrap_angle
from mast_zenoh.states import CLASSES, Floats, Ints, ObjectStates
from mast_zenoh.tracking.soundness import sound
from mast_zenoh.tracking.tracks import known_class


@dataclass(frozen=True, slots=True)
class Members:
    """n members of c clusters, the members of a cluster next to each other.

    states: n rows; their covariances are positive definite
    weight: (n,) > 0, sums to 1 over a cluster
    start:  (c,) row of each cluster's first member
    cluster: (n,) 0 to c-1
    label:  (c,) int64, what the cluster was called
    """

    states: ObjectStates
    weight: Floats
    start: Ints
    cluster: Ints
    label: Ints

    @classmethod
    def of(cls, states: ObjectStates, labels: Ints, weights: Floats | None) -> Members:
        """The members of positive weight of the clusters `labels` (n,); without weights all members alike."""
        order = np.lexsort((states.id, *states.velocity.T, *states.position.T, labels))
        if weights is not None:
            order = order[weights[order] > 0.0]
        states, labels = states.select(order), labels[order]
        first = np.ones(len(labels), bool)
        first[1:] = labels[1:] != labels[:-1]
        start = np.flatnonzero(first)
        cluster = np.cumsum(first) - 1
        weight = np.ones(len(labels)) if weights is None else weights[order]
        members = cls(states.with_(covariance=sound(states.covariance)), weight, start, cluster, labels[start])
        return members.weighted(weight)

    def weighted(self, weight: Floats) -> Members:
        """The same with other weights (n,), brought to a sum of 1 in each cluster."""
        return Members(self.states, weight / self.sum(weight)[self.cluster], self.start, self.cluster, self.label)

    def sum(self, values: Floats) -> Floats:
        """(c, ...) sums of (n, ...) values over the members of each cluster."""
        return np.asarray(np.add.reduceat(values, self.start)) if len(self.start) else values

    def fused(self, mean: Floats, covariance: Floats) -> ObjectStates:
        """One row per cluster at `mean` (c, 9) with `covariance` (c, 9, 9).

        Heading: weighted mean of the members' axes, in the sense of the greater weight. Class: by weight of votes.
        Existence: that of the surest member, as members may share the evidence.
        """
        s = self.states
        # Angles doubled, opposite headings fall together.
        axis = 0.5 * np.arctan2(self.sum(self.weight * np.sin(2 * s.yaw)), self.sum(self.weight * np.cos(2 * s.yaw)))
        sense = self.sum(self.weight * np.sign(np.cos(s.yaw - axis[self.cluster])))
        votes = np.zeros((len(self.start), len(CLASSES)))
        np.add.at(votes, (self.cluster, known_class(s.class_id)), self.weight)
        return ObjectStates(
            id=self.label,
            position=mean[:, 0:3],
            velocity=mean[:, 6:9],
            size=mean[:, 3:6],
            yaw=wrap_angle(np.where(sense < 0.0, axis + np.pi, axis)),
            covariance=covariance,
            score=np.maximum.reduceat(s.score, self.start),
            class_id=votes.argmax(axis=1).astype(np.uint8),
        )


def state_vectors(states: ObjectStates) -> Floats:
    """(n, 9) [x y z l w h vx vy vz]."""
    return np.concatenate([states.position, states.size, states.velocity], axis=1)
