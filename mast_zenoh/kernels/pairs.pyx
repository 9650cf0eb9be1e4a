# cython: language_level=3, cdivision=True
"""Kernels for pairs of objects: gating, association gains. The NumPy references document them."""

cimport numpy as np
from libc.math cimport INFINITY, fabs, fmax, fmin, log, sqrt

from mast_zenoh.kernels.algebra cimport distance_of
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_vector, float_data, int_data, length, writable_data, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST, XX, XY, YY, ODDS, CLASS, WIDTH

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


def gate_radius(t, covariance, jump, double gate):
    cdef const double* row = float_data(t, 2)
    cdef const double* noise = float_data(covariance, 3)
    cdef const double* variance_of = float_data(jump, 1)
    cdef Py_ssize_t r, n = length(t), k = length(covariance, 1)
    cdef double widest = 0.0
    result = empty_vector(np.NPY_DOUBLE, n)
    cdef double* out = writable_data(result, 1)
    for r in range(length(covariance)):
        widest = fmax(widest, noise[0] + noise[k + 1])
        noise += k * k
    for r in range(n):
        out[r] = sqrt(gate * (row[XX] + row[YY] + 0.5 * variance_of[<Py_ssize_t>row[CLASS]] + widest))
        row += WIDTH
    return result


def pairs_within_radius(a, b, radius):
    a, b = contiguous(a), contiguous(b)
    cdef const double* position_a = float_data(a, 2)
    cdef const double* position_b = float_data(b, 2)
    cdef const double* radii = float_data(radius, 1)
    cdef Py_ssize_t n = length(a), m = length(b), stride_a = length(a, 1), stride_b = length(b, 1), i, j, p = 0
    cdef double dx, dy, limit
    # Two passes: count, then store.
    for i in range(n):
        limit = radii[i] * radii[i]
        for j in range(m):
            dx = position_b[stride_b * j] - position_a[stride_a * i]
            dy = position_b[stride_b * j + 1] - position_a[stride_a * i + 1]
            p += dx * dx + dy * dy <= limit
    rows, others = empty_vector(np.NPY_INT64, p), empty_vector(np.NPY_INT64, p)
    east, north = empty_vector(np.NPY_DOUBLE, p), empty_vector(np.NPY_DOUBLE, p)
    cdef np.int64_t* of_a = int_data(rows)
    cdef np.int64_t* of_b = int_data(others)
    cdef double* x = writable_data(east, 1)
    cdef double* y = writable_data(north, 1)
    p = 0
    for i in range(n):
        limit = radii[i] * radii[i]
        for j in range(m):
            dx = position_b[stride_b * j] - position_a[stride_a * i]
            dy = position_b[stride_b * j + 1] - position_a[stride_a * i + 1]
            if dx * dx + dy * dy <= limit:
                of_a[p], of_b[p], x[p], y[p] = i, j, dx, dy
                p += 1
    return rows, others, east, north


