# cython: language_level=3, cdivision=True
"""Kernels that transform detections and objects in space and time. The NumPy references document them."""

cimport numpy as np
from libc.math cimport atan2, fmax, fmin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport wrap_angle
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrices, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST, N_CLASSES

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


def constant_velocity(position, velocity, covariance, double dt):
    position, velocity, covariance = contiguous(position), contiguous(velocity), contiguous(covariance)
    cdef const double* start = float_data(position, 2)
    cdef const double* rate = float_data(velocity, 2)
    cdef const double* before = float_data(covariance, 3)
    cdef Py_ssize_t r, i, k, n = length(position)
    places, covariances = empty_matrix(n, 3), empty_matrices(n, 9)
    cdef double* place = writable_data(places, 2)
    cdef double* out = writable_data(covariances, 3)
    memcpy(out, before, 81 * n * sizeof(double))
    for r in range(n):
        for i in range(3):
            place[i] = start[3 * r + i] + dt * rate[3 * r + i]
            for k in range(9):
                out[9 * i + k] += dt * out[9 * (6 + i) + k]
        for k in range(9):
            for i in range(3):
                out[9 * k + i] += dt * out[9 * k + 6 + i]
        place += 3
        out += 81
    return places, covariances


def rigid_transform(position, yaw, covariance, origin, rotation):
    position, yaw, covariance, rotation = contiguous(position), contiguous(yaw), contiguous(covariance), contiguous(rotation)
    cdef const double* local = float_data(position, 2)
    cdef const double* local_yaw = float_data(yaw, 1)
    cdef const double* before = float_data(covariance, 3)
    cdef const double* centre = float_data(origin, 1)
    cdef const double* R = float_data(rotation, 2)
    cdef Py_ssize_t r, i, j, k, n = length(position)
    cdef double heading = atan2(R[3], R[0])
    cdef double[9] rotated
    places, headings, covariances = empty_matrix(n, 3), empty_vector(np.NPY_DOUBLE, n), empty_matrices(n, 3)
    cdef double* place = writable_data(places, 2)
    cdef double* angle = writable_data(headings, 1)
    cdef double* out = writable_data(covariances, 3)
    for r in range(n):
        angle[r] = wrap_angle(local_yaw[r] + heading)
        for i in range(3):
            place[i] = centre[i]
            for j in range(3):
                place[i] += R[3 * i + j] * local[j]
                rotated[3 * i + j] = 0.0
                for k in range(3):
                    rotated[3 * i + j] += R[3 * i + k] * before[3 * k + j]
        for i in range(3):
            for j in range(3):
                out[3 * i + j] = 0.0
                for k in range(3):
                    out[3 * i + j] += rotated[3 * i + k] * R[3 * j + k]
        local, before, place, out = local + 3, before + 9, place + 3, out + 9
    return places, headings, covariances


def ordered_boxes(order, columns, variance, double least, double most):
    positions, sizes, yaws, classes, scores, covariances = columns
    positions, sizes, covariances = contiguous(positions), contiguous(sizes), contiguous(covariances)
    yaws, classes, scores = contiguous(yaws), contiguous(classes), contiguous(scores)
    cdef const np.int64_t* row = int_data(order)
    cdef const double* position = float_data(positions, 2)
    cdef const double* size = float_data(sizes, 2)
    cdef const double* yaw = float_data(yaws, 1)
    cdef const np.uint8_t* class_id = byte_data(classes)
    cdef const double* score = float_data(scores, 1)
    cdef const double* reported = float_data(covariances, 3)
    cdef const double* default = float_data(variance, 1)
    cdef const double* own
    cdef Py_ssize_t r, i, n = length(order)
    cdef double bound
    cdef bint known = False
    boxes, noises, out_yaws = empty_matrix(n, 6), empty_matrices(n, 6), empty_vector(np.NPY_DOUBLE, n)
    out_classes, out_scores = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_DOUBLE, n)
    cdef double* box = writable_data(boxes, 2)
    cdef double* noise = writable_data(noises, 3)
    cdef double* out_yaw = writable_data(out_yaws, 1)
    cdef np.int64_t* out_class = int_data(out_classes)
    cdef double* out_score = writable_data(out_scores, 1)
    memset(noise, 0, 36 * n * sizeof(double))
    for i in range(9 * length(covariances)):
        known = known or reported[i] != 0.0
    for r in range(n):
        own = reported + 9 * row[r]
        memcpy(box, position + 3 * row[r], 3 * sizeof(double))
        memcpy(box + 3, size + 3 * row[r], 3 * sizeof(double))
        out_yaw[r], out_score[r] = yaw[row[r]], score[row[r]]
        out_class[r] = class_id[row[r]] if class_id[row[r]] < N_CLASSES else 0
        for i in range(6):
            noise[7 * i] = default[i]
        if known:
            for i in range(3):
                if own[4 * i] > 0.0:
                    noise[7 * i] = own[4 * i]
                noise[7 * i] = fmin(fmax(noise[7 * i], least), most)
            bound = sqrt((noise[0] - 0.5 * least) * (noise[7] - 0.5 * least))
            noise[1] = noise[6] = fmin(fmax(own[1], -bound), bound)
        box, noise = box + 6, noise + 36
    return boxes, noises, out_yaws, out_classes, out_scores


