# cython: language_level=3, cdivision=True
"""Kernels on the table of tracks: prediction, correction, existence. The NumPy references document them."""

cimport numpy as np
from libc.math cimport INFINITY, copysign, cos, exp, fabs, fmax, fmin, rint, sin, sqrt
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.algebra cimport distance_of, factorise, forward, wrap_angle
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrices, empty_matrix, empty_vector, float_data, int_data, length, writable_data,
    zero_vector,
)
from mast_zenoh.kernels.table cimport (
    SOURCE_DIGEST, P, XX, XY, YY, YAW, YAW_VARIANCE, TURN, LATERAL_RESIDUAL, ODDS, HITS, MISSES, VOTES, N_CLASSES,
    CLASS, CONFIRMED, AGE, ID, ROW, SCORE, SPAN, DUE, WIDTH,
)

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793


def begin_step(t, double dt, double yaw_drift, double lifetime_s, double memory_s):
    cdef double* row = writable_data(t, 2)
    cdef Py_ssize_t r, k
    cdef double growth = exp(dt / lifetime_s), decay = exp(-dt / memory_s)
    for r in range(length(t)):
        row[ROW] = -1.0
        row[YAW_VARIANCE] += yaw_drift * dt
        row[AGE] += dt
        row[ODDS] /= growth + (growth - 1.0) * row[ODDS]
        for k in range(HITS, VOTES + N_CLASSES):
            row[k] *= decay
        row += WIDTH


def predict(t, double dt, noise):
    cdef double* row = writable_data(t, 2)
    cdef const double* by_class = float_data(noise, 3)
    cdef const double* added
    cdef Py_ssize_t r, i, k
    for r in range(length(t)):
        added = by_class + 81 * <Py_ssize_t>row[CLASS]
        for i in range(3):
            row[i] += dt * row[6 + i]
            for k in range(9):
                row[P + 9 * i + k] += dt * row[P + 9 * (6 + i) + k]
        for k in range(9):
            for i in range(3):
                row[P + 9 * k + i] += dt * row[P + 9 * k + 6 + i]
        for k in range(81):
            row[P + k] += added[k]
        row += WIDTH


def correct(t, measured, noise):
    cdef double* row = writable_data(t, 2)
    cdef const double* measurement = float_data(measured, 2)
    cdef const double* measurement_noise = float_data(noise, 3)
    cdef Py_ssize_t m = length(measured, 1)
    cdef Py_ssize_t r, i, j, k
    cdef double[81] total
    cdef double[90] columns  # per measured component: innovation, and covariance with the state
    cdef double factor
    for r in range(length(t)):
        for i in range(m):
            for j in range(m):
                total[i * m + j] = row[P + 9 * i + j] + measurement_noise[i * m + j]
            columns[10 * i] = measurement[i] - row[i]
            memcpy(&columns[10 * i + 1], &row[P + 9 * i], 9 * sizeof(double))
        factorise(total, m)
        forward(total, m, columns, 10)
        for i in range(m):
            for j in range(9):
                factor = columns[10 * i + 1 + j]
                if factor != 0.0:
                    factor /= total[i * m + i]
                    row[j] += factor * columns[10 * i]
                    for k in range(j + 1):
                        row[P + 9 * j + k] -= factor * columns[10 * i + 1 + k]
        for j in range(9):
            for k in range(j):
                row[P + 9 * k + j] = row[P + 9 * j + k]
        row, measurement, measurement_noise = row + WIDTH, measurement + m, measurement_noise + m * m


def correct_speed(t, direction, noise):
    cdef double* row = writable_data(t, 2)
    cdef const double* along = float_data(direction, 2)
    cdef const double* measurement_noise = float_data(noise, 1)
    cdef Py_ssize_t r, i, j
    cdef double[9] cross
    cdef double x, y, variance, speed
    for r in range(length(t)):
        x, y = along[2 * r], along[2 * r + 1]
        for i in range(9):
            cross[i] = row[P + 9 * i + 6] * x + row[P + 9 * i + 7] * y
        variance = 1.0 / (cross[6] * x + cross[7] * y + measurement_noise[r])
        speed = (row[6] * x + row[7] * y) * variance
        for i in range(9):
            row[i] -= cross[i] * speed
            for j in range(i + 1):
                row[P + 9 * i + j] -= cross[i] * cross[j] * variance
                row[P + 9 * j + i] = row[P + 9 * i + j]
        row += WIDTH


