# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Clustering and fusion at the command centre. The references say what each function does.

The members of a cluster lie next to each other; `start` (c,) is the row of each cluster's first one.
"""

import numpy as np

from libc.math cimport atan2, copysign, cos, fmax, sin
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport MOST, factorise, invert, wrapped
from mast_zenoh.kernels.table cimport N_CLASSES, SOURCE_DIGEST

DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def symmetrised(const double[:, :, :] covariance, double least, double most):
    cdef Py_ssize_t r, i, j, k = covariance.shape[1]
    cdef double[MOST * MOST] shifted
    cdef bint fit = True
    if k > MOST:
        raise ValueError(f"covariance: found {k} rows, expected at most {MOST}")
    result = np.empty((covariance.shape[0], k, k))
    cdef double[:, :, ::1] out = result
    for r in range(covariance.shape[0]):
        for i in range(k):
            for j in range(i + 1):
                out[r, i, j] = out[r, j, i] = 0.5 * (covariance[r, i, j] + covariance[r, j, i])
            fit = fit and out[r, i, i] <= most
        if fit:
            memcpy(shifted, &out[r, 0, 0], k * k * sizeof(double))
            for i in range(k):
                shifted[i * k + i] -= 0.5 * least
            factorise(shifted, k)
            for i in range(k):
                fit = fit and shifted[i * k + i] > 0.0
    return result, fit


def intersection(const double[:, :, :] covariance, const double[:, ::1] state, const double[::1] weight, const long long[::1] start):
    cdef Py_ssize_t c, r, i, j, end, n = covariance.shape[0], count = start.shape[0]
    cdef double[81] own, information, inverse
    cdef double[9] total
    means, covariances = np.empty((count, 9)), np.empty((count, 9, 9))
    cdef double[:, ::1] mean = means
    cdef double[:, :, ::1] fused = covariances
    for c in range(count):
        memset(information, 0, sizeof(information))
        memset(total, 0, sizeof(total))
        end = start[c + 1] if c + 1 < count else n
        for r in range(start[c], end):
            for i in range(9):
                for j in range(9):
                    own[9 * i + j] = covariance[r, i, j]
            invert(own, 9, inverse)
            for i in range(9):
                for j in range(9):
                    own[9 * i + j] = weight[r] * inverse[9 * i + j]
                    information[9 * i + j] += own[9 * i + j]
                    total[i] += own[9 * i + j] * state[r, j]
        invert(information, 9, &fused[c, 0, 0])
        for i in range(9):
            mean[c, i] = 0.0
            for j in range(9):
                mean[c, i] += fused[c, i, j] * total[j]
    return means, covariances


def agreement(
    const double[::1] yaw, const unsigned char[::1] class_id, const double[::1] score, const double[::1] weight,
    const long long[::1] start,
):
    cdef Py_ssize_t c, r, k, end, best, n = yaw.shape[0], count = start.shape[0]
    cdef double x, y, axis, sense
    cdef double[N_CLASSES] votes
    yaws, classes, scores = np.empty(count), np.empty(count, np.uint8), np.empty(count)
    cdef double[::1] heading = yaws, highest = scores
    cdef unsigned char[::1] chosen = classes
    for c in range(count):
        end = start[c + 1] if c + 1 < count else n
        memset(votes, 0, sizeof(votes))
        x = y = sense = 0.0
        highest[c] = score[start[c]]
        for r in range(start[c], end):
            x += weight[r] * cos(2.0 * yaw[r])
            y += weight[r] * sin(2.0 * yaw[r])
            votes[class_id[r] if class_id[r] < N_CLASSES else 0] += weight[r]
            highest[c] = fmax(highest[c], score[r])
        axis = 0.5 * atan2(y, x)
        for r in range(start[c], end):
            sense += weight[r] * copysign(1.0, cos(yaw[r] - axis))
        heading[c] = wrapped(axis + PI if sense < 0.0 else axis)
        best = 0
        for k in range(1, N_CLASSES):
            if votes[k] > votes[best]:
                best = k
        chosen[c] = best
    return yaws, classes, scores


def plain_clusters(const long long[::1] agent, const long long[::1] i, const long long[::1] j):
    cdef Py_ssize_t p, k = 0, n = agent.shape[0], count = i.shape[0]
    cdef long long a, b
    roots = np.arange(n)
    cdef long long[::1] root = roots
    cdef long long[:, ::1] tally = np.zeros((2, n), np.int64)  # members, pairs
    cdef unsigned char[::1] odd = np.zeros(n, np.uint8)
    for p in range(count):
        root[j[p]] = min(root[j[p]], i[p])
    for p in range(n):
        tally[0, root[p]] += 1
    for p in range(count):
        a, b = root[i[p]], root[j[p]]
        tally[1, a] += 1
        if a != b or agent[i[p]] == agent[j[p]]:
            odd[a] = odd[b] = 1
    for p in range(n):
        if tally[1, p] != tally[0, p] * (tally[0, p] - 1) // 2:
            odd[p] = 1
    for p in range(count):
        k += odd[root[i[p]]]
    others = np.empty(k, np.int64)
    cdef long long[::1] rest = others
    k = 0
    for p in range(count):
        if odd[root[i[p]]]:
            rest[k] = p
            k += 1
    return roots, others
