"""Clusterers of the command centre, which group tracks by object.

Rows are first sorted by (agent, id), so the result does not depend on the order in which they arrive.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.clustering import merge_pairs, pairs_near
from mast_zenoh.arrays.ordering import by_agent
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer


class SampledAssignmentClusterer(Clusterer):
    """Clusters tracks within a radius, nearest pairs first.

    assign_radius: m, in the bird's-eye view, maximum distance between the centres of two clusters to be merged

    Pairs of tracks are merged by distance, unless both clusters have a track of the same agent or their centres are too
    far apart. The original takes tracks in the order of arrival, so its result depends on that order, and two tracks of
    one agent may merge.
    """

    def __init__(self, *, assign_radius: float = 2.0) -> None:
        if not assign_radius > 0.0:
            raise ValueError(f"assign_radius: found {assign_radius}, expected more than 0")
        self._radius = assign_radius

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        i, j, distance = pairs_near(position, self._radius)
        labels = np.empty(len(order), np.int64)
        labels[order] = merge_pairs(position, agent, i, j, distance, self._radius)
        return labels


class DBSCANClusterer(Clusterer):
    """Density-based clusters, with at most one track of each agent.

    Ester, Kriegel, Sander, Xu: DBSCAN, KDD 1996.

    eps: m, in the bird's-eye view, within which tracks are neighbours
    min_samples: number of tracks within `eps` of a track, including itself, that make it a core of a cluster

    Neighbouring cores share a cluster, other tracks join their nearest core, and a track without one is its own
    cluster. Where two tracks of one agent would share a cluster, the nearest are merged first, as in
    `SampledAssignmentClusterer`.
    """

    def __init__(self, *, eps: float = 2.0, min_samples: int = 2) -> None:
        if not eps > 0.0 or min_samples < 1:
            raise ValueError(f"eps, min_samples: found {eps}, {min_samples}, expected more than 0, and 1 or more")
        self._eps = eps
        self._min_samples = min_samples

    def cluster(self, states: ObjectStates, agent: Ints) -> Ints:
        order = by_agent(states, agent)
        position, agent = states.position.take(order, 0)[:, :2], agent.take(order)
        i, j, distance = pairs_near(position, self._eps)
        core = 1 + np.bincount(i, minlength=len(order)) + np.bincount(j, minlength=len(order)) >= self._min_samples
        linked = core[i] & core[j]
        linked[_to_nearest_core(i, j, distance, core)] = True
        labels = np.empty(len(order), np.int64)
        labels[order] = merge_pairs(position, agent, i[linked], j[linked], distance[linked], np.inf)
        return labels


def _to_nearest_core(i: Ints, j: Ints, distance: Floats, core: Bools) -> Ints:
    """Pairs that join each border track to its nearest core, the first in a tie."""
    pair = np.concatenate([(core[j] & ~core[i]).nonzero()[0], (core[i] & ~core[j]).nonzero()[0]])
    border = np.where(core[i], j, i)[pair]
    by_distance = np.lexsort((np.where(core[i], i, j)[pair], distance[pair], border))
    _, first = np.unique(border[by_distance], return_index=True)
    return np.asarray(pair[by_distance][first])