def lateral_constraint(t, innovation, free, double slip, double share, double time_s):
    cdef double* row = writable_data(t, 2)
    cdef const double* offset = float_data(innovation, 2)
    cdef const double* by_class = float_data(free, 1)
    cdef Py_ssize_t r, n = length(t)
    cdef double c, d, squared
    directions, variances = empty_matrix(n, 2), empty_vector(np.NPY_DOUBLE, n)
    cdef double* direction = writable_data(directions, 2)
    cdef double* variance = writable_data(variances, 1)
    for r in range(n):
        c, d = cos(row[YAW]), sin(row[YAW])
        row[LATERAL_RESIDUAL] += share * (offset[2 * r + 1] * c - offset[2 * r] * d - row[LATERAL_RESIDUAL])
        squared = row[6] * row[6] + row[7] * row[7]
        variance[r] = slip * slip + (row[LATERAL_RESIDUAL] / time_s) ** 2 + squared * row[YAW_VARIANCE]
        variance[r] += by_class[<Py_ssize_t>row[CLASS]]
        direction[2 * r], direction[2 * r + 1] = -d, c
        row += WIDTH
    return directions, variances


cdef inline void vote(double* row, Py_ssize_t class_id) noexcept nogil:
    """Count a vote for a class; the class with most votes wins, in a tie the lower."""
    cdef Py_ssize_t k, best = 0
    row[VOTES + class_id] += 1.0
    for k in range(1, N_CLASSES):
        if row[VOTES + k] > row[VOTES + best]:
            best = k
    row[CLASS] = best


def new_tracks(explained, measured, first_id, constants, speed):
    rows, states, noises, yaws, classes, scores = measured
    by_class, half_by_class, vertical_variance = speed
    cdef const np.uint8_t* known = byte_data(explained)
    cdef const np.int64_t* row_of = int_data(rows)
    cdef const double* state = float_data(states, 2)
    cdef const double* noise = float_data(noises, 3)
    cdef const double* yaw = float_data(yaws, 1)
    cdef const np.int64_t* class_id = int_data(classes)
    cdef const double* score = float_data(scores, 1)
    cdef const double* mean = float_data(by_class, 1)
    cdef const double* half = float_data(half_by_class, 1)
    cdef double yaw_variance = constants[0], odds = constants[1], due = constants[2], vertical = vertical_variance
    cdef double id = first_id, swing
    cdef Py_ssize_t m, i, k = 0, n = length(explained), w = length(states, 1)
    for m in range(n):
        k += not known[m]
    result = empty_matrix(k, WIDTH)
    cdef double* row = writable_data(result, 2)
    memset(row, 0, k * WIDTH * sizeof(double))
    for m in range(n):
        if known[m]:
            continue
        memcpy(row, state + w * m, w * sizeof(double))
        for i in range(w):
            memcpy(row + P + 9 * i, noise + w * (w * m + i), w * sizeof(double))
        if w < 9:
            swing = half[class_id[m]] * cos(2.0 * yaw[m])
            row[P + 60], row[P + 70] = mean[class_id[m]] + swing, mean[class_id[m]] - swing
            row[P + 61] = row[P + 69] = half[class_id[m]] * sin(2.0 * yaw[m])
            row[P + 80] = vertical
        row[ID], row[ROW], row[SCORE] = id, row_of[m], score[m]
        row[YAW], row[YAW_VARIANCE], row[TURN] = yaw[m], yaw_variance, 1.0
        row[ODDS], row[HITS], row[DUE] = odds, 1.0, due
        vote(row, class_id[m])
        id += 1.0
        row += WIDTH
    return result


cdef void share_errors(double* track_covariance, double* noise) noexcept nogil:
    """Widen the covariances of a track and of its measurement, (9, 9) each, as `matched.widen` does."""
    cdef double variance = noise[0] + noise[10]
    cdef double weight = variance / (track_covariance[0] + track_covariance[10] + variance)
    cdef Py_ssize_t i
    for i in range(81):
        track_covariance[i] /= weight
        noise[i] /= 1.0 - weight


