"""Nearest-first clustering of rows from different sources."""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.neighbours import MAX_TABLE, neighbours
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel


def pairs_near(position: Floats, radius: float) -> tuple[Ints, Ints, Floats]:
    """Pairs i < j of (n, 2) positions within `radius`, sorted by i, then j, and their squared distances."""
    n = len(position)
    i, j, dx, dy = neighbours(position, position, np.full(n, radius))
    squared = dx * dx + dy * dy
    upper = (i < j).nonzero()[0]
    if n * n > MAX_TABLE:
        # Above that size, neighbours are limited to the nearest, so a pair may be found from only one side.
        i, j = np.minimum(i, j), np.maximum(i, j)
        upper = np.unique(i * n + j, return_index=True)[1]
        upper = upper[i[upper] < j[upper]]
    return i[upper], j[upper], squared[upper]


@kernel
def merge_pairs(position: Floats, agent: Ints, i: Ints, j: Ints, squared: Floats, radius: float) -> Ints:
    """Cluster labels after merging the pairs by distance, then i, then j.

    (n,), numbered in the order of the clusters' first rows. The pairs are as of `pairs_near`, or some of those.
    """
    root, contested = split_simple_clusters(agent, i, j)
    if len(contested):
        i, j = i.take(contested), j.take(contested)
        nearest = np.lexsort((j, i, squared.take(contested)))
        root = merge_in_order(root, position, agent, i.take(nearest), j.take(nearest), radius)
    label = (root == np.arange(len(root))).cumsum() - 1
    return np.asarray(label[root])


def split_simple_clusters(agent: Ints, i: Ints, j: Ints) -> tuple[Ints, Ints]:
    """First row (n,) of each row's cluster, for pairs i < j; and the contested pairs.

    A pair is contested if the result for its cluster depends on the order of merging.
    """
    n = len(agent)
    root = np.arange(n)
    np.minimum.at(root, j, i)
    # Most clusters are simple: tracks of different agents, all within the radius of each other and of nothing else.
    # For those, the order of the pairs does not matter.
    size = np.bincount(root, minlength=n)
    cluster = root[i]
    simple = np.bincount(cluster, minlength=n) == size * (size - 1) // 2
    conflicting = (cluster != root[j]) | (agent[i] == agent[j])
    simple[cluster[conflicting]] = simple[root[j[conflicting]]] = False
    return root, (~simple[cluster]).nonzero()[0]


def merge_in_order(root: Ints, position: Floats, agent: Ints, i: Ints, j: Ints, radius: float) -> Ints:
    """First row (n,) of each row's cluster after merging the pairs i < j in order.

    root: (n,) as for `split_simple_clusters`; unchanged for rows in none of the pairs
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
