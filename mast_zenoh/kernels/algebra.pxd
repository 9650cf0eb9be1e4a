# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Small symmetric matrices, by rows, with the least work: most of their numbers are zero."""

from libc.math cimport floor
from libc.string cimport memset

cdef enum:
    MOST = 9  # rows of the largest matrix


cdef inline void factorise(double* a, Py_ssize_t m) noexcept nogil:
    """L D L' of `a` (m, m), symmetric, positive definite: L below the diagonal, D on it."""
    cdef Py_ssize_t i, j, k
    cdef double scaled
    for k in range(m):
        for i in range(k + 1, m):
            if a[i * m + k] != 0.0:
                scaled = a[i * m + k] / a[k * m + k]
                for j in range(k + 1, i + 1):
                    a[i * m + j] -= scaled * a[j * m + k]
        for i in range(k + 1, m):
            a[i * m + k] /= a[k * m + k]


cdef inline void forward(const double* l, Py_ssize_t m, double* b, Py_ssize_t columns) noexcept nogil:
    """L^-1 b in place of `b` (m, columns)."""
    cdef Py_ssize_t i, k, c
    cdef double factor
    for i in range(m):
        for k in range(i):
            factor = l[i * m + k]
            if factor != 0.0:
                for c in range(columns):
                    b[i * columns + c] -= factor * b[k * columns + c]


cdef inline void invert(double* a, Py_ssize_t m, double* result) noexcept nogil:
    """The inverse of `a` (m, m), symmetric, positive definite, into `result`; `a` is spoilt."""
    cdef double[MOST * MOST] rows
    cdef Py_ssize_t i, j, k
    cdef double factor
    factorise(a, m)
    memset(rows, 0, sizeof(rows))
    memset(result, 0, m * m * sizeof(double))
    for i in range(m):
        rows[i * m + i] = 1.0
    forward(a, m, rows, m)
    # (L D L')^-1 = R' D^-1 R with R = L^-1, which is lower triangular.
    for k in range(m):
        for i in range(k + 1):
            factor = rows[k * m + i]
            if factor != 0.0:
                factor /= a[k * m + k]
                for j in range(i + 1):
                    result[i * m + j] += factor * rows[k * m + j]
    for i in range(m):
        for j in range(i):
            result[j * m + i] = result[i * m + j]


cdef inline double wrapped(double angle) noexcept nogil:
    """An angle in [-pi, pi), as `geometry.wrap_angle` has it."""
    cdef double pi = 3.141592653589793
    angle += pi
    return angle - 2.0 * pi * floor(angle / (2.0 * pi)) - pi
