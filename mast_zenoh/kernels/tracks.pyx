# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""A table of tracks: prediction, correction, evidence. The references say what each function does."""

import numpy as np

from libc.math cimport cos, exp, fabs, fmax, fmin, rint, sin, sqrt
from libc.string cimport memcpy

from mast_zenoh.kernels.algebra cimport factorise, forward, wrapped
from mast_zenoh.kernels.table cimport (
    SOURCE_DIGEST, P, XX, XY, YY, YAW, YAW_VARIANCE, TURN, ASIDE, ODDS, HITS, MISSES, VOTES, N_CLASSES, CLASS,
    CONFIRMED, AGE, ID, ROW, WIDTH,
)

DIGEST = SOURCE_DIGEST.decode()

COLUMNS = dict(
    XX=XX, XY=XY, YY=YY, YAW=YAW, YAW_VARIANCE=YAW_VARIANCE, TURN=TURN, ASIDE=ASIDE, ODDS=ODDS, HITS=HITS,
    MISSES=MISSES, CLASS=CLASS, CONFIRMED=CONFIRMED, AGE=AGE, ID=ID, ROW=ROW, WIDTH=WIDTH,
)

cdef double PI = 3.141592653589793


def predict(double[:, ::1] t, double dt, const double[:, :, ::1] noise):
    cdef Py_ssize_t r, i, k
    cdef double* row
    cdef const double* added
    for r in range(t.shape[0]):
        row = &t[r, 0]
        added = &noise[<Py_ssize_t>row[CLASS], 0, 0]
        for i in range(3):
            row[i] += dt * row[6 + i]
            for k in range(9):
                row[P + 9 * i + k] += dt * row[P + 9 * (6 + i) + k]
        for k in range(9):
            for i in range(3):
                row[P + 9 * k + i] += dt * row[P + 9 * k + 6 + i]
        for k in range(81):
            row[P + k] += added[k]


def correct(double[:, ::1] t, const double[:, ::1] measured, const double[:, :, ::1] noise):
    cdef Py_ssize_t m = measured.shape[1]
    cdef Py_ssize_t r, i, j, k
    cdef double[81] total
    cdef double[90] columns  # of what was measured: innovation, and covariance with the state
    cdef double* row
    cdef double factor
    for r in range(t.shape[0]):
        row = &t[r, 0]
        for i in range(m):
            for j in range(m):
                total[i * m + j] = row[P + 9 * i + j] + noise[r, i, j]
            columns[10 * i] = measured[r, i] - row[i]
            memcpy(&columns[10 * i + 1], &row[P + 9 * i], 9 * sizeof(double))
        factorise(total, m)
        forward(total, m, columns, 10)
        for i in range(m):
            for j in range(9):
                factor = columns[10 * i + 1 + j]
                if factor != 0.0:
                    factor /= total[i * m + i]
                    row[j] += factor * columns[10 * i]
                    for k in range(j + 1):
                        row[P + 9 * j + k] -= factor * columns[10 * i + 1 + k]
        for j in range(9):
            for k in range(j):
                row[P + 9 * k + j] = row[P + 9 * j + k]


def correct_speed(double[:, ::1] t, const double[:, ::1] direction, const double[::1] noise):
    cdef Py_ssize_t r, i, j
    cdef double[9] cross
    cdef double* row
    cdef double x, y, variance, speed
    for r in range(t.shape[0]):
        row = &t[r, 0]
        x, y = direction[r, 0], direction[r, 1]
        for i in range(9):
            cross[i] = row[P + 9 * i + 6] * x + row[P + 9 * i + 7] * y
        variance = 1.0 / (cross[6] * x + cross[7] * y + noise[r])
        speed = (row[6] * x + row[7] * y) * variance
        for i in range(9):
            row[i] -= cross[i] * speed
            for j in range(i + 1):
                row[P + 9 * i + j] -= cross[i] * cross[j] * variance
                row[P + 9 * j + i] = row[P + 9 * i + j]


def correct_heading(double[:, ::1] t, const double[::1] yaw, double variance):
    cdef Py_ssize_t r
    cdef double innovation, half_turns, gain
    for r in range(t.shape[0]):
        innovation = yaw[r] - t[r, YAW]
        half_turns = rint(innovation * (1.0 / PI))
        gain = t[r, YAW_VARIANCE] / (t[r, YAW_VARIANCE] + variance)
        t[r, YAW] += gain * (innovation - PI * half_turns)
        t[r, YAW_VARIANCE] = variance * gain
        t[r, TURN] += 1.0 - 2.0 * fabs(half_turns - 2.0 * rint(0.5 * half_turns))


def settle_sense(double[:, ::1] t, double forward, double limit):
    cdef Py_ssize_t r
    cdef double along
    for r in range(t.shape[0]):
        along = t[r, 6] * cos(t[r, YAW]) + t[r, 7] * sin(t[r, YAW])
        if along > forward:
            t[r, TURN] += 1.0
        elif along < -forward:
            t[r, TURN] -= 1.0
        if t[r, TURN] < 0.0:
            t[r, YAW] += PI
        t[r, TURN] = fmin(fabs(t[r, TURN]), limit)


