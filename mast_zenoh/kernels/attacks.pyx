# cython: language_level=3, cdivision=True
"""What an adversary does in every frame: following objects, imitating them, and looking past buildings. The references
say what each function does."""

cimport numpy as np
from libc.math cimport erf, fabs, fmax, fmin, sqrt
from libc.string cimport memcpy

from mast_zenoh.kernels.algebra cimport wrapped
from mast_zenoh.kernels.arrays cimport floats, ints, length, made, octets, squares, table, whole, writable, zeros
from mast_zenoh.kernels.table cimport (
    SOURCE_DIGEST, FOLLOWED_VX, FOLLOWED_UNSEEN, FOLLOWED_AGE, FOLLOWED_HITS, FOLLOWED_ID, FOLLOWED_TARGET,
    FOLLOWED_ROW, FOLLOWED_COLUMNS,
)

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


def followed(tracks, position, velocity, id, double elapsed_s, double radius_m, limits):
    tracks, position, velocity = whole(tracks), whole(position), whole(velocity)
    cdef double gate_m = limits.gate_m, growth = limits.gate_growth_mps, fastest = limits.fastest_mps
    cdef double forgotten = limits.forgotten_s, clutter = limits.clutter_s, same_id_m = limits.same_id_m
    cdef double least_alpha = limits.least_alpha, least_beta = limits.least_beta
    cdef Py_ssize_t m = length(tracks), n = length(position), t, r, p, axis, best, kept = 0, fresh = 0, count = 0
    cdef const double* there = floats(position, 2)
    cdef const double* speed = floats(velocity, 2)
    cdef const np.int64_t* ids = ints(id)
    state = table(m, FOLLOWED_COLUMNS)
    cdef double* row = writable(state, 2)
    cdef double* first = row
    cdef double* own
    cdef double dx, dy, gate, alpha, beta, k, surprise, elapsed
    memcpy(row, floats(tracks, 2), m * FOLLOWED_COLUMNS * sizeof(double))
    taken_ = zeros(np.NPY_BOOL, n)
    cdef np.uint8_t* taken = octets(taken_)
    for t in range(m):
        own = first + t * FOLLOWED_COLUMNS
        for axis in range(3):
            own[axis] += own[FOLLOWED_VX + axis] * elapsed_s
        own[FOLLOWED_UNSEEN] += elapsed_s
        own[FOLLOWED_AGE] += elapsed_s
        own[FOLLOWED_ROW] = -1.0
        if own[FOLLOWED_ID] < 0.0:
            continue
        for r in range(n):
            if ids[r] >= 0 and <double>ids[r] == own[FOLLOWED_ID] and not taken[r]:
                dx, dy = own[0] - there[3 * r], own[1] - there[3 * r + 1]
                if dx * dx + dy * dy < same_id_m * same_id_m:
                    own[FOLLOWED_ROW], taken[r] = <double>r, 1
                    break
    # Pairs within the gates: counted, written, and joined nearest first.
    for t in range(m):
        own = first + t * FOLLOWED_COLUMNS
        if own[FOLLOWED_ROW] >= 0.0:
            continue
        gate = fmin(gate_m + growth * own[FOLLOWED_UNSEEN] if own[FOLLOWED_HITS] > 1.0 else fastest * own[FOLLOWED_UNSEEN], radius_m)
        for r in range(n):
            if not taken[r]:
                dx, dy = there[3 * r] - own[0], there[3 * r + 1] - own[1]
                count += dx * dx + dy * dy <= gate * gate
    tracks_, rows_, costs_ = made(np.NPY_INT64, count), made(np.NPY_INT64, count), made(np.NPY_DOUBLE, count)
    cdef np.int64_t* of_track = ints(tracks_)
    cdef np.int64_t* of_row = ints(rows_)
    cdef double* cost = writable(costs_, 1)
    count = 0
    for t in range(m):
        own = first + t * FOLLOWED_COLUMNS
        if own[FOLLOWED_ROW] >= 0.0:
            continue
        gate = fmin(gate_m + growth * own[FOLLOWED_UNSEEN] if own[FOLLOWED_HITS] > 1.0 else fastest * own[FOLLOWED_UNSEEN], radius_m)
        for r in range(n):
            if not taken[r]:
                dx, dy = there[3 * r] - own[0], there[3 * r + 1] - own[1]
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
        own = first + t * FOLLOWED_COLUMNS
        if own[FOLLOWED_ROW] >= 0.0:
            r = <Py_ssize_t>own[FOLLOWED_ROW]
            if speed[3 * r] != 0.0 or speed[3 * r + 1] != 0.0 or speed[3 * r + 2] != 0.0:
                for axis in range(3):
                    own[axis], own[FOLLOWED_VX + axis] = there[3 * r + axis], speed[3 * r + axis]
            else:
                k = own[FOLLOWED_HITS]
                alpha = fmax(2.0 * (2.0 * k + 1.0) / ((k + 1.0) * (k + 2.0)), least_alpha)
                beta = fmax(6.0 / ((k + 1.0) * (k + 2.0)), least_beta)
                elapsed = fmax(own[FOLLOWED_UNSEEN], 1e-9)
                for axis in range(3):
                    surprise = there[3 * r + axis] - own[axis]
                    own[axis] += alpha * surprise
                    own[FOLLOWED_VX + axis] += beta / elapsed * surprise
            own[FOLLOWED_ID], own[FOLLOWED_UNSEEN] = <double>ids[r], 0.0
            own[FOLLOWED_HITS] += 1.0
        kept += own[FOLLOWED_TARGET] >= 0.0 or own[FOLLOWED_UNSEEN] <= (forgotten if own[FOLLOWED_HITS] > 1.0 else clutter)
    for r in range(n):
        fresh += not taken[r]
    result = table(kept + fresh, FOLLOWED_COLUMNS)
    cdef double* out = writable(result, 2)
    for t in range(m):
        own = first + t * FOLLOWED_COLUMNS
        if own[FOLLOWED_TARGET] >= 0.0 or own[FOLLOWED_UNSEEN] <= (forgotten if own[FOLLOWED_HITS] > 1.0 else clutter):
            memcpy(out, own, FOLLOWED_COLUMNS * sizeof(double))
            out += FOLLOWED_COLUMNS
    for r in range(n):
        if not taken[r]:
            for axis in range(3):
                out[axis], out[FOLLOWED_VX + axis] = there[3 * r + axis], speed[3 * r + axis]
            out[FOLLOWED_UNSEEN], out[FOLLOWED_AGE], out[FOLLOWED_HITS], out[FOLLOWED_ID] = 0.0, 0.0, 1.0, <double>ids[r]
            out[FOLLOWED_TARGET], out[FOLLOWED_ROW] = -1.0, <double>r
            out += FOLLOWED_COLUMNS
    return result


