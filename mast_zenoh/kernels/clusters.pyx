# cython: language_level=3, cdivision=True
"""Kernels of clustering and fusion at the command centre. The NumPy references document them.

The members of a cluster are adjacent; `start` (c,) is the first row of each cluster.
"""

cimport numpy as np
from libc.math cimport atan2, copysign, cos, floor, fmax, fmin, sin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport MAX_ROWS, factorise, invert, wrap_angle
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrices, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
    zero_vector,
)
from mast_zenoh.kernels.table cimport N_CLASSES, SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def symmetrise(covariance, double min_variance, double max_variance):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef Py_ssize_t r, i, j, k = length(covariance, 1)
    cdef double[MAX_ROWS * MAX_ROWS] shifted
    cdef bint valid = True
    if k > MAX_ROWS:
        raise ValueError(f"covariance: found {k} rows, expected at max_variance {MAX_ROWS}")
    result = empty_matrices(length(covariance), k)
    cdef double* out = writable_data(result, 3)
    for r in range(length(covariance)):
        for i in range(k):
            for j in range(i + 1):
                out[k * i + j] = out[k * j + i] = 0.5 * (matrix[k * i + j] + matrix[k * j + i])
            valid = valid and out[k * i + i] <= max_variance
        if valid:
            memcpy(shifted, out, k * k * sizeof(double))
            for i in range(k):
                shifted[i * k + i] -= 0.5 * min_variance
            factorise(shifted, k)
            for i in range(k):
                valid = valid and shifted[i * k + i] > 0.0
        matrix, out = matrix + k * k, out + k * k
    return result, valid


def covariance_intersection(covariance, state, weight, start):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const double* vector = float_data(state, 2)
    cdef const double* share = float_data(weight, 1)
    cdef const np.int64_t* first = int_data(start)
    cdef Py_ssize_t c, r, i, j, end, n = length(covariance), count = length(start)
    cdef double[81] member, information, inverse
    cdef double[9] total
    means, covariances = empty_matrix(count, 9), empty_matrices(count, 9)
    cdef double* mean = writable_data(means, 2)
    cdef double* fused = writable_data(covariances, 3)
    for c in range(count):
        memset(information, 0, sizeof(information))
        memset(total, 0, sizeof(total))
        end = first[c + 1] if c + 1 < count else n
        for r in range(first[c], end):
            memcpy(member, matrix + 81 * r, sizeof(member))
            invert(member, 9, inverse)
            for i in range(9):
                for j in range(9):
                    member[9 * i + j] = share[r] * inverse[9 * i + j]
                    information[9 * i + j] += member[9 * i + j]
                    total[i] += member[9 * i + j] * vector[9 * r + j]
        invert(information, 9, fused)
        for i in range(9):
            mean[i] = 0.0
            for j in range(9):
                mean[i] += fused[9 * i + j] * total[j]
        mean, fused = mean + 9, fused + 81
    return means, covariances


def fused_attributes(yaw, class_id, score, weight, start):
    cdef const double* heading = float_data(yaw, 1)
    cdef const np.uint8_t* class_of = byte_data(class_id)
    cdef const double* member_score = float_data(score, 1)
    cdef const double* share = float_data(weight, 1)
    cdef const np.int64_t* first = int_data(start)
    cdef Py_ssize_t c, r, k, end, best, n = length(yaw), count = length(start)
    cdef double x, y, axis, direction
    cdef double[N_CLASSES] votes
    yaws, classes, scores = empty_vector(np.NPY_DOUBLE, count), empty_vector(np.NPY_UINT8, count), empty_vector(np.NPY_DOUBLE, count)
    cdef double* fused_yaw = writable_data(yaws, 1)
    cdef double* fused_score = writable_data(scores, 1)
    cdef np.uint8_t* fused_class = byte_data(classes)
    for c in range(count):
        end = first[c + 1] if c + 1 < count else n
        memset(votes, 0, sizeof(votes))
        x = y = direction = 0.0
        fused_score[c] = member_score[first[c]]
        for r in range(first[c], end):
            x += share[r] * cos(2.0 * heading[r])
            y += share[r] * sin(2.0 * heading[r])
            votes[class_of[r] if class_of[r] < N_CLASSES else 0] += share[r]
            fused_score[c] = fmax(fused_score[c], member_score[r])
        axis = 0.5 * atan2(y, x)
        for r in range(first[c], end):
            direction += share[r] * copysign(1.0, cos(heading[r] - axis))
        fused_yaw[c] = wrap_angle(axis + PI if direction < 0.0 else axis)
        best = 0
        for k in range(1, N_CLASSES):
            if votes[k] > votes[best]:
                best = k
        fused_class[c] = best
    return yaws, classes, scores


