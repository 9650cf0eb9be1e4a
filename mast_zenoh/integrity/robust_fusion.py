"""Fusion weights that one lying member of a cluster cannot move far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, Integrity, ObjectTrust
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.tracking.kalman import make_positive_definite

#: Rows of the state that members are compared by, in COVARIANCE_ORDER: x y vx vy.
_COMPARED = np.array([0, 1, 6, 7])
#: Steps of Weiszfeld's iteration; each reduces the distance to the median.
_STEPS = 8
#: m, below which distances to the median count as equal (Pillutla et al. smooth the iteration in the same way).
_SMOOTHING_M = 0.1
#: m², least variance of a track.
_LEAST_M2 = 1e-9


@dataclass(kw_only=True, eq=False)
class RobustFusion(Integrity):
    """Leaves out members far from the others of their cluster, and weighs the rest by their geometric median.

    A member of three or more is left out if its squared Mahalanobis distance from the mean of the others, in position
    and velocity, is above `gate`, the farthest first, until two are left. The others get the weights of Weiszfeld's
    iteration, whose fixed point is the geometric median of their positions: a minority cannot move it far (Pillutla,
    Kakade, Harchaoui: Robust Aggregation for Federated Learning, IEEE Transactions on Signal Processing 2022). Of two
    that are apart, the agent with the better record is kept; their dispute is in nobody's record, as nobody else
    decides it (TrustFlip, arXiv 2605.22122).

    gate: squared distance; 18.5 is exceeded by one in a thousand of a chi-square distribution with four degrees
    bias_m: m, standard deviation of position errors that the covariances do not contain, such as seeing one side of a
        vehicle only: 0.3 m was measured between honest agents
    bias_mps: m/s, the same for velocities
    confidence: factor, greatest ratio of a member's variance to the median of its cluster that counts, either way
    margin: difference of two records above which they decide
    record_s: s, after which an outcome counts 1/e in an agent's record

    Weaknesses: phantoms and removals are not its business, and it withholds nothing; displacements within the gate
    pass, and a majority of liars in a cluster decides.
    """

    needs_views = False

    gate: float = 18.5
    bias_m: float = 0.3
    bias_mps: float = 0.5
    confidence: float = 4.0
    margin: float = 0.1
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check("more than 0", gate=self.gate, bias_m=self.bias_m, bias_mps=self.bias_mps)
        check("1 or more", confidence=self.confidence)
        self._bias = np.diag([self.bias_m**2, self.bias_m**2, self.bias_mps**2, self.bias_mps**2])
        self.reset()

    def assess(self, batch: Batch) -> Assessment:
        reported: Bools = batch.reported
        state = np.column_stack([batch.states.position[:, :2], batch.states.velocity[:, :2]])[batch.member]
        claimed = make_positive_definite(batch.states.covariance)[:, _COMPARED[:, None], _COMPARED][batch.member]
        covariance = claimed + self._bias
        kept = self._without_outliers(reported, state, covariance)
        judged = reported & (reported.sum(axis=1) > 2)[:, None]
        kept = self._better_of_two(kept, state, covariance, self._record.mean(batch.agents))
        weight = median_weights(kept, state[..., :2]) * self._limited(kept, claimed)
        mean = self._record.update(batch, judged & kept, judged & ~kept)
        members, agreeing = reported.sum(axis=1), kept.sum(axis=1)
        objects = ObjectTrust.of(members, agreeing, members - agreeing, np.zeros(len(members), np.bool_))
        return Assessment(weight[batch.labels, batch.agent], AgentTrust.of(mean), objects)

    def _without_outliers(self, members: Bools, state: Floats, covariance: Floats) -> Bools:
        """(c, a) members that are within the gate of the others."""
        kept = members.copy()
        rows = np.flatnonzero(kept.sum(axis=1) > 2)
        while len(rows):
            distance = leave_one_out(kept[rows], state[rows], covariance[rows])
            worst = distance.argmax(axis=1)
            beyond = distance[np.arange(len(rows)), worst] > self.gate
            rows, worst = rows[beyond], worst[beyond]
            kept[rows, worst] = False
            rows = rows[kept[rows].sum(axis=1) > 2]
        return kept

    def _better_of_two(self, kept: Bools, state: Floats, covariance: Floats, record: Floats) -> Bools:
        """(c, a) members, without the one with the worse record of two that are apart."""
        rows = np.flatnonzero(kept.sum(axis=1) == 2)
        if len(rows) == 0:
            return kept
        apart = leave_one_out(kept[rows], state[rows], covariance[rows]).max(axis=1) > self.gate
        rows = rows[apart]
        trusted = np.where(kept[rows], record, -np.inf)
        worse = kept[rows] & (trusted < trusted.max(axis=1, keepdims=True) - self.margin)
        result = kept.copy()
        result[rows] &= ~worse
        return result

    def _limited(self, kept: Bools, covariance: Floats) -> Floats:
        """(c, a) factors that limit how confident a member may be compared to the others of its cluster."""
        variance = np.maximum(covariance[..., 0, 0] + covariance[..., 1, 1], _LEAST_M2)
        ordered = np.sort(np.where(kept, variance, np.inf), axis=1)
        middle = np.maximum((kept.sum(axis=1) - 1) // 2, 0)
        median = np.take_along_axis(ordered, middle[:, None], axis=1)
        limited = np.clip(variance, median / self.confidence, median * self.confidence)
        return np.asarray(np.where(kept, variance / limited, 0.0))

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)


def leave_one_out(members: Bools, state: Floats, covariance: Floats) -> Floats:
    """(c, a) squared Mahalanobis distances of members from the mean of the others; 0 where there is no member.

    members: (c, a), at least two in each cluster; state: (c, a, d); covariance: (c, a, d, d), of each member's error
    """
    present = members[..., None]
    state = np.where(present, state, 0.0)
    covariance = np.where(present[..., None], covariance, 0.0)
    others = members.sum(axis=1)[:, None, None] - 1
    mean = (state.sum(axis=1, keepdims=True) - state) / others
    spread = (covariance.sum(axis=1, keepdims=True) - covariance) / others[..., None] ** 2
    difference = np.where(present, state - mean, 0.0)
    total = np.where(present[..., None], covariance + spread, np.eye(state.shape[2]))
    solved = np.linalg.solve(total, difference[..., None])[..., 0]
    return np.asarray((difference * solved).sum(axis=2))


def median_weights(members: Bools, position: Floats) -> Floats:
    """(c, a) weights of members whose weighted mean is the geometric median of their positions (c, a, 2)."""
    present: Floats = members.astype(np.float64)
    weight = present
    for _ in range(_STEPS):
        total = np.maximum(weight.sum(axis=1), 1e-300)
        centre = (weight[..., None] * np.where(members[..., None], position, 0.0)).sum(axis=1) / total[:, None]
        offset = position - centre[:, None, :]
        weight = present / np.maximum(np.hypot(offset[..., 0], offset[..., 1]), _SMOOTHING_M)
    return weight
