# cython: language_level=3, cdivision=True
"""Clustering and fusion at the command centre. The references say what each function does.

The members of a cluster lie next to each other; `start` (c,) is the row of each cluster's first one.
"""

cimport numpy as np
from libc.math cimport atan2, copysign, cos, fmax, sin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport MOST, factorise, invert, wrapped
from mast_zenoh.kernels.arrays cimport floats, ints, length, made, octets, squares, table, whole, writable, zeros
from mast_zenoh.kernels.table cimport N_CLASSES, SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def symmetrised(covariance, double least, double most):
    covariance = whole(covariance)
    cdef const double* given = floats(covariance, 3)
    cdef Py_ssize_t r, i, j, k = length(covariance, 1)
    cdef double[MOST * MOST] shifted
    cdef bint fit = True
    if k > MOST:
        raise ValueError(f"covariance: found {k} rows, expected at most {MOST}")
    result = squares(length(covariance), k)
    cdef double* out = writable(result, 3)
    for r in range(length(covariance)):
        for i in range(k):
            for j in range(i + 1):
                out[k * i + j] = out[k * j + i] = 0.5 * (given[k * i + j] + given[k * j + i])
            fit = fit and out[k * i + i] <= most
        if fit:
            memcpy(shifted, out, k * k * sizeof(double))
            for i in range(k):
                shifted[i * k + i] -= 0.5 * least
            factorise(shifted, k)
            for i in range(k):
                fit = fit and shifted[i * k + i] > 0.0
        given, out = given + k * k, out + k * k
    return result, fit


def intersection(covariance, state, weight, start):
    covariance = whole(covariance)
    cdef const double* given = floats(covariance, 3)
    cdef const double* vector = floats(state, 2)
    cdef const double* share = floats(weight, 1)
    cdef const np.int64_t* first = ints(start)
    cdef Py_ssize_t c, r, i, j, end, n = length(covariance), count = length(start)
    cdef double[81] own, information, inverse
    cdef double[9] total
    means, covariances = table(count, 9), squares(count, 9)
    cdef double* mean = writable(means, 2)
    cdef double* fused = writable(covariances, 3)
    for c in range(count):
        memset(information, 0, sizeof(information))
        memset(total, 0, sizeof(total))
        end = first[c + 1] if c + 1 < count else n
        for r in range(first[c], end):
            memcpy(own, given + 81 * r, sizeof(own))
            invert(own, 9, inverse)
            for i in range(9):
                for j in range(9):
                    own[9 * i + j] = share[r] * inverse[9 * i + j]
                    information[9 * i + j] += own[9 * i + j]
                    total[i] += own[9 * i + j] * vector[9 * r + j]
        invert(information, 9, fused)
        for i in range(9):
            mean[i] = 0.0
            for j in range(9):
                mean[i] += fused[9 * i + j] * total[j]
        mean, fused = mean + 9, fused + 81
    return means, covariances


def agreement(yaw, class_id, score, weight, start):
    cdef const double* heading = floats(yaw, 1)
    cdef const np.uint8_t* class_of = octets(class_id)
    cdef const double* sure = floats(score, 1)
    cdef const double* share = floats(weight, 1)
    cdef const np.int64_t* first = ints(start)
    cdef Py_ssize_t c, r, k, end, best, n = length(yaw), count = length(start)
    cdef double x, y, axis, sense
    cdef double[N_CLASSES] votes
    yaws, classes, scores = made(np.NPY_DOUBLE, count), made(np.NPY_UINT8, count), made(np.NPY_DOUBLE, count)
    cdef double* agreed = writable(yaws, 1)
    cdef double* highest = writable(scores, 1)
    cdef np.uint8_t* chosen = octets(classes)
    for c in range(count):
        end = first[c + 1] if c + 1 < count else n
        memset(votes, 0, sizeof(votes))
        x = y = sense = 0.0
        highest[c] = sure[first[c]]
        for r in range(first[c], end):
            x += share[r] * cos(2.0 * heading[r])
            y += share[r] * sin(2.0 * heading[r])
            votes[class_of[r] if class_of[r] < N_CLASSES else 0] += share[r]
            highest[c] = fmax(highest[c], sure[r])
        axis = 0.5 * atan2(y, x)
        for r in range(first[c], end):
            sense += share[r] * copysign(1.0, cos(heading[r] - axis))
        agreed[c] = wrapped(axis + PI if sense < 0.0 else axis)
        best = 0
        for k in range(1, N_CLASSES):
            if votes[k] > votes[best]:
                best = k
        chosen[c] = best
    return yaws, classes, scores
