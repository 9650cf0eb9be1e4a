# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Detections and objects in other frames and at other times. The references say what each function does."""

import numpy as np

from libc.math cimport atan2, fmax, fmin, sqrt

from mast_zenoh.kernels.algebra cimport wrapped
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

DIGEST = SOURCE_DIGEST.decode()


def moved(const double[:, :] position, const double[:, :] velocity, const double[:, :, :] covariance, double dt):
    cdef Py_ssize_t r, i, k, n = position.shape[0]
    places, covariances = np.empty((n, 3)), np.empty((n, 9, 9))
    cdef double[:, ::1] place = places
    cdef double[:, :, ::1] out = covariances
    for r in range(n):
        for i in range(9):
            for k in range(9):
                out[r, i, k] = covariance[r, i, k]
        for i in range(3):
            place[r, i] = position[r, i] + dt * velocity[r, i]
            for k in range(9):
                out[r, i, k] += dt * out[r, 6 + i, k]
        for k in range(9):
            for i in range(3):
                out[r, k, i] += dt * out[r, k, 6 + i]
    return places, covariances


def turned(
    const double[:, :] position, const double[:] yaw, const double[:, :, :] covariance, const double[:] origin,
    const double[:, :] rotation,
):
    cdef Py_ssize_t r, i, j, k, n = position.shape[0]
    cdef double heading = atan2(rotation[1, 0], rotation[0, 0])
    cdef double[9] half
    places, headings, covariances = np.empty((n, 3)), np.empty(n), np.empty((n, 3, 3))
    cdef double[:, ::1] place = places
    cdef double[::1] angle = headings
    cdef double[:, :, ::1] out = covariances
    for r in range(n):
        angle[r] = wrapped(yaw[r] + heading)
        for i in range(3):
            place[r, i] = origin[i]
            for j in range(3):
                place[r, i] += rotation[i, j] * position[r, j]
                half[3 * i + j] = 0.0
                for k in range(3):
                    half[3 * i + j] += rotation[i, k] * covariance[r, k, j]
        for i in range(3):
            for j in range(3):
                out[r, i, j] = 0.0
                for k in range(3):
                    out[r, i, j] += half[3 * i + k] * rotation[j, k]
    return places, headings, covariances


def box_noise(
    const double[:, :, :] covariance, const long long[::1] order, const double[::1] variance, double least, double most
):
    cdef Py_ssize_t r, s, i, j, n = order.shape[0]
    cdef double bound
    cdef bint said = False
    result = np.zeros((n, 6, 6))
    cdef double[:, :, ::1] noise = result
    for r in range(n):
        for i in range(3):
            for j in range(3):
                said = said or covariance[r, i, j] != 0.0
    for r in range(n):
        s = order[r]
        for i in range(6):
            noise[r, i, i] = variance[i]
        if said:
            for i in range(3):
                if covariance[s, i, i] > 0.0:
                    noise[r, i, i] = covariance[s, i, i]
                noise[r, i, i] = fmin(fmax(noise[r, i, i], least), most)
            bound = sqrt((noise[r, 0, 0] - 0.5 * least) * (noise[r, 1, 1] - 0.5 * least))
            noise[r, 0, 1] = noise[r, 1, 0] = fmin(fmax(covariance[s, 0, 1], -bound), bound)
    return result