def gated_pairs(t, detected, boxes, near, gates, model):
    i, j, dx, dy = near
    position, covariance, class_id = boxes
    jump, log_of_jump, clutter, confusion = model
    cdef const double* rows = float_data(t, 2)
    cdef const double* detection = float_data(detected, 1)
    cdef const double* at = float_data(position, 2)
    cdef const double* noise = float_data(covariance, 3)
    cdef const np.int64_t* class_of = int_data(class_id)
    cdef const double* jump_of = float_data(jump, 1)
    cdef const double* log_confusion = float_data(confusion, 2)
    cdef double log_jump = log_of_jump, log_clutter = clutter
    cdef const np.int64_t* of_t = int_data(i)
    cdef const np.int64_t* of_m = int_data(j)
    cdef const double* x = float_data(dx, 1)
    cdef const double* y = float_data(dy, 1)
    cdef Py_ssize_t n = length(t), m = length(position), stride = length(position, 1), w = length(covariance, 1)
    cdef Py_ssize_t p, q, r, s, k = 0, count = length(i), classes = length(confusion, 1)
    cdef double gate = gates.steady, jump_gate = gates.sudden, level_m = gates.level_m
    cdef double standing = gates.standing, per_speed = gates.moving
    cdef double a, b, c, jump_variance
    cdef const double* row
    cdef const double* measurement_noise
    inside, explained, measured = zero_vector(np.NPY_UINT8, count), zero_vector(np.NPY_UINT8, n), zero_vector(np.NPY_UINT8, m)
    density, added = empty_vector(np.NPY_DOUBLE, count), zero_vector(np.NPY_DOUBLE, count)
    cdef np.uint8_t* chosen = byte_data(inside)
    cdef np.uint8_t* track_explained = byte_data(explained)
    cdef np.uint8_t* measurement_explained = byte_data(measured)
    cdef double* log_density = writable_data(density, 1)
    cdef double* variance = writable_data(added, 1)
    for p in range(count):
        r, s = of_t[p], of_m[p]
        row, measurement_noise = rows + WIDTH * r, noise + w * w * s
        a = row[XX] + measurement_noise[0]
        b = row[XY] + measurement_noise[1]
        c = row[YY] + measurement_noise[w + 1]
        if fabs(at[stride * s + 2] - row[2]) <= level_m:
            chosen[p] = 2  # on the same level
            if distance_of(x[p], y[p], a, b, c, &log_density[p]) <= gate:
                chosen[p] = 1
                track_explained[r] = measurement_explained[s] = 1
                k += 1
    for p in range(count):
        r, s = of_t[p], of_m[p]
        if chosen[p] == 2:
            chosen[p] = 0
            if not track_explained[r] and not measurement_explained[s]:
                row, measurement_noise = rows + WIDTH * r, noise + w * w * s
                jump_variance = jump_of[<Py_ssize_t>row[CLASS]] * fmin(standing + per_speed * (row[6] * row[6] + row[7] * row[7]), 1.0)
                a = row[XX] + measurement_noise[0] + jump_variance
                b = row[XY] + measurement_noise[1]
                c = row[YY] + measurement_noise[w + 1] + jump_variance
                if distance_of(x[p], y[p], a, b, c, &log_density[p]) <= jump_gate:
                    log_density[p] += log_jump
                    variance[p] = jump_variance
                    chosen[p] = 1
                    k += 1
    tracks, measurements = empty_vector(np.NPY_INT64, k), empty_vector(np.NPY_INT64, k)
    ratios, jumps, costs = empty_vector(np.NPY_DOUBLE, k), empty_vector(np.NPY_DOUBLE, k), empty_vector(np.NPY_DOUBLE, k)
    cdef np.int64_t* out_i = int_data(tracks)
    cdef np.int64_t* out_j = int_data(measurements)
    cdef double* ratio = writable_data(ratios, 1)
    cdef double* out_added = writable_data(jumps, 1)
    cdef double* cost = writable_data(costs, 1)
    q = 0
    for p in range(count):
        if chosen[p]:
            r, s = of_t[p], of_m[p]
            row = rows + WIDTH * r
            out_i[q], out_j[q], out_added[q] = r, s, variance[p]
            ratio[q] = log_density[p] - log_clutter + log_confusion[classes * <Py_ssize_t>row[CLASS] + class_of[s]]
            cost[q] = -(ratio[q] + log(detection[r] * row[ODDS] / ((1.0 - detection[r]) * (1.0 + row[ODDS]))))
            q += 1
    return tracks, measurements, ratios, jumps, costs


def useful_pairs(row, column, cost):
    cdef const np.int64_t* of_row = int_data(row)
    cdef const np.int64_t* of_column = int_data(column)
    cdef const double* costs = float_data(cost, 1)
    cdef Py_ssize_t p, k = 0, count = length(row)
    cdef np.int64_t last_row = -1, last_column = -1
    for p in range(count):
        if costs[p] < 0.0:
            k += 1
            last_row, last_column = max(last_row, of_row[p]), max(last_column, of_column[p])
    chosen, alone = empty_vector(np.NPY_INT64, k), empty_vector(np.NPY_BOOL, k)
    if k == 0:
        return chosen, alone
    in_rows, in_columns = zero_vector(np.NPY_INT64, last_row + 1), zero_vector(np.NPY_INT64, last_column + 1)
    cdef np.int64_t* rows = int_data(in_rows)
    cdef np.int64_t* columns = int_data(in_columns)
    cdef np.int64_t* useful = int_data(chosen)
    cdef np.uint8_t* single = byte_data(alone)
    k = 0
    for p in range(count):
        if costs[p] < 0.0:
            useful[k] = p
            k += 1
            rows[of_row[p]] += 1
            columns[of_column[p]] += 1
    for p in range(k):
        single[p] = rows[of_row[useful[p]]] == 1 and columns[of_column[useful[p]]] == 1
    return chosen, alone


