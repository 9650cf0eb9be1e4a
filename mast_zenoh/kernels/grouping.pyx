# cython: language_level=3, cdivision=True
"""Kernels that group tracks by object at the command centre. The NumPy references document them."""

cimport numpy as np
from libc.math cimport fmax, fmin, sqrt
from libc.stdlib cimport free, qsort, realloc
from libc.string cimport memset

from mast_zenoh.kernels.algebra cimport factorise, forward
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, int_data, length, writable_data, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


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
    coordinate = fmax(-1e12, fmin(coordinate / size, 1e12))
    return <np.int64_t>coordinate - (coordinate < <np.int64_t>coordinate)  # rounded down, without a call


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


cdef struct Grid:  # rows by bucket of their cell, adjacent in memory
    double size  # m, of a cell
    np.int64_t mask  # number of buckets less 1
    np.int64_t* start  # (mask + 3,) of each bucket
    np.int64_t* bucket  # (n,) of each row
    np.int64_t* row  # (n,) by bucket
    double* place  # (n, 2) x and y, by bucket
    np.int64_t* near  # (n + 1,) what `rows_near` found
    double* squared  # (n + 1,) their squared distances


cdef void place_rows(Grid* grid, const double* at, Py_ssize_t n, double radius) noexcept nogil:
    """Place n rows in cells for `rows_near` with this radius; at: (n, 6)."""
    cdef Py_ssize_t r, k
    grid.size = radius * CELL
    memset(grid.start, 0, (grid.mask + 3) * sizeof(np.int64_t))
    for r in range(n):
        grid.bucket[r] = bucket_of(cell_of(at[6 * r], grid.size), cell_of(at[6 * r + 1], grid.size), grid.mask)
        grid.start[grid.bucket[r] + 2] += 1
    for k in range(grid.mask + 1):
        grid.start[k + 1] += grid.start[k]
    for r in range(n):  # the start of a bucket is counted up one further on, where the start of the next one is then
        k = grid.start[grid.bucket[r] + 1]
        grid.row[k], grid.place[2 * k], grid.place[2 * k + 1] = r, at[6 * r], at[6 * r + 1]
        grid.start[grid.bucket[r] + 1] += 1


