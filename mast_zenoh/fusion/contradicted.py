"""Clusters that contradict a larger one at the same place, and are left out of the picture."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.joint_gate import BIAS_M, BIAS_MPS, GATE, JointGate
from mast_zenoh.tracking import gating
from mast_zenoh.tracking.duplicates import ONE_OBJECT, overlap

#: m, between the centres of clusters at the same place, whatever their size: two standard deviations of the difference
#: of the errors that covariances do not contain. Boxes that overlap as one object are at the same place, too.
SAME_PLACE_M = 2.0 * 2.0**0.5 * BIAS_M
#: m, the farthest that the centres of two boxes at the same place are considered.
_REACH_M = 2.0

#: Clusters at the place of one, and pairs of them, up to which they are compared: only a hostile source sends more.
_MAX_LARGER, _MAX_PAIRS = 8, 1_000
_FIRST = np.zeros(1, np.int64)
_JOINT_GATE = JointGate(GATE, BIAS_M, BIAS_MPS)


def without_contradicted(states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None) -> Floats | None:
    """Weights (n,) of tracks, 0 for those in a cluster that a larger one contradicts; `weights` if there is none.

    states: n tracks; agent, labels: (n,) of each; weights: (n,) how far each is trusted, 0: it does not count

    Two road users are not at the same place. Where clusters of different agents are, because their velocities differ
    too much, one of them is wrong: the one with fewer agents, such as a track that has jumped to an oncoming vehicle.
    An agent that sees both objects is in both clusters, which then are two objects. Of two with equally many agents
    nothing says which is wrong, and both stay.
    """
    rows = np.lexsort((agent, labels))  # sums must not depend on the order of the rows
    if weights is not None:
        rows = rows[weights[rows] > 0.0]
    if len(rows) < 3:  # one cluster of two, and one of one
        return weights
    label = labels.take(rows)
    later = (label[1:] != label[:-1]).nonzero()[0] + 1
    start, end = np.concatenate([_FIRST, later]), np.concatenate([later, [len(rows)]])
    size = end - start
    centre = np.add.reduceat(states.position.take(rows, 0), start) / size[:, None]
    i, j, dx, dy = neighbours(centre, centre, np.full(len(centre), _REACH_M))
    pairs = (size.take(i) > size.take(j)).nonzero()[0]
    if not len(pairs):
        return weights
    larger, smaller, offset = i[pairs], j[pairs], np.column_stack([dx[pairs], dy[pairs]])
    first = rows[start]
    one, other = first[larger], first[smaller]
    same = overlap(offset, states.size[one], states.yaw[one], states.size[other], states.yaw[other], ONE_OBJECT)
    same |= np.hypot(offset[:, 0], offset[:, 1]) <= SAME_PLACE_M
    same &= np.abs(centre[larger, 2] - centre[smaller, 2]) <= gating.GATE.level_m
    crowd = np.bincount(smaller[same], minlength=len(size))
    same &= crowd[smaller] <= _MAX_LARGER
    if np.count_nonzero(same) > _MAX_PAIRS:
        return weights
    members = np.split(rows, later)
    wrong = [
        label[start[b]]
        for a, b in zip(larger[same].tolist(), smaller[same].tolist(), strict=True)
        if _contradict(states, agent, members[a], members[b])
    ]
    if not wrong:
        return weights
    kept: Bools = ~np.isin(labels, wrong)
    return kept.astype(np.float64) if weights is None else weights * kept


def _contradict(states: ObjectStates, agent: Ints, one: Ints, other: Ints) -> bool:
    """Whether the rows of two clusters have no agent in common, and tracks that cannot be of one object."""
    if np.isin(agent[other], agent[one]).any():
        return False
    i, j = np.repeat(one, len(other)), np.tile(other, len(one))
    return bool(_JOINT_GATE.apart(states, i, j).any())
