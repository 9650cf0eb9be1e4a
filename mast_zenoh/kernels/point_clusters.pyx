# cython: language_level=3, cdivision=True
"""Kernels of the detector of points by clusters. The NumPy references document them, and make the same numbers."""

cimport numpy as np
from libc.math cimport INFINITY, fabs, sqrt
from libc.stdlib cimport abs
from libc.string cimport memset

from mast_zenoh.kernels.arrays cimport byte_data, contiguous, data_pointer, float_data, int_data, length, writable_data
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

import numpy

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef np.int32_t NONE = 1 << 30


cdef inline np.int32_t* singles(np.ndarray array, int axes) except NULL:
    return <np.int32_t*>data_pointer(array, np.NPY_INT32, axes)


cdef inline np.int64_t inverse_of(np.int64_t divisor) noexcept nogil:
    return (1LL << 40) // divisor + 1


cdef inline np.int32_t quotient(np.int64_t number, np.int64_t inverse) noexcept nogil:
    """Exactly number // divisor, both below a million, without a division."""
    return <np.int32_t>(number * inverse >> 40)


def lowest_by_cell(position, int reach_mm, int depth_mm, int cell_mm):
    position = contiguous(position)
    cdef const float* at = <const float*>data_pointer(position, np.NPY_FLOAT, 2)
    cdef Py_ssize_t begin, end, k, kept = 0, n = length(position)
    cdef int side = 2 * reach_mm // cell_mm, farthest = max(reach_mm, depth_mm)
    cdef double value, limit = farthest
    cdef np.int64_t per_cell = inverse_of(cell_mm)
    cdef np.int32_t[768] whole
    points, lowest = numpy.empty((n, 4), numpy.int32), numpy.full((side, side), NONE, numpy.int32)
    cdef np.int32_t* out = singles(points, 2)
    cdef np.int32_t* low = singles(lowest, 2)
    for begin in range(0, n, 256):
        end = 3 * min(256, n - begin)
        for k in range(end):  # several at once, in one instruction
            value = 1000.0 * at[3 * begin + k]
            whole[k] = <np.int32_t>((value if fabs(value) < limit else limit) + limit + 0.5) - farthest
        for k in range(0, end, 3):
            if abs(whole[k]) < reach_mm and abs(whole[k + 1]) < reach_mm and abs(whole[k + 2]) < depth_mm:
                out[0], out[1], out[2] = whole[k], whole[k + 1], whole[k + 2]
                out[3] = quotient(out[0] + reach_mm, per_cell) * side + quotient(out[1] + reach_mm, per_cell)
                if out[2] < low[out[3]]:
                    low[out[3]] = out[2]
                out, kept = out + 4, kept + 1
    return points[:kept], lowest


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


cdef inline double steeper(double best, double x, double y, double z) noexcept nogil:
    """The greater of `best` and z by distance in plan."""
    cdef double square = x * x + y * y + 1.0
    if z * fabs(z) > best * (fabs(best) - 1e-9 * best) * square:  # worth a root and a division
        best = max(best, z / sqrt(square))
    return best


