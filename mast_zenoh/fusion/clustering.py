"""Which tracks of different agents are of one object.

Rows are brought into the order of (agent, id) first, so that nothing depends on the order in which they arrive.
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.fusion.base import Clusterer
from mast_zenoh.states import Bools, Floats, Ints, ObjectStates


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
        order = np.lexsort((*states.position.T, states.id, agent))
        position, agent = states.position[order, :2], agent[order]
        i, j, distance = _near(position, self._radius)
        labels = np.empty(len(order), np.int64)
        labels[order] = _merge(position, agent, i, j, distance, self._radius)
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
        order = np.lexsort((*states.position.T, states.id, agent))
        position, agent = states.position[order, :2], agent[order]
        i, j, distance = _near(position, self._eps)
        core = 1 + np.bincount(i, minlength=len(order)) + np.bincount(j, minlength=len(order)) >= self._min_samples
        linked = core[i] & core[j]
        linked[_to_nearest_core(i, j, distance, core)] = True
        labels = np.empty(len(order), np.int64)
        labels[order] = _merge(position, agent, i[linked], j[linked], distance[linked], np.inf)
        return labels


def _to_nearest_core(i: Ints, j: Ints, distance: Floats, core: Bools) -> Ints:
    """Which pairs join a track that is no core to its nearest core, the first of those if several are as near."""
    pair = np.concatenate([(core[j] & ~core[i]).nonzero()[0], (core[i] & ~core[j]).nonzero()[0]])
    border = np.where(core[i], j, i)[pair]
    by_distance = np.lexsort((np.where(core[i], i, j)[pair], distance[pair], border))
    _, first = np.unique(border[by_distance], return_index=True)
    return np.asarray(pair[by_distance][first])


def _near(position: Floats, radius: float) -> tuple[Ints, Ints, Floats]:
    """Pairs i < j of (n, 2) positions within `radius`, and their distances."""
    x, y = position[:, 0], position[:, 1]
    dx, dy = x[:, None] - x[None, :], y[:, None] - y[None, :]
    squared = dx * dx + dy * dy
    i, j = np.nonzero(squared <= radius * radius)
    upper = i < j
    i, j = i[upper], j[upper]
    return i, j, np.sqrt(squared[i, j])


def _merge(position: Floats, agent: Ints, i: Ints, j: Ints, distance: Floats, radius: float) -> Ints:
    """(n,) labels, in the order of first rows, after joining the pairs by distance, then i, then j."""
    label = list(range(len(position)))
    members = [[row] for row in label]
    agents = [{one} for one in agent.tolist()]
    centre = position.tolist()
    by_distance = np.lexsort((j, i, distance))
    for p, q in zip(i[by_distance].tolist(), j[by_distance].tolist(), strict=True):
        a, b = label[p], label[q]
        if a == b or not agents[a].isdisjoint(agents[b]):
            continue
        if math.dist(centre[a], centre[b]) > radius:
            continue
        if b < a:
            a, b = b, a
        for row in members[b]:
            label[row] = a
        m, n = len(members[a]), len(members[b])
        (ax, ay), (bx, by) = centre[a], centre[b]
        centre[a] = ((m * ax + n * bx) / (m + n), (m * ay + n * by) / (m + n))
        members[a] += members[b]
        agents[a] |= agents[b]
    return np.unique(np.array(label, np.int64), return_inverse=True)[1].astype(np.int64)
