# cython: language_level=3, cdivision=True
"""Kernels for the middle of clusters whose members are in a table (c, a). The NumPy references document them."""

cimport numpy as np
from libc.math cimport atan2, cos, fmax, fmin, sin

from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, int_data, length, writable_data, zero_vector,
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


cdef void weighted_median(double* values, double* weights, Py_ssize_t n, double* ends) noexcept:
    """The two ends of the weighted median of n >= 1 values, which are sorted."""
    cdef double half = 0.0, below = 0.0
    cdef Py_ssize_t i
    cdef bint has_low = False
    sort(values, weights, n)
    for i in range(n):
        half += weights[i]
    half *= 0.5
    for i in range(n):
        below += weights[i]
        if not has_low and below >= half * (1.0 - 1e-9):
            has_low, ends[0] = True, values[i]
        if below > half * (1.0 + 1e-9):
            ends[1] = values[i]
            return
    ends[1] = ends[0]


def track_offsets(
    position, covariance, member, weight, isolated, floor_m, double max_error_m, Py_ssize_t members, double inefficiency
):
    position, covariance, rows = contiguous(position), contiguous(covariance), contiguous(member).ravel()
    cdef const double* at = float_data(position, 2)
    cdef const double* claimed = float_data(covariance, 3)
    cdef const np.int64_t* row = int_data(rows)
    cdef const double* say = float_data(weight, 1)
    cdef const np.uint8_t* alone = byte_data(isolated)
    cdef const double* floor = float_data(floor_m, 1)
    cdef Py_ssize_t r, j, k, m, t, c = length(member), a = length(member, 1), w = length(covariance, 1)
    validity, offsets = zero_vector(np.NPY_BOOL, c * a), zero_vector(np.NPY_DOUBLE, 2 * c * a)
    inverses = zero_vector(np.NPY_DOUBLE, 4 * c * a)
    cdef np.uint8_t* valid = byte_data(validity)
    cdef double* offset = writable_data(offsets, 1)
    cdef double* information = writable_data(inverses, 1)
    scratch = empty_matrix(6, a)
    cdef double* values = writable_data(scratch, 2)
    cdef double* weights = values + a
    cdef double* own = values + 2 * a  # limited variances and covariance of each member
    cdef double[4] middle  # ends in x, and in y
    cdef double[4] spread
    cdef double limit, x, xx, xy, yx, yy, determinant
    for r in range(c):
        m = 0
        for j in range(a):
            m += row[j] >= 0 and say[j] > 0.0
        if alone[r] and m >= members:
            for k in range(2):
                m = 0
                for j in range(a):
                    if row[j] >= 0 and say[j] > 0.0:
                        values[m], weights[m] = at[3 * row[j] + k], say[j]
                        m += 1
                weighted_median(values, weights, m, middle + 2 * k)
            for k in range(4):
                spread[k] = 0.0
            for j in range(a):
                if row[j] >= 0:
                    t = w * w * row[j]
                    limit = fmin(1.0, max_error_m * max_error_m / fmax(fmax(claimed[t], claimed[t + w + 1]), 1e-12))
                    own[4 * j], own[4 * j + 1] = limit * claimed[t], limit * claimed[t + 1]
                    own[4 * j + 2], own[4 * j + 3] = limit * claimed[t + w], limit * claimed[t + w + 1]
                    if say[j] > 0.0:
                        for k in range(4):
                            spread[k] += own[4 * j + k]
            for k in range(4):
                spread[k] *= inefficiency / (m * m)
            for j in range(a):
                if row[j] >= 0:
                    valid[j] = True
                    for k in range(2):
                        x = at[3 * row[j] + k]
                        offset[2 * j + k] = x - fmin(fmax(x, middle[2 * k]), middle[2 * k + 1])
                    xx = own[4 * j] + spread[0] + floor[r] * floor[r]
                    xy, yx = own[4 * j + 1] + spread[1], own[4 * j + 2] + spread[2]
                    yy = own[4 * j + 3] + spread[3] + floor[r] * floor[r]
                    determinant = xx * yy - xy * yx
                    information[4 * j], information[4 * j + 1] = yy / determinant, -xy / determinant
                    information[4 * j + 2], information[4 * j + 3] = -yx / determinant, xx / determinant
        row, valid, offset, information = row + a, valid + a, offset + 2 * a, information + 4 * a
    return validity.reshape(c, a), offsets.reshape(c, a, 2), inverses.reshape(c, a, 2, 2)
