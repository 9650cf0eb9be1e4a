# cython: language_level=3, cdivision=True
"""Detections and objects in other frames and at other times. The references say what each function does."""

cimport numpy as np
from libc.math cimport atan2, fmax, fmin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport wrapped
from mast_zenoh.kernels.arrays cimport floats, ints, length, made, squares, table, whole, writable
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


def moved(position, velocity, covariance, double dt):
    position, velocity, covariance = whole(position), whole(velocity), whole(covariance)
    cdef const double* at = floats(position, 2)
    cdef const double* speed = floats(velocity, 2)
    cdef const double* before = floats(covariance, 3)
    cdef Py_ssize_t r, i, k, n = length(position)
    places, covariances = table(n, 3), squares(n, 9)
    cdef double* place = writable(places, 2)
    cdef double* out = writable(covariances, 3)
    memcpy(out, before, 81 * n * sizeof(double))
    for r in range(n):
        for i in range(3):
            place[i] = at[3 * r + i] + dt * speed[3 * r + i]
            for k in range(9):
                out[9 * i + k] += dt * out[9 * (6 + i) + k]
        for k in range(9):
            for i in range(3):
                out[9 * k + i] += dt * out[9 * k + 6 + i]
        place += 3
        out += 81
    return places, covariances


def turned(position, yaw, covariance, origin, rotation):
    position, yaw, covariance, rotation = whole(position), whole(yaw), whole(covariance), whole(rotation)
    cdef const double* local = floats(position, 2)
    cdef const double* own = floats(yaw, 1)
    cdef const double* before = floats(covariance, 3)
    cdef const double* centre = floats(origin, 1)
    cdef const double* R = floats(rotation, 2)
    cdef Py_ssize_t r, i, j, k, n = length(position)
    cdef double heading = atan2(R[3], R[0])
    cdef double[9] half
    places, headings, covariances = table(n, 3), made(np.NPY_DOUBLE, n), squares(n, 3)
    cdef double* place = writable(places, 2)
    cdef double* angle = writable(headings, 1)
    cdef double* out = writable(covariances, 3)
    for r in range(n):
        angle[r] = wrapped(own[r] + heading)
        for i in range(3):
            place[i] = centre[i]
            for j in range(3):
                place[i] += R[3 * i + j] * local[j]
                half[3 * i + j] = 0.0
                for k in range(3):
                    half[3 * i + j] += R[3 * i + k] * before[3 * k + j]
        for i in range(3):
            for j in range(3):
                out[3 * i + j] = 0.0
                for k in range(3):
                    out[3 * i + j] += half[3 * i + k] * R[3 * j + k]
        local, before, place, out = local + 3, before + 9, place + 3, out + 9
    return places, headings, covariances
