"""Fusion of members whose errors have an unknown correlation, and what ignores it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Fusion, Members, state_vectors
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.covariances import inverse

#: Largest ln of the ratio of a determinant to the least one: 1 %.
TOLERANCE = 0.01
#: The search stops after so many steps; it needed at most 8.
_MAX_STEPS = 30
#: Clusters are searched together with others of up to as many members; larger ones have equal weights.
_SIZES = (8, 64)
#: Each step aims for this share of the mean complementarity, and stops at this share of the way to the boundary.
_CENTERING, _DAMPING = 0.1, 0.9


def least_volume_weights(information: Floats, start: Ints) -> Floats:
    """Weights (n,) that minimise the determinant of the fused covariance of each of c clusters.

    Up to 64 members, the determinant is within 1 % of the least one; the search needed at most 8 steps and stops after
    30. Larger clusters have equal weights.

    information: (n, 9, 9) inverse covariances of the members, those of a cluster adjacent; start: (c,) its first row

    Maximising ln det of sum w_i A_i over the simplex is concave (D-optimal design; Vandenberghe, Boyd, Wu, SIAM Journal
    on Matrix Analysis 19(2), 1998). A primal-dual interior-point method (Boyd, Vandenberghe, Convex Optimization, 2004,
    section 11.7) is applied to all clusters at once. A cluster is left alone once the largest tr(P A_i) is within
    TOLERANCE of the 9 states, which bounds how far ln det is from its optimum (Kiefer, Wolfowitz 1960).
    """
    size = np.diff(start, append=len(information))
    weight = np.repeat(1.0 / size, size)
    smaller = 1
    for largest in _SIZES:
        searched = (size > smaller) & (size <= largest)
        if searched.any():
            rows = np.repeat(searched, size)
            weight[rows] = _search(information[rows], size[searched])
        smaller = largest
    return weight


def _search(information: Floats, size: Ints) -> Floats:
    """Weights (n,) of clusters that have up to m members each; size: (c,)."""
    clusters, most = len(size), int(size.max())
    member: Bools = np.arange(most) < size[:, None]
    A = np.zeros((clusters, most, 9, 9))
    A[member] = information
    flat = A.reshape(clusters, most, 81)
    weight, slack = np.where(member, 1.0 / size[:, None], 0.0), member.astype(np.float64)
    diagonal = np.eye(most)
    for _ in range(_MAX_STEPS):
        fused = inverse((weight[:, None, :] @ flat).reshape(clusters, 9, 9))
        product = fused[:, None] @ A
        slope = np.trace(product, axis1=2, axis2=3)
        unsettled = (np.max(slope, axis=1, where=member, initial=0.0) - 9.0 > TOLERANCE)[:, None]
        if not np.count_nonzero(unsettled):
            break
        curvature = product.reshape(clusters, most, 81) @ product.swapaxes(2, 3).reshape(clusters, most, 81).mT
        w, z = np.where(member, weight, 1.0), np.where(member, slack, 1.0)
        target = (_CENTERING * np.vecdot(weight, slack) / size)[:, None]
        right = np.stack([np.where(member, slope + target / w, 0.0), member], axis=-1)
        a, b = np.moveaxis(np.linalg.solve(curvature + diagonal * (z / w)[:, :, None], right), -1, 0)
        step = np.where(member, a - b * (a.sum(axis=1) / b.sum(axis=1))[:, None], 0.0)
        slack_step = np.where(member, (target - slack * step) / w - slack, 0.0)
        weight = np.where(unsettled, weight + _length(step / w) * step, weight)
        slack = np.where(unsettled, slack + _length(slack_step / z) * slack_step, slack)
        weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(weight[member])


def _length(relative: Floats) -> Floats:
    """(c, 1) the length of steps that keeps all values positive; relative: (c, m) steps, as shares of the values."""
    return np.asarray(np.minimum(1.0, _DAMPING / np.maximum(-relative.min(axis=1, keepdims=True), 1e-30)))


class CovarianceIntersectionFusion(Fusion):
    """Covariance intersection (Julier, Uhlmann, ACC 1997), split where errors are known to be partly independent.

    P^-1 = sum w_i P_i^-1, x = P sum w_i P_i^-1 x_i, sum w_i = 1.

    Consistent, whatever the correlation of the members' errors, for any weights.

    independent_share: share d of each covariance that is independent of the other members' errors. The rest may have
    any correlation (split covariance intersection: Julier, Uhlmann, Handbook of Multisensor Data Fusion, 2001; Li,
    Nashashibi, Yang, IEEE Intelligent Vehicles Symposium, 2013). Each P_i becomes (1 - d) P_i / w_i + d P_i, so w_i
    becomes w_i / (1 - d + d w_i). With 0 it is covariance intersection, with 1 `NaiveKalmanFusion`.

    weights: "uniform", or "optimised": the least determinant of the fused covariance of the full state, within 1 %. It
    is the volume of the region of uncertainty, so the optimum does not depend on units; that of a trace, which adds
    metres and metres per second, would. The optimum is the best bound for unknown correlation and drops members that do
    not tighten it; where the agents' errors are in fact nearly independent, uniform weights average more of them and
    err less.
    """

    def __init__(self, *, weights: Literal["uniform", "optimised"] = "uniform", independent_share: float = 0.0) -> None:
        check("0 to 1", independent_share=independent_share)
        self._optimised = weights == "optimised"
        self._independent_share = independent_share

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        trust = members.relative_weight
        if self._optimised:
            best = least_volume_weights(inverse(members.states.covariance), members.start)
            members = members.weighted(members.weight * best)
        vectors, weight = state_vectors(members.states), split_weights(members.weight, trust, self._independent_share)
        mean, covariance = covariance_intersection(members.states.covariance, vectors, weight, members.start)
        return members.fused(mean, covariance)


def split_weights(weight: Floats, trust: Floats, independent_share: float) -> Floats:
    """Factors (n,) on the information of members, a share of whose covariances is independent.

    weight: (n,) of covariance intersection, trust included; trust: (n,) relative to the most trusted of the cluster.
    It multiplies the factor of a member whose errors are all independent.
    """
    if independent_share == 0.0:
        return weight
    return np.asarray(weight / (1.0 - independent_share + independent_share * np.minimum(weight / trust, 1.0)))


@kernel
def covariance_intersection(covariance: Floats, state: Floats, weight: Floats, start: Ints) -> tuple[Floats, Floats]:
    """Means (c, 9) and covariances (c, 9, 9) of clusters of n members, see `Members`.

    covariance: (n, 9, 9), positive definite; state: (n, 9); weight: (n,), of any sum
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


class NaiveKalmanFusion(Fusion):
    """Adds up the information of the members, as if their errors were independent.

    P^-1 = sum P_i^-1, x = P sum P_i^-1 x_i: the correction of a Kalman filter by each of them (Durrant-Whyte, Stevens,
    Data Fusion in Decentralised Sensing Networks, FUSION 2001). The wrong reference: information that members share is
    counted as often as it arrives, so the result is too certain, the more so the longer rumours circulate.

    Trust in a member multiplies its information, relative to the most trusted member of its cluster.
    """

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        vectors, weight = state_vectors(members.states), members.relative_weight
        mean, covariance = covariance_intersection(members.states.covariance, vectors, weight, members.start)
        return members.fused(mean, covariance)


class BestMemberFusion(Fusion):
    """Selects the member with the least horizontal position variance per weight."""

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        P = members.states.covariance
        worth = members.weight / (P[:, 0, 0] + P[:, 1, 1])
        best = np.lexsort((-worth, members.cluster))[members.start]
        return members.states.select(best).with_(id=members.label)
