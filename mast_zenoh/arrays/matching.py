"""One-to-one matching of rows and columns, such as measurements and tracks.

SciPy is the reference. With compiled kernels it is not imported, as that takes as long as all other imports of a node.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel

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