def matched_tracks(t, match, detected, measured, double yaw_variance, double most, bint correlated):
    of_track, of_measurement, log_ratios, jumps = match
    rows, states, noises, yaws, classes, scores = measured
    cdef const double* before = float_data(t, 2)
    cdef const np.int64_t* track = int_data(of_track)
    cdef const np.int64_t* measurement = int_data(of_measurement)
    cdef const double* log_ratio = float_data(log_ratios, 1)
    cdef const double* jump = float_data(jumps, 1)
    cdef const double* probability = float_data(detected, 1)
    cdef const np.int64_t* row_of = int_data(rows)
    cdef const double* box = float_data(states, 2)
    cdef const double* measurement_noise = float_data(noises, 3)
    cdef const double* yaw = float_data(yaws, 1)
    cdef const np.int64_t* class_id = int_data(classes)
    cdef const double* score = float_data(scores, 1)
    cdef Py_ssize_t r, m, k = length(of_track), w = length(states, 1), steady = 0, confirmed = 0
    cdef double turn, half_turns, gain, p, total = 0.0, squared = 0.0, predicted = 0.0, log_density
    updated, innovations = empty_matrix(k, WIDTH), empty_matrix(k, 2)
    matched_states, matched_noises = empty_matrix(k, w), empty_matrices(k, w)
    cdef double* row = writable_data(updated, 2)
    cdef double* state = writable_data(matched_states, 2)
    cdef double* noise = writable_data(matched_noises, 3)
    cdef double* innovation = writable_data(innovations, 2)
    for r in range(k):
        m, p = measurement[r], probability[track[r]]
        memcpy(row, before + WIDTH * track[r], WIDTH * sizeof(double))
        memcpy(state, box + w * m, w * sizeof(double))
        memcpy(noise, measurement_noise + w * w * m, w * w * sizeof(double))
        row[XX] += jump[r]
        row[YY] += jump[r]
        turn = yaw[m] - row[YAW]
        half_turns = rint(turn * (1.0 / PI))
        gain = row[YAW_VARIANCE] / (row[YAW_VARIANCE] + yaw_variance)
        row[YAW] += gain * (turn - PI * half_turns)
        row[YAW_VARIANCE] = yaw_variance * gain
        row[TURN] += 1.0 - 2.0 * fabs(half_turns - 2.0 * rint(0.5 * half_turns))
        vote(row, class_id[m])
        row[ODDS] = fmin(row[ODDS] * (p * exp(log_ratio[r]) + (1.0 - p)), most)
        row[HITS] += 1.0
        row[SCORE] += (score[m] - row[SCORE]) / row[HITS]
        row[SPAN] += row[AGE]
        row[AGE], row[ROW] = 0.0, row_of[m]
        if correlated and w == 9:
            share_errors(row + P, noise)
        innovation[0], innovation[1] = state[0] - row[0], state[1] - row[1]
        if jump[r] == 0.0:
            total += distance_of(
                innovation[0], innovation[1], row[XX] + noise[0], row[XY] + noise[1], row[YY] + noise[w + 1],
                &log_density,
            )
            steady += 1
            if row[CONFIRMED] > 0.0:
                squared += innovation[0] * innovation[0] + innovation[1] * innovation[1]
                predicted += row[XX] + row[YY]
                confirmed += 1
        row, state, noise, innovation = row + WIDTH, state + w, noise + w * w, innovation + 2
    return updated, matched_states, matched_noises, innovations, (total, steady), (squared - predicted, confirmed)


def resolve_headings_and_store(t, track, matched, double forward, double limit):
    cdef double* rows = writable_data(t, 2)
    cdef const np.int64_t* row_of = int_data(track)
    cdef double* row = writable_data(matched, 2)
    cdef Py_ssize_t r
    cdef double along
    for r in range(length(matched)):
        along = row[6] * cos(row[YAW]) + row[7] * sin(row[YAW])
        if along > forward:
            row[TURN] += 1.0
        elif along < -forward:
            row[TURN] -= 1.0
        if row[TURN] < 0.0:
            row[YAW] += PI
        row[TURN] = fmin(fabs(row[TURN]), limit)
        memcpy(rows + WIDTH * row_of[r], row, WIDTH * sizeof(double))
        row += WIDTH