def sorted_rows(keys):
    order = np.PyArray_ArgSort(keys[0], 0, np.NPY_MERGESORT) if len(keys) == 1 else np.PyArray_LexSort(keys, 0)
    cdef Py_ssize_t r, n = length(order), left = max(n - 1, 0)
    cdef const double* real
    cdef const np.int64_t* whole
    tie_mask = empty_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* tied = byte_data(tie_mask)  # with the next row
    memset(tied, 1, n)
    for key in keys:
        ordered = key.take(order)
        if np.PyArray_TYPE(ordered) == np.NPY_DOUBLE:
            real = float_data(ordered, 1)
            for r in range(left):
                tied[r] = tied[r] and real[r] == real[r + 1]
        elif np.PyArray_TYPE(ordered) == np.NPY_INT64:
            whole = int_data(ordered)
            for r in range(left):
                tied[r] = tied[r] and whole[r] == whole[r + 1]
        else:
            for r in range(left):
                tied[r] = tied[r] and ordered[r] == ordered[r + 1]
    for r in range(left):
        if tied[r]:
            return order, True
    return order, False


def rotation_from_quaternion(quaternion):
    quaternion = np.PyArray_FROMANY(quaternion, np.NPY_DOUBLE, 1, 0, np.NPY_ARRAY_CARRAY_RO)
    cdef Py_ssize_t r, n = np.PyArray_SIZE(quaternion) // 4
    flat, result = quaternion.reshape(n, 4), empty_matrix(n, 9)
    cdef const double* q = float_data(flat, 2)
    cdef double* R = writable_data(result, 2)
    cdef double w, x, y, z, norm
    for r in range(n):
        if np.PyArray_NDIM(quaternion) == 1:
            w, x, y, z = q[0], q[1], q[2], q[3]
            norm = 2.0 / (w * w + x * x + y * y + z * z)
        else:
            norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            w, x, y, z, norm = q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm, 2.0
        R[0], R[1], R[2] = 1.0 - norm * (y * y + z * z), norm * (x * y - w * z), norm * (x * z + w * y)
        R[3], R[4], R[5] = norm * (x * y + w * z), 1.0 - norm * (x * x + z * z), norm * (y * z - w * x)
        R[6], R[7], R[8] = norm * (x * z - w * y), norm * (y * z + w * x), 1.0 - norm * (x * x + y * y)
        q, R = q + 4, R + 9
    return result.reshape((<object>quaternion).shape[:-1] + (3, 3))


def quaternion_from_rotation(rotation):
    rotation = contiguous(rotation)
    cdef Py_ssize_t r, k, largest, n = np.PyArray_SIZE(rotation) // 9
    flat, result = rotation.reshape(n, 9), empty_matrix(n, 4)
    cdef const double* R = float_data(flat, 2)
    cdef double* q = writable_data(result, 2)
    cdef double trace, norm
    cdef double[4] four  # squares of the components, times four
    for r in range(n):
        trace = R[0] + R[4] + R[8]
        four[0] = 1.0 + trace
        largest = 0
        for k in range(3):
            four[k + 1] = 1.0 - trace + 2.0 * R[4 * k]
            if four[k + 1] > four[largest]:
                largest = k + 1
        if largest == 0:
            q[0], q[1], q[2], q[3] = four[0], R[7] - R[5], R[2] - R[6], R[3] - R[1]
        elif largest == 1:
            q[0], q[1], q[2], q[3] = R[7] - R[5], four[1], R[1] + R[3], R[2] + R[6]
        elif largest == 2:
            q[0], q[1], q[2], q[3] = R[2] - R[6], R[1] + R[3], four[2], R[5] + R[7]
        else:
            q[0], q[1], q[2], q[3] = R[3] - R[1], R[2] + R[6], R[5] + R[7], four[3]
        norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if q[0] < 0.0:
            norm = -norm
        for k in range(4):
            q[k] /= norm
        R, q = R + 9, q + 4
    return result.reshape((*rotation.shape[: rotation.ndim - 2], 4))
