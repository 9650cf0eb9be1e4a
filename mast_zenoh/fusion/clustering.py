"""Which tracks of different agents are of one object.

Rows are brought into the order of (agent, id) first, so that nothing depends on the order in which they arrive.
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.neighbours import TABLE, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer
from mast_zenoh.kernels import kernel


class SampledAssignmentClusterer(Clusterer):
    """Clusters within a radius, the nearest tracks first.

    assign_radius: m, in the bird's-eye view, that two clusters' centres may be apart to become one

    Pairs of tracks are taken by distance; the clusters of a pair become one unless they both have a track of one agent,
    or their centres are too far apart. The original takes tracks as they come, which makes the result depend on their
    order and lets two tracks of one agent merge.
    """

    def __init__(self, *, assign_radius: float = 2.0) -> None:
        if not assign_radius > 0.0:
            raise ValueError(f"assign_radius: found {assign_radius}, expected more than 0")
        self._radius = assign_radius

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = _canonical_order(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        i, j, distance = pairs_near(position, self._radius)
        labels = np.empty(len(order), np.int64)
        labels[order] = merged(position, agent, i, j, distance, self._radius)
        return labels


class DBSCANClusterer(Clusterer):
    """Density-based clusters (Ester, Kriegel, Sander, Xu, KDD 1996), split where they have two tracks of one agent.

    eps: m, in the bird's-eye view, within which tracks are neighbours
    min_samples: tracks within `eps` of one, itself among them, that make it a core of a cluster

    Cores that are neighbours are of one cluster, others join their nearest core, and what has none is a cluster of its
    own. Where that puts two tracks of one agent together, the nearest are joined first, as in
    `SampledAssignmentClusterer`.
    """

    def __init__(self, *, eps: float = 2.0, min_samples: int = 2) -> None:
        if not eps > 0.0 or min_samples < 1:
            raise ValueError(f"eps, min_samples: found {eps}, {min_samples}, expected more than 0, and 1 or more")
        self._eps = eps
        self._min_samples = min_samples

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = _canonical_order(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        i, j, distance = pairs_near(position, self._eps)
        core = 1 + np.bincount(i, minlength=len(order)) + np.bincount(j, minlength=len(order)) >= self._min_samples
        linked = core[i] & core[j]
        linked[_to_nearest_core(i, j, distance, core)] = True
        labels = np.empty(len(order), np.int64)
        labels[order] = merged(position, agent, i[linked], j[linked], distance[linked], np.inf)
        return labels


def _to_nearest_core(i: Ints, j: Ints, distance: Floats, core: Bools) -> Ints:
    """Which pairs join a track that is no core to its nearest core, the first of those if several are as near."""
    pair = np.concatenate([(core[j] & ~core[i]).nonzero()[0], (core[i] & ~core[j]).nonzero()[0]])
    border = np.where(core[i], j, i)[pair]
    by_distance = np.lexsort((np.where(core[i], i, j)[pair], distance[pair], border))
    _, first = np.unique(border[by_distance], return_index=True)
    return np.asarray(pair[by_distance][first])


def _canonical_order(states: ObjectStates, agent: Ints) -> Ints:
    """(n,) rows by (agent, id); by place where a faulty source uses an id twice."""
    order = np.lexsort((states.id, agent))
    a, b = agent.take(order), states.id.take(order)
    if np.count_nonzero((b[1:] == b[:-1]) & (a[1:] == a[:-1])):
        order = np.lexsort((*states.position.T, states.id, agent))
    return order


def pairs_near(position: Floats, radius: float) -> tuple[Ints, Ints, Floats]:
    """Pairs i < j of (n, 2) positions within `radius`, and their squared distances."""
    n = len(position)
    i, j, dx, dy = neighbours(position, position, np.full(n, radius))
    squared = dx * dx + dy * dy
    upper = (i < j).nonzero()[0]
    if n * n > TABLE:
        # Of very many places only the nearest are looked at, and one may be among the other's but not the reverse.
        i, j = np.minimum(i, j), np.maximum(i, j)
        upper = np.unique(i * n + j, return_index=True)[1]
        upper = upper[i[upper] < j[upper]]
    return i[upper], j[upper], squared[upper]


def merged(position: Floats, agent: Ints, i: Ints, j: Ints, squared: Floats, radius: float) -> Ints:
    """(n,) labels, in the order of first rows, after joining the pairs by distance, then i, then j."""
    root, rest = plain_clusters(agent, i, j)
    if len(rest):
        i, j = i.take(rest), j.take(rest)
        nearest = np.lexsort((j, i, squared.take(rest)))
        root = joined_in_turn(root, position, agent, i.take(nearest), j.take(nearest), radius)
    label = (root == np.arange(len(root))).cumsum() - 1
    return np.asarray(label[root])


@kernel
def plain_clusters(agent: Ints, i: Ints, j: Ints) -> tuple[Ints, Ints]:
    """(n,) the first row of each row's cluster, by the pairs i < j; and which pairs are not so easily told."""
    n = len(agent)
    root = np.arange(n)
    np.minimum.at(root, j, i)
    # Most clusters are plain: tracks of different agents, all within the radius of each other and of nothing else.
    # Those come out as one in whatever order their pairs are taken.
    size = np.bincount(root, minlength=n)
    own = root[i]
    plain = np.bincount(own, minlength=n) == size * (size - 1) // 2
    odd = (own != root[j]) | (agent[i] == agent[j])
    plain[own[odd]] = plain[root[j[odd]]] = False
    return root, (~plain[own]).nonzero()[0]


@kernel
def joined_in_turn(root: Ints, position: Floats, agent: Ints, i: Ints, j: Ints, radius: float) -> Ints:
    """(n,) the first row of the cluster that each row ends up in, when the pairs i < j are joined in this order.

    root: (n,) as for `plain_clusters`; it stays as it is for rows in none of the pairs
    """
    root = root.copy()
    rows = np.unique(np.concatenate([i, j])).tolist()
    members = {row: [row] for row in rows}
    label = {row: row for row in rows}
    agents = {row: {int(agent[row])} for row in rows}
    centre = {row: tuple(position[row].tolist()) for row in rows}
    for p, q in zip(i.tolist(), j.tolist(), strict=True):
        a, b = sorted((label[p], label[q]))
        if a == b or not agents[a].isdisjoint(agents[b]):
            continue
        (ax, ay), (bx, by) = centre[a], centre[b]
        if math.sqrt((ax - bx) * (ax - bx) + (ay - by) * (ay - by)) > radius:
            continue
        for row in members[b]:
            label[row] = a
        m, n = len(members[a]), len(members[b])
        centre[a] = ((m * ax + n * bx) / (m + n), (m * ay + n * by) / (m + n))
        members[a] += members[b]
        agents[a] |= agents[b]
    root[rows] = [label[row] for row in rows]
    return root