def end_stages(t, double report_odds, stages):
    cdef double* row = writable_data(t, 2)
    cdef const double* due = float_data(stages, 1)
    cdef Py_ssize_t r, stage, k = 0, m = 0, n = length(t), last = length(stages) - 1
    cdef bint lasts
    scores, stages_of, lasting = empty_vector(np.NPY_DOUBLE, n), empty_vector(np.NPY_INT64, n), empty_vector(np.NPY_BOOL, n)
    rows = empty_vector(np.NPY_INT64, n)
    cdef double* score = writable_data(scores, 1)
    cdef np.int64_t* stage_of = int_data(stages_of)
    cdef np.uint8_t* survived = byte_data(lasting)
    cdef np.int64_t* established = int_data(rows)
    for r in range(n):
        lasts = row[SPAN] >= fabs(row[DUE])
        if lasts or (row[ODDS] <= report_odds * row[CONFIRMED] and 0.0 < row[DUE] < INFINITY):
            stage = 0
            while stage < last and due[stage] < fabs(row[DUE]):
                stage += 1
            if row[CONFIRMED] > 0.0 and row[DUE] > 0.0:
                score[k], stage_of[k], survived[k] = row[SCORE], stage, lasts
                k += 1
            if lasts and row[DUE] == due[last]:
                established[m] = r
                m += 1
            row[DUE] = copysign(due[stage + 1] if stage < last else INFINITY, row[DUE]) if lasts else -row[DUE]
        row += WIDTH
    return scores[:k], stages_of[:k], lasting[:k], rows[:m]


def extremes(values):
    cdef const double* value = float_data(values, 1)
    cdef Py_ssize_t r
    cdef double low = value[0], high = value[0]
    for r in range(length(values)):
        if value[r] != value[r]:
            return value[r], value[r]
        low, high = fmin(low, value[r]), fmax(high, value[r])
    return low, high


def coasting_tracks(t, double report_odds):
    cdef const double* row = float_data(t, 2)
    cdef Py_ssize_t r, k = 0, m = 0, n = length(t)
    rows, boxes, others = empty_vector(np.NPY_INT64, n), empty_matrix(n, 6), empty_matrix(n, 6)
    cdef np.int64_t* coasting = int_data(rows)
    cdef double* box = writable_data(boxes, 2)
    cdef double* occluder = writable_data(others, 2)
    for r in range(n):
        if row[ROW] < 0.0:
            coasting[k] = r
            memcpy(box + 6 * k, row, 6 * sizeof(double))
            k += 1
        if row[CONFIRMED] > 0.0 and row[ODDS] > report_odds:
            memcpy(occluder + 6 * m, row, 6 * sizeof(double))
            m += 1
        row += WIDTH
    return rows[:k], boxes[:k], others[:m]


def next_table(t, keep, report, new):
    cdef const double* row = float_data(t, 2)
    cdef const np.uint8_t* kept = byte_data(keep)
    cdef const np.uint8_t* reported = byte_data(report)
    cdef Py_ssize_t r, k = 0, m = 0, n = length(t), n_new = length(new)
    for r in range(n):
        k += kept[r]
        m += kept[r] and reported[r]
    table, selected = empty_matrix(k + n_new, WIDTH), empty_matrix(m, WIDTH)
    cdef double* out = writable_data(table, 2)
    cdef double* out_reported = writable_data(selected, 2)
    for r in range(n):
        if kept[r]:
            memcpy(out, row, WIDTH * sizeof(double))
            out += WIDTH
            if reported[r]:
                memcpy(out_reported, row, WIDTH * sizeof(double))
                out_reported += WIDTH
        row += WIDTH
    memcpy(out, float_data(new, 2), n_new * WIDTH * sizeof(double))
    return table, selected


def survival_table(score, stage, survived, edges, Py_ssize_t stages, double prior):
    cdef const double* value = float_data(score, 1)
    cdef const np.int64_t* stage_of = int_data(stage)
    cdef const np.uint8_t* lasts = byte_data(survived)
    cdef const double* edge = float_data(edges, 1)
    cdef Py_ssize_t r, k, s, blocks, n_edges = length(edges), width = n_edges + 1
    cdef double n, n_lasting, mean, total
    counts, survivors = zero_vector(np.NPY_DOUBLE, stages * width), zero_vector(np.NPY_DOUBLE, stages * width)
    levels, weights, ends = empty_vector(np.NPY_DOUBLE, width), empty_vector(np.NPY_DOUBLE, width), empty_vector(np.NPY_INT64, width)
    result = empty_matrix(stages + 1, width)
    cdef double* samples = writable_data(counts, 1)
    cdef double* lasting = writable_data(survivors, 1)
    cdef double* level = writable_data(levels, 1)
    cdef double* weight = writable_data(weights, 1)
    cdef np.int64_t* end = int_data(ends)
    cdef double* table = writable_data(result, 2)
    for r in range(length(score)):
        k = 0
        while k < n_edges and not value[r] < edge[k]:
            k += 1
        samples[stage_of[r] * width + k] += 1.0
        lasting[stage_of[r] * width + k] += lasts[r]
    for s in range(stages - 1, -1, -1):
        n = n_lasting = 0.0
        for k in range(width):
            n += samples[s * width + k]
            n_lasting += lasting[s * width + k]
        blocks = 0
        for k in range(width):  # isotonic regression
            total = samples[s * width + k] + prior
            mean = (lasting[s * width + k] + prior * ((n_lasting + 1.0) / (n + 1.0))) / total
            while blocks > 0 and level[blocks - 1] >= mean:
                blocks -= 1
                mean = (level[blocks] * weight[blocks] + mean * total) / (weight[blocks] + total)
                total += weight[blocks]
            level[blocks], weight[blocks], end[blocks] = mean, total, k + 1
            blocks += 1
        r = 0
        for k in range(width):
            if k == end[r]:
                r += 1
            table[s * width + k] = level[r] if s == stages - 1 else table[(s + 1) * width + k] * level[r]
    for s in range(stages):
        total = table[s * width + width - 1]
        for k in range(width):
            table[s * width + k] /= total
    memcpy(table + stages * width, table + (stages - 1) * width, width * sizeof(double))
    return result


