# cython: language_level=3, cdivision=True
"""Kernels of the detector of points by clusters. The NumPy references document them, and make the same numbers."""

cimport numpy as np
from libc.math cimport fabs, floor, sqrt
from libc.stdlib cimport calloc, free, malloc
from libc.string cimport memset

from mast_zenoh.kernels.arrays cimport contiguous, data_pointer, empty_vector, float_data, int_data, length
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

import numpy

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef np.int32_t NONE = 1 << 30


cdef inline np.int32_t* singles(np.ndarray array, int axes) except NULL:
    return <np.int32_t*>data_pointer(array, np.NPY_INT32, axes)


def lowest_by_cell(position, int reach_mm, int depth_mm, int cell_mm):
    position = contiguous(position)
    cdef const float* at = <const float*>data_pointer(position, np.NPY_FLOAT, 2)
    cdef Py_ssize_t r, kept = 0, n = length(position)
    cdef int side = 2 * reach_mm // cell_mm
    cdef double x, y, z, per_cell = 1.0 / cell_mm, reach = reach_mm, depth = depth_mm
    cdef np.int32_t* cell
    cdef np.int32_t i, j
    whole = numpy.empty((n, 3), numpy.int32)
    lowest = numpy.full((side, side), NONE, numpy.int32)
    cdef np.int32_t* out = singles(whole, 2)
    cdef np.int32_t* low = singles(lowest, 2)
    for r in range(n):
        x, y, z = 1000.0 * at[3 * r], 1000.0 * at[3 * r + 1], 1000.0 * at[3 * r + 2]
        if not (fabs(x) < reach - 1.0 and fabs(y) < reach - 1.0 and fabs(z) < depth):
            continue
        i, j = <np.int32_t>(x + reach + 0.5), <np.int32_t>(y + reach + 0.5)
        out[0], out[1], out[2] = i - reach_mm, j - reach_mm, <np.int32_t>(z + depth + 0.5) - depth_mm
        # Halves of whole numbers are far from the ends of cells: the product is as exact as a division.
        cell = low + <np.int32_t>((i + 0.5) * per_cell) * side + <np.int32_t>((j + 0.5) * per_cell)
        if out[2] < cell[0]:
            cell[0] = out[2]
        out, kept = out + 3, kept + 1
    return whole[:kept], lowest


def ground_surface(lowest, plane, int step_mm, int unseen_mm, int pit_mm):
    cdef const np.int32_t* low = singles(lowest, 2)
    cdef const np.int32_t* flat = singles(plane, 2)
    cdef Py_ssize_t i, j, k, u, v, n = length(lowest), m = length(lowest, 1), wide = m + 2
    cdef np.int32_t best, straight, across, around
    cdef bint changed = True, forward = True
    padded, steps = numpy.full((n + 2, wide), NONE, numpy.int32), numpy.empty((n + 2, wide), numpy.int32)
    cdef np.int32_t* z = singles(padded, 2)
    cdef np.int32_t* step = singles(steps, 2)
    for i in range(n):
        for j in range(m):
            k = (i + 1) * wide + j + 1
            step[k] = unseen_mm
            if low[i * m + j] == NONE:
                continue
            step[k] = step_mm
            around = NONE
            for u in range(max(i - 1, 0), min(i + 2, n)):
                for v in range(max(j - 1, 0), min(j + 2, m)):
                    if (u != i or v != j) and low[u * m + v] != NONE:
                        around = min(around, low[u * m + v] - flat[u * m + v])
            z[k] = low[i * m + j] - flat[i * m + j]
            if around != NONE:
                z[k] = max(z[k], around - pit_mm)
    while changed:
        changed = False
        for i in range(n):
            for j in range(m):
                k = (i + 1) * wide + j + 1 if forward else (n - i) * wide + m - j
                straight = step[k]
                across = straight + straight * 2 // 5
                best = min(min(z[k - 1], z[k + 1]), min(z[k - wide], z[k + wide])) + straight
                best = min(
                    best,
                    min(min(z[k - wide - 1], z[k - wide + 1]), min(z[k + wide - 1], z[k + wide + 1])) + across,
                )
                if best < z[k]:
                    z[k], changed = best, True
        forward = not forward
    return padded[1:-1, 1:-1] + plane


