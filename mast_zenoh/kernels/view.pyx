# cython: language_level=3, cdivision=True
"""What a sensor is expected to see. The reference says what the function does."""

cimport numpy as np
from libc.math cimport atan2, fabs, fmax, fmin, sqrt

from mast_zenoh.kernels.arrays cimport floats, length, made, table, whole, writable
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def expected(
    boxes, screens, position, rotation, tuple azimuth, tuple elevation, double max_range, double edge_m,
    double nearest_m,
):
    boxes, screens, rotation = whole(boxes), whole(screens), whole(rotation)
    cdef const double* box = floats(boxes, 2)
    cdef const double* screen = floats(screens, 2)
    cdef const double* origin = floats(position, 1)
    cdef const double* R = floats(rotation, 2)
    cdef Py_ssize_t r, s, k, n = length(boxes), m = length(screens)
    cdef Py_ssize_t wide = length(boxes, 1), broad = length(screens, 1)
    cdef double low = azimuth[0], high = azimuth[1], down = elevation[0], up = elevation[1]
    cdef double ground, distance, inside, angle, top, x, y, z, u, v
    cdef bint partial = high - low < 2 * PI - 1e-6
    cdef double[3] at
    result, others = made(np.NPY_DOUBLE, n), table(m, 5)
    cdef double* out = writable(result, 1)
    cdef double* first = writable(others, 2)  # x, y, radius, distance of the far side, slope of the line over the top
    cdef double* other = first
    for s in range(m):
        x, y, z = screen[0] - origin[0], screen[1] - origin[1], screen[2] - origin[2]
        ground = fmax(sqrt(x * x + y * y), nearest_m)
        other[0], other[1] = x, y
        other[2] = 0.25 * (screen[3] + screen[4])
        other[3] = ground + 0.5 * screen[4]
        other[4] = (z + 0.5 * screen[5]) / ground
        screen, other = screen + broad, other + 5
    for r in range(n):
        x, y, z = box[0] - origin[0], box[1] - origin[1], box[2] - origin[2]
        for k in range(3):
            at[k] = x * R[k] + y * R[3 + k] + z * R[6 + k]
        ground = sqrt(at[0] * at[0] + at[1] * at[1])
        distance = sqrt(ground * ground + at[2] * at[2])
        inside = max_range - distance
        if partial:
            angle = atan2(at[1], at[0])
            inside = fmin(inside, fmin(angle - low, high - angle) * ground)
        angle = atan2(at[2], ground)
        inside = fmin(inside, fmin(angle - down, up - angle) * distance)
        out[r] = fmin(fmax(0.5 + (0.5 / edge_m) * inside, 0.0), 1.0)
        ground = fmax(sqrt(x * x + y * y), nearest_m)
        top = (z + 0.5 * box[5]) / ground
        other = first
        for s in range(m):
            u, v = other[0], other[1]
            if (
                ground > other[3] and top < other[4] and x * u + y * v > 0.0
                and fabs(y * u - x * v) < ground * other[2]
            ):
                out[r] = 0.0
                break
            other += 5
        box += wide
    return result
