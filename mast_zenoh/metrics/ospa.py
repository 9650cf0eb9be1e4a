"""Distances between the set of truth objects and the set of tracks: OSPA and GOSPA, for all frames in one call.

Sources: Schuhmacher, Vo and Vo, A consistent metric for performance evaluation of multi-object filters (2008);
Rahmathullah, Garcia-Fernandez and Svensson, Generalized optimal sub-pattern assignment metric (2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mast_zenoh.metrics.assignment import alone
from mast_zenoh.metrics.boxes import Boxes, centre_distance, pairs_within
from mast_zenoh.states import Bools, Floats, Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class SetDistance:
    """Parameters of OSPA and GOSPA.

    c: m, distance at which two objects count as different ones: what a missed or a false object costs
    p: order of the mean: the greater, the more outliers weigh
    alpha: of GOSPA, above 0 up to 2: a missed or false object costs c^p / alpha; at 2 it separates exactly into
           localisation, missed and false
    Raises ValueError for values that make no sense.
    """

    c: float = 5.0
    p: float = 2.0
    alpha: float = 2.0

    def __post_init__(self) -> None:
        if not self.c > 0.0:
            raise ValueError(f"c: found {self.c}, expected more than 0")
        if not 1.0 <= self.p < np.inf:
            raise ValueError(f"p: found {self.p}, expected 1 or more")
        if not 0.0 < self.alpha <= 2.0:
            raise ValueError(f"alpha: found {self.alpha}, expected more than 0, at most 2")

    def of(self, truth: Boxes, tracks: Boxes, n_groups: int) -> tuple[Floats, Floats]:
        """OSPA and GOSPA of every group, both (n_groups,) m; 0 of two empty sets.

        With X the smaller set of m and Y the greater of n objects, d the bird's-eye distance of centres, and the
        least sum S over one-to-one assignments of X into Y of min(d, c)^p:
        OSPA = ((S + c^p (n - m)) / n)^(1/p), GOSPA = (S + c^p / alpha (n - m))^(1/p).
        """
        truth, tracks = (boxes.sorted()[0] for boxes in (truth, tracks))
        counts = [np.bincount(boxes.group, minlength=n_groups) for boxes in (truth, tracks)]
        fewer, more = np.minimum(*counts), np.maximum(*counts)
        cut = self.c**self.p
        gained = self._gained(truth, tracks, n_groups)
        ospa = np.divide(cut * more - gained, more, out=np.zeros(n_groups), where=more > 0)
        gospa = cut * fewer - gained + cut / self.alpha * (more - fewer)
        root = 1.0 / self.p
        return np.maximum(ospa, 0.0) ** root, np.maximum(gospa, 0.0) ** root

    def _gained(self, truth: Boxes, tracks: Boxes, n_groups: int) -> Floats:
        """(n_groups,) m^p: what the best assignment saves over one in which all pairs are c apart: c^p · m - S.

        Only pairs nearer than c save anything: S is found as the matching of greatest saving in that sparse graph,
        island by island.
        """
        i, j = pairs_within(truth, tracks, self.c)
        distance = centre_distance(truth.position[i], tracks.position[j])
        near = distance < self.c
        i, j = i[near], j[near]
        saving = self.c**self.p - distance[near] ** self.p
        lone = alone(i, j)
        gained = np.bincount(truth.group[i[lone]], saving[lone], minlength=n_groups).astype(np.float64)
        i, j, saving = i[~lone], j[~lone], saving[~lone]
        if len(i) == 0:
            return gained
        (r, rows), (c, columns) = _ranks(i, len(truth)), _ranks(j, len(tracks))
        graph = coo_array((np.ones(len(i), np.int8), (r, c + rows)), shape=(rows + columns, rows + columns))
        n_islands, label = connected_components(graph, directed=False)
        island = label[r]
        # Where nobody's nearest is the nearest of another as well, taking the nearest is the best there is.
        solved, chosen = np.zeros(n_islands, bool), np.zeros(len(i), bool)
        for favourites, other in ((_favourites(r, saving), c), (_favourites(c, saving), r)):
            clash = np.zeros(n_islands, bool)
            clash[island[favourites & (np.bincount(other[favourites], minlength=other.max() + 1)[other] > 1)]] = True
            chosen |= favourites & ~(clash | solved)[island]
            solved |= ~clash
        gained += np.bincount(truth.group[i[chosen]], saving[chosen], minlength=n_groups)
        left = np.flatnonzero(~solved[island])
        left = left[np.argsort(island[left], kind="stable")]
        for edges in np.split(left, np.flatnonzero(np.diff(island[left])) + 1):
            if len(edges):
                gained[truth.group[i[edges[0]]]] += _best(i[edges], j[edges], saving[edges])
        return gained


def _ranks(values: Ints, n: int) -> tuple[Ints, int]:
    """The rank of each value, 0 to n - 1, among those that occur, and how many these are."""
    present = np.zeros(n, np.int64)
    present[values] = 1
    ranks = present.cumsum()
    return ranks[values] - 1, int(ranks[-1])


def _favourites(end: Ints, saving: Floats) -> Bools:
    """(e,) of the edges at each end the one that saves most; the first of several."""
    order = np.argsort(end, kind="stable")
    start = np.flatnonzero(np.diff(end[order], prepend=-1))
    most = np.maximum.reduceat(saving[order], start)
    best = order[saving[order] == np.repeat(most, np.diff(start, append=len(end)))]
    mask = np.zeros(len(end), bool)
    mask[best[np.diff(end[best], prepend=-1) != 0]] = True
    return mask


def _best(i: Ints, j: Ints, saving: Floats) -> float:
    """The greatest saving of a matching of one island."""
    rows, r = np.unique(i, return_inverse=True)
    columns, c = np.unique(j, return_inverse=True)
    table = np.zeros((len(rows), len(columns)))
    table[r, c] = saving
    return float(table[linear_sum_assignment(table, maximize=True)].sum())
