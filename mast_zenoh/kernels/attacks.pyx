# cython: language_level=3, cdivision=True
"""Kernels of the adversaries: tracking, imitation and occlusion by buildings. The NumPy references document them."""

cimport numpy as np
from libc.math cimport erf, fabs, fmax, fmin, sqrt
from libc.string cimport memcpy

from mast_zenoh.kernels.algebra cimport wrap_angle
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrices, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
    zero_vector,
)
from mast_zenoh.kernels.table cimport (
    SOURCE_DIGEST, FOLLOWED_VX, FOLLOWED_UNSEEN, FOLLOWED_AGE, FOLLOWED_HITS, FOLLOWED_ID, FOLLOWED_TARGET,
    FOLLOWED_ROW, FOLLOWED_COLUMNS,
)

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


def track_observations(tracks, position, velocity, id, double elapsed_s, double radius_m, limits):
    tracks, position, velocity = contiguous(tracks), contiguous(position), contiguous(velocity)
    cdef double gate_m = limits.gate_m, growth = limits.gate_growth_mps, max_speed = limits.fastest_mps
    cdef double drop_s = limits.forgotten_s, clutter_s = limits.clutter_s, same_id_m = limits.same_id_m
    cdef double min_alpha = limits.least_alpha, min_beta = limits.least_beta
    cdef Py_ssize_t m = length(tracks), n = length(position), t, r, p, axis, best, n_kept = 0, n_new = 0, count = 0
    cdef const double* measured = float_data(position, 2)
    cdef const double* measured_velocity = float_data(velocity, 2)
    cdef const np.int64_t* ids = int_data(id)
    state = empty_matrix(m, FOLLOWED_COLUMNS)
    cdef double* row = writable_data(state, 2)
    cdef double* first = row
    cdef double* track
    cdef double dx, dy, gate, alpha, beta, k, innovation, elapsed
    memcpy(row, float_data(tracks, 2), m * FOLLOWED_COLUMNS * sizeof(double))
    taken_ = zero_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* taken = byte_data(taken_)
    for t in range(m):
        track = first + t * FOLLOWED_COLUMNS
        for axis in range(3):
            track[axis] += track[FOLLOWED_VX + axis] * elapsed_s
        track[FOLLOWED_UNSEEN] += elapsed_s
        track[FOLLOWED_AGE] += elapsed_s
        track[FOLLOWED_ROW] = -1.0
        if track[FOLLOWED_ID] < 0.0:
            continue
        for r in range(n):
            if ids[r] >= 0 and <double>ids[r] == track[FOLLOWED_ID] and not taken[r]:
                dx, dy = track[0] - measured[3 * r], track[1] - measured[3 * r + 1]
                if dx * dx + dy * dy < same_id_m * same_id_m:
                    track[FOLLOWED_ROW], taken[r] = <double>r, 1
                    break
    # Pairs within the gates: counted, stored, and matched nearest first.
    for t in range(m):
        track = first + t * FOLLOWED_COLUMNS
        if track[FOLLOWED_ROW] >= 0.0:
            continue
        gate = fmin(gate_m + growth * track[FOLLOWED_UNSEEN] if track[FOLLOWED_HITS] > 1.0 else max_speed * track[FOLLOWED_UNSEEN], radius_m)
        for r in range(n):
            if not taken[r]:
                dx, dy = measured[3 * r] - track[0], measured[3 * r + 1] - track[1]
                count += dx * dx + dy * dy <= gate * gate
    tracks_, rows_, costs_ = empty_vector(np.NPY_INT64, count), empty_vector(np.NPY_INT64, count), empty_vector(np.NPY_DOUBLE, count)
    cdef np.int64_t* of_track = int_data(tracks_)
    cdef np.int64_t* of_row = int_data(rows_)
    cdef double* cost = writable_data(costs_, 1)
    count = 0
    for t in range(m):
        track = first + t * FOLLOWED_COLUMNS
        if track[FOLLOWED_ROW] >= 0.0:
            continue
        gate = fmin(gate_m + growth * track[FOLLOWED_UNSEEN] if track[FOLLOWED_HITS] > 1.0 else max_speed * track[FOLLOWED_UNSEEN], radius_m)
        for r in range(n):
            if not taken[r]:
                dx, dy = measured[3 * r] - track[0], measured[3 * r + 1] - track[1]
                if dx * dx + dy * dy <= gate * gate:
                    of_track[count], of_row[count], cost[count] = t, r, dx * dx + dy * dy
                    count += 1
    while True:
        best = -1
        for p in range(count):
            if first[of_track[p] * FOLLOWED_COLUMNS + FOLLOWED_ROW] < 0.0 and not taken[of_row[p]] and (best < 0 or cost[p] < cost[best]):
                best = p
        if best < 0:
            break
        first[of_track[best] * FOLLOWED_COLUMNS + FOLLOWED_ROW], taken[of_row[best]] = <double>of_row[best], 1
    for t in range(m):
        track = first + t * FOLLOWED_COLUMNS
        if track[FOLLOWED_ROW] >= 0.0:
            r = <Py_ssize_t>track[FOLLOWED_ROW]
            if measured_velocity[3 * r] != 0.0 or measured_velocity[3 * r + 1] != 0.0 or measured_velocity[3 * r + 2] != 0.0:
                for axis in range(3):
                    track[axis], track[FOLLOWED_VX + axis] = measured[3 * r + axis], measured_velocity[3 * r + axis]
            else:
                k = track[FOLLOWED_HITS]
                alpha = fmax(2.0 * (2.0 * k + 1.0) / ((k + 1.0) * (k + 2.0)), min_alpha)
                beta = fmax(6.0 / ((k + 1.0) * (k + 2.0)), min_beta)
                elapsed = fmax(track[FOLLOWED_UNSEEN], 1e-9)
                for axis in range(3):
                    innovation = measured[3 * r + axis] - track[axis]
                    track[axis] += alpha * innovation
                    track[FOLLOWED_VX + axis] += beta / elapsed * innovation
            track[FOLLOWED_ID], track[FOLLOWED_UNSEEN] = <double>ids[r], 0.0
            track[FOLLOWED_HITS] += 1.0
        n_kept += track[FOLLOWED_TARGET] >= 0.0 or track[FOLLOWED_UNSEEN] <= (drop_s if track[FOLLOWED_HITS] > 1.0 else clutter_s)
    for r in range(n):
        n_new += not taken[r]
    result = empty_matrix(n_kept + n_new, FOLLOWED_COLUMNS)
    cdef double* out = writable_data(result, 2)
    for t in range(m):
        track = first + t * FOLLOWED_COLUMNS
        if track[FOLLOWED_TARGET] >= 0.0 or track[FOLLOWED_UNSEEN] <= (drop_s if track[FOLLOWED_HITS] > 1.0 else clutter_s):
            memcpy(out, track, FOLLOWED_COLUMNS * sizeof(double))
            out += FOLLOWED_COLUMNS
    for r in range(n):
        if not taken[r]:
            for axis in range(3):
                out[axis], out[FOLLOWED_VX + axis] = measured[3 * r + axis], measured_velocity[3 * r + axis]
            out[FOLLOWED_UNSEEN], out[FOLLOWED_AGE], out[FOLLOWED_HITS], out[FOLLOWED_ID] = 0.0, 0.0, 1.0, <double>ids[r]
            out[FOLLOWED_TARGET], out[FOLLOWED_ROW] = -1.0, <double>r
            out += FOLLOWED_COLUMNS
    return result