def across(double[:, ::1] t, const double[:, ::1] surprise, const double[::1] free, double slip, double share, double s):
    cdef Py_ssize_t r
    cdef double c, d, squared
    directions, variances = np.empty((t.shape[0], 2)), np.empty(t.shape[0])
    cdef double[:, ::1] direction = directions
    cdef double[::1] variance = variances
    for r in range(t.shape[0]):
        c, d = cos(t[r, YAW]), sin(t[r, YAW])
        t[r, ASIDE] += share * (surprise[r, 1] * c - surprise[r, 0] * d - t[r, ASIDE])
        squared = t[r, 6] * t[r, 6] + t[r, 7] * t[r, 7]
        variance[r] = slip * slip + (t[r, ASIDE] / s) ** 2 + squared * t[r, YAW_VARIANCE]
        variance[r] += free[<Py_ssize_t>t[r, CLASS]]
        direction[r, 0], direction[r, 1] = -d, c
    return directions, variances


def vote(double[:, ::1] t, const long long[::1] class_id):
    cdef Py_ssize_t r, k, best
    for r in range(t.shape[0]):
        t[r, VOTES + class_id[r]] += 1.0
        best = 0
        for k in range(1, N_CLASSES):
            if t[r, VOTES + k] > t[r, VOTES + best]:
                best = k
        t[r, CLASS] = best


def survive(double[:, ::1] t, double dt, double lifetime_s, double memory_s):
    cdef Py_ssize_t r, k
    cdef double leaves = exp(dt / lifetime_s), fades = exp(-dt / memory_s)
    for r in range(t.shape[0]):
        t[r, ODDS] /= leaves + (leaves - 1.0) * t[r, ODDS]
        for k in range(HITS, VOTES + N_CLASSES):
            t[r, k] *= fades


def detection_probability(const double[:, ::1] t, double prior, double weight):
    cdef Py_ssize_t r
    result = np.empty(t.shape[0])
    cdef double[::1] out = result
    for r in range(t.shape[0]):
        out[r] = fmin((t[r, HITS] + prior * weight) / (t[r, HITS] + t[r, MISSES] + weight), prior)
    return result


def hit(double[:, ::1] t, const double[::1] detected, const double[::1] log_ratio, double most):
    cdef Py_ssize_t r
    for r in range(t.shape[0]):
        t[r, ODDS] = fmin(t[r, ODDS] * (detected[r] * exp(log_ratio[r]) + (1.0 - detected[r])), most)
        t[r, HITS] += 1.0


def miss(double[:, ::1] t, const double[::1] detected, const double[::1] expected, double birth):
    cdef Py_ssize_t r
    for r in range(t.shape[0]):
        t[r, ODDS] = fmax(t[r, ODDS] * (1.0 - detected[r] * expected[r]), birth * t[r, CONFIRMED])
        t[r, MISSES] += expected[r]


def to_columns(const double[:, ::1] t):
    cdef Py_ssize_t r, n = t.shape[0]
    cdef const double* row
    ids, positions, velocities = np.empty(n, np.int64), np.empty((n, 3)), np.empty((n, 3))
    sizes, yaws, covariances = np.empty((n, 3)), np.empty(n), np.empty((n, 9, 9))
    scores, classes = np.empty(n), np.empty(n, np.uint8)
    cdef long long[::1] id = ids
    cdef double[:, ::1] position = positions, velocity = velocities, size = sizes
    cdef double[::1] yaw = yaws, score = scores
    cdef double[:, :, ::1] covariance = covariances
    cdef unsigned char[::1] class_id = classes
    for r in range(n):
        row = &t[r, 0]
        id[r] = <long long>row[ID]
        memcpy(&position[r, 0], row, 3 * sizeof(double))
        memcpy(&size[r, 0], row + 3, 3 * sizeof(double))
        memcpy(&velocity[r, 0], row + 6, 3 * sizeof(double))
        memcpy(&covariance[r, 0, 0], row + P, 81 * sizeof(double))
        yaw[r] = wrapped(row[YAW])
        score[r] = row[ODDS] / (1.0 + row[ODDS])
        class_id[r] = <unsigned char>row[CLASS]
    return ids, positions, velocities, sizes, yaws, covariances, scores, classes


def kept(
    double[:, ::1] t, double confirm, double report, double doubtful, double max_age, double lost, double max_speed,
    double max_variance,
):
    cdef Py_ssize_t r, n = t.shape[0]
    cdef double variance, speed
    keeps, reports = np.empty(n, bool), np.empty(n, bool)
    cdef unsigned char[::1] keep = keeps.view(np.uint8), tell = reports.view(np.uint8)
    for r in range(n):
        if t[r, ODDS] > confirm:
            t[r, CONFIRMED] = 1.0
        variance = t[r, XX] + t[r, YY]
        speed = sqrt(t[r, 6] * t[r, 6] + t[r, 7] * t[r, 7])
        keep[r] = (
            t[r, ODDS] >= doubtful * (1.0 - t[r, CONFIRMED]) and t[r, AGE] <= max_age and variance <= lost
            and speed <= max_speed
        )
        tell[r] = t[r, CONFIRMED] > 0.0 and t[r, ODDS] > report and variance <= max_variance
    return keeps, reports