cdef Py_ssize_t rows_near(
    Grid* grid, const double* at, np.int64_t end, double least, double most
) noexcept nogil:
    """Number of rows below `end` whose squared distance from `at` is above `least` and at most `most`, see `near`."""
    cdef np.int64_t[9] buckets
    cdef np.int64_t column = cell_of(at[0], grid.size), row = cell_of(at[1], grid.size), bucket
    cdef const double* place = grid.place
    cdef const np.int64_t* row_at = grid.row
    cdef np.int64_t* near = grid.near
    cdef double* squared = grid.squared
    cdef Py_ssize_t count = 0, k, j, first, last
    cdef double dx, dy, distance
    for k in range(9):
        bucket = bucket_of(column + k // 3 - 1, row + k % 3 - 1, grid.mask)
        j = 0
        while j < k and buckets[j] != bucket:
            j += 1
        buckets[k] = bucket
        if j < k:
            continue  # cells may share a bucket
        first, last = grid.start[bucket], grid.start[bucket + 1]
        while last > first and row_at[last - 1] >= end:
            last -= 1
        for j in range(first, last):
            dx, dy = at[0] - place[2 * j], at[1] - place[2 * j + 1]
            distance = dx * dx + dy * dy
            near[count], squared[count] = row_at[j], distance  # overwritten unless it counts: faster than a branch
            count += (least < distance) & (distance <= most)
    return count


cdef bint cannot_be_one(
    const double* one, const double* other, const double* P, const double* Q, const double* bias, double gate
) noexcept nogil:
    """Whether two tracks are beyond the gate of each other; one, other: (6,) motions; P, Q: (6, 6) covariances."""
    cdef double[36] total
    cdef double[6] difference
    cdef double squared = 0.0
    cdef Py_ssize_t k
    for k in range(6):
        difference[k] = other[k] - one[k]
        squared += difference[k] * difference[k] / bias[k]
    if squared <= gate:
        return False
    for k in range(36):
        total[k] = P[k] + Q[k]
    for k in range(6):
        total[7 * k] += bias[k]
    factorise(total, 6)
    forward(total, 6, difference, 1)
    squared = 0.0
    for k in range(6):
        squared += difference[k] * difference[k] / total[7 * k]
    return squared > gate


cdef inline np.int64_t first_of(np.int64_t* parent, np.int64_t r) noexcept nogil:
    """The first row of a component, in a forest of rows."""
    while parent[r] != r:
        parent[r] = parent[parent[r]]
        r = parent[r]
    return r


cdef struct NearPair:
    double squared
    np.int64_t rows  # i * n + j of rows i < j


cdef int by_distance(const void* one, const void* other) noexcept nogil:
    cdef const NearPair* a = <const NearPair*>one
    cdef const NearPair* b = <const NearPair*>other
    if a.squared != b.squared:
        return 1 if a.squared > b.squared else -1
    return (a.rows > b.rows) - (a.rows < b.rows)


cdef struct Clusters:  # by first row
    np.int64_t* label  # by row: the first row of its cluster
    np.int64_t* following  # by row: the next member, -1: none
    np.int64_t* last  # the last member
    double* centre  # x, y, number of members
    np.uint64_t* agents  # bits of the agents of the members
    Py_ssize_t words


cdef inline bint share_agent(const Clusters* clusters, np.int64_t a, np.int64_t b) noexcept nogil:
    cdef Py_ssize_t k
    for k in range(clusters.words):
        if clusters.agents[clusters.words * a + k] & clusters.agents[clusters.words * b + k]:
            return True
    return False


cdef inline bint too_far(const Clusters* clusters, np.int64_t a, np.int64_t b, double radius) noexcept nogil:
    cdef double dx = clusters.centre[3 * a] - clusters.centre[3 * b]
    cdef double dy = clusters.centre[3 * a + 1] - clusters.centre[3 * b + 1]
    return sqrt(dx * dx + dy * dy) > radius


cdef void join(Clusters* clusters, np.int64_t a, np.int64_t b) noexcept nogil:
    """Merge cluster b into a, whose first row is earlier."""
    cdef double* one = clusters.centre + 3 * a
    cdef double* other = clusters.centre + 3 * b
    cdef double total = one[2] + other[2]
    cdef np.int64_t s = b
    cdef Py_ssize_t k
    while s >= 0:
        clusters.label[s], s = a, clusters.following[s]
    for k in range(2):
        one[k] = (one[2] * one[k] + other[2] * other[k]) / total
    one[2] = total
    clusters.following[clusters.last[a]], clusters.last[a] = b, clusters.last[b]
    for k in range(clusters.words):
        clusters.agents[clusters.words * a + k] |= clusters.agents[clusters.words * b + k]


def merge_nearest(motion, agent, covariance, bias, double radius, double gate, Py_ssize_t most, Py_ssize_t crowd):
    motion, covariance = contiguous(motion), contiguous(covariance)
    cdef const double* at = float_data(motion, 2)
    cdef const double* matrix = float_data(covariance, 3)
    cdef const double* bias_of = float_data(bias, 1)
    cdef const np.int64_t* agent_of = int_data(agent)
    cdef Py_ssize_t n = length(agent), k, p, count, total = 0, capacity = 0, found, open
    cdef np.int64_t r, s, a, b, c, mask = 1, rank = 0
    cdef double least, limit
    cdef bint majority
    cdef Grid grid
    cdef Clusters clusters
    cdef NearPair* pairs = NULL
    cdef NearPair* larger
    while mask < 2 * n:
        mask *= 2
    starts, rows, places = empty_vector(np.NPY_INT64, mask + 2), empty_vector(np.NPY_INT64, n), empty_matrix(n, 2)
    buckets, nears, squares = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n + 1), empty_vector(np.NPY_DOUBLE, n + 1)
    parents, pair_counts, sizes = empty_vector(np.NPY_INT64, n), zero_vector(np.NPY_INT64, n), zero_vector(np.NPY_INT64, n)
    roots, following_rows, last_rows = empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_INT64, n)
    centres, separate = empty_matrix(n, 3), zero_vector(np.NPY_BOOL, n)
    cdef np.int64_t* parent = int_data(parents)
    cdef np.int64_t* pairs_of = int_data(pair_counts)  # by first row of a component, as is `size`
    cdef np.int64_t* size = int_data(sizes)
    cdef np.uint8_t* divided = byte_data(separate)
    grid.mask, grid.start, grid.bucket, grid.row = mask - 1, int_data(starts), int_data(buckets), int_data(rows)
    grid.place, grid.near, grid.squared = writable_data(places, 2), int_data(nears), writable_data(squares, 1)
    clusters.label, clusters.following, clusters.last = int_data(roots), int_data(following_rows), int_data(last_rows)
    clusters.centre = writable_data(centres, 2)
    for r in range(n):
        clusters.label[r] = clusters.last[r] = parent[r] = r
        clusters.following[r] = -1
        clusters.centre[3 * r], clusters.centre[3 * r + 1], clusters.centre[3 * r + 2] = at[6 * r], at[6 * r + 1], 1.0
    place_rows(&grid, at, n, radius)
    # Components, and how many pairs each has.
    for r in range(n):
        count = rows_near(&grid, at + 6 * r, r, -1.0, radius * radius)
        total += count
        if 2 * total > crowd * n:
            separate[:] = True
            return roots, separate
        a = r
        for k in range(count):
            s = grid.near[k]
            if agent_of[s] != agent_of[r]:
                pairs_of[r] += 1
                if parent[s] != a:
                    b = first_of(parent, s)
                    a, b = min(a, b), max(a, b)
                    parent[b] = a
    for r in range(n):
        a = first_of(parent, r)
        size[a] += 1
        if a != r:
            pairs_of[a] += pairs_of[r]
    for r in range(n):
        c = first_of(parent, r)
        if pairs_of[c] > most or divided[c]:
            continue
        for k in range(rows_near(&grid, at + 6 * r, r, -1.0, radius * radius)):
            s = grid.near[k]
            if agent_of[s] != agent_of[r] and cannot_be_one(
                at + 6 * r, at + 6 * s, matrix + 36 * r, matrix + 36 * s, bias_of, gate
            ):
                divided[c] = 1
                break
    for r in range(n):
        parent[r] = first_of(parent, r)
        divided[r] = divided[parent[r]]
        rank += r > 0 and agent_of[r] != agent_of[r - 1]
    # Merged by distance, one band of it after the other. Most rows are in one cluster after the first.
    clusters.words = rank // 64 + 1
    bits = zero_vector(np.NPY_INT64, n * clusters.words)
    clusters.agents = <np.uint64_t*>int_data(bits)
    rank = 0
    for r in range(n):
        rank += r > 0 and agent_of[r] != agent_of[r - 1]
        clusters.agents[clusters.words * r + rank // 64] = <np.uint64_t>1 << <np.uint64_t>(rank % 64)
    least, limit = -1.0, radius * radius
    if total > 8 * n:
        limit *= 0.125 * n / total
    place_rows(&grid, at, n, sqrt(limit))
    while True:
        found = open = 0
        for r in range(n):
            c, a = parent[r], clusters.label[r]
            if divided[r] or 2.0 * clusters.centre[3 * a + 2] > size[c]:
                continue  # of two rows, at least one is in no such cluster
            open += 1
            count = rows_near(&grid, at + 6 * r, n, least, limit)
            if found + count > capacity:
                capacity = 2 * (found + count)
                larger = <NearPair*>realloc(pairs, capacity * sizeof(NearPair))
                if larger == NULL:
                    free(pairs)
                    raise MemoryError
                pairs = larger
            for k in range(count):
                s = grid.near[k]
                b = clusters.label[s]
                majority = 2.0 * clusters.centre[3 * b + 2] > size[c]
                if a != b and (r < s or majority) and not share_agent(&clusters, a, b):
                    pairs[found].squared, pairs[found].rows = grid.squared[k], min(r, s) * n + max(r, s)
                    found += 1
        qsort(pairs, found, sizeof(NearPair), by_distance)
        for p in range(found):
            r, s = pairs[p].rows // n, pairs[p].rows % n
            a, b = min(clusters.label[r], clusters.label[s]), max(clusters.label[r], clusters.label[s])
            if a == b or too_far(&clusters, a, b, radius) or share_agent(&clusters, a, b):
                continue
            if pairs_of[parent[r]] > most and cannot_be_one(
                at + 6 * r, at + 6 * s, matrix + 36 * r, matrix + 36 * s, bias_of, gate
            ):
                continue
            join(&clusters, a, b)
        if limit >= radius * radius or not open:
            break
        least, limit = limit, fmin(2.0 * limit, radius * radius)
        if grid.size < sqrt(limit) * CELL:
            place_rows(&grid, at, n, sqrt(limit) if 8 * open > n else radius)
    free(pairs)
    return roots, separate
