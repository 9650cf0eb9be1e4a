# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The one-to-one choice of least total cost. The reference says what the function does."""

cimport numpy as np
from libc.math cimport INFINITY, isfinite

from mast_zenoh.kernels.arrays cimport floats, ints, length, made, octets, writable, zeros
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


cdef inline np.int64_t root_of(np.int64_t* above, np.int64_t node) noexcept nogil:
    """The first node of its island; ways there are shortened."""
    while above[node] != node:
        above[node] = above[above[node]]
        node = above[node]
    return node


cdef void solve(
    const double* cost, Py_ssize_t n, Py_ssize_t m, np.int64_t* partner, np.int64_t* of_row, np.int64_t* before,
    np.int64_t* open_columns, double* u, double* v, double* shortest, np.uint8_t* reached,
) noexcept nogil:
    """`partner` (m,): the row of each column or -1, in the complete choice of least total cost (n, m), n <= m.

    Room for of_row (n,), before, open_columns (m,), u (n,), v, shortest (m,), reached (m,) numbers is lent.
    """
    cdef Py_ssize_t row, column, new, k, nearest, left
    cdef double lowest, way
    for row in range(n):
        u[row] = 0.0
        of_row[row] = -1
    for column in range(m):
        v[column] = 0.0
        partner[column] = -1
    for new in range(n):
        # The cheapest way from the new row to a free column, along which pairs change partners (Dijkstra).
        for column in range(m):
            shortest[column] = INFINITY
            reached[column] = 0
            open_columns[column] = m - 1 - column
        left, lowest, row = m, 0.0, new
        while True:
            way = lowest - u[row]
            lowest, nearest = INFINITY, 0
            for k in range(left):
                column = open_columns[k]
                if way + cost[row * m + column] - v[column] < shortest[column]:
                    shortest[column] = way + cost[row * m + column] - v[column]
                    before[column] = row
                # Of columns that are as near, a free one ends the search.
                if shortest[column] < lowest or (shortest[column] == lowest and partner[column] < 0):
                    lowest, nearest = shortest[column], k
            column = open_columns[nearest]
            left -= 1
            open_columns[nearest] = open_columns[left]
            reached[column] = 1
            if partner[column] < 0:
                break
            row = partner[column]
        # What has been reached is as cheap to reach as the end of the way.
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


def cheapest(row, column, cost):
    cdef const np.int64_t* of_row = ints(row)
    cdef const np.int64_t* of_column = ints(column)
    cdef const double* costs = floats(cost, 1)
    cdef Py_ssize_t p, q, k, n, m, most = 0, broadest = 0, widest = 0, count = length(row)
    cdef np.int64_t rows = 0, nodes = 0, a, b
    for p in range(count):
        if not isfinite(costs[p]):
            raise ValueError("cost: found one that is not finite")
        rows, nodes = max(rows, of_row[p] + 1), max(nodes, of_column[p] + 1)
    nodes += rows
    result = zeros(np.NPY_BOOL, count)
    cdef np.uint8_t* chosen = octets(result)
    # Rows, and after them columns, are nodes; an island is named after its first node.
    ways, present = made(np.NPY_INT64, nodes), zeros(np.NPY_UINT8, nodes)
    numbers, ends = made(np.NPY_INT64, nodes), zeros(np.NPY_INT64, nodes + 1)
    of_rows, of_columns = zeros(np.NPY_INT64, nodes), zeros(np.NPY_INT64, nodes)
    by_island = made(np.NPY_INT64, count)
    cdef np.int64_t* above = ints(ways)
    cdef np.uint8_t* there = octets(present)
    cdef np.int64_t* local = ints(numbers)
    cdef np.int64_t* end = ints(ends)
    cdef np.int64_t* n_rows = ints(of_rows)
    cdef np.int64_t* n_columns = ints(of_columns)
    cdef np.int64_t* pair = ints(by_island)
    for a in range(nodes):
        above[a] = a
    for p in range(count):
        a, b = root_of(above, of_row[p]), root_of(above, rows + of_column[p])
        above[max(a, b)] = min(a, b)
        there[of_row[p]] = there[rows + of_column[p]] = 1
    for a in range(nodes):
        if there[a]:
            b = root_of(above, a)
            if a < rows:
                local[a] = n_rows[b]
                n_rows[b] += 1
            else:
                local[a] = n_columns[b]
                n_columns[b] += 1
    # Pairs by island: after this loop and the next, end[a] is where those of island a end.
    for p in range(count):
        end[root_of(above, of_row[p]) + 1] += 1
    for a in range(nodes):
        end[a + 1] += end[a]
        most = max(most, n_rows[a] * n_columns[a])
        broadest, widest = max(broadest, min(n_rows[a], n_columns[a])), max(widest, max(n_rows[a], n_columns[a]))
    for p in range(count):
        a = root_of(above, of_row[p])
        pair[end[a]] = p
        end[a] += 1
    table = zeros(np.NPY_DOUBLE, most)
    partners, columns = made(np.NPY_INT64, widest), made(np.NPY_INT64, broadest)
    ways_back, still_open = made(np.NPY_INT64, widest), made(np.NPY_INT64, widest)
    prices, values = made(np.NPY_DOUBLE, broadest), made(np.NPY_DOUBLE, widest)
    distances, visited = made(np.NPY_DOUBLE, widest), made(np.NPY_UINT8, widest)
    cdef double* square = writable(table, 1)
    cdef np.int64_t* partner = ints(partners)
    p = 0
    for a in range(rows):
        n, m = n_rows[a], n_columns[a]
        if end[a] == p:
            continue
        if end[a] == p + 1:
            chosen[pair[p]] = 1
            p += 1
            continue
        # The smaller side stands in the rows.
        for q in range(p, end[a]):
            k, b = local[of_row[pair[q]]], local[rows + of_column[pair[q]]]
            square[k * m + b if n <= m else b * n + k] = costs[pair[q]]
        solve(
            square, min(n, m), max(n, m), partner, ints(columns), ints(ways_back), ints(still_open),
            writable(prices, 1), writable(values, 1), writable(distances, 1), octets(visited),
        )
        for q in range(p, end[a]):
            k, b = local[of_row[pair[q]]], local[rows + of_column[pair[q]]]
            chosen[pair[q]] = partner[b] == k if n <= m else partner[k] == b
            square[k * m + b if n <= m else b * n + k] = 0.0
        p = end[a]
    return result
