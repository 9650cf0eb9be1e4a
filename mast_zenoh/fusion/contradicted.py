"""Clusters that contradict a larger one at the same place, and are left out of the picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.ordering import within_runs
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.joint_gate import BIAS_M, BIAS_MPS, SAME_ORIGIN_GATE, JointGate
from mast_zenoh.fusion.members import trusted_rows
from mast_zenoh.tracking.duplicates import ONE_OBJECT, overlap

#: m, between the centres of clusters at the same place, whatever their size: two standard deviations of the difference
#: of the errors that covariances do not contain. Boxes that overlap as one object are at the same place, too.
SAME_PLACE_M = 2.0 * 2.0**0.5 * BIAS_M
#: m, the farthest that the centres of two boxes at the same place are considered.
_REACH_M = 2.0

#: m^2, of a horizontal position, both axes together: what is less certain would not be reported in place of what it
#: contradicts (a tracker's `max_std_m` of 1.2 m), and has no say.
_MAX_VARIANCE = 1.2**2
#: A cluster is compared with so many larger ones at its place, the largest, and by so many members of each. Only
#: hostile sources send more, and whatever they send, a track costs at most the product of the two.
_MAX_LARGER, _MAX_MEMBERS = 8, 32
_FIRST = np.zeros(1, np.int64)
_JOINT_GATE = JointGate(SAME_ORIGIN_GATE, BIAS_M, BIAS_MPS)


def without_contradicted(states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None) -> Floats | None:
    """Weights (n,) of tracks, 0 for those in a cluster that a larger one contradicts; `weights` if there is none.

    states: n tracks; agent, labels: (n,) of each; weights: (n,) how far each is trusted, 0: it does not count

    Two road users are not at the same place, but one may be above the other. Where clusters of different agents are,
    because their velocities differ too much, one of them is wrong: the one with fewer agents, such as a track that has
    jumped to an oncoming vehicle.
    An agent that sees both objects is in both clusters, which then are two objects. Of two with equally many agents
    nothing says which is wrong, and both stay. A cluster that is left out contradicts no other.

    What remains: agents that together put `_MAX_LARGER` clusters around their false one, each larger than it and than
    the true one, keep it in the picture.
    """
    rows = trusted_rows(agent, labels, weights)
    variance = states.covariance[:, 0, 0] + states.covariance[:, 1, 1]
    rows = rows[variance[rows] <= _MAX_VARIANCE]
    if len(rows) < 3:  # one cluster of two, and one of one
        return weights
    label = labels.take(rows)
    later = (label[1:] != label[:-1]).nonzero()[0] + 1
    start, end = np.concatenate([_FIRST, later]), np.concatenate([later, [len(rows)]])
    size = end - start
    centre = np.add.reduceat(states.position.take(rows, 0), start) / size[:, None]
    several = (size > 1).nonzero()[0]
    i, j, dx, dy = neighbours(centre, centre[several], np.full(len(centre), _REACH_M))
    j = several.take(j)
    pairs = (size.take(j) > size.take(i)).nonzero()[0]
    if not len(pairs):
        return weights
    larger, smaller, offset = j[pairs], i[pairs], np.column_stack([-dx[pairs], -dy[pairs]])
    first = rows[start]
    one, other = first[larger], first[smaller]
    same = overlap(offset, states.size[one], states.yaw[one], states.size[other], states.yaw[other], ONE_OBJECT)
    same |= np.hypot(offset[:, 0], offset[:, 1]) <= SAME_PLACE_M
    height = 0.5 * (states.size[one, 2] + states.size[other, 2])
    same &= np.abs(centre[larger, 2] - centre[smaller, 2]) <= height
    larger, smaller, offset = larger[same], smaller[same], offset[same]
    if not len(larger):
        return weights
    largest = np.lexsort((larger, np.vecdot(offset, offset), -size[larger], smaller))
    rank = np.arange(len(largest)) - np.searchsorted(smaller[largest], smaller[largest])
    compared = largest[rank < _MAX_LARGER]
    larger, smaller = larger[compared], smaller[compared]
    apart = _contradict(states, agent, _Clusters(rows, start, size), larger, smaller)
    larger, smaller = larger[apart], smaller[apart]
    wrong = set[int]()  # a larger cluster is judged before those that it contradicts
    for k in np.lexsort((smaller, larger, -size[larger])).tolist():
        if larger[k] not in wrong:
            wrong.add(int(smaller[k]))
    if not wrong:
        return weights
    kept: Bools = ~np.isin(labels, label[start[list(wrong)]])
    return kept.astype(np.float64) if weights is None else weights * kept


class _Clusters(NamedTuple):
    """rows: (n,) tracks by cluster and agent; start, size: (c,) of each cluster in `rows`"""

    rows: Ints
    start: Ints
    size: Ints

    def members(self, clusters: Ints, most: int | None = None) -> tuple[Ints, Ints]:
        """For each member of p clusters, at most so many of each: which of the p, and its row."""
        size = self.size[clusters] if most is None else np.minimum(self.size[clusters], most)
        which = np.repeat(np.arange(len(clusters)), size)
        return which, self.rows[self.start[clusters[which]] + within_runs(size)]


def _contradict(states: ObjectStates, agent: Ints, clusters: _Clusters, one: Ints, other: Ints) -> Bools:
    """(p,) whether clusters have no agent in common, and tracks that cannot be of one object; one, other: (p,)"""
    agents = int(agent.max()) + 1
    codes = np.repeat(np.arange(len(clusters.size)), clusters.size) * agents + agent[clusters.rows]  # ascending
    pair, row = clusters.members(other)
    sought = one[pair] * agents + agent[row]
    common = codes.take(np.searchsorted(codes, sought), mode="clip") == sought
    result: Bools = np.bincount(pair[common], minlength=len(one)) == 0
    apart = np.flatnonzero(result)
    pair, j = clusters.members(other[apart], _MAX_MEMBERS)
    which, i = clusters.members(one[apart][pair], _MAX_MEMBERS)
    contradicting = _JOINT_GATE.apart(states, i, j[which])
    result[apart] = np.bincount(pair[which[contradicting]], minlength=len(apart)) > 0
    return result