def merge_pairs(position, agent, i, j, squared, double radius):
    position, nearest = contiguous(position), squared.argsort(kind="stable")
    cdef const double* place = float_data(position, 2)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef const np.int64_t* one = int_data(i)
    cdef const np.int64_t* other = int_data(j)
    cdef const np.int64_t* pair = int_data(nearest)
    cdef Py_ssize_t p, n = length(agent), stride = length(position, 1)
    cdef np.int64_t a, b, r, s, count = 0
    cdef double dx, dy, m, k
    cdef bint separate
    labels, clusters = empty_vector(np.NPY_INT64, n), empty_matrix(n, 3)
    next_rows, last_rows = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n)
    cdef np.int64_t* label = int_data(labels)  # the first row of each row's cluster, later its number
    cdef double* cluster = writable_data(clusters, 2)  # by first row: x and y of the centre, number of members
    cdef np.int64_t* following = int_data(next_rows)  # the next member, -1: none
    cdef np.int64_t* last = int_data(last_rows)  # by first row: the last member
    for p in range(n):
        label[p] = last[p] = p
        following[p] = -1
        cluster[3 * p], cluster[3 * p + 1], cluster[3 * p + 2] = place[stride * p], place[stride * p + 1], 1.0
    for p in range(length(i)):
        a, b = label[one[pair[p]]], label[other[pair[p]]]
        if a == b:
            continue
        if b < a:
            a, b = b, a
        dx, dy = cluster[3 * a] - cluster[3 * b], cluster[3 * a + 1] - cluster[3 * b + 1]
        separate = sqrt(dx * dx + dy * dy) > radius
        r = a
        while r >= 0 and not separate:
            s = b
            while s >= 0 and not separate:
                separate, s = agent_of[r] == agent_of[s], following[s]
            r = following[r]
        if separate:
            continue
        s = b
        while s >= 0:
            label[s], s = a, following[s]
        m, k = cluster[3 * a + 2], cluster[3 * b + 2]
        cluster[3 * a] = (m * cluster[3 * a] + k * cluster[3 * b]) / (m + k)
        cluster[3 * a + 1] = (m * cluster[3 * a + 1] + k * cluster[3 * b + 1]) / (m + k)
        cluster[3 * a + 2] = m + k
        following[last[a]], last[a] = b, last[b]
    for p in range(n):
        if label[p] == p:
            label[p], count = count, count + 1
        else:
            label[p] = label[label[p]]  # of an earlier row, so it is a number already
    return labels


cdef double CELL = 1.0 + 1e-6, MARGIN = 1.0 + 1e-9


cdef inline np.int64_t cell_of(double coordinate, double size) noexcept nogil:
    return <np.int64_t>floor(fmax(-1e12, fmin(coordinate / size, 1e12)))


cdef inline np.int64_t bucket_of(np.int64_t column, np.int64_t row, np.int64_t mask) noexcept nogil:
    return <np.int64_t>((<np.uint64_t>column * 0x9E3779B97F4A7C15ULL + <np.uint64_t>row * 0xC2B2AE3D27D4EB4FULL) >> 20) & mask


cdef inline void keep_two(double* two, double value) noexcept nogil:
    if value > two[0]:
        two[0], two[1] = value, two[0]
    elif value > two[1]:
        two[1] = value


cdef bint touch(
    const double* at, const np.int64_t* following, np.int64_t one, np.int64_t other, const double* centre, double reach,
    double radius,
) noexcept nogil:
    """Whether a member of the first group is within the radius of one of the second, which are in reach of `centre`."""
    cdef np.int64_t s
    cdef double dx, dy
    while one >= 0:
        dx, dy = centre[0] - at[6 * one], centre[1] - at[6 * one + 1]
        if dx * dx + dy * dy <= reach * reach:
            s = other
            while s >= 0:
                dx, dy = at[6 * s] - at[6 * one], at[6 * s + 1] - at[6 * one + 1]
                if dx * dx + dy * dy <= radius * radius:
                    return True
                s = following[s]
        one = following[one]
    return False


