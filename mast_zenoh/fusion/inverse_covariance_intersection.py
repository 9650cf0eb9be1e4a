"""Fusion of members that share unknown information: inverse covariance intersection."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Fusion, Members, state_vectors
from mast_zenoh.fusion.covariance_intersection import TOLERANCE
from mast_zenoh.tracking.covariances import inverse, make_positive_definite

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
    consistent in all that was tried (docs/fusion.md).

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
