"""Finds the tracks of different agents that are of one object.

Rows are brought into the order of (agent, id) first, so that nothing depends on the order in which they arrive.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.clustering import merged, pairs_near
from mast_zenoh.arrays.ordering import row_order
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer


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
        order = _by_agent(states, agent)
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
        order = _by_agent(states, agent)
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


def _by_agent(states: ObjectStates, agent: Ints) -> Ints:
    """(n,) rows by (agent, id); by place where a faulty source uses an id twice."""
    return row_order(states.id, agent, ties=tuple(states.position.T))