def isolated_groups(motion, agent, inverse_bias, double radius, double gate):
    motion = contiguous(motion)
    cdef const double* at = float_data(motion, 2)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef const double* scale = float_data(inverse_bias, 1)
    cdef Py_ssize_t n = length(agent), k, groups = 0
    cdef np.int64_t mask = 1, r, a, g, h, column, row, x, y, bucket
    cdef double size = radius * CELL, dx, dy, total, squared, reach
    while mask < 2 * n:
        mask *= 2
    roots, following_rows, last_rows = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n)
    chains, heads, numbers = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, mask), empty_vector(np.NPY_INT64, n)
    sizes, centres, extents = zero_vector(np.NPY_DOUBLE, n), empty_matrix(n, 6), empty_matrix(n, 4)
    separate = zero_vector(np.NPY_BOOL, n)
    cdef np.int64_t* root = int_data(roots)
    cdef np.int64_t* following = int_data(following_rows)
    cdef np.int64_t* last = int_data(last_rows)  # by anchor
    cdef np.int64_t* anchors = int_data(numbers)
    cdef np.int64_t* chain = int_data(chains)  # by anchor: the next of its bucket
    cdef np.int64_t* head = int_data(heads)
    cdef double* count = writable_data(sizes, 1)  # by anchor, as are those below
    cdef double* centre = writable_data(centres, 2)
    cdef double* extent = writable_data(extents, 2)  # the two largest distances from the centre: m, and normalised
    cdef np.uint8_t* simple = byte_data(separate)
    for k in range(mask):
        head[k] = -1
    mask -= 1
    for r in range(n):
        column, row, a = cell_of(at[6 * r], size), cell_of(at[6 * r + 1], size), n
        for x in range(column - 1, column + 2):
            for y in range(row - 1, row + 2):
                g = head[bucket_of(x, y, mask)]
                while g >= 0:
                    dx, dy = at[6 * r] - at[6 * g], at[6 * r + 1] - at[6 * g + 1]
                    if g < a and dx * dx + dy * dy <= radius * radius:
                        a = g
                    g = chain[g]
        following[r] = -1
        if a == n:
            a = root[r] = last[r] = anchors[groups] = r
            groups += 1
            bucket = bucket_of(column, row, mask)
            chain[r], head[bucket] = head[bucket], r
            simple[r] = 1
            for k in range(6):
                centre[6 * r + k] = 0.0
            for k in range(4):
                extent[4 * r + k] = 0.0
        else:
            root[r] = a
            if agent_of[last[a]] == agent_of[r]:
                simple[a] = 0
            following[last[a]], last[a] = r, r
        count[a] += 1.0
        for k in range(6):
            centre[6 * a + k] += at[6 * r + k]
    for g in range(groups):
        a = anchors[g]
        for k in range(6):
            centre[6 * a + k] /= count[a]
    for r in range(n):
        a, total = root[r], 0.0
        for k in range(6):
            dx = at[6 * r + k] - centre[6 * a + k]
            total += dx * dx * scale[k]
            if k == 1:
                dy = at[6 * r] - centre[6 * a]
                keep_two(extent + 4 * a, sqrt(dy * dy + dx * dx))
        keep_two(extent + 4 * a + 2, sqrt(total))
    for k in range(groups):
        a = anchors[k]
        squared = (extent[4 * a + 2] + extent[4 * a + 3]) * (extent[4 * a + 2] + extent[4 * a + 3])
        if count[a] > 1.0 and ((extent[4 * a] + extent[4 * a + 1]) * MARGIN > radius or squared * MARGIN > gate):
            simple[a] = 0
    for k in range(groups):
        g = anchors[k]
        column, row = cell_of(at[6 * g], size), cell_of(at[6 * g + 1], size)
        for x in range(column - 3, column + 4):
            for y in range(row - 3, row + 4):
                h = head[bucket_of(x, y, mask)]
                while h >= 0:
                    if h < g and (simple[g] or simple[h]):
                        dx, dy = centre[6 * g] - centre[6 * h], centre[6 * g + 1] - centre[6 * h + 1]
                        reach = (radius + extent[4 * g] + extent[4 * h]) * MARGIN
                        if dx * dx + dy * dy <= reach * reach and touch(
                            at, following, g, h, centre + 6 * h, (radius + extent[4 * h]) * MARGIN, radius
                        ):
                            simple[g] = simple[h] = 0
                    h = chain[h]
    for r in range(n):
        simple[r] = simple[root[r]]
    return roots, separate