def clusters_above(points, ground, int reach_mm, body, int cell_mm, int growth_mm, limits):
    cdef const np.int32_t* at = singles(points, 2)
    cdef const np.int32_t* level = singles(ground, 2)
    cdef np.int32_t low = body[0], high = body[1], least = limits[0], tallest = limits[1], below = limits[2]
    cdef np.int64_t longest = limits[3], wide, deep
    cdef Py_ssize_t r, k, raised = 0, clusters = 0, kept = 0, n = length(points)
    cdef np.int32_t side = 2 * reach_mm // cell_mm + 1, cell, other, first, second, i, j, u, v, reach, height, count = 0
    cdef np.int64_t per_cell = inverse_of(cell_mm)
    cdef double steepest = -NONE
    # Larger than all other arrays of a scan, though not used: else malloc returns their memory to the system, which
    # clears it again for the next scan, in up to a millisecond.
    marked, scratch = numpy.zeros(side * side, bool), numpy.empty(side * side + 9 * n, numpy.int32)
    cdef np.uint8_t* occupied = byte_data(marked)
    cdef np.int32_t* parent = singles(scratch, 1)  # of a cell; then its component
    cdef np.int32_t* records = parent + side * side  # row, height, cell of points above the ground
    cdef np.int32_t* record = records
    cdef np.int32_t* entry
    cdef const np.int32_t* point
    for r in range(n):
        height = at[4 * r + 2] - level[at[4 * r + 3]]
        if height <= low:
            continue
        cell = quotient(at[4 * r] + reach_mm, per_cell) * side + quotient(at[4 * r + 1] + reach_mm, per_cell)
        record[0], record[1], record[2] = r, height, cell
        record, raised = record + 3, raised + 1
        occupied[cell] |= height <= high
    places = numpy.flatnonzero(marked)
    cdef np.int64_t* place = int_data(places)
    for k in range(len(places)):
        parent[place[k]] = <np.int32_t>place[k]
    for k in range(len(places)):
        cell = <np.int32_t>place[k]
        i, j = cell // side, cell % side
        reach = 1 + max(abs(i * cell_mm - reach_mm), abs(j * cell_mm - reach_mm)) // growth_mm
        first = root(parent, cell)
        for u in range(max(i - reach, 0), min(i + reach, side - 1) + 1):
            for v in range(max(j - reach, 0), min(j + reach, side - 1) + 1):
                other = u * side + v
                if occupied[other]:
                    second = root(parent, other)
                    if second < first:
                        parent[first], first = second, second
                    elif first < second:
                        parent[second] = first
    for k in range(len(places)):  # the root is the first cell of each component; -1 - number replaces it
        cell = <np.int32_t>place[k]
        if parent[cell] == cell:
            count += 1
            parent[cell] = -count
        else:
            parent[cell] = parent[parent[cell]]
    table = numpy.zeros((count, 7), numpy.int32)  # points; least and greatest x, y; height; whether some are overhead
    table[:, 1] = table[:, 3] = NONE
    table[:, 2] = table[:, 4] = -NONE
    cdef np.int32_t* summary = singles(table, 2)
    record = records
    for r in range(raised):
        if not occupied[record[2]]:
            record[2] = -1
        else:
            point, height = at + 4 * record[0], record[1]
            record[2] = -1 - parent[record[2]]
            entry = summary + 7 * record[2]
            steepest = steeper(steepest, point[0], point[1], point[2])
            if height > high:
                entry[6], record[2] = True, -1
            else:
                entry[0] += 1
                entry[1], entry[2] = min(entry[1], point[0]), max(entry[2], point[0])
                entry[3], entry[4] = min(entry[3], point[1]), max(entry[4], point[1])
                entry[5] = max(entry[5], height)
        record += 3
    starts = numpy.zeros(count + 1, numpy.int64)
    cdef np.int64_t* start = int_data(starts)
    for k in range(count):  # what is kept of the summary is where the next point goes
        entry = summary + 7 * k
        wide, deep = entry[2] - entry[1], entry[4] - entry[3]
        if (
            entry[0] < least or wide * wide + deep * deep >= longest * longest
            or entry[5] > tallest or (entry[5] > below and entry[6])
        ):
            entry[0] = -1
        else:
            entry[0], kept = kept, kept + entry[0]
            clusters += 1
            start[clusters] = kept
    result = numpy.empty((kept, 4), numpy.int32)
    cdef np.int32_t* out = singles(result, 2)
    record = records
    for r in range(raised):
        if record[2] >= 0 and summary[7 * record[2]] >= 0:
            point, k = at + 4 * record[0], 4 * summary[7 * record[2]]
            out[k], out[k + 1], out[k + 2], out[k + 3] = point[0], point[1], point[2], record[1]
            summary[7 * record[2]] += 1
        record += 3
    return result, starts[:clusters + 1], steepest


cdef long long closeness(
    const double* x, const double* y, Py_ssize_t n, double cosine, double sine, double near
) noexcept nogil:
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
        total += <np.int32_t>(1e6 / max(gap, near))
    return total


