# cython: language_level=3, cdivision=True
"""Kernels of clustering and fusion at the command centre. The NumPy references document them.

The members of a cluster are adjacent; `start` (c,) is the first row of each cluster.
"""

cimport numpy as np
from libc.math cimport atan2, copysign, cos, fmax, sin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport MAX_ROWS, factorise, invert, wrap_angle
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrices, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
    zero_vector,
)
from mast_zenoh.kernels.table cimport N_CLASSES, SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def symmetrise(covariance, double min_variance, double max_variance):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef Py_ssize_t r, i, j, k = length(covariance, 1)
    cdef double[MAX_ROWS * MAX_ROWS] shifted
    cdef bint valid = True
    if k > MAX_ROWS:
        raise ValueError(f"covariance: found {k} rows, expected at max_variance {MAX_ROWS}")
    result = empty_matrices(length(covariance), k)
    cdef double* out = writable_data(result, 3)
    for r in range(length(covariance)):
        for i in range(k):
            for j in range(i + 1):
                out[k * i + j] = out[k * j + i] = 0.5 * (matrix[k * i + j] + matrix[k * j + i])
            valid = valid and out[k * i + i] <= max_variance
        if valid:
            memcpy(shifted, out, k * k * sizeof(double))
            for i in range(k):
                shifted[i * k + i] -= 0.5 * min_variance
            factorise(shifted, k)
            for i in range(k):
                valid = valid and shifted[i * k + i] > 0.0
        matrix, out = matrix + k * k, out + k * k
    return result, valid


def covariance_intersection(covariance, state, weight, start):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const double* vector = float_data(state, 2)
    cdef const double* share = float_data(weight, 1)
    cdef const np.int64_t* first = int_data(start)
    cdef Py_ssize_t c, r, i, j, end, n = length(covariance), count = length(start)
    cdef double[81] member, information, inverse
    cdef double[9] total
    means, covariances = empty_matrix(count, 9), empty_matrices(count, 9)
    cdef double* mean = writable_data(means, 2)
    cdef double* fused = writable_data(covariances, 3)
    for c in range(count):
        memset(information, 0, sizeof(information))
        memset(total, 0, sizeof(total))
        end = first[c + 1] if c + 1 < count else n
        for r in range(first[c], end):
            memcpy(member, matrix + 81 * r, sizeof(member))
            invert(member, 9, inverse)
            for i in range(9):
                for j in range(9):
                    member[9 * i + j] = share[r] * inverse[9 * i + j]
                    information[9 * i + j] += member[9 * i + j]
                    total[i] += member[9 * i + j] * vector[9 * r + j]
        invert(information, 9, fused)
        for i in range(9):
            mean[i] = 0.0
            for j in range(9):
                mean[i] += fused[9 * i + j] * total[j]
        mean, fused = mean + 9, fused + 81
    return means, covariances


def fused_attributes(yaw, class_id, score, weight, start):
    cdef const double* heading = float_data(yaw, 1)
    cdef const np.uint8_t* class_of = byte_data(class_id)
    cdef const double* member_score = float_data(score, 1)
    cdef const double* share = float_data(weight, 1)
    cdef const np.int64_t* first = int_data(start)
    cdef Py_ssize_t c, r, k, end, best, n = length(yaw), count = length(start)
    cdef double x, y, axis, direction
    cdef double[N_CLASSES] votes
    yaws, classes, scores = empty_vector(np.NPY_DOUBLE, count), empty_vector(np.NPY_UINT8, count), empty_vector(np.NPY_DOUBLE, count)
    cdef double* fused_yaw = writable_data(yaws, 1)
    cdef double* fused_score = writable_data(scores, 1)
    cdef np.uint8_t* fused_class = byte_data(classes)
    for c in range(count):
        end = first[c + 1] if c + 1 < count else n
        memset(votes, 0, sizeof(votes))
        x = y = direction = 0.0
        fused_score[c] = member_score[first[c]]
        for r in range(first[c], end):
            x += share[r] * cos(2.0 * heading[r])
            y += share[r] * sin(2.0 * heading[r])
            votes[class_of[r] if class_of[r] < N_CLASSES else 0] += share[r]
            fused_score[c] = fmax(fused_score[c], member_score[r])
        axis = 0.5 * atan2(y, x)
        for r in range(first[c], end):
            direction += share[r] * copysign(1.0, cos(heading[r] - axis))
        fused_yaw[c] = wrap_angle(axis + PI if direction < 0.0 else axis)
        best = 0
        for k in range(1, N_CLASSES):
            if votes[k] > votes[best]:
                best = k
        fused_class[c] = best
    return yaws, classes, scores


def merge_pairs(position, agent, i, j, squared, double radius):
    position, nearest = contiguous(position), squared.argsort(kind="stable")
    cdef const double* place = float_data(position, 2)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef const np.int64_t* one = int_data(i)
    cdef const np.int64_t* other = int_data(j)
    cdef const np.int64_t* pair = int_data(nearest)
    cdef Py_ssize_t p, n = length(agent), stride = length(position, 1)
    cdef np.int64_t a, b, r, s, count = 0
    cdef double dx, dy, m, k
    cdef bint separate
    labels, clusters = empty_vector(np.NPY_INT64, n), empty_matrix(n, 3)
    next_rows, last_rows = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n)
    cdef np.int64_t* label = int_data(labels)  # the first row of each row's cluster, later its number
    cdef double* cluster = writable_data(clusters, 2)  # by first row: x and y of the centre, number of members
    cdef np.int64_t* following = int_data(next_rows)  # the next member, -1: none
    cdef np.int64_t* last = int_data(last_rows)  # by first row: the last member
    for p in range(n):
        label[p] = last[p] = p
        following[p] = -1
        cluster[3 * p], cluster[3 * p + 1], cluster[3 * p + 2] = place[stride * p], place[stride * p + 1], 1.0
    for p in range(length(i)):
        a, b = label[one[pair[p]]], label[other[pair[p]]]
        if a == b:
            continue
        if b < a:
            a, b = b, a
        dx, dy = cluster[3 * a] - cluster[3 * b], cluster[3 * a + 1] - cluster[3 * b + 1]
        separate = sqrt(dx * dx + dy * dy) > radius
        r = a
        while r >= 0 and not separate:
            s = b
            while s >= 0 and not separate:
                separate, s = agent_of[r] == agent_of[s], following[s]
            r = following[r]
        if separate:
            continue
        s = b
        while s >= 0:
            label[s], s = a, following[s]
        m, k = cluster[3 * a + 2], cluster[3 * b + 2]
        cluster[3 * a] = (m * cluster[3 * a] + k * cluster[3 * b]) / (m + k)
        cluster[3 * a + 1] = (m * cluster[3 * a + 1] + k * cluster[3 * b + 1]) / (m + k)
        cluster[3 * a + 2] = m + k
        following[last[a]], last[a] = b, last[b]
    for p in range(n):
        if label[p] == p:
            label[p], count = count, count + 1
        else:
            label[p] = label[label[p]]  # of an earlier row, so it is a number already
    return labels
