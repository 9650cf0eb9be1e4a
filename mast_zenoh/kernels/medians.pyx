# cython: language_level=3, cdivision=True
"""Kernels for the middle of clusters whose members are in a table (c, a). The NumPy references document them."""

cimport numpy as np
from libc.math cimport atan2, cos, sin

from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


cdef inline void sort(double* values, double* weights, Py_ssize_t n) noexcept:
    """Sort values, and their weights, in ascending order; equal ones keep their order."""
    cdef Py_ssize_t i, k
    cdef double value, weight
    for i in range(1, n):
        value, weight, k = values[i], weights[i], i
        while k > 0 and values[k - 1] > value:
            values[k], weights[k] = values[k - 1], weights[k - 1]
            k -= 1
        values[k], weights[k] = value, weight


def median_boxes(position, velocity, size, yaw, member, present):
    position, velocity, size, yaw = contiguous(position), contiguous(velocity), contiguous(size), contiguous(yaw)
    rows, use = contiguous(member).ravel(), contiguous(present).ravel()
    cdef const np.int64_t* row = int_data(rows)
    cdef const np.uint8_t* used = byte_data(use)
    cdef const double* heading = float_data(yaw, 1)
    cdef (const double*)[3] columns = [float_data(position, 2), float_data(velocity, 2), float_data(size, 2)]
    cdef Py_ssize_t r, j, k, m, q, c = length(member), a = length(member, 1)
    places, speeds, sizes, yaws = empty_matrix(c, 3), empty_matrix(c, 3), empty_matrix(c, 3), empty_vector(np.NPY_DOUBLE, c)
    cdef (double*)[3] out = [writable_data(places, 2), writable_data(speeds, 2), writable_data(sizes, 2)]
    cdef double* angle = writable_data(yaws, 1)
    scratch = empty_matrix(2, a)
    cdef double* values = writable_data(scratch, 2)
    cdef double* unused = values + a
    cdef double east, north
    for r in range(c):
        east, north, m = 0.0, 0.0, 0
        for j in range(a):
            if used[j]:
                east += cos(2.0 * heading[row[j]])
                north += sin(2.0 * heading[row[j]])
                m += 1
        angle[r] = 0.5 * atan2(north / m, east / m)
        for q in range(3):
            for k in range(3):
                m = 0
                for j in range(a):
                    if used[j]:
                        values[m], unused[m] = columns[q][3 * row[j] + k], 0.0
                        m += 1
                sort(values, unused, m)
                out[q][3 * r + k] = 0.5 * (values[(m - 1) // 2] + values[m // 2])
        row, used = row + a, used + a
    return places, speeds, sizes, yaws


cdef double weighted_median(double* values, double* weights, Py_ssize_t n) noexcept:
    """The middle of the two ends of the weighted median of n values, which are sorted."""
    cdef double half = 0.0, below = 0.0, low = 0.0
    cdef Py_ssize_t i
    cdef bint has_low = False
    sort(values, weights, n)
    for i in range(n):
        half += weights[i]
    half *= 0.5
    for i in range(n):
        below += weights[i]
        if not has_low and below >= half * (1.0 - 1e-9):
            has_low, low = True, values[i]
        if below > half * (1.0 + 1e-9):
            return 0.5 * (low + values[i])
    return low


def weighted_medians(values, member, weight):
    values, rows, say = contiguous(values), contiguous(member).ravel(), contiguous(weight).ravel()
    cdef const double* at = float_data(values, 2)
    cdef const np.int64_t* row = int_data(rows)
    cdef const double* says = float_data(say, 1)
    cdef Py_ssize_t r, j, k, m, c = length(member), a = length(member, 1), q = length(values, 1)
    middle = empty_matrix(c, q)
    cdef double* out = writable_data(middle, 2)
    scratch = empty_matrix(2, a)
    cdef double* own = writable_data(scratch, 2)
    cdef double* weights = own + a
    for r in range(c):
        for k in range(q):
            m = 0
            for j in range(a):
                if says[j] > 0.0:
                    own[m], weights[m] = at[q * row[j] + k], says[j]
                    m += 1
            out[k] = weighted_median(own, weights, m)
        row, says, out = row + a, says + a, out + q
    return middle
