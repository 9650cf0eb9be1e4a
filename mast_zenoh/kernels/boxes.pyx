# cython: language_level=3, cdivision=True
"""Kernels for boxes and views: visibility, overlap. The NumPy references document them."""

cimport numpy as np
from libc.math cimport atan2, cos, fabs, fmax, fmin, sin, sqrt

from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, length, writable_data,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def visible_fraction(boxes, occluders, view, double edge_m, double nearest_m):
    boxes, occluders, rotation, position = contiguous(boxes), contiguous(occluders), contiguous(view.rotation), view.position
    cdef const double* box = float_data(boxes, 2)
    cdef const double* occluder = float_data(occluders, 2)
    cdef const double* origin = float_data(position, 1)
    cdef const double* R = float_data(rotation, 2)
    cdef Py_ssize_t r, s, k, n = length(boxes), m = length(occluders)
    cdef Py_ssize_t box_stride = length(boxes, 1), occluder_stride = length(occluders, 1)
    cdef double low = view.azimuth_min, high = view.azimuth_max, down = view.elevation_min, up = view.elevation_max
    cdef double max_range = view.max_range
    cdef double ground, distance, inside, angle, top, x, y, z, u, v
    cdef bint partial = high - low < 2 * PI - 1e-6
    cdef double[3] at
    result, projected = empty_vector(np.NPY_DOUBLE, n), empty_matrix(m, 5)
    cdef double* out = writable_data(result, 1)
    cdef double* first = writable_data(projected, 2)  # x, y, radius, distance of the far side, slope of the line over the top
    cdef double* projection = first
    for s in range(m):
        x, y, z = occluder[0] - origin[0], occluder[1] - origin[1], occluder[2] - origin[2]
        ground = fmax(sqrt(x * x + y * y), nearest_m)
        projection[0], projection[1] = x, y
        projection[2] = 0.25 * (occluder[3] + occluder[4])
        projection[3] = ground + 0.5 * occluder[4]
        projection[4] = (z + 0.5 * occluder[5]) / ground
        occluder, projection = occluder + occluder_stride, projection + 5
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
        projection = first
        for s in range(m):
            u, v = projection[0], projection[1]
            if (
                ground > projection[3] and top < projection[4] and x * u + y * v > 0.0
                and fabs(y * u - x * v) < ground * projection[2]
            ):
                out[r] = 0.0
                break
            projection += 5
        box += box_stride
    return result


def overlap(offset, size, yaw, other_size, other_yaw, double share):
    offset, size, yaw = contiguous(offset), contiguous(size), contiguous(yaw)
    other_size, other_yaw = contiguous(other_size), contiguous(other_yaw)
    cdef const double* off = float_data(offset, 2)
    cdef const double* box = float_data(size, 2)
    cdef const double* heading = float_data(yaw, 1)
    cdef const double* other = float_data(other_size, 2)
    cdef const double* other_heading = float_data(other_yaw, 1)
    cdef Py_ssize_t p, n = length(offset)
    cdef double c, s, u, v
    result = empty_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* out = byte_data(result)
    for p in range(n):
        c, s = cos(heading[p]), sin(heading[p])
        u, v = fabs(cos(other_heading[p] - heading[p])), fabs(sin(other_heading[p] - heading[p]))
        out[p] = (
            fabs(c * off[0] + s * off[1]) < 0.5 * share * (box[0] + u * other[0] + v * other[1])
            and fabs(c * off[1] - s * off[0]) < 0.5 * share * (box[1] + v * other[0] + u * other[1])
        )
        off, box, other = off + 2, box + 3, other + 3
    return result
