"""One-to-one matching of rows and columns, such as measurements and tracks.

SciPy is the reference. With compiled kernels it is not imported, as that takes as long as all other imports of a node.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel

if kernels.USED == "numpy":  # now, and not in the middle of a frame
    import scipy.optimize
    import scipy.sparse.csgraph  # noqa: F401


def uncontested(row: Ints, column: Ints) -> Bools:
    """(p,) pairs both of whose ends are in no other pair; row, column: (p,) int64 >= 0."""
    if len(row) == 0:
        return np.zeros(0, bool)
    single: Bools = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    return single


def greedy_matching(row: Ints, column: Ints, cost: Floats) -> Bools:
    """(p,) bool: the cheapest pair first, then the cheapest of what remains; ties by row and column.

    row, column: (p,) int64 >= 0, no pair twice; cost: (p,)
    """
    chosen = uncontested(row, column)
    contested = (~chosen).nonzero()[0]
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
    """(p,) bool: the pairs of the one-to-one choice of least total cost.

    row, column: (p,) int64 >= 0, no pair twice
    cost:        (p,) below 0: what choosing the pair costs against leaving both ends out
    Raises ValueError for a cost that is not finite.

    Rows and columns that compete, directly or through others, form islands. Each is solved by itself with shortest
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
    island = label[r]
    order = np.argsort(island, kind="stable")
    for pairs in np.split(order, np.flatnonzero(np.diff(island[order])) + 1):
        mine_r, at_r = np.unique(r[pairs], return_inverse=True)
        mine_c, at_c = np.unique(c[pairs], return_inverse=True)
        # Zero is for "both left out", so that the complete choice of least cost contains the best partial one.
        table = np.zeros((len(mine_r), len(mine_c)))
        table[at_r, at_c] = cost[contested[pairs]]
        solved_r, solved_c = linear_sum_assignment(table)
        partner = np.full(len(mine_r), -1)
        partner[solved_r] = solved_c
        chosen[contested[pairs[partner[at_r] == at_c]]] = True
    return chosen
