"""The members of clusters, in an order that does not depend on how they came in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.ordering import row_order
from mast_zenoh.arrays.states import CLASSES, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel
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
        x, y, z = states.position.T
        order = row_order(x, labels, ties=(states.id, *states.velocity.T, z, y))
        if weights is None:
            weight = np.ones(len(order))
        else:
            order = order[weights[order] > 0.0]
            weight = weights[order]
        label = labels.take(order)
        first = np.ones(len(label), bool)
        first[1:] = label[1:] != label[:-1]
        states = states.select(order)
        states = states.with_(covariance=sound(states.covariance))
        return cls(states, weight, first.nonzero()[0], first.cumsum() - 1, label[first]).weighted(weight)

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
    """(c,) headings, classes and scores of clusters out of (n,) those of their members, as `Members.fused` says."""
    n = len(yaw)
    # Angles doubled, opposite headings fall together; beside them, the votes.
    terms = np.zeros((n, 2 + len(CLASSES)))
    double = 2.0 * yaw
    terms[:, 0], terms[:, 1] = np.cos(double), np.sin(double)
    terms[np.arange(n), 2 + known_class(class_id)] = 1.0
    terms *= weight[:, None]
    sums = np.add.reduceat(terms, start)
    axis = 0.5 * np.arctan2(sums[:, 1], sums[:, 0])
    own = np.repeat(axis, np.diff(start, append=n))
    sense = np.add.reduceat(weight * np.copysign(1.0, np.cos(yaw - own)), start)
    heading = wrap_angle(axis + np.pi * (sense < 0.0))
    return heading, sums[:, 2:].argmax(axis=1).astype(np.uint8), np.maximum.reduceat(score, start)


def state_vectors(states: ObjectStates) -> Floats:
    """(n, 9) [x y z l w h vx vy vz]."""
    return np.concatenate([states.position, states.size, states.velocity], axis=1)