def pairs_in_groups(a_group, a_position, b_group, b_position, double radius):
    a_position, b_position = contiguous(a_position), contiguous(b_position)
    cdef const np.int64_t* groups_a = int_data(a_group)
    cdef const double* position_a = float_data(a_position, 2)
    cdef const np.int64_t* groups_b = int_data(b_group)
    cdef const double* position_b = float_data(b_position, 2)
    cdef Py_ssize_t n = length(a_group), m = length(b_group), stride_a = length(a_position, 1), stride_b = length(b_position, 1)
    cdef Py_ssize_t i, k, p = 0, capacity = 2 * max(n, m)
    cdef np.int64_t group, last = -1
    cdef double dx, dy, limit = radius * (1.0 + 1e-9) + 1e-9
    for k in range(m):
        last = max(last, groups_b[k])
    # Rows of b by group, in their order.
    by_group = b_group.argsort(kind="stable")
    begins = zero_vector(np.NPY_INT64, last + 2)
    cdef const np.int64_t* row = int_data(by_group)
    cdef np.int64_t* start = int_data(begins)
    for k in range(m):
        start[groups_b[k] + 1] += 1
    for group in range(last + 1):
        start[group + 1] += start[group]
    rows, others = empty_vector(np.NPY_INT64, capacity), empty_vector(np.NPY_INT64, capacity)
    cdef np.int64_t* of_a = int_data(rows)
    cdef np.int64_t* of_b = int_data(others)
    for i in range(n):
        group = groups_a[i]
        if group > last:
            continue
        if p + start[group + 1] - start[group] > capacity:
            capacity = 2 * capacity + start[group + 1] - start[group]
            rows.resize(capacity, refcheck=False)
            others.resize(capacity, refcheck=False)
            of_a, of_b = int_data(rows), int_data(others)
        for k in range(start[group], start[group + 1]):
            dx = position_a[stride_a * i] - position_b[stride_b * row[k]]
            dy = position_a[stride_a * i + 1] - position_b[stride_b * row[k] + 1]
            if dx * dx + dy * dy <= limit * limit:
                of_a[p], of_b[p] = i, row[k]
                p += 1
    return rows[:p], others[:p]


def nearest_points(position, path, least, double reach_m):
    path = contiguous(path)
    cdef const double* at = float_data(position, 2)
    cdef const double* point = float_data(path, 2)
    cdef const np.int64_t* first = int_data(least)
    cdef Py_ssize_t r, k, n = length(position), stride = length(position, 1), points = length(path)
    cdef double dx, dy, squared, closest
    result = empty_vector(np.NPY_INT64, n)
    cdef np.int64_t* nearest = int_data(result)
    for r in range(n):
        nearest[r], closest = -1, INFINITY
        for k in range(first[r], points):
            dx, dy = at[0] - point[2 * k], at[1] - point[2 * k + 1]
            squared = dx * dx + dy * dy
            if squared < closest and squared <= reach_m * reach_m:
                nearest[r], closest = k, squared
        at += stride
    return result


def common_tracks(left, track, double radius_m):
    left = contiguous(left)
    cdef const double* at = float_data(left, 3)
    cdef const np.int64_t* of_track = int_data(track)
    cdef Py_ssize_t h, i, j, n = length(left), k = length(left, 1)
    cdef double dx, dy, limit = radius_m * radius_m
    cdef np.int64_t last
    counts = zero_vector(np.NPY_INT64, n * k)
    cdef np.int64_t* count = int_data(counts)
    for h in range(n):
        for i in range(k):
            last = -1
            for j in range(k):
                dx, dy = at[2 * j] - at[2 * i], at[2 * j + 1] - at[2 * i + 1]
                if dx * dx + dy * dy <= limit and of_track[j] != last:
                    last = of_track[j]
                    count[i] += 1
        at, count = at + 2 * k, count + k
    return counts.reshape(n, k)


def pair_equations(one, other, offset, information, design, weight, Py_ssize_t a):
    offset, information, design = contiguous(offset), contiguous(information), contiguous(design)
    cdef const np.int64_t* of_one = int_data(one)
    cdef const np.int64_t* of_other = int_data(other)
    cdef const double* away = float_data(offset, 2)
    cdef const double* certain = float_data(information, 3)
    cdef const double* slope = float_data(design, 3)
    cdef const double* counts = float_data(weight, 1)
    cdef Py_ssize_t row, p, q, n = length(one)
    matrices, vectors = zero_vector(np.NPY_DOUBLE, 16 * a * a), zero_vector(np.NPY_DOUBLE, 4 * a * a)
    cdef double* matrix
    cdef double* vector
    cdef double* first_matrix = writable_data(matrices, 1)
    cdef double* first_vector = writable_data(vectors, 1)
    cdef double x, y
    for row in range(n):
        matrix = first_matrix + 16 * (of_one[row] * a + of_other[row])
        vector = first_vector + 4 * (of_one[row] * a + of_other[row])
        for p in range(4):
            x = counts[row] * (slope[p] * certain[0] + slope[4 + p] * certain[2])
            y = counts[row] * (slope[p] * certain[1] + slope[4 + p] * certain[3])
            vector[p] += x * away[0] + y * away[1]
            for q in range(4):
                matrix[4 * p + q] += x * slope[q] + y * slope[4 + q]
        away, certain, slope = away + 2, certain + 4, slope + 8
    return matrices.reshape(a, a, 4, 4), vectors.reshape(a, a, 4)
