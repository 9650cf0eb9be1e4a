"""Pairs of points: radius search, one-to-one matching, nearest-first clustering.

SciPy is the reference of matching. With compiled kernels it is not imported, as that takes as long as all other imports
of a node.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel

#: Number of pairs up to which all are compared.
MAX_TABLE = 250_000

#: Limit on the neighbours of a point above that. No street holds more road users within a few metres, and objects that
#: a hostile source puts in one place must not fill the memory.
MAX_NEIGHBOURS = 64


def neighbours(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """Pairs of `a` (n,) and `b` (m,) at most `radius` (n,) m apart, sorted by a, b.

    a, b: (n, >= 2), (m, >= 2) m; only x and y count
    Returns rows of a (p,), rows of b (p,), and how far b is from a in x and in y (p,) m.
    """
    if len(a) * len(b) > MAX_TABLE:
        return _nearest(a[:, :2], b[:, :2], radius)
    return pairs_within_radius(a, b, radius)


@kernel
def pairs_within_radius(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """See `neighbours`."""
    m = len(b)
    dx = b[:, 0] - a[:, 0, None]
    dy = b[:, 1] - a[:, 1, None]
    pair = (dx * dx + dy * dy <= (radius * radius)[:, None]).ravel().nonzero()[0]
    i = pair // max(m, 1)
    return i, pair - i * m, dx.take(pair), dy.take(pair)


def _nearest(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """As `neighbours`, with at most MAX_NEIGHBOURS in `b` for each point in `a`."""
    from scipy.spatial import cKDTree  # slow to load, and few nodes ever see so many pairs

    count = min(MAX_NEIGHBOURS, len(b))
    # A little further than the radius, so that rounding in the tree has no effect.
    _, other = cKDTree(b).query(a, np.arange(1, count + 1), distance_upper_bound=float(radius.max()) * (1.0 + 1e-9))
    other = np.sort(np.asarray(other, np.int64), axis=1).ravel()
    valid = (other < len(b)).nonzero()[0]
    i, j = valid // count, other[valid]
    dx, dy = (b[j] - a[i]).T
    inside = dx * dx + dy * dy <= (radius * radius)[i]
    return i[inside], j[inside], dx[inside], dy[inside]


if kernels.USED == "numpy":  # imported now, not in the middle of a frame
    import scipy.optimize
    import scipy.sparse.csgraph  # noqa: F401


def uncontested(row: Ints, column: Ints) -> Bools:
    """Pairs (p,) that share no row or column with another; row, column: int64 >= 0."""
    if len(row) == 0:
        return np.zeros(0, bool)
    single: Bools = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    return single


def greedy_matching(row: Ints, column: Ints, cost: Floats) -> Bools:
    """Pairs (p,) chosen one by one, the cheapest first; ties by row and column.

    row, column: (p,) int64 >= 0, no pair twice; cost: (p,)
    """
    chosen = uncontested(row, column)
    contested = (~chosen).nonzero()[0]
    if len(contested) == 0:
        return chosen
    order = contested[np.lexsort((column[contested], row[contested], cost[contested]))]
    rows: set[int] = set()
    columns: set[int] = set()
    for pair, r, c in zip(order.tolist(), row[order].tolist(), column[order].tolist(), strict=True):
        if r not in rows and c not in columns:
            rows.add(r)
            columns.add(c)
            chosen[pair] = True
    return chosen


@kernel
def min_cost_matching(row: Ints, column: Ints, cost: Floats) -> Bools:
    """Pairs (p,) of the one-to-one matching with the least total cost.

    row, column: (p,) int64 >= 0, no pair twice
    cost:        (p,) below 0: cost of choosing the pair relative to leaving both unmatched
    Raises ValueError for a cost that is not finite.

    Each connected component of competing rows and columns is solved separately with shortest
    augmenting paths (Jonker and Volgenant, Computing 1987; in the form of Crouse, IEEE TAES 2016).
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not np.isfinite(cost).all():
        raise ValueError("cost: found one that is not finite")
    chosen = uncontested(row, column)
    contested = (~chosen).nonzero()[0]
    if len(contested) == 0:
        return chosen
    rows, r = np.unique(row[contested], return_inverse=True)
    columns, c = np.unique(column[contested], return_inverse=True)
    size = len(rows) + len(columns)
    graph = coo_array((np.ones(len(contested), np.int8), (r, c + len(rows))), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    component = label[r]
    order = np.argsort(component, kind="stable")
    for pairs in np.split(order, np.flatnonzero(np.diff(component[order])) + 1):
        component_rows, local_row = np.unique(r[pairs], return_inverse=True)
        component_columns, local_column = np.unique(c[pairs], return_inverse=True)
        # Zero means "both unmatched", so that the complete matching of least cost contains the best partial one.
        table = np.zeros((len(component_rows), len(component_columns)))
        table[local_row, local_column] = cost[contested[pairs]]
        matched_row, matched_column = linear_sum_assignment(table)
        partner = np.full(len(component_rows), -1)
        partner[matched_row] = matched_column
        chosen[contested[pairs[partner[local_row] == local_column]]] = True
    return chosen


#: Pairs of a connected group, and of all groups, up to which pairs that are apart are kept from sharing a cluster. Only
#: a hostile source puts more tracks in one place; those are merged by distance, without the pairs that are apart.
MAX_GROUP_PAIRS, MAX_COST_PAIRS = 2_000, 50_000


class NearPairs(NamedTuple):
    """p pairs of rows i < j, (p,) each, sorted by i, then j, and their squared distances (p,)."""

    i: Ints
    j: Ints
    squared: Floats

    def select(self, pairs: Ints) -> NearPairs:
        """Select pairs by index (k,)."""
        return NearPairs(self.i.take(pairs), self.j.take(pairs), self.squared.take(pairs))


def pairs_near(position: Floats, radius: float) -> NearPairs:
    """Pairs of (n, 2) positions within `radius`."""
    n = len(position)
    i, j, dx, dy = neighbours(position, position, np.full(n, radius))
    squared = dx * dx + dy * dy
    upper = (i < j).nonzero()[0]
    if n * n > MAX_TABLE:
        # Above that size, neighbours are limited to the nearest, so a pair may be found from only one side.
        i, j = np.minimum(i, j), np.maximum(i, j)
        upper = np.unique(i * n + j, return_index=True)[1]
        upper = upper[i[upper] < j[upper]]
    return NearPairs(i[upper], j[upper], squared[upper])


@kernel
def isolated_groups(
    motion: Floats, agent: Ints, inverse_bias: Floats, radius: float, gate: float
) -> tuple[Ints, Bools]:
    """Groups of rows around one place, without a list of their pairs.

    motion: (n, 6) m, m/s, positions and velocities; agent: (n,) of each row, ascending
    inverse_bias: (6,) weights of squared differences; radius: m, in the bird's-eye view; gate: of their weighted sum

    Returns the first row (n,) of each row's group: the first that is within `radius` of it and in no earlier group. And
    whether the group is isolated (n,): its rows are of different agents, all within the radius and the gate of each
    other, by their distances from its centre, and no row of another group is within the radius of them.

    Linear in rows, unless many groups that are not isolated are at one place.
    """
    n = len(agent)
    root, anchors = np.arange(n), dict[tuple[int, int], list[int]]()
    cells = np.floor(np.clip(motion[:, :2] / (radius * (1.0 + 1e-6)), -1e12, 1e12)).astype(np.int64)
    squared, place = radius * radius, motion[:, :2].tolist()
    for row, (x, y) in enumerate(cells.tolist()):
        candidates = (
            anchor for key in product((x - 1, x, x + 1), (y - 1, y, y + 1)) for anchor in anchors.get(key, ())
        )
        root[row] = min(
            (anchor for anchor in candidates if _squared(place[row], place[anchor]) <= squared), default=row
        )
        if root[row] == row:
            anchors.setdefault((x, y), []).append(row)
    first, group, size = np.unique(root, return_inverse=True, return_counts=True)
    centre = np.stack([np.bincount(group, column, len(first)) for column in motion.T], axis=-1) / size[:, None]
    offset = motion - centre[group]
    distances = np.hypot(offset[:, 0], offset[:, 1]), np.sqrt(offset * offset @ inverse_bias)
    (extent, across), (_, spread) = (_largest_two(distance, group, size) for distance in distances)
    margin = 1.0 + 1e-9  # rounding
    simple = (size == 1) | ((across * margin <= radius) & (spread * spread * margin <= gate))
    by_group = group.argsort(kind="stable")
    repeated = (np.diff(group[by_group]) == 0) & (np.diff(agent[by_group]) == 0)
    simple[group[by_group[1:][repeated]]] = False
    members = np.split(by_group, np.cumsum(size)[:-1])
    # Rows that are within the radius of each other have first rows within three; those are so far apart that few are.
    at = motion.take(first, 0)
    i, j, _, _ = neighbours(at, at, np.full(len(first), 3.0 * radius * margin))
    reach = (radius + extent[i] + extent[j]) * margin
    offset = centre[i] - centre[j]
    near = ((i > j) & (simple[i] | simple[j]) & (offset[:, 0] ** 2 + offset[:, 1] ** 2 <= reach * reach)).nonzero()[0]
    for g, h in zip(i[near].tolist(), j[near].tolist(), strict=True):
        dx, dy = (motion[members[g], None, :2] - motion[members[h], :2]).transpose(2, 0, 1)
        if (dx * dx + dy * dy <= squared).any():
            simple[g] = simple[h] = False
    return root, simple[group]


def _squared(one: Sequence[float], other: Sequence[float]) -> float:
    """Squared distance of two positions, in x and y."""
    dx, dy = one[0] - other[0], one[1] - other[1]
    return dx * dx + dy * dy


def _largest_two(values: Floats, group: Ints, size: Ints) -> tuple[Floats, Floats]:
    """Of each of c groups of n values, the largest (c,), and the sum of the two largest (c,).

    group: (n,) 0 to c - 1; size: (c,)
    """
    ordered, last = values[np.lexsort((values, group))], np.cumsum(size) - 1
    return ordered[last], ordered[last] + np.where(size > 1, ordered[last - 1], 0.0)


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


def merge_pairs_apart(
    position: Floats, agent: Ints, pairs: NearPairs, radius: float, apart: Bools, cost: Callable[[Ints], Floats]
) -> Ints:
    """As `merge_pairs`, where some pairs (p,) are `apart`: no cluster has both rows of one of them.

    cost: of merging each of some pairs, by their numbers (k,); (k,), called at most once

    Rows that are connected, directly or by way of others, with a pair that is apart are merged in the order of this
    cost instead of the distance: a row may be near two others that exclude each other.
    """
    i, j, squared = pairs
    if not np.count_nonzero(apart):
        return merge_pairs(position, agent, i, j, squared, radius)
    n = len(agent)
    group = connected_groups(n, i, j)
    divided = np.zeros(n, bool)
    divided[group[i[apart]]] = True
    divided &= np.bincount(group[i], minlength=n) <= MAX_GROUP_PAIRS
    by_cost = divided[group[i]]
    if np.count_nonzero(by_cost) > MAX_COST_PAIRS:
        by_cost[:] = False
    label = merge_pairs(position, agent, *pairs.select((~by_cost & ~apart).nonzero()[0]), radius)
    root = np.unique(label, return_index=True)[1].take(label)
    chosen = (by_cost & ~apart).nonzero()[0]
    if len(chosen):
        chosen = chosen.take(np.lexsort((j.take(chosen), i.take(chosen), cost(chosen))))
        excluded = set((i[apart] * n + j[apart]).tolist())
        root = merge_in_order(root, position, agent, i.take(chosen), j.take(chosen), radius, excluded)
    return np.asarray(((root == np.arange(n)).cumsum() - 1)[root])


def connected_groups(n: int, i: Ints, j: Ints) -> Ints:
    """(n,) the first row that each row is connected with by pairs i < j, directly or by way of others."""
    group = np.arange(n)
    while True:
        least = np.minimum(group[i], group[j])
        before = group.copy()
        np.minimum.at(group, before[i], least)
        np.minimum.at(group, before[j], least)
        group = group[group]
        if np.array_equal(group, before):
            return group


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


def merge_in_order(
    root: Ints,
    position: Floats,
    agent: Ints,
    i: Ints,
    j: Ints,
    radius: float,
    excluded: Container[int] = (),
) -> Ints:
    """First row (n,) of each row's cluster after merging the pairs i < j in order.

    root: (n,) as for `split_simple_clusters`; unchanged for rows in none of the pairs
    excluded: pairs p < q of the n rows that are never in one cluster, as numbers p * n + q
    """
    root, n_rows = root.copy(), len(root)
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
        if excluded and any(min(r, s) * n_rows + max(r, s) in excluded for r in members[a] for s in members[b]):
            continue
        for row in members[b]:
            label[row] = a
        m, n = len(members[a]), len(members[b])
        centre[a] = ((m * ax + n * bx) / (m + n), (m * ay + n * by) / (m + n))
        members[a] += members[b]
        agents[a] |= agents[b]
    root[rows] = [label[row] for row in rows]
    return root