def achievable(covariance, per_unit, double least, double most):
    covariance = contiguous(covariance)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const double* factor = float_data(per_unit, 2)
    cdef Py_ssize_t r, i, j, k = length(covariance, 1)
    cdef double[MAX_ROWS * MAX_ROWS] shifted
    if k > MAX_ROWS:
        raise ValueError(f"covariance: found {k} rows, expected at most {MAX_ROWS}")
    for r in range(length(covariance)):
        for i in range(k):
            for j in range(i + 1):
                shifted[k * i + j] = shifted[k * j + i] = 0.5 * (
                    matrix[k * i + j] * factor[k * i + j] + matrix[k * j + i] * factor[k * j + i]
                )
            if not shifted[k * i + i] <= most:
                return False
            shifted[k * i + i] -= 0.5 * least
        factorise(shifted, k)
        for i in range(k):
            if not shifted[k * i + i] > 0.0:
                return False
        matrix += k * k
    return True


def horizontal_motion(position, velocity, covariance, rows):
    position, velocity, covariance = contiguous(position), contiguous(velocity), contiguous(covariance)
    cdef const double* at = float_data(position, 2)
    cdef const double* speed = float_data(velocity, 2)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const np.int64_t* row = int_data(rows)
    cdef const double* P
    cdef Py_ssize_t r, s, q, n = length(rows)
    motions, spreads = empty_matrix(n, 4), empty_matrix(n, 8)
    cdef double* motion = writable_data(motions, 2)
    cdef double* spread = writable_data(spreads, 2)
    for r in range(n):
        s = row[r]
        motion[0], motion[1], motion[2], motion[3] = at[3 * s], at[3 * s + 1], speed[3 * s], speed[3 * s + 1]
        for q in range(2):
            P = matrix + 81 * s + 60 * q
            spread[4 * q], spread[4 * q + 1], spread[4 * q + 2], spread[4 * q + 3] = P[0], P[10], P[1], P[9]
        motion, spread = motion + 4, spread + 8
    return motions, spreads


def compare_members(motion, spread, agent, label, Py_ssize_t agents, Py_ssize_t partners):
    motion, spread = contiguous(motion), contiguous(spread)
    cdef const double* at = float_data(motion, 2)
    cdef const double* variance = float_data(spread, 2)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef const np.int64_t* label_of = int_data(label)
    cdef Py_ssize_t r, s, q, k, shift, n = length(agent)
    cdef double x, y, xx, yy, xy
    cdef bint any_same
    result = zero_vector(np.NPY_DOUBLE, agents * agents * 8)
    cdef double* sums = writable_data(result, 1)
    cdef double* total
    cdef double* mirrored
    for shift in range(1, min(partners, n - 1) + 1):
        any_same = False
        for r in range(n - shift):
            s = r + shift
            if label_of[r] != label_of[s]:
                continue
            any_same = True
            total = sums + 8 * (agents * agent_of[r] + agent_of[s])
            for q in range(2):
                x, y = at[4 * r + 2 * q] - at[4 * s + 2 * q], at[4 * r + 2 * q + 1] - at[4 * s + 2 * q + 1]
                k = 4 * q
                xx, yy = variance[8 * r + k] + variance[8 * s + k], variance[8 * r + k + 1] + variance[8 * s + k + 1]
                xy = 0.5 * ((variance[8 * r + k + 2] + variance[8 * s + k + 2]) + (variance[8 * r + k + 3] + variance[8 * s + k + 3]))
                total[k] += 1.0
                total[k + 1] += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
                total[k + 2] += x * x + y * y
                total[k + 3] += xx + yy
        if not any_same:
            break
    for r in range(agents):
        for s in range(r, agents):
            total, mirrored = sums + 8 * (agents * r + s), sums + 8 * (agents * s + r)
            if total[0] > 0.0 or mirrored[0] > 0.0:
                for k in range(8):
                    total[k] = mirrored[k] = total[k] + mirrored[k]
    return result.reshape(agents, agents, 2, 4)


def decay_and_add(sums, comparisons, double decay, double share, double limit, double prior_pairs):
    cdef double* total = writable_data(sums, 4)
    cdef const double* new = float_data(comparisons, 4)
    cdef Py_ssize_t r, k, all_agents = length(sums), agents = length(comparisons)
    cdef bint exceeded = False
    for r in range(agents):
        for k in range(8 * agents):
            total[k] = total[k] * decay + share * new[k]
        for k in range(0, 8 * agents, 4):
            exceeded |= total[k + 1] + 2.0 * prior_pairs > 2.0 * limit * (total[k] + prior_pairs)
        total += 8 * all_agents
        new += 8 * agents
    return bool(exceeded)
