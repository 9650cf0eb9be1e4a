"""Fusion of members whose errors have an unknown correlation, and what ignores it.

Fusion of members that share unknown information: inverse covariance intersection.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Fusion, Members, state_vectors
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import inverse, make_positive_definite

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


#: Halvings of the interval in which the best weight is: it is exact to 1e-6.
_HALVINGS = 20
#: Least trust in a member, relative to the greatest in its cluster.
_LEAST_TRUST = 1e-6
#: Limits on the ratios of the variances of two members.
_RATIOS = 1e-12, 1e12


class InverseCovarianceIntersectionFusion(Fusion):
    """Inverse covariance intersection (Noack, Sijs, Reinhardt, Hanebeck, Automatica 79, 2017).

    P^-1 = P_A^-1 + P_B^-1 - G^-1 with G = w P_A + (1 - w) P_B, x = K x_A + L x_B,
    K = P (P_A^-1 - w G^-1), L = P (P_B^-1 - (1 - w) G^-1).

    Consistent, for any w, if each of two estimates is independent information and a part that both share, whatever it
    is: such as a common prior, or a track that has come back to its sender. It is never less certain than covariance
    intersection with the weights 1 - w and w. More than two members are fused one after another, in their canonical
    order (`Members`), as the literature does.

    Where it fails: correlation that is no shared information, such as errors of a common map or clock. The variance in
    some direction can then be twice what it claims (`tests/fusion/test_shared_information.py`). Nor does the promise
    cover the process noise that tracks of one object have in common, or more than two members; with both it was
    consistent in all that was tried (docs/explanation-tracking-and-fusion.md).

    weights: w is 1/k for the k-th member ("uniform": equally certain members count equally), or that of the least
    determinant of each P within 1 % ("optimised"). Trust in a member multiplies its information, relative to the most
    trusted member of its cluster.
    """

    def __init__(self, *, weights: Literal["uniform", "optimised"] = "uniform") -> None:
        self._optimised = weights == "optimised"

    def fuse(self, states: ObjectStates, labels: Ints, weights: Floats | None = None) -> ObjectStates:
        members = Members.of(states, labels, weights)
        if len(members.start) == 0:
            return ObjectStates.empty()
        covariance = members.states.covariance
        if weights is not None:
            trust = np.maximum(members.relative_weight, _LEAST_TRUST)
            covariance = make_positive_definite(covariance / trust[:, None, None])
        mean, fused = inverse_covariance_intersection(
            covariance, state_vectors(members.states), members.start, self._optimised
        )
        return members.fused(mean, fused)


def inverse_covariance_intersection(
    covariance: Floats, state: Floats, start: Ints, optimised: bool
) -> tuple[Floats, Floats]:
    """Means (c, 9) and covariances (c, 9, 9) of clusters of n members, each fused with the next.

    covariance: (n, 9, 9), positive definite; state: (n, 9); start: (c,) see `Members`
    optimised: whether the weights have the least determinant, or are uniform
    """
    size = np.diff(start, append=len(state))
    mean, fused = state.take(start, 0), covariance.take(start, 0)
    for k in range(1, int(size.max())):
        rows = (size > k).nonzero()[0]
        member = start.take(rows) + k
        pair = fused.take(rows, 0), covariance.take(member, 0)
        weight = least_volume_weight(*pair) if optimised else np.full(len(rows), 1.0 / (k + 1))
        mean[rows], fused[rows] = _fuse_pairs(mean.take(rows, 0), state.take(member, 0), *pair, weight)
    return mean, fused


def _fuse_pairs(x_a: Floats, x_b: Floats, P_a: Floats, P_b: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Means (c, 9) and covariances (c, 9, 9) of pairs; weight: (c,) w of P_a in the common bound.

    With A = P_a^-1, B = P_b^-1 and C = (1 - w) A + w B, the equations of the paper are P^-1 = (1 - w) A C^-1 A + w B
    C^-1 B and x = P ((1 - w) A C^-1 A x_a + w B C^-1 B x_b): sums of positive definite matrices, not differences.
    """
    A, B, w = inverse(P_a), inverse(P_b), weight[:, None, None]
    common = inverse((1.0 - w) * A + w * B)
    of_a, of_b = (1.0 - w) * (A @ common @ A), w * (B @ common @ B)
    information = of_a + of_b
    fused = inverse(0.5 * (information + information.mT))
    fused = 0.5 * (fused + fused.mT)
    vector = of_a @ x_a[:, :, None] + of_b @ x_b[:, :, None]
    return (fused @ vector)[:, :, 0], fused


def least_volume_weight(P_a: Floats, P_b: Floats) -> Floats:
    """The weights w (c,) of the least determinant, for pairs of covariances (c, 9, 9); 1/2 if it is within 1 %.

    In the basis in which P_a is the identity and P_b diagonal, the determinant is a product over the nine ratios d of
    their variances. Its logarithm is convex in w, since the inverse of a matrix is. Bisection finds where it is flat.
    """
    root = np.linalg.cholesky(inverse(P_a))
    ratio = np.clip(np.linalg.eigvalsh(root.mT @ P_b @ root), *_RATIOS)
    low, high = np.zeros(len(ratio)), np.ones(len(ratio))
    best = np.zeros(len(ratio), np.bool_)
    for step in range(_HALVINGS):
        weight = 0.5 * (low + high)
        bound = weight[:, None] + (1.0 - weight[:, None]) * ratio
        slope = ((1.0 - ratio) / (bound * bound) / (1.0 + 1.0 / ratio - 1.0 / bound)).sum(axis=1)
        if step == 0:
            best = 0.5 * np.abs(slope) <= TOLERANCE  # the most that ln det can be above its optimum
        low, high = np.where(slope > 0.0, weight, low), np.where(slope > 0.0, high, weight)
    return np.where(best, 0.5, 0.5 * (low + high))
