# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Small symmetric matrices, stored by rows, factorised with zeros skipped; angles; Gaussians in the plane."""

from libc.math cimport floor, log
from libc.string cimport memset

cdef enum:
    MAX_ROWS = 9  # of a matrix


cdef inline void factorise(double* a, Py_ssize_t m) noexcept nogil:
    """Factorise `a` (m, m), symmetric, positive definite, in place: L below the diagonal, D on it; a = L D L'."""
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
    """Replace `b` (m, columns) by L^-1 b."""
    cdef Py_ssize_t i, k, c
    cdef double factor
    for i in range(m):
        for k in range(i):
            factor = l[i * m + k]
            if factor != 0.0:
                for c in range(columns):
                    b[i * columns + c] -= factor * b[k * columns + c]


cdef inline void invert(double* a, Py_ssize_t m, double* result) noexcept nogil:
    """Write the inverse of `a` (m, m), symmetric, positive definite, to `result`; overwrites `a`."""
    cdef double[MAX_ROWS * MAX_ROWS] inverse_l
    cdef Py_ssize_t i, j, k
    cdef double factor
    factorise(a, m)
    memset(inverse_l, 0, sizeof(inverse_l))
    memset(result, 0, m * m * sizeof(double))
    for i in range(m):
        inverse_l[i * m + i] = 1.0
    forward(a, m, inverse_l, m)
    # (L D L')^-1 = R' D^-1 R with R = L^-1, which is lower triangular.
    for k in range(m):
        for i in range(k + 1):
            factor = inverse_l[k * m + i]
            if factor != 0.0:
                factor /= a[k * m + k]
                for j in range(i + 1):
                    result[i * m + j] += factor * inverse_l[k * m + j]
    for i in range(m):
        for j in range(i):
            result[j * m + i] = result[i * m + j]


cdef inline double wrap_angle(double angle) noexcept nogil:
    """Wrap an angle to [-pi, pi), as `geometry.wrap_angle`."""
    cdef double pi = 3.141592653589793
    angle += pi
    return angle - 2.0 * pi * floor(angle / (2.0 * pi)) - pi


cdef inline double distance_of(double dx, double dy, double a, double b, double c, double* log_density) noexcept nogil:
    """Squared distance at (dx, dy) of a zero-mean Gaussian with covariance [[a, b], [b, c]], and its log density."""
    cdef double log_2_pi = 1.8378770664093453
    cdef double slope = b / a
    cdef double conditional = c - b * slope
    cdef double distance
    dy = dy - slope * dx
    distance = dx * dx / a + dy * dy / conditional
    log_density[0] = -0.5 * (distance + log(a * conditional)) - log_2_pi
    return distance
