# cython: language_level=3, cdivision=True
"""What lies near what, and in front of it: gating, overlap, view. The references say what each function does."""

cimport numpy as np
from libc.math cimport atan2, cos, fabs, fmax, fmin, log, sin, sqrt

from mast_zenoh.kernels.arrays cimport floats, ints, length, made, octets, table, whole, writable, zeros
from mast_zenoh.kernels.table cimport SOURCE_DIGEST, XX, XY, YY, ODDS, CLASS, WIDTH

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793
cdef double LOG_2_PI = log(2.0 * 3.141592653589793)


def reach(t, covariance, jump, double gate):
    cdef const double* row = floats(t, 2)
    cdef const double* own = floats(covariance, 3)
    cdef const double* more = floats(jump, 1)
    cdef Py_ssize_t r, n = length(t), k = length(covariance, 1)
    cdef double widest = 0.0
    result = made(np.NPY_DOUBLE, n)
    cdef double* out = writable(result, 1)
    for r in range(length(covariance)):
        widest = fmax(widest, own[0] + own[k + 1])
        own += k * k
    for r in range(n):
        out[r] = sqrt(gate * (row[XX] + row[YY] + 0.5 * more[r] + widest))
        row += WIDTH
    return result


def pairs_in_reach(a, b, reach):
    a, b = whole(a), whole(b)
    cdef const double* here = floats(a, 2)
    cdef const double* there = floats(b, 2)
    cdef const double* far = floats(reach, 1)
    cdef Py_ssize_t n = length(a), m = length(b), wide = length(a, 1), broad = length(b, 1), i, j, p = 0
    cdef double dx, dy, limit
    # Twice: counted, then written.
    for i in range(n):
        limit = far[i] * far[i]
        for j in range(m):
            dx = there[broad * j] - here[wide * i]
            dy = there[broad * j + 1] - here[wide * i + 1]
            p += dx * dx + dy * dy <= limit
    rows, others = made(np.NPY_INT64, p), made(np.NPY_INT64, p)
    east, north = made(np.NPY_DOUBLE, p), made(np.NPY_DOUBLE, p)
    cdef np.int64_t* of_a = ints(rows)
    cdef np.int64_t* of_b = ints(others)
    cdef double* x = writable(east, 1)
    cdef double* y = writable(north, 1)
    p = 0
    for i in range(n):
        limit = far[i] * far[i]
        for j in range(m):
            dx = there[broad * j] - here[wide * i]
            dy = there[broad * j + 1] - here[wide * i + 1]
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


def gated(t, position, covariance, jump, near, gates, double log_jump):
    i, j, dx, dy = near
    cdef const double* rows = floats(t, 2)
    cdef const double* at = floats(position, 2)
    cdef const double* noise = floats(covariance, 3)
    cdef const double* sudden = floats(jump, 1)
    cdef const np.int64_t* of_t = ints(i)
    cdef const np.int64_t* of_m = ints(j)
    cdef const double* x = floats(dx, 1)
    cdef const double* y = floats(dy, 1)
    cdef Py_ssize_t n = length(t), m = length(position), wide = length(position, 1), w = length(covariance, 1)
    cdef Py_ssize_t p, q, r, s, k = 0, count = length(i)
    cdef double gate = gates.steady, sudden_gate = gates.sudden, level_m = gates.level_m
    cdef double standing = gates.standing, per_speed = gates.moving
    cdef double a, b, c, more
    cdef const double* row
    cdef const double* own
    inside, explained, measured = zeros(np.NPY_UINT8, count), zeros(np.NPY_UINT8, n), zeros(np.NPY_UINT8, m)
    density, added = made(np.NPY_DOUBLE, count), zeros(np.NPY_DOUBLE, count)
    cdef np.uint8_t* chosen = octets(inside)
    cdef np.uint8_t* of_track = octets(explained)
    cdef np.uint8_t* of_measurement = octets(measured)
    cdef double* log_density = writable(density, 1)
    cdef double* variance = writable(added, 1)
    for p in range(count):
        r, s = of_t[p], of_m[p]
        row, own = rows + WIDTH * r, noise + w * w * s
        a = row[XX] + own[0]
        b = row[XY] + own[1]
        c = row[YY] + own[w + 1]
        if fabs(at[wide * s + 2] - row[2]) <= level_m:
            chosen[p] = 2  # on one level
            if distance_of(x[p], y[p], a, b, c, &log_density[p]) <= gate:
                chosen[p] = 1
                of_track[r] = of_measurement[s] = 1
                k += 1
    for p in range(count):
        r, s = of_t[p], of_m[p]
        if chosen[p] == 2:
            chosen[p] = 0
            if not of_track[r] and not of_measurement[s]:
                row, own = rows + WIDTH * r, noise + w * w * s
                more = sudden[r] * fmin(standing + per_speed * (row[6] * row[6] + row[7] * row[7]), 1.0)
                a = row[XX] + own[0] + more
                b = row[XY] + own[1]
                c = row[YY] + own[w + 1] + more
                if distance_of(x[p], y[p], a, b, c, &log_density[p]) <= sudden_gate:
                    log_density[p] += log_jump
                    variance[p] = more
                    chosen[p] = 1
                    k += 1
    if k == count:
        return i, j, density, added
    tracks, measurements = made(np.NPY_INT64, k), made(np.NPY_INT64, k)
    densities, jumps = made(np.NPY_DOUBLE, k), made(np.NPY_DOUBLE, k)
    cdef np.int64_t* out_i = ints(tracks)
    cdef np.int64_t* out_j = ints(measurements)
    cdef double* out_density = writable(densities, 1)
    cdef double* out_added = writable(jumps, 1)
    q = 0
    for p in range(count):
        if chosen[p]:
            out_i[q], out_j[q], out_density[q], out_added[q] = of_t[p], of_m[p], log_density[p], variance[p]
            q += 1
    return tracks, measurements, densities, jumps