cdef void sort(double* values, Py_ssize_t n) noexcept:
    """Sort in place, ascending; insertion sort, as messages have few rows."""
    cdef Py_ssize_t r, k
    cdef double value
    for r in range(1, n):
        value, k = values[r], r
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value


def imitate_rows(false_objects, errors, range_m, real, default_std, bint has_velocity, limits):
    errors = contiguous(errors)
    position_, velocity_, size_ = (contiguous(column) for column in false_objects[:3])
    row_positions_, covariance_ = contiguous(real[0]), contiguous(real[1])
    cdef const double* position = float_data(position_, 2)
    cdef const double* velocity = float_data(velocity_, 2)
    cdef const double* size = float_data(size_, 2)
    cdef const double* error = float_data(errors, 2)
    cdef const double* distance = float_data(range_m, 1)
    cdef const double* row_position = float_data(row_positions_, 2)
    cdef const double* covariance = float_data(covariance_, 3)
    cdef Py_ssize_t r, k, i, best, n = length(row_positions_), count = length(range_m), columns = length(errors, 1), typical = 0
    cdef double position_std = default_std[0], size_std = default_std[1], yaw_std = default_std[2]
    cdef double typical_trace, max_size_error = limits[1], dx, dy, std, limit, nearest
    cdef const double* reported
    yaw_, score_, sensor_ = contiguous(false_objects[3]), contiguous(real[2]), contiguous(real[3])
    cdef const double* yaw = float_data(yaw_, 1)
    cdef const double* score = float_data(score_, 1)
    cdef const double* sensor = float_data(sensor_, 1)
    traces_, sorted_, scores_, ranges_ = (empty_vector(np.NPY_DOUBLE, n) for _ in range(4))
    cdef double* trace = writable_data(traces_, 1)
    cdef double* ascending = writable_data(sorted_, 1)
    cdef double* scores = writable_data(scores_, 1)  # of typical rows, ascending
    cdef double* row_range = writable_data(ranges_, 1)
    for r in range(n):
        trace[r] = 0.0
        for i in range(9):
            trace[r] += covariance[81 * r + 10 * i]
    memcpy(ascending, trace, n * sizeof(double))
    sort(ascending, n)
    typical_trace = limits[0] * ascending[(n - 1) // 2]
    for r in range(n):
        if trace[r] <= typical_trace:
            scores[typical] = score[r]
            typical += 1
        dx, dy = row_position[3 * r] - sensor[0], row_position[3 * r + 1] - sensor[1]
        row_range[r] = sqrt(dx * dx + dy * dy)
    sort(scores, typical)
    noisy_position_, noisy_velocity_, noisy_size_ = empty_matrix(count, 3), empty_matrix(count, 3), empty_matrix(count, 3)
    heading_, noisy_score_, noisy_covariance_ = empty_vector(np.NPY_DOUBLE, count), empty_vector(np.NPY_DOUBLE, count), empty_matrices(count, 9)
    cdef double* noisy_position = writable_data(noisy_position_, 2)
    cdef double* noisy_velocity = writable_data(noisy_velocity_, 2)
    cdef double* noisy_size = writable_data(noisy_size_, 2)
    cdef double* heading = writable_data(heading_, 1)
    cdef double* noisy_score = writable_data(noisy_score_, 1)
    cdef double* noisy_covariance = writable_data(noisy_covariance_, 3)
    for k in range(count):
        best, nearest = 0, -1.0
        for r in range(n):
            if trace[r] <= typical_trace and (nearest < 0.0 or fabs(distance[k] - row_range[r]) < nearest):
                best, nearest = r, fabs(distance[k] - row_range[r])
        reported = covariance + 81 * best
        memcpy(noisy_covariance + 81 * k, reported, 81 * sizeof(double))
        for i in range(3):
            std = sqrt(fmax(reported[10 * i], 0.0))
            noisy_position[3 * k + i] = position[3 * k + i] + error[i] * (std if std > 0.0 else position_std)
            limit = max_size_error * size[3 * k + i]
            noisy_size[3 * k + i] = size[3 * k + i] + fmin(fmax(error[3 + i] * size_std, -limit), limit)
            noisy_velocity[3 * k + i] = velocity[3 * k + i]
            if has_velocity:
                noisy_velocity[3 * k + i] += error[6 + i] * sqrt(fmax(reported[10 * (6 + i)], 0.0))
        heading[k] = wrap_angle(yaw[k] + error[9] * yaw_std)
        r = <Py_ssize_t>((0.5 + 0.5 * erf(error[10] / sqrt(2.0))) * typical)
        noisy_score[k] = scores[r if r < typical else typical - 1]
        error += columns
    return noisy_position_, noisy_velocity_, noisy_size_, heading_, noisy_covariance_, noisy_score_


def occluded_by_walls(origin, positions, start, end, top):
    positions, start, end = contiguous(positions), contiguous(start), contiguous(end)
    cdef const double* sensor = float_data(origin, 1)
    cdef const double* position = float_data(positions, 2)
    cdef const double* a = float_data(start, 2)
    cdef const double* b = float_data(end, 2)
    cdef const double* height = float_data(top, 1)
    cdef Py_ssize_t p, w, n = length(positions), stride = length(positions, 1), walls = length(start)
    cdef double sx, sy, wx, wy, ox, oy, cross, along
    result = zero_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* hidden = byte_data(result)
    for p in range(n):
        sx, sy = position[stride * p] - sensor[0], position[stride * p + 1] - sensor[1]
        for w in range(walls):
            wx, wy = b[2 * w] - a[2 * w], b[2 * w + 1] - a[2 * w + 1]
            ox, oy = a[2 * w] - sensor[0], a[2 * w + 1] - sensor[1]
            cross = sx * wy - sy * wx
            if cross == 0.0:
                continue
            along = (ox * sy - oy * sx) / cross
            if along < 0.0 or along > 1.0:
                continue
            along = (ox * wy - oy * wx) / cross
            if along > 0.0 and along < 1.0 and sensor[2] + along * (position[stride * p + 2] - sensor[2]) <= height[w]:
                hidden[p] = 1
                break
    return result


def inside_outlines(positions, start, end, first):
    positions, start, end = contiguous(positions), contiguous(start), contiguous(end)
    cdef const double* position = float_data(positions, 2)
    cdef const double* a = float_data(start, 2)
    cdef const double* b = float_data(end, 2)
    cdef const np.int64_t* begin = int_data(first)
    cdef Py_ssize_t p, w, o, n = length(positions), stride = length(positions, 1), walls = length(start), outlines = length(first)
    cdef double x, y
    cdef bint odd
    result = zero_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* inside = byte_data(result)
    for p in range(n):
        x, y = position[stride * p], position[stride * p + 1]
        for o in range(outlines):
            odd = False
            for w in range(begin[o], begin[o + 1] if o + 1 < outlines else walls):
                if (a[2 * w + 1] > y) != (b[2 * w + 1] > y):
                    if x < a[2 * w] + (b[2 * w] - a[2 * w]) * (y - a[2 * w + 1]) / (b[2 * w + 1] - a[2 * w + 1]):
                        odd = not odd
            if odd:
                inside[p] = 1
                break
    return result
