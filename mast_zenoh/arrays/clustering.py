"""Nearest-first clustering: rows of different sources that are near each other are joined, the nearest first."""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.neighbours import TABLE, neighbours
from mast_zenoh.arrays.states import Floats, Ints


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