def gains(t, detected, class_id, confusion, i, j, log_density, double log_clutter):
    cdef const double* row = floats(t, 2)
    cdef const double* seen = floats(detected, 1)
    cdef const np.int64_t* class_of = ints(class_id)
    cdef const double* confused = floats(confusion, 2)
    cdef const np.int64_t* of_t = ints(i)
    cdef const np.int64_t* of_m = ints(j)
    cdef const double* density = floats(log_density, 1)
    cdef Py_ssize_t p, r, n = length(t), count = length(i), classes = length(confusion, 1)
    ratios, total, worths = made(np.NPY_DOUBLE, count), made(np.NPY_DOUBLE, count), made(np.NPY_DOUBLE, n)
    cdef double* ratio = writable(ratios, 1)
    cdef double* gain = writable(total, 1)
    cdef double* worth = writable(worths, 1)
    for r in range(n):
        worth[r] = log(seen[r] * row[WIDTH * r + ODDS] / ((1.0 - seen[r]) * (1.0 + row[WIDTH * r + ODDS])))
    for p in range(count):
        r = of_t[p]
        ratio[p] = density[p] - log_clutter + confused[classes * <Py_ssize_t>row[WIDTH * r + CLASS] + class_of[of_m[p]]]
        gain[p] = ratio[p] + worth[r]
    return ratios, total


def useful_pairs(row, column, cost):
    cdef const np.int64_t* of_row = ints(row)
    cdef const np.int64_t* of_column = ints(column)
    cdef const double* costs = floats(cost, 1)
    cdef Py_ssize_t p, k = 0, count = length(row)
    cdef np.int64_t last_row = -1, last_column = -1
    for p in range(count):
        if costs[p] < 0.0:
            k += 1
            last_row, last_column = max(last_row, of_row[p]), max(last_column, of_column[p])
    chosen, alone = made(np.NPY_INT64, k), made(np.NPY_BOOL, k)
    if k == 0:
        return chosen, alone
    in_rows, in_columns = zeros(np.NPY_INT64, last_row + 1), zeros(np.NPY_INT64, last_column + 1)
    cdef np.int64_t* rows = ints(in_rows)
    cdef np.int64_t* columns = ints(in_columns)
    cdef np.int64_t* useful = ints(chosen)
    cdef np.uint8_t* single = octets(alone)
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


def expected(boxes, screens, view, double edge_m, double nearest_m):
    boxes, screens, rotation, position = whole(boxes), whole(screens), whole(view.rotation), view.position
    cdef const double* box = floats(boxes, 2)
    cdef const double* screen = floats(screens, 2)
    cdef const double* origin = floats(position, 1)
    cdef const double* R = floats(rotation, 2)
    cdef Py_ssize_t r, s, k, n = length(boxes), m = length(screens)
    cdef Py_ssize_t wide = length(boxes, 1), broad = length(screens, 1)
    cdef double low = view.azimuth_min, high = view.azimuth_max, down = view.elevation_min, up = view.elevation_max
    cdef double max_range = view.max_range
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


def pairs_in_groups(a_group, a_position, b_group, b_position, double radius):
    a_position, b_position = whole(a_position), whole(b_position)
    cdef const np.int64_t* of = ints(a_group)
    cdef const double* here = floats(a_position, 2)
    cdef const np.int64_t* other = ints(b_group)
    cdef const double* there = floats(b_position, 2)
    cdef Py_ssize_t n = length(a_group), m = length(b_group), wide = length(a_position, 1), broad = length(b_position, 1)
    cdef Py_ssize_t i, k, p = 0, room = 2 * max(n, m)
    cdef np.int64_t group, last = -1
    cdef double dx, dy, limit = radius * (1.0 + 1e-9) + 1e-9
    for k in range(m):
        last = max(last, other[k])
    # The boxes of b by group, in their order.
    by_group = b_group.argsort(kind="stable")
    begins = zeros(np.NPY_INT64, last + 2)
    cdef const np.int64_t* row = ints(by_group)
    cdef np.int64_t* start = ints(begins)
    for k in range(m):
        start[other[k] + 1] += 1
    for group in range(last + 1):
        start[group + 1] += start[group]
    rows, others = made(np.NPY_INT64, room), made(np.NPY_INT64, room)
    cdef np.int64_t* of_a = ints(rows)
    cdef np.int64_t* of_b = ints(others)
    for i in range(n):
        group = of[i]
        if group > last:
            continue
        if p + start[group + 1] - start[group] > room:
            room = 2 * room + start[group + 1] - start[group]
            rows.resize(room, refcheck=False)
            others.resize(room, refcheck=False)
            of_a, of_b = ints(rows), ints(others)
        for k in range(start[group], start[group + 1]):
            dx = here[wide * i] - there[broad * row[k]]
            dy = here[wide * i + 1] - there[broad * row[k] + 1]
            if dx * dx + dy * dy <= limit * limit:
                of_a[p], of_b[p] = i, row[k]
                p += 1
    return rows[:p], others[:p]