def calibrated(t, stages, edges, table):
    cdef const double* row = float_data(t, 2)
    cdef const double* due = float_data(stages, 1)
    cdef const double* edge = float_data(edges, 1)
    cdef const double* probability = float_data(table, 2)
    cdef Py_ssize_t r, stage, interval, n = length(t), n_stages = length(stages), n_edges = length(edges)
    result = empty_vector(np.NPY_DOUBLE, n)
    cdef double* out = writable_data(result, 1)
    for r in range(n):
        stage = interval = 0
        while stage < n_stages and due[stage] < fabs(row[DUE]):
            stage += 1
        while interval < n_edges and not row[SCORE] < edge[interval]:
            interval += 1
        out[r] = probability[stage * (n_edges + 1) + interval]
        row += WIDTH
    return result


def detection_probability(t, double prior, double weight):
    cdef const double* row = float_data(t, 2)
    cdef Py_ssize_t r, n = length(t)
    result = empty_vector(np.NPY_DOUBLE, n)
    cdef double* out = writable_data(result, 1)
    for r in range(n):
        out[r] = fmin((row[HITS] + prior * weight) / (row[HITS] + row[MISSES] + weight), prior)
        row += WIDTH
    return result


def update_missed(t, detected, coasting, visible, double birth):
    cdef double* row = writable_data(t, 2)
    cdef const double* p = float_data(detected, 1)
    cdef const np.int64_t* unmeasured = int_data(coasting)
    cdef const double* fraction = float_data(visible, 1)
    cdef Py_ssize_t r, k = 0, n = length(coasting)
    for r in range(length(t)):
        if k < n and unmeasured[k] == r:
            row[ODDS] *= 1.0 - p[r] * fraction[k]
            row[MISSES] += fraction[k]
            k += 1
        row[ODDS] = fmax(row[ODDS], birth * row[CONFIRMED])
        row += WIDTH


def report_columns(t, weights, double least):
    cdef const double* row = float_data(t, 2)
    cdef const double* weight = float_data(weights, 1)
    cdef Py_ssize_t r, k = 0, n = length(t)
    cdef double power
    chosen = empty_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* likely = byte_data(chosen)
    for r in range(n):
        likely[r] = row[ODDS] / (1.0 + row[ODDS]) * weight[r] > least or fabs(row[DUE]) == INFINITY
        k += likely[r]
        row += WIDTH
    ids, positions, velocities = empty_vector(np.NPY_INT64, k), empty_matrix(k, 3), empty_matrix(k, 3)
    sizes, yaws, covariances = empty_matrix(k, 3), empty_vector(np.NPY_DOUBLE, k), empty_matrices(k, 9)
    scores, classes, rows = empty_vector(np.NPY_DOUBLE, k), empty_vector(np.NPY_UINT8, k), empty_vector(np.NPY_INT64, k)
    cdef np.int64_t* id = int_data(ids)
    cdef double* position = writable_data(positions, 2)
    cdef double* velocity = writable_data(velocities, 2)
    cdef double* size = writable_data(sizes, 2)
    cdef double* yaw = writable_data(yaws, 1)
    cdef double* covariance = writable_data(covariances, 3)
    cdef double* score = writable_data(scores, 1)
    cdef np.uint8_t* class_id = byte_data(classes)
    cdef np.int64_t* row_of = int_data(rows)
    k, row = 0, float_data(t, 2)
    for r in range(n):
        if likely[r]:
            id[k], row_of[k] = <np.int64_t>row[ID], <np.int64_t>row[ROW]
            memcpy(position + 3 * k, row, 3 * sizeof(double))
            memcpy(size + 3 * k, row + 3, 3 * sizeof(double))
            memcpy(velocity + 3 * k, row + 6, 3 * sizeof(double))
            memcpy(covariance + 81 * k, row + P, 81 * sizeof(double))
            yaw[k] = wrap_angle(row[YAW])
            power = sqrt(sqrt(sqrt(row[ODDS])))
            score[k] = power / (1.0 + power) * weight[r]
            class_id[k] = <np.uint8_t>row[CLASS]
            k += 1
        row += WIDTH
    return (ids, positions, velocities, sizes, yaws, covariances, scores, classes), rows


