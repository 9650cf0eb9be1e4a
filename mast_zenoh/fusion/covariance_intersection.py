"""Fusion of members whose errors have an unknown correlation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Fusion
from mast_zenoh.fusion.members import Members, state_vectors
from mast_zenoh.fusion.volume_weights import least_volume_weights
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.inversion import inverse


class CovarianceIntersectionFusion(Fusion):
    """Covariance intersection (Julier, Uhlmann, ACC 1997).

    P^-1 = sum w_i P_i^-1, x = P sum w_i P_i^-1 x_i, sum w_i = 1.

    Consistent, whatever the correlation of the members' errors, for any weights.

    weights: "uniform", or "optimised": the least determinant of the fused covariance of the full state, within 1 %. It
    is the volume of the region of uncertainty, so the optimum does not depend on units; that of a trace, which adds
    metres and metres per second, would. The optimum is the best bound for unknown correlation and drops members that do
    not tighten it; where the agents' errors are in fact nearly independent, uniform weights average more of them and
    err less.
    """

    def __init__(self, *, weights: Literal["uniform", "optimised"] = "uniform") -> None:
        self._optimised = weights == "optimised"

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        if self._optimised:
            best = least_volume_weights(inverse(members.states.covariance), members.start)
            members = members.weighted(members.weight * best)
        vectors = state_vectors(members.states)
        mean, covariance = covariance_intersection(members.states.covariance, vectors, members.weight, members.start)
        return members.fused(mean, covariance)


@kernel
def covariance_intersection(covariance: Floats, state: Floats, weight: Floats, start: Ints) -> tuple[Floats, Floats]:
    """Means (c, 9) and covariances (c, 9, 9) of clusters of n members, see `Members`.

    covariance: (n, 9, 9), positive definite; state: (n, 9)
    """
    n = len(weight)
    terms = np.empty((n, 90))
    information = inverse(covariance)
    information *= weight[:, None, None]
    terms[:, :81] = information.reshape(n, 81)
    terms[:, 81:] = (information @ state[:, :, None])[:, :, 0]
    sums = np.add.reduceat(terms, start)
    fused = inverse(sums[:, :81].reshape(-1, 9, 9))
    fused = 0.5 * (fused + fused.transpose(0, 2, 1))
    return (fused @ sums[:, 81:, None])[:, :, 0], fused


class BestMemberFusion(Fusion):
    """Selects the member with the least horizontal position variance per weight."""

    def __init__(self) -> None:
        pass

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        P = members.states.covariance
        worth = members.weight / (P[:, 0, 0] + P[:, 1, 1])
        best = np.lexsort((-worth, members.cluster))[members.start]
        return members.states.select(best).with_(id=members.label)
