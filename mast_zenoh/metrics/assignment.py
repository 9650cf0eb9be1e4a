"""Which track is which truth object: one-to-one, for all frames of a run in one call."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mast_zenoh.metrics.boxes import Boxes, centre_distance, pairs_within
from mast_zenoh.metrics.overlap import iou_3d
from mast_zenoh.states import Bools, Floats, Ints


class Assigner(ABC):
    """Pairs truth objects with tracks."""

    def assign(self, truth: Boxes, tracks: Boxes) -> Ints:
        """(m, 2) int64: rows of `truth` and of `tracks` that belong together, sorted by the former.

        Only boxes of one group are paired, each at most once. The pairs do not depend on the order of the rows.
        """
        if len(truth) == 0 or len(tracks) == 0:
            return np.zeros((0, 2), np.int64)
        (truth, by_truth), (tracks, by_track) = truth.sorted(), tracks.sorted()
        i, j = self._assign(truth, tracks)
        pairs = np.column_stack([by_truth[i], by_track[j]])
        return pairs[np.argsort(pairs[:, 0])]

    @abstractmethod
    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        """Rows of the pairs, given boxes in their own order (`Boxes.sorted`), some on either side."""


class CenterDistanceAssigner(Assigner):
    """Optimal assignment on bird's-eye centre distance.

    As many pairs within `gate_m` as can be and, of these choices, the one of least total distance: the same as the
    Hungarian method on the whole cost matrix of each frame with all costs beyond the gate prohibitive. Only objects
    and tracks that compete are put through it.
    """

    def __init__(self, *, gate_m: float = 2.0) -> None:
        if not gate_m > 0.0:
            raise ValueError(f"gate_m: found {gate_m}, expected more than 0")
        self.gate_m = gate_m

    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        i, j = pairs_within(truth, tracks, self.gate_m)
        distance = centre_distance(truth.position[i], tracks.position[j])
        near = distance <= self.gate_m
        i, j, distance = i[near], j[near], distance[near]
        chosen = _cheapest(i, j, distance, self.gate_m)
        return i[chosen], j[chosen]


class IoU3DGreedyAssigner(Assigner):
    """Greedy assignment on 3D overlap: the best pair first, then the best of what is left, down to `threshold`."""

    def __init__(self, *, threshold: float = 0.3) -> None:
        if not 0.0 < threshold <= 1.0:
            raise ValueError(f"threshold: found {threshold}, expected more than 0, at most 1")
        self.threshold = threshold

    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        reach = [np.hypot(boxes.size[:, 0], boxes.size[:, 1]) / 2.0 for boxes in (truth, tracks)]
        i, j = pairs_within(truth, tracks, float(reach[0].max() + reach[1].max()))
        touching = centre_distance(truth.position[i], tracks.position[j]) <= reach[0][i] + reach[1][j]
        i, j = i[touching], j[touching]
        iou = iou_3d(truth.select(i), tracks.select(j))
        good = iou >= self.threshold
        i, j, iou = i[good], j[good], iou[good]
        single = alone(i, j)
        free_truth, free_track = np.ones(len(truth), bool), np.ones(len(tracks), bool)
        chosen = single.copy()
        contested = np.flatnonzero(~single)
        for pair in contested[np.lexsort((j[contested], i[contested], -iou[contested]))]:
            if free_truth[i[pair]] and free_track[j[pair]]:
                free_truth[i[pair]] = free_track[j[pair]] = False
                chosen[pair] = True
        return i[chosen], j[chosen]


def alone(i: Ints, j: Ints) -> Bools:
    """(p,) pairs both of whose ends are in no other pair."""
    if len(i) == 0:
        return np.zeros(0, bool)
    single: Bools = (np.bincount(i)[i] == 1) & (np.bincount(j)[j] == 1)
    return single


def _cheapest(i: Ints, j: Ints, cost: Floats, limit: float) -> Bools:
    """(p,) the pairs of a matching with the most pairs and, of these, the least total cost; costs are 0 to `limit`."""
    chosen = alone(i, j)
    contested = np.flatnonzero(~chosen)
    if len(contested) == 0:
        return chosen
    # Objects that compete directly or through others form islands, each solved by itself.
    rows, r = np.unique(i[contested], return_inverse=True)
    columns, c = np.unique(j[contested], return_inverse=True)
    size = len(rows) + len(columns)
    graph = coo_array((np.ones(len(contested), np.int8), (r, c + len(rows))), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    island = label[r]
    order = np.argsort(island, kind="stable")
    for edges in np.split(order, np.flatnonzero(np.diff(island[order])) + 1):
        mine_r, at_r = np.unique(r[edges], return_inverse=True)
        mine_c, at_c = np.unique(c[edges], return_inverse=True)
        if min(len(mine_r), len(mine_c)) == 1:
            chosen[contested[edges[np.argmin(cost[contested[edges]])]]] = True
            continue
        prohibitive = 1.0 + limit * (min(len(mine_r), len(mine_c)) + 1)
        table = np.full((len(mine_r), len(mine_c)), prohibitive)
        table[at_r, at_c] = cost[contested[edges]]
        solved_r, solved_c = linear_sum_assignment(table)
        partner = np.full(len(mine_r), -1)
        partner[solved_r] = solved_c
        chosen[contested[edges[partner[at_r] == at_c]]] = True
    return chosen
