# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""What lies near what, and in front of it: gating, overlap, view. The references say what each function does."""

import numpy as np

from libc.math cimport atan2, cos, fabs, fmax, fmin, log, sin, sqrt

from mast_zenoh.kernels.table cimport SOURCE_DIGEST, XX, XY, YY, ODDS, CLASS

DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793
cdef double LOG_2_PI = log(2.0 * 3.141592653589793)


def reach(const double[:, ::1] t, const double[:, :, ::1] covariance, const double[::1] jump, double gate):
    cdef Py_ssize_t r, m = covariance.shape[0]
    cdef double widest = 0.0
    result = np.empty(t.shape[0])
    cdef double[::1] out = result
    for r in range(m):
        widest = fmax(widest, covariance[r, 0, 0] + covariance[r, 1, 1])
    for r in range(t.shape[0]):
        out[r] = sqrt(gate * (t[r, XX] + t[r, YY] + 0.5 * jump[r] + widest))
    return result


def pairs_in_reach(const double[:, :] a, const double[:, :] b, const double[::1] reach):
    cdef Py_ssize_t n = a.shape[0], m = b.shape[0], i, j, p = 0
    cdef double dx, dy, limit
    # Twice: counted, then written.
    for i in range(n):
        limit = reach[i] * reach[i]
        for j in range(m):
            dx = b[j, 0] - a[i, 0]
            dy = b[j, 1] - a[i, 1]
            p += dx * dx + dy * dy <= limit
    rows, others, east, north = np.empty(p, np.int64), np.empty(p, np.int64), np.empty(p), np.empty(p)
    cdef long long[::1] of_a = rows, of_b = others
    cdef double[::1] x = east, y = north
    p = 0
    for i in range(n):
        limit = reach[i] * reach[i]
        for j in range(m):
            dx = b[j, 0] - a[i, 0]
            dy = b[j, 1] - a[i, 1]
            if dx * dx + dy * dy <= limit:
                of_a[p], of_b[p], x[p], y[p] = i, j, dx, dy
                p += 1
    return rows, others, east, north


cdef inline double distance_of(double dx, double dy, double a, double b, double c, double* log_density) noexcept nogil:
    cdef double slope = b / a
    cdef double rest = c - b * slope
    cdef double distance
    dy = dy - slope * dx
    distance = dx * dx / a + dy * dy / rest
    log_density[0] = -0.5 * (distance + log(a * rest)) - LOG_2_PI
    return distance


def gated(
    const double[:, ::1] t, const double[:, ::1] position, const double[:, :, ::1] covariance, const double[::1] jump,
    const long long[::1] i, const long long[::1] j, const double[::1] dx, const double[::1] dy,
    tuple gates, double level_m, tuple moving, double log_jump,
):
    cdef Py_ssize_t p, q, r, s, k = 0, count = i.shape[0]
    cdef double gate = gates[0], sudden_gate = gates[1], standing = moving[0], per_speed = moving[1]
    cdef double a, b, c, more
    near = np.zeros(count, np.uint8)
    explained, measured = np.zeros(t.shape[0], np.uint8), np.zeros(position.shape[0], np.uint8)
    density, added = np.empty(count), np.zeros(count)
    cdef unsigned char[::1] chosen = near, of_track = explained, of_measurement = measured
    cdef double[::1] log_density = density, variance = added
    for p in range(count):
        r, s = i[p], j[p]
        a = t[r, XX] + covariance[s, 0, 0]
        b = t[r, XY] + covariance[s, 0, 1]
        c = t[r, YY] + covariance[s, 1, 1]
        if fabs(position[s, 2] - t[r, 2]) <= level_m:
            chosen[p] = 2  # on one level
            if distance_of(dx[p], dy[p], a, b, c, &log_density[p]) <= gate:
                chosen[p] = 1
                of_track[r] = of_measurement[s] = 1
                k += 1
    for p in range(count):
        r, s = i[p], j[p]
        if chosen[p] == 2:
            chosen[p] = 0
            if not of_track[r] and not of_measurement[s]:
                more = jump[r] * fmin(standing + per_speed * (t[r, 6] * t[r, 6] + t[r, 7] * t[r, 7]), 1.0)
                a = t[r, XX] + covariance[s, 0, 0] + more
                b = t[r, XY] + covariance[s, 0, 1]
                c = t[r, YY] + covariance[s, 1, 1] + more
                if distance_of(dx[p], dy[p], a, b, c, &log_density[p]) <= sudden_gate:
                    log_density[p] += log_jump
                    variance[p] = more
                    chosen[p] = 1
                    k += 1
    if k == count:
        return np.asarray(i), np.asarray(j), density, added
    rows, others, kept, sudden = np.empty(k, np.int64), np.empty(k, np.int64), np.empty(k), np.empty(k)
    cdef long long[::1] out_i = rows, out_j = others
    cdef double[::1] out_density = kept, out_added = sudden
    q = 0
    for p in range(count):
        if chosen[p]:
            out_i[q], out_j[q], out_density[q], out_added[q] = i[p], j[p], log_density[p], variance[p]
            q += 1
    return rows, others, kept, sudden