def track_status(
    t, double confirm, double report, double drop, double max_age, double lost_variance, double max_speed,
    double max_variance,
):
    cdef double* row = writable_data(t, 2)
    cdef Py_ssize_t r, n = length(t)
    cdef double variance, speed
    keep_mask, report_mask = empty_vector(np.NPY_BOOL, n), empty_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* keep = byte_data(keep_mask)
    cdef np.uint8_t* reported = byte_data(report_mask)
    for r in range(n):
        if row[ODDS] > confirm:
            row[CONFIRMED] = 1.0
        variance = row[XX] + row[YY]
        speed = sqrt(row[6] * row[6] + row[7] * row[7])
        keep[r] = (
            row[ODDS] >= drop * (1.0 - row[CONFIRMED]) and row[AGE] <= max_age and variance <= lost_variance
            and speed <= max_speed
        )
        reported[r] = row[CONFIRMED] > 0.0 and row[ODDS] > report and variance <= max_variance
        row += WIDTH
    return keep_mask, report_mask


def averaged(mean, yaw, covariance, j, pairs, limits):
    own_means, own_covariances, claims, own_yaws, shares, changes = pairs
    covariance, yaw = contiguous(covariance), contiguous(yaw)
    cdef const double* mean_of = float_data(mean, 2)
    cdef const np.int64_t* place = int_data(j)
    cdef const double* own_mean = float_data(own_means, 2)
    cdef const double* own_covariance = float_data(own_covariances, 3)
    cdef const double* claimed = float_data(claims, 3)
    cdef const double* own_yaw = float_data(own_yaws, 1)
    cdef const double* share_of = float_data(shares, 1)
    cdef const double* change = float_data(changes, 2)
    cdef double least = limits[0], disagreement = limits[1]
    cdef Py_ssize_t r, i, row, n = length(mean), p = length(j)
    positions, sizes, velocities = empty_matrix(n, 3), empty_matrix(n, 3), empty_matrix(n, 3)
    yaws, covariances = empty_vector(np.NPY_DOUBLE, n), empty_matrices(n, 9)
    cdef double* parts[3]
    parts[0], parts[1], parts[2] = writable_data(positions, 2), writable_data(sizes, 2), writable_data(velocities, 2)
    cdef double* out_yaw = writable_data(yaws, 1)
    cdef double* out = writable_data(covariances, 3)
    cdef double own_variance, picture_variance, share, gain, weight
    cdef double[9] difference
    memcpy(out_yaw, float_data(yaw, 1), n * sizeof(double))
    memcpy(out, float_data(covariance, 3), 81 * n * sizeof(double))
    for r in range(n):
        for i in range(9):
            parts[i // 3][3 * r + i % 3] = mean_of[9 * r + i]
    for r in range(p):
        row = place[r]
        own_variance = fmax(own_covariance[0] + own_covariance[10], least)
        picture_variance = fmax(claimed[0] + claimed[10], least)
        for i in range(9):
            difference[i] = own_mean[9 * r + i] - mean_of[9 * row + i]
        share = disagreement * (difference[0] * difference[0] + difference[1] * difference[1])
        share = fmax(share_of[r], fmin(share / (own_variance + picture_variance), 1.0))
        gain = picture_variance / (share * picture_variance + own_variance)
        weight = gain * share
        for i in range(9):
            parts[i // 3][3 * row + i % 3] = (
                mean_of[9 * row + i] + weight * difference[i] + (gain - weight) * change[9 * r + i]
            )
        for i in range(81):
            out[81 * row + i] = claimed[i] + weight * (own_covariance[i] - claimed[i])
        if own_variance < picture_variance:
            out_yaw[row] = own_yaw[r]
        own_covariance, claimed = own_covariance + 81, claimed + 81
    return positions, sizes, velocities, yaws, covariances