cdef inline np.int32_t root(np.int32_t* parent, np.int32_t cell) noexcept nogil:
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


def connected_cells(whole, ground, int reach_mm, body, int cell_mm, int growth_mm):
    cdef const np.int32_t* at = singles(whole, 2)
    cdef const np.int32_t* level = singles(ground, 2)
    cdef int low = body[0], high = body[1], side = 2 * reach_mm // cell_mm + 1
    cdef int coarse = length(ground), coarse_mm = 2 * reach_mm // coarse
    cdef Py_ssize_t r, k, cells = 0, raised = 0, n = length(whole), grid = side * side
    cdef np.int32_t cell, other, first, second, i, j, u, v, reach, x, y, height, count = 0
    cdef double per_cell = 1.0 / cell_mm, per_coarse = 1.0 / coarse_mm, east, north
    cdef np.int32_t steepness
    label, height_mm = numpy.full(n, -1, numpy.int32), numpy.empty(n, numpy.int32)
    cdef np.int32_t* out = singles(label, 1)
    cdef np.int32_t* heights = singles(height_mm, 1)
    cdef np.int32_t* entry
    cdef np.int32_t* parent = <np.int32_t*>malloc(grid * sizeof(np.int32_t))
    cdef np.int32_t* occupied = <np.int32_t*>malloc((n + 1) * sizeof(np.int32_t))
    cdef np.int32_t* above = <np.int32_t*>malloc((n + 1) * sizeof(np.int32_t))  # rows
    cdef np.uint64_t* bits = <np.uint64_t*>calloc(grid // 64 + 1, sizeof(np.uint64_t))  # of occupied cells
    cdef np.uint64_t word
    if parent == NULL or occupied == NULL or above == NULL or bits == NULL:
        free(parent)
        free(occupied)
        free(above)
        free(bits)
        raise MemoryError()
    memset(parent, 255, grid * sizeof(np.int32_t))  # -1
    for r in range(n):
        x, y = at[3 * r] + reach_mm, at[3 * r + 1] + reach_mm
        cell = <np.int32_t>((x + 0.5) * per_coarse) * coarse + <np.int32_t>((y + 0.5) * per_coarse)
        height = heights[r] = at[3 * r + 2] - level[cell]
        if height <= low:
            continue
        above[raised] = r
        raised += 1
        cell = out[r] = <np.int32_t>((x + 0.5) * per_cell) * side + <np.int32_t>((y + 0.5) * per_cell)
        if height <= high and parent[cell] < 0:
            parent[cell] = cell
            bits[cell // 64] |= <np.uint64_t>1 << (cell % 64)
    for k in range(grid // 64 + 1):
        word = bits[k]
        cell = <np.int32_t>(64 * k)
        while word:
            if word & 1:
                occupied[cells] = cell
                cells += 1
            word >>= 1
            cell += 1
    for k in range(cells):
        cell = occupied[k]
        i, j = cell // side, cell % side
        x, y = abs(i * cell_mm - reach_mm), abs(j * cell_mm - reach_mm)
        reach = 1 + max(x, y) // growth_mm
        first = root(parent, cell)
        for u in range(max(i - reach, 0), min(i + reach, side - 1) + 1):
            for v in range(max(j - reach, 0), min(j + reach, side - 1) + 1):
                other = u * side + v
                if parent[other] >= 0:
                    second = root(parent, other)
                    if second < first:
                        parent[first], first = second, second
                    elif first < second:
                        parent[second] = first
    for k in range(cells):  # the root is the first cell of each component; numbers of components are below -1
        cell = occupied[k]
        first = parent[cell]
        if first == cell:
            parent[cell] = -2 - count
            count += 1
        else:
            while parent[first] >= 0:
                first = parent[first]
            parent[cell] = parent[first]
    summary = numpy.zeros((count, 8), numpy.int32)
    summary[:, 1] = summary[:, 3] = NONE
    summary[:, 2] = summary[:, 4] = summary[:, 7] = -NONE
    cdef np.int32_t* table = singles(summary, 2)
    for k in range(raised):
        r = above[k]
        first = -2 - parent[out[r]]
        if first < 0:
            out[r] = -1
            continue
        entry = table + 8 * first
        x, y = at[3 * r], at[3 * r + 1]
        east, north = x, y
        steepness = <np.int32_t>floor(1e4 * at[3 * r + 2] / sqrt(east * east + north * north + 1.0))
        entry[7] = max(entry[7], steepness)
        if heights[r] > high:
            out[r] = -1
            entry[6] += 1
            continue
        out[r] = first
        entry[0] += 1
        entry[1], entry[2] = min(entry[1], x), max(entry[2], x)
        entry[3], entry[4] = min(entry[3], y), max(entry[4], y)
        entry[5] = max(entry[5], heights[r])
    free(parent)
    free(occupied)
    free(above)
    free(bits)
    return label, height_mm, summary


cdef long long closeness(const double* x, const double* y, Py_ssize_t n, double cosine, double sine, double near) noexcept nogil:
    cdef double first, second, low = 1e300, high = -1e300, left = 1e300, right = -1e300, gap
    cdef long long total = 0
    cdef Py_ssize_t k
    for k in range(n):
        first, second = x[k] * cosine + y[k] * sine, y[k] * cosine - x[k] * sine
        low, high = min(low, first), max(high, first)
        left, right = min(left, second), max(right, second)
    for k in range(n):
        first, second = x[k] * cosine + y[k] * sine, y[k] * cosine - x[k] * sine
        gap = min(min(first - low, high - first), min(second - left, right - second))
        total += <long long>(1e6 / max(gap, near))
    return total


def rectangle_turns(plan, start, axes, int coarse, int least_mm, int across, double near_mm):
    plan, axes = contiguous(plan), contiguous(axes)
    cdef const np.int32_t* at = singles(plan, 2)
    cdef const np.int64_t* first = int_data(start)
    cdef const double* axis = float_data(axes, 2)
    cdef Py_ssize_t c, r, k, n, cell, count = length(start) - 1, turns = length(axes)
    cdef Py_ssize_t best, turn, place
    cdef long long score, highest
    cdef np.int32_t low_x, low_y, high_x, high_y, cell_mm, width
    cdef np.int64_t* sums = <np.int64_t*>malloc(3 * (across + 1) * (across + 1) * sizeof(np.int64_t))
    cdef double* x = <double*>malloc(2 * (across + 1) * (across + 1) * sizeof(double))
    cdef double* y = x + (across + 1) * (across + 1)
    result = empty_vector(np.NPY_INT64, count)
    cdef np.int64_t* out = int_data(result)
    if sums == NULL or x == NULL:
        free(sums)
        free(x)
        raise MemoryError()
    for c in range(count):
        low_x = low_y = NONE
        high_x = high_y = -NONE
        for r in range(first[c], first[c + 1]):
            low_x, high_x = min(low_x, at[2 * r]), max(high_x, at[2 * r])
            low_y, high_y = min(low_y, at[2 * r + 1]), max(high_y, at[2 * r + 1])
        cell_mm = max(least_mm, max(high_x - low_x, high_y - low_y) // across + 1)
        width = (high_y - low_y) // cell_mm + 1
        n = ((high_x - low_x) // cell_mm + 1) * width
        memset(sums, 0, 3 * n * sizeof(np.int64_t))
        for r in range(first[c], first[c + 1]):
            cell = 3 * (((at[2 * r] - low_x) // cell_mm) * width + (at[2 * r + 1] - low_y) // cell_mm)
            sums[cell] += 1
            sums[cell + 1] += at[2 * r] - low_x
            sums[cell + 2] += at[2 * r + 1] - low_y
        k = 0
        for cell in range(n):
            if sums[3 * cell]:
                x[k] = <double>sums[3 * cell + 1] / <double>sums[3 * cell]
                y[k] = <double>sums[3 * cell + 2] / <double>sums[3 * cell]
                k += 1
        best, highest = 0, -1
        for turn in range(0, turns, coarse):
            score = closeness(x, y, k, axis[2 * turn], axis[2 * turn + 1], near_mm)
            if score > highest:
                best, highest = turn, score
        place = best
        for turn in range(place - coarse + 1, place + coarse):
            r = (turn + turns) % turns
            score = closeness(x, y, k, axis[2 * r], axis[2 * r + 1], near_mm)
            if score > highest:
                best, highest = r, score
        out[c] = best
    free(sums)
    free(x)
    return result