def gains(
    const double[:, ::1] t, const double[::1] detected, const long long[::1] class_id, const double[:, ::1] confusion,
    const long long[::1] i, const long long[::1] j, const double[::1] log_density, double log_clutter,
):
    cdef Py_ssize_t p, r, n = t.shape[0]
    ratios, total, worths = np.empty(i.shape[0]), np.empty(i.shape[0]), np.empty(n)
    cdef double[::1] ratio = ratios, gain = total, worth = worths
    for r in range(n):
        worth[r] = log(detected[r] * t[r, ODDS] / ((1.0 - detected[r]) * (1.0 + t[r, ODDS])))
    for p in range(i.shape[0]):
        r = i[p]
        ratio[p] = log_density[p] - log_clutter + confusion[<Py_ssize_t>t[r, CLASS], class_id[j[p]]]
        gain[p] = ratio[p] + worth[r]
    return ratios, total


def useful_pairs(const long long[::1] row, const long long[::1] column, const double[::1] cost):
    cdef Py_ssize_t p, k = 0, count = row.shape[0]
    cdef long long last_row = -1, last_column = -1
    for p in range(count):
        if cost[p] < 0.0:
            k += 1
            last_row, last_column = max(last_row, row[p]), max(last_column, column[p])
    chosen, alone = np.empty(k, np.int64), np.empty(k, bool)
    if k == 0:
        return chosen, alone
    cdef long long[::1] rows = np.zeros(last_row + 1, np.int64), columns = np.zeros(last_column + 1, np.int64)
    cdef long long[::1] useful = chosen
    cdef unsigned char[::1] single = alone.view(np.uint8)
    k = 0
    for p in range(count):
        if cost[p] < 0.0:
            useful[k] = p
            k += 1
            rows[row[p]] += 1
            columns[column[p]] += 1
    for p in range(k):
        single[p] = rows[row[useful[p]]] == 1 and columns[column[useful[p]]] == 1
    return chosen, alone


def in_view(
    const double[:, :] boxes, const double[::1] position, const double[:, :] rotation, tuple azimuth, tuple elevation,
    double max_range, double edge_m,
):
    cdef Py_ssize_t r, k
    cdef double low = azimuth[0], high = azimuth[1], down = elevation[0], up = elevation[1]
    cdef double ground, distance, inside, angle, x, y, z
    cdef bint partial = high - low < 2 * PI - 1e-6
    cdef double[3] at
    result = np.empty(boxes.shape[0])
    cdef double[::1] out = result
    for r in range(boxes.shape[0]):
        x, y, z = boxes[r, 0] - position[0], boxes[r, 1] - position[1], boxes[r, 2] - position[2]
        for k in range(3):
            at[k] = x * rotation[0, k] + y * rotation[1, k] + z * rotation[2, k]
        ground = sqrt(at[0] * at[0] + at[1] * at[1])
        distance = sqrt(ground * ground + at[2] * at[2])
        inside = max_range - distance
        if partial:
            angle = atan2(at[1], at[0])
            inside = fmin(inside, fmin(angle - low, high - angle) * ground)
        angle = atan2(at[2], ground)
        inside = fmin(inside, fmin(angle - down, up - angle) * distance)
        out[r] = fmin(fmax(0.5 + (0.5 / edge_m) * inside, 0.0), 1.0)
    return result


