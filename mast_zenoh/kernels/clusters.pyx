# cython: language_level=3, cdivision=True
"""Kernels of fusion at the command centre. The NumPy references document them.

The members of a cluster are adjacent; `start` (c,) is the first row of each cluster.
"""

cimport numpy as np
from libc.math cimport atan2, copysign, cos, fmax, sin
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


def achievable(covariance, per_unit, double least, double most):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const double* factor = float_data(per_unit, 2)
    cdef Py_ssize_t r, i, j, k = length(covariance, 1)
    cdef double[MAX_ROWS * MAX_ROWS] shifted
    if k > MAX_ROWS:
        raise ValueError(f"covariance: found {k} rows, expected at most {MAX_ROWS}")
    for r in range(length(covariance)):
        for i in range(k):
            for j in range(i + 1):
                shifted[k * i + j] = shifted[k * j + i] = 0.5 * (
                    matrix[k * i + j] * factor[k * i + j] + matrix[k * j + i] * factor[k * j + i]
                )
            if not shifted[k * i + i] <= most:
                return False
            shifted[k * i + i] -= 0.5 * least
        factorise(shifted, k)
        for i in range(k):
            if not shifted[k * i + i] > 0.0:
                return False
        matrix += k * k
    return True


def horizontal_motion(position, velocity, covariance, rows):
    position, velocity, covariance = contiguous(position), contiguous(velocity), contiguous(covariance)
    cdef const double* at = float_data(position, 2)
    cdef const double* speed = float_data(velocity, 2)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const np.int64_t* row = int_data(rows)
    cdef const double* P
    cdef Py_ssize_t r, s, q, n = length(rows)
    motions, spreads = empty_matrix(n, 4), empty_matrix(n, 8)
    cdef double* motion = writable_data(motions, 2)
    cdef double* spread = writable_data(spreads, 2)
    for r in range(n):
        s = row[r]
        motion[0], motion[1], motion[2], motion[3] = at[3 * s], at[3 * s + 1], speed[3 * s], speed[3 * s + 1]
        for q in range(2):
            P = matrix + 81 * s + 60 * q
            spread[4 * q], spread[4 * q + 1], spread[4 * q + 2], spread[4 * q + 3] = P[0], P[10], P[1], P[9]
        motion, spread = motion + 4, spread + 8
    return motions, spreads


def compare_members(motion, spread, agent, label, Py_ssize_t agents, Py_ssize_t partners):
    motion, spread = contiguous(motion), contiguous(spread)
    cdef const double* at = float_data(motion, 2)
    cdef const double* variance = float_data(spread, 2)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef const np.int64_t* label_of = int_data(label)
    cdef Py_ssize_t r, s, q, k, shift, n = length(agent)
    cdef double x, y, xx, yy, xy
    cdef bint any_same
    result = zero_vector(np.NPY_DOUBLE, agents * agents * 8)
    cdef double* sums = writable_data(result, 1)
    cdef double* total
    cdef double* mirrored
    for shift in range(1, min(partners, n - 1) + 1):
        any_same = False
        for r in range(n - shift):
            s = r + shift
            if label_of[r] != label_of[s]:
                continue
            any_same = True
            total = sums + 8 * (agents * agent_of[r] + agent_of[s])
            for q in range(2):
                x, y = at[4 * r + 2 * q] - at[4 * s + 2 * q], at[4 * r + 2 * q + 1] - at[4 * s + 2 * q + 1]
                k = 4 * q
                xx, yy = variance[8 * r + k] + variance[8 * s + k], variance[8 * r + k + 1] + variance[8 * s + k + 1]
                xy = 0.5 * ((variance[8 * r + k + 2] + variance[8 * s + k + 2]) + (variance[8 * r + k + 3] + variance[8 * s + k + 3]))
                total[k] += 1.0
                total[k + 1] += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
                total[k + 2] += x * x + y * y
                total[k + 3] += xx + yy
        if not any_same:
            break
    for r in range(agents):
        for s in range(r, agents):
            total, mirrored = sums + 8 * (agents * r + s), sums + 8 * (agents * s + r)
            if total[0] > 0.0 or mirrored[0] > 0.0:
                for k in range(8):
                    total[k] = mirrored[k] = total[k] + mirrored[k]
    return result.reshape(agents, agents, 2, 4)


def decay_and_add(sums, comparisons, double decay, double share, double limit, double prior_pairs):
    cdef double* total = writable_data(sums, 4)
    cdef const double* new = float_data(comparisons, 4)
    cdef Py_ssize_t r, k, all_agents = length(sums), agents = length(comparisons)
    cdef bint exceeded = False
    for r in range(agents):
        for k in range(8 * agents):
            total[k] = total[k] * decay + share * new[k]
        for k in range(0, 8 * agents, 4):
            exceeded |= total[k + 1] + 2.0 * prior_pairs > 2.0 * limit * (total[k] + prior_pairs)
        total += 8 * all_agents
        new += 8 * agents
    return bool(exceeded)