def fitted_rectangles(points, start, axes, int coarse, int least_mm, int across, double near_mm):
    axes = contiguous(axes)
    cdef const np.int32_t* all_points = singles(points, 2)
    cdef const np.int32_t* at
    cdef const np.int64_t* first = int_data(start)
    cdef const double* axis = float_data(axes, 2)
    cdef Py_ssize_t c, r, k, n, m, cell, count = length(start) - 1, turns = length(axes) // 2, best, turn, place
    cdef long long score, highest
    cdef np.int32_t low_x, low_y, high_x, high_y, bottom, top, floor, cell_mm, width
    cdef np.int64_t per_cell
    cdef double cosine, sine, along, beside, along_upper, beside_upper, steepest
    grid, means = numpy.empty(3 * (across + 1) ** 2, numpy.int64), numpy.empty(2 * (across + 1) ** 2)
    turn_of, extents = numpy.empty(count, numpy.int64), numpy.empty((count, 11))
    cdef np.int64_t* sums = int_data(grid)
    cdef double* x = writable_data(means, 1)
    cdef double* y = x + (across + 1) * (across + 1)
    cdef double* out = writable_data(extents, 2)
    cdef np.int64_t* turned = int_data(turn_of)
    for c in range(count):
        at, n = all_points + 4 * first[c], first[c + 1] - first[c]
        low_x = low_y = bottom = floor = NONE
        high_x = high_y = top = -NONE
        steepest = -NONE
        for r in range(n):
            low_x, high_x = min(low_x, at[4 * r]), max(high_x, at[4 * r])
            low_y, high_y = min(low_y, at[4 * r + 1]), max(high_y, at[4 * r + 1])
            bottom, top = min(bottom, at[4 * r + 3]), max(top, at[4 * r + 3])
            floor = min(floor, at[4 * r + 2] - at[4 * r + 3])
            steepest = steeper(steepest, at[4 * r], at[4 * r + 1], at[4 * r + 2])
        cell_mm = max(least_mm, max(high_x - low_x, high_y - low_y) // across + 1)
        per_cell = inverse_of(cell_mm)
        width = (high_y - low_y) // cell_mm + 1
        m = ((high_x - low_x) // cell_mm + 1) * width
        memset(sums, 0, 3 * m * sizeof(np.int64_t))
        for r in range(n):
            cell = 3 * (quotient(at[4 * r] - low_x, per_cell) * width + quotient(at[4 * r + 1] - low_y, per_cell))
            sums[cell] += 1
            sums[cell + 1] += at[4 * r] - low_x
            sums[cell + 2] += at[4 * r + 1] - low_y
        k = 0
        for cell in range(m):
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
        cosine, sine = axis[2 * best], axis[2 * best + 1]
        out[0] = out[1] = out[4] = out[5] = INFINITY
        out[2] = out[3] = along_upper = beside_upper = -INFINITY
        for r in range(n):
            along = at[4 * r] / 1000.0 * cosine + at[4 * r + 1] / 1000.0 * sine
            beside = at[4 * r + 1] / 1000.0 * cosine - at[4 * r] / 1000.0 * sine
            out[0], out[2] = min(out[0], along), max(out[2], along)
            out[1], out[3] = min(out[1], beside), max(out[3], beside)
            if at[4 * r + 3] > 0.75 * top:
                out[4], along_upper = min(out[4], along), max(along_upper, along)
                out[5], beside_upper = min(out[5], beside), max(beside_upper, beside)
        out[4], out[5] = max(along_upper - out[4], 0.0), max(beside_upper - out[5], 0.0)
        if out[3] - out[1] > out[2] - out[0]:  # the second side is the longer one
            best += turns
            out[0], out[1], out[2], out[3], out[4], out[5] = out[1], -out[2], out[3], -out[0], out[5], out[4]
        out[6], out[7], out[8], out[9] = bottom / 1000.0, top / 1000.0, floor / 1000.0, steepest
        out[10], turned[c], out = n, best, out + 11
    return turn_of, extents