cdef void sort(double* numbers, Py_ssize_t n) noexcept:
    """Ascending, in place; a message has few rows, and what a hostile one has is sorted as well, only slowly."""
    cdef Py_ssize_t r, k
    cdef double own
    for r in range(1, n):
        own, k = numbers[r], r
        while k > 0 and numbers[k - 1] > own:
            numbers[k] = numbers[k - 1]
            k -= 1
        numbers[k] = own


def victim_like(false, errors, range_m, real, usual_std, bint moves, limits):
    errors = whole(errors)
    position_, velocity_, size_ = (whole(column) for column in false[:3])
    places_, covariance_ = whole(real[0]), whole(real[1])
    cdef const double* position = floats(position_, 2)
    cdef const double* velocity = floats(velocity_, 2)
    cdef const double* size = floats(size_, 2)
    cdef const double* error = floats(errors, 2)
    cdef const double* distance = floats(range_m, 1)
    cdef const double* place = floats(places_, 2)
    cdef const double* covariance = floats(covariance_, 3)
    cdef Py_ssize_t r, k, i, best, n = length(places_), count = length(range_m), columns = length(errors, 1), typical = 0
    cdef double position_std = usual_std[0], size_std = usual_std[1], yaw_std = usual_std[2]
    cdef double usual, most = limits[1], dx, dy, std, limit, nearest
    cdef const double* stated
    yaw_, score_, eye_ = whole(false[3]), whole(real[2]), whole(real[3])
    cdef const double* yaw = floats(yaw_, 1)
    cdef const double* score = floats(score_, 1)
    cdef const double* eye = floats(eye_, 1)
    traces_, sorted_, scores_, ranges_ = (made(np.NPY_DOUBLE, n) for _ in range(4))
    cdef double* trace = writable(traces_, 1)
    cdef double* ascending = writable(sorted_, 1)
    cdef double* scores = writable(scores_, 1)  # of typical rows, ascending
    cdef double* away = writable(ranges_, 1)
    for r in range(n):
        trace[r] = 0.0
        for i in range(9):
            trace[r] += covariance[81 * r + 10 * i]
    memcpy(ascending, trace, n * sizeof(double))
    sort(ascending, n)
    usual = limits[0] * ascending[(n - 1) // 2]
    for r in range(n):
        if trace[r] <= usual:
            scores[typical] = score[r]
            typical += 1
        dx, dy = place[3 * r] - eye[0], place[3 * r + 1] - eye[1]
        away[r] = sqrt(dx * dx + dy * dy)
    sort(scores, typical)
    at_, speed_, box_ = table(count, 3), table(count, 3), table(count, 3)
    heading_, likely_, spread_ = made(np.NPY_DOUBLE, count), made(np.NPY_DOUBLE, count), squares(count, 9)
    cdef double* at = writable(at_, 2)
    cdef double* speed = writable(speed_, 2)
    cdef double* box = writable(box_, 2)
    cdef double* heading = writable(heading_, 1)
    cdef double* likely = writable(likely_, 1)
    cdef double* spread = writable(spread_, 3)
    for k in range(count):
        best, nearest = 0, -1.0
        for r in range(n):
            if trace[r] <= usual and (nearest < 0.0 or fabs(distance[k] - away[r]) < nearest):
                best, nearest = r, fabs(distance[k] - away[r])
        stated = covariance + 81 * best
        memcpy(spread + 81 * k, stated, 81 * sizeof(double))
        for i in range(3):
            std = sqrt(fmax(stated[10 * i], 0.0))
            at[3 * k + i] = position[3 * k + i] + error[i] * (std if std > 0.0 else position_std)
            limit = most * size[3 * k + i]
            box[3 * k + i] = size[3 * k + i] + fmin(fmax(error[3 + i] * size_std, -limit), limit)
            speed[3 * k + i] = velocity[3 * k + i]
            if moves:
                speed[3 * k + i] += error[6 + i] * sqrt(fmax(stated[10 * (6 + i)], 0.0))
        heading[k] = wrapped(yaw[k] + error[9] * yaw_std)
        r = <Py_ssize_t>((0.5 + 0.5 * erf(error[10] / sqrt(2.0))) * typical)
        likely[k] = scores[r if r < typical else typical - 1]
        error += columns
    return at_, speed_, box_, heading_, spread_, likely_


def walled_off(origin, places, start, end, top):
    places, start, end = whole(places), whole(start), whole(end)
    cdef const double* eye = floats(origin, 1)
    cdef const double* place = floats(places, 2)
    cdef const double* a = floats(start, 2)
    cdef const double* b = floats(end, 2)
    cdef const double* height = floats(top, 1)
    cdef Py_ssize_t p, w, n = length(places), wide = length(places, 1), walls = length(start)
    cdef double sx, sy, wx, wy, ox, oy, cross, along
    result = zeros(np.NPY_BOOL, n)
    cdef np.uint8_t* hidden = octets(result)
    for p in range(n):
        sx, sy = place[wide * p] - eye[0], place[wide * p + 1] - eye[1]
        for w in range(walls):
            wx, wy = b[2 * w] - a[2 * w], b[2 * w + 1] - a[2 * w + 1]
            ox, oy = a[2 * w] - eye[0], a[2 * w + 1] - eye[1]
            cross = sx * wy - sy * wx
            if cross == 0.0:
                continue
            along = (ox * sy - oy * sx) / cross
            if along < 0.0 or along > 1.0:
                continue
            along = (ox * wy - oy * wx) / cross
            if along > 0.0 and along < 1.0 and eye[2] + along * (place[wide * p + 2] - eye[2]) <= height[w]:
                hidden[p] = 1
                break
    return result


def built_over(places, start, end, first):
    places, start, end = whole(places), whole(start), whole(end)
    cdef const double* place = floats(places, 2)
    cdef const double* a = floats(start, 2)
    cdef const double* b = floats(end, 2)
    cdef const np.int64_t* begin = ints(first)
    cdef Py_ssize_t p, w, o, n = length(places), wide = length(places, 1), walls = length(start), outlines = length(first)
    cdef double x, y
    cdef bint odd
    result = zeros(np.NPY_BOOL, n)
    cdef np.uint8_t* inside = octets(result)
    for p in range(n):
        x, y = place[wide * p], place[wide * p + 1]
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