def hidden_table(const double[::1] origin, const double[:, :] boxes, const double[:, :] screens, double nearest_m):
    cdef Py_ssize_t r, s, n = screens.shape[0]
    cdef double x, y, z, ground, top, u, v
    result = np.zeros(boxes.shape[0], bool)
    cdef unsigned char[::1] out = result.view(np.uint8)
    cdef double[:, ::1] other = np.empty((n, 5))  # x, y, radius, distance of the far side, slope of the line over the top
    for s in range(n):
        x, y, z = screens[s, 0] - origin[0], screens[s, 1] - origin[1], screens[s, 2] - origin[2]
        ground = fmax(sqrt(x * x + y * y), nearest_m)
        other[s, 0], other[s, 1] = x, y
        other[s, 2] = 0.25 * (screens[s, 3] + screens[s, 4])
        other[s, 3] = ground + 0.5 * screens[s, 4]
        other[s, 4] = (z + 0.5 * screens[s, 5]) / ground
    for r in range(boxes.shape[0]):
        x, y, z = boxes[r, 0] - origin[0], boxes[r, 1] - origin[1], boxes[r, 2] - origin[2]
        ground = fmax(sqrt(x * x + y * y), nearest_m)
        top = (z + 0.5 * boxes[r, 5]) / ground
        for s in range(n):
            u, v = other[s, 0], other[s, 1]
            if (
                ground > other[s, 3] and top < other[s, 4] and x * u + y * v > 0.0
                and fabs(y * u - x * v) < ground * other[s, 2]
            ):
                out[r] = 1
                break
    return result


def overlap(
    const double[:, :] offset, const double[:, :] size, const double[:] yaw, const double[:, :] other_size,
    const double[:] other_yaw, double one_object,
):
    cdef Py_ssize_t p
    cdef double c, s, u, v
    result = np.empty(offset.shape[0], bool)
    cdef unsigned char[::1] out = result.view(np.uint8)
    for p in range(offset.shape[0]):
        c, s = cos(yaw[p]), sin(yaw[p])
        u, v = fabs(cos(other_yaw[p] - yaw[p])), fabs(sin(other_yaw[p] - yaw[p]))
        out[p] = (
            fabs(c * offset[p, 0] + s * offset[p, 1])
            < 0.5 * one_object * (size[p, 0] + u * other_size[p, 0] + v * other_size[p, 1])
            and fabs(c * offset[p, 1] - s * offset[p, 0])
            < 0.5 * one_object * (size[p, 1] + v * other_size[p, 0] + u * other_size[p, 1])
        )
    return result


def pairs_in_groups(
    const long long[::1] a_group, const double[:, :] a_position, const long long[::1] b_group,
    const double[:, :] b_position, double radius,
):
    cdef Py_ssize_t i, k, p = 0, n = a_group.shape[0], m = b_group.shape[0], room = 2 * max(n, m)
    cdef long long group, last = -1
    cdef double dx, dy, limit = radius * (1.0 + 1e-9) + 1e-9
    for k in range(m):
        last = max(last, b_group[k])
    # The boxes of b by group, in their order.
    by_group = np.argsort(b_group, kind="stable")
    cdef long long[::1] row = by_group, start = np.zeros(last + 2, np.int64)
    for k in range(m):
        start[b_group[k] + 1] += 1
    for group in range(last + 1):
        start[group + 1] += start[group]
    rows, others = np.empty(room, np.int64), np.empty(room, np.int64)
    cdef long long[::1] of_a = rows, of_b = others
    for i in range(n):
        group = a_group[i]
        if group > last:
            continue
        if p + start[group + 1] - start[group] > room:
            room = 2 * room + start[group + 1] - start[group]
            rows, others = np.resize(rows, room), np.resize(others, room)
            of_a, of_b = rows, others
        for k in range(start[group], start[group + 1]):
            dx = a_position[i, 0] - b_position[row[k], 0]
            dy = a_position[i, 1] - b_position[row[k], 1]
            if dx * dx + dy * dy <= limit * limit:
                of_a[p], of_b[p] = i, row[k]
                p += 1
    return rows[:p], others[:p]
