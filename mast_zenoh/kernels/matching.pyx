# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Kernel of minimum-cost one-to-one matching. The NumPy reference documents it."""

cimport numpy as np
from libc.math cimport INFINITY, isfinite

from mast_zenoh.kernels.arrays cimport (
    byte_data, empty_vector, float_data, int_data, length, writable_data, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


cdef inline np.int64_t root_of(np.int64_t* parent, np.int64_t node) noexcept nogil:
    """The root of the node's component (union-find with path compression)."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


cdef void solve(
    const double* cost, Py_ssize_t n, Py_ssize_t m, np.int64_t* partner, np.int64_t* of_row, np.int64_t* before,
    np.int64_t* open_columns, double* u, double* v, double* shortest, np.uint8_t* reached,
) noexcept nogil:
    """Complete matching of minimum total cost (n, m), n <= m: `partner` (m,) is the row of each column, or -1.

    The caller provides the work arrays of_row (n,), before, open_columns (m,), u (n,), v, shortest (m,), reached (m,).
    """
    cdef Py_ssize_t row, column, new, k, nearest, left
    cdef double lowest, path_cost
    for row in range(n):
        u[row] = 0.0
        of_row[row] = -1
    for column in range(m):
        v[column] = 0.0
        partner[column] = -1
    for new in range(n):
        # The shortest augmenting path from the new row to a free column (Dijkstra).
        for column in range(m):
            shortest[column] = INFINITY
            reached[column] = 0
            open_columns[column] = m - 1 - column
        left, lowest, row = m, 0.0, new
        while True:
            path_cost = lowest - u[row]
            lowest, nearest = INFINITY, 0
            for k in range(left):
                column = open_columns[k]
                if path_cost + cost[row * m + column] - v[column] < shortest[column]:
                    shortest[column] = path_cost + cost[row * m + column] - v[column]
                    before[column] = row
                # Among equally near columns, a free one ends the search.
                if shortest[column] < lowest or (shortest[column] == lowest and partner[column] < 0):
                    lowest, nearest = shortest[column], k
            column = open_columns[nearest]
            left -= 1
            open_columns[nearest] = open_columns[left]
            reached[column] = 1
            if partner[column] < 0:
                break
            row = partner[column]
        # Update the dual variables of the reached rows and columns.
        u[new] += lowest
        for k in range(m):
            if reached[k]:
                if partner[k] >= 0:
                    u[partner[k]] += lowest - shortest[k]
                v[k] -= lowest - shortest[k]
        while True:
            row = before[column]
            partner[column] = row
            k, of_row[row] = of_row[row], column
            column = k
            if row == new:
                break


def min_cost_matching(row, column, cost):
    cdef const np.int64_t* of_row = int_data(row)
    cdef const np.int64_t* of_column = int_data(column)
    cdef const double* costs = float_data(cost, 1)
    cdef Py_ssize_t p, q, k, n, m, largest_table = 0, max_rows = 0, max_columns = 0, count = length(row)
    cdef np.int64_t rows = 0, nodes = 0, a, b
    for p in range(count):
        if not isfinite(costs[p]):
            raise ValueError("cost: found one that is not finite")
        rows, nodes = max(rows, of_row[p] + 1), max(nodes, of_column[p] + 1)
    nodes += rows
    result = zero_vector(np.NPY_BOOL, count)
    cdef np.uint8_t* chosen = byte_data(result)
    # Nodes are rows, then columns; a component is identified by its root.
    parents, present = empty_vector(np.NPY_INT64, nodes), zero_vector(np.NPY_UINT8, nodes)
    local_indices, ends = empty_vector(np.NPY_INT64, nodes), zero_vector(np.NPY_INT64, nodes + 1)
    of_rows, of_columns = zero_vector(np.NPY_INT64, nodes), zero_vector(np.NPY_INT64, nodes)
    by_component = empty_vector(np.NPY_INT64, count)
    cdef np.int64_t* parent = int_data(parents)
    cdef np.uint8_t* used = byte_data(present)
    cdef np.int64_t* local = int_data(local_indices)
    cdef np.int64_t* end = int_data(ends)
    cdef np.int64_t* n_rows = int_data(of_rows)
    cdef np.int64_t* n_columns = int_data(of_columns)
    cdef np.int64_t* pair = int_data(by_component)
    for a in range(nodes):
        parent[a] = a
    for p in range(count):
        a, b = root_of(parent, of_row[p]), root_of(parent, rows + of_column[p])
        parent[max(a, b)] = min(a, b)
        used[of_row[p]] = used[rows + of_column[p]] = 1
    for a in range(nodes):
        if used[a]:
            b = root_of(parent, a)
            if a < rows:
                local[a] = n_rows[b]
                n_rows[b] += 1
            else:
                local[a] = n_columns[b]
                n_columns[b] += 1
    # Pairs by component: after this loop and the next, end[a] is the end of those of component a.
    for p in range(count):
        end[root_of(parent, of_row[p]) + 1] += 1
    for a in range(nodes):
        end[a + 1] += end[a]
        largest_table = max(largest_table, n_rows[a] * n_columns[a])
        max_rows, max_columns = max(max_rows, min(n_rows[a], n_columns[a])), max(max_columns, max(n_rows[a], n_columns[a]))
    for p in range(count):
        a = root_of(parent, of_row[p])
        pair[end[a]] = p
        end[a] += 1
    table = zero_vector(np.NPY_DOUBLE, largest_table)
    partners, columns = empty_vector(np.NPY_INT64, max_columns), empty_vector(np.NPY_INT64, max_rows)
    predecessors, still_open = empty_vector(np.NPY_INT64, max_columns), empty_vector(np.NPY_INT64, max_columns)
    row_duals, column_duals = empty_vector(np.NPY_DOUBLE, max_rows), empty_vector(np.NPY_DOUBLE, max_columns)
    distances, visited = empty_vector(np.NPY_DOUBLE, max_columns), empty_vector(np.NPY_UINT8, max_columns)
    cdef double* square = writable_data(table, 1)
    cdef np.int64_t* partner = int_data(partners)
    p = 0
    for a in range(rows):
        n, m = n_rows[a], n_columns[a]
        if end[a] == p:
            continue
        if end[a] == p + 1:
            chosen[pair[p]] = 1
            p += 1
            continue
        # The smaller side becomes the rows.
        for q in range(p, end[a]):
            k, b = local[of_row[pair[q]]], local[rows + of_column[pair[q]]]
            square[k * m + b if n <= m else b * n + k] = costs[pair[q]]
        solve(
            square, min(n, m), max(n, m), partner, int_data(columns), int_data(predecessors), int_data(still_open),
            writable_data(row_duals, 1), writable_data(column_duals, 1), writable_data(distances, 1), byte_data(visited),
        )
        for q in range(p, end[a]):
            k, b = local[of_row[pair[q]]], local[rows + of_column[pair[q]]]
            chosen[pair[q]] = partner[b] == k if n <= m else partner[k] == b
            square[k * m + b if n <= m else b * n + k] = 0.0
        p = end[a]
    return result
