"""Clusterers of the command centre, which group tracks by object, and the gate between two tracks.

Rows are first sorted by (agent, id), so the result does not depend on the order in which they arrive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import (
    MAX_GROUP_PAIRS,
    MAX_NEIGHBOURS,
    NearPairs,
    connected_groups,
    greedy_matching,
    isolated_groups,
    merge_pairs,
    merge_pairs_apart,
    neighbours,
    pairs_near,
)
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, by_agent, within_runs
from mast_zenoh.fusion.base import Clusterer, trusted_rows
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import make_positive_definite
from mast_zenoh.tracking.tracks import ONE_OBJECT, overlap

#: Squared Mahalanobis distance that one in 10,000 of a chi-square distribution with six degrees of freedom exceeds.
SAME_ORIGIN_GATE = 27.86
#: m, per axis, and m/s: standard deviations of errors that no covariance contains, such as those of the agent's pose
#: and of seeing one side of a vehicle only. As measured between honest agents, see `integrity.robust_fusion`.
BIAS_M, BIAS_MPS = 0.3, 0.5

#: Rows of a covariance that count, see `states.COVARIANCE_ORDER`: x y z vx vy vz.
_JOINT = np.array([0, 1, 2, 6, 7, 8])
#: Pairs that are compared at once, which limits the memory.
_CHUNK = 1 << 16
#: Mean number of neighbours up to which tracks are merged without limiting those of a track to the nearest.
_CROWD = 4 * MAX_NEIGHBOURS


class JointGate:
    """Compares tracks of different agents in position and velocity, in all three dimensions.

    Test of whether two tracks have a common origin (Bar-Shalom, Li, Kirubarajan 2001, section 10; Bar-Shalom and Campo,
    IEEE Transactions on Aerospace and Electronic Systems 22(6), 1986): the squared Mahalanobis distance of the
    difference against a quantile of its chi-square distribution. Errors of trackers of one object share the process
    noise, so the sum of the two covariances is an upper bound. `bias_m` and `bias_mps` widen it once per track.

    gate: squared distance up to which two tracks may be of one object; infinite: no gate
    bias_m, bias_mps: standard deviations per axis of errors that no covariance contains, m and m/s
    """

    def __init__(self, gate: float, bias_m: float, bias_mps: float) -> None:
        check("more than 0", gate=gate, bias_m=bias_m, bias_mps=bias_mps)
        self.gate = gate
        #: (6,) m² and (m/s)², what both tracks together add to the variances of a difference.
        self.bias = 2.0 * np.array([bias_m**2] * 3 + [bias_mps**2] * 3)
        #: (6,) 1/m² and s²/m²: with these weights, the sum of squared differences is at least the squared distance.
        self.inverse_bias = 1.0 / self.bias

    def apart(self, states: ObjectStates, i: Ints, j: Ints) -> Bools:
        """(p,) whether the tracks in rows i and j (p,) cannot be of one object."""
        joint = motion_of(states)
        result = np.empty(len(i), np.bool_)
        for start in range(0, len(i), _CHUNK):
            part = slice(start, start + _CHUNK)
            result[part] = self._apart(states, joint, i[part], j[part])
        return result

    def _apart(self, states: ObjectStates, joint: Floats, i: Ints, j: Ints) -> Bools:
        difference = joint.take(j, 0)
        difference -= joint.take(i, 0)
        # The bias alone bounds the distance from above, which decides most pairs.
        result: Bools = (difference * difference) @ self.inverse_bias > self.gate
        doubtful = result.nonzero()[0]
        if len(doubtful):
            covariance = self._covariance(states, i.take(doubtful), j.take(doubtful))
            result[doubtful] = squared_distance(difference.take(doubtful, 0), covariance) > self.gate
        return result

    def cost(self, states: ObjectStates, i: Ints, j: Ints) -> Floats:
        """(p,) -2 ln of the likelihood that the tracks in rows i and j (p,) are of one object, up to a constant."""
        joint = motion_of(states)
        covariance = self._covariance(states, i, j)
        cost = squared_distance(joint.take(j, 0) - joint.take(i, 0), covariance)
        return np.asarray(cost + np.linalg.slogdet(covariance)[1])

    def _covariance(self, states: ObjectStates, i: Ints, j: Ints) -> Floats:
        """(p, 6, 6) covariances of the differences."""
        total = np.diag(self.bias) + _joint_covariance(states, i)
        total += _joint_covariance(states, j)
        return total


def motion_of(states: ObjectStates) -> Floats:
    """(n, 6) positions and velocities, m and m/s."""
    return np.concatenate([states.position, states.velocity], axis=1)


def _joint_covariance(states: ObjectStates, rows: Ints) -> Floats:
    """(p, 6, 6) covariances of positions and velocities."""
    return make_positive_definite(states.covariance.take(rows, 0)[:, _JOINT[:, None], _JOINT])


def squared_distance(difference: Floats, covariance: Floats) -> Floats:
    """(p,) squared Mahalanobis distances of differences (p, m), with covariances (p, m, m)."""
    return np.asarray(np.vecdot(difference, np.linalg.solve(covariance, difference[:, :, None])[:, :, 0]))


@dataclass(kw_only=True, eq=False)
class SampledAssignmentClusterer(Clusterer):
    """Clusters tracks within a radius, nearest pairs first.

    assign_radius: m, in the bird's-eye view, maximum distance between the centres of two clusters to be merged

    gate, bias_m, bias_mps: see `JointGate`

    Pairs of tracks are merged by distance, unless both clusters have a track of the same agent, their centres are too
    far apart, or two tracks within the radius differ too much in position, height and velocity to be of one object.
    Where tracks near each other do so, the likeliest pair is merged first, not the nearest. The original takes tracks
    in the order of arrival, so its result depends on that order, and two tracks of one agent may merge.
    """

    assign_radius: float = 2.0
    gate: float = SAME_ORIGIN_GATE
    bias_m: float = BIAS_M
    bias_mps: float = BIAS_MPS

    def __post_init__(self) -> None:
        check("more than 0", assign_radius=self.assign_radius)
        self._gate = JointGate(self.gate, self.bias_m, self.bias_mps)

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        motion, agent = motion_of(states).take(order, 0), agent.take(order)
        root, isolated = isolated_groups(motion, agent, self._gate.inverse_bias, self.assign_radius, self._gate.gate)
        # All other tracks are far from those of isolated groups, so they are clustered as if they were alone.
        contested = (~isolated).nonzero()[0]
        if len(contested):
            covariance = _joint_covariance(states, order.take(contested))
            first, divided = merge_nearest(
                motion.take(contested, 0), agent.take(contested), covariance, self._gate.bias, self.assign_radius,
                self._gate.gate, MAX_GROUP_PAIRS, _CROWD,
            )  # fmt: skip
            root[contested] = contested.take(first)
            contested = contested[divided]
        if len(contested):
            label = self._merged(states, order.take(contested), motion.take(contested, 0)[:, :2], agent.take(contested))
            root[contested] = contested[np.unique(label, return_index=True)[1]].take(label)
        labels = np.empty(len(order), np.int64)
        labels[order] = ((root == np.arange(len(order))).cumsum() - 1).take(root)
        return labels

    def _merged(self, states: ObjectStates, rows: Ints, position: Floats, agent: Ints) -> Ints:
        """(k,) clusters of the tracks in `rows` (k,), by their pairs; position (k, 2), agent (k,): theirs."""
        pairs = pairs_near(position, self.assign_radius)
        pairs = pairs.select((agent.take(pairs.i) != agent.take(pairs.j)).nonzero()[0])
        i, j = rows.take(pairs.i), rows.take(pairs.j)

        def cost(chosen: Ints) -> Floats:
            return self._gate.cost(states, i.take(chosen), j.take(chosen))

        return merge_pairs_apart(position, agent, pairs, self.assign_radius, self._gate.apart(states, i, j), cost)


@kernel
def merge_nearest(
    motion: Floats,
    agent: Ints,
    covariance: Floats,
    bias: Floats,
    radius: float,
    gate: float,
    most: int,
    crowd: int,
) -> tuple[Ints, Bools]:
    """Clusters as of `SampledAssignmentClusterer`, except where they depend on likelihoods.

    motion: (n, 6) m, m/s, positions and velocities; agent: (n,) of each row, ascending
    covariance: (n, 6, 6) theirs, positive definite; bias, gate: see `JointGate`; radius: m, in the bird's-eye view
    most: number of a component's pairs up to which none that is beyond the gate shares a cluster
    crowd: mean number of neighbours up to which rows are merged

    Returns the first row (n,) of each row's cluster. And whether the row is left alone (n,), because it is connected
    with such a pair, or all rows are crowded. The kernel keeps no list of all pairs: of those up to some distance, it
    sorts the ones between different clusters, and then continues with those that are farther apart.
    """
    from scipy.spatial import cKDTree  # slow to load, and not needed by the kernel

    n, position = len(agent), motion[:, :2]
    tree, reach = cKDTree(position), radius * (1.0 + 1e-9)
    if tree.count_neighbors(tree, reach) > (crowd + 1) * n:
        return np.arange(n), np.ones(n, np.bool_)
    i, j = np.sort(tree.query_pairs(reach, output_type="ndarray"), axis=1).astype(np.int64).T
    dx, dy = (position[i] - position[j]).T
    squared = dx * dx + dy * dy
    kept = ((squared <= radius * radius) & (agent[i] != agent[j])).nonzero()[0]
    pairs = NearPairs(i, j, squared).select(kept[np.lexsort((j[kept], i[kept]))])
    difference, total = motion[pairs.j] - motion[pairs.i], np.diag(bias) + covariance[pairs.i] + covariance[pairs.j]
    apart = squared_distance(difference, total) > gate
    group = connected_groups(n, pairs.i, pairs.j)
    divided = np.zeros(n, np.bool_)
    divided[group[pairs.i[apart]]] = True
    divided &= np.bincount(group[pairs.i], minlength=n) <= most
    divided = divided[group]
    label = merge_pairs(position, agent, *pairs.select((~apart & ~divided[pairs.i]).nonzero()[0]), radius)
    return np.unique(label, return_index=True)[1].take(label), divided


@dataclass(kw_only=True, eq=False)
class DBSCANClusterer(Clusterer):
    """Density-based clusters, with at most one track of each agent.

    Ester, Kriegel, Sander, Xu: DBSCAN, KDD 1996.

    eps: m, in the bird's-eye view, within which tracks are neighbours
    min_samples: number of tracks within `eps` of a track, including itself, that make it a core of a cluster
    gate, bias_m, bias_mps: see `JointGate`

    Tracks of different agents are neighbours only if they can be of one object by position, height and velocity, and
    only then share a cluster. Neighbouring cores share a cluster, other tracks join their nearest core, and a track
    without one is its own cluster. Where two tracks of one agent would share a cluster, the nearest are merged first,
    as in `SampledAssignmentClusterer`.
    """

    eps: float = 2.0
    min_samples: int = 2
    gate: float = SAME_ORIGIN_GATE
    bias_m: float = BIAS_M
    bias_mps: float = BIAS_MPS

    def __post_init__(self) -> None:
        check("more than 0", eps=self.eps)
        check("1 or more", min_samples=self.min_samples)
        self._gate = JointGate(self.gate, self.bias_m, self.bias_mps)

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        pairs = pairs_near(position, self.eps)
        apart = agent.take(pairs.i) != agent.take(pairs.j)
        apart &= self._gate.apart(states, order.take(pairs.i), order.take(pairs.j))
        near = (~apart).nonzero()[0]
        i, j, distance = pairs.select(near)
        core = 1 + np.bincount(i, minlength=len(order)) + np.bincount(j, minlength=len(order)) >= self.min_samples
        linked = core[i] & core[j]
        linked[_to_nearest_core(i, j, distance, core)] = True
        considered = apart.copy()
        considered[near[linked]] = True
        kept = considered.nonzero()[0]
        pairs = pairs.select(kept)

        def cost(chosen: Ints) -> Floats:
            return self._gate.cost(states, order.take(pairs.i.take(chosen)), order.take(pairs.j.take(chosen)))

        labels = np.empty(len(order), np.int64)
        labels[order] = merge_pairs_apart(position, agent, pairs, np.inf, apart[kept], cost)
        return labels


def _to_nearest_core(i: Ints, j: Ints, distance: Floats, core: Bools) -> Ints:
    """Pairs that join each border track to its nearest core, the first in a tie."""
    pair = np.concatenate([(core[j] & ~core[i]).nonzero()[0], (core[i] & ~core[j]).nonzero()[0]])
    border = np.where(core[i], j, i)[pair]
    by_distance = np.lexsort((np.where(core[i], i, j)[pair], distance[pair], border))
    _, first = np.unique(border[by_distance], return_index=True)
    return np.asarray(pair[by_distance][first])


#: m, in the bird's-eye view, between the middles of a cluster of believed agents and one of others of the same object.
RADIUS_M = 2.0


def believed_first(clusterer: Clusterer, states: ObjectStates, agent: Ints, believed: Bools) -> Ints:
    """(n,) the cluster of each track, as `Clusterer.cluster` numbers them.

    believed: (n,) tracks of agents that are believed; they are clustered as if there were no others, whose clusters
    join the nearest of theirs

    So a suspended agent cannot divide the objects of others by tracks beside them.
    """
    if believed.all():
        return clusterer.cluster(states, agent)
    labels = np.full(len(states), -1, np.int64)
    groups = [np.flatnonzero(believed), np.flatnonzero(~believed)]
    count = 0
    middles: list[Floats] = []
    for rows in groups:
        own = clusterer.cluster(states.select(rows), agent[rows]) if len(rows) else np.zeros(0, np.int64)
        size = int(own.max(initial=-1)) + 1
        middle = (
            np.stack([np.bincount(own, states.position[rows, axis], size) for axis in range(2)], axis=-1)
            / np.maximum(np.bincount(own, minlength=size), 1)[:, None]
        )
        middles.append(middle)
        labels[rows] = own + count
        count += size
    i, j, dx, dy = neighbours(middles[1], middles[0], np.full(len(middles[1]), RADIUS_M))
    chosen = greedy_matching(i, j, np.hypot(dx, dy))
    joined = np.arange(count)
    joined[len(middles[0]) + i[chosen]] = j[chosen]
    labels = joined[labels]
    # Numbered by the least member, (agent, id), of each.
    order = by_agent(states, agent)
    _, first, inverse = np.unique(labels[order], return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first, kind="stable"), kind="stable")
    result = np.empty(len(states), np.int64)
    result[order] = number[inverse.ravel()]
    return result


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
