# cython: language_level=3, cdivision=True, boundscheck=False, wraparound=False
"""A kernel for the scans of lidars. The NumPy reference documents it, and makes the same numbers."""

cimport numpy as np
from libc.math cimport INFINITY, fabs, fmax, fmin, sqrt

from mast_zenoh.kernels.arrays cimport contiguous, empty_matrix, float_data, int_data, length, writable_data
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

import numpy

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef int GROUND = -1, WALL = -2, NOTHING = -3


cdef struct Axes:
    double[3] ahead, left, up  # of the beams at an azimuth
    double[3] origin


cdef struct Face:
    double lean, at, steep  # steep: length of the normal


cdef struct Part:
    double low, high  # m, z
    Face[4] faces  # behind, in front, right, left


cdef inline void turned(const double* heading, double angle, double* cosine, double* sine) noexcept nogil:
    cdef double square = angle * angle, c, s
    c = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40320.0))))
    s = angle * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))))
    cosine[0], sine[0] = heading[0] * c - heading[1] * s, heading[1] * c + heading[0] * s


cdef inline void into(double cosine, double sine, const double* world, double* local) noexcept nogil:
    local[0], local[1], local[2] = cosine * world[0] + sine * world[1], cosine * world[1] - sine * world[0], world[2]


cdef inline void set_part(Part* part, const double* low, const double* high) noexcept nogil:
    cdef double height = high[0] - low[0]
    cdef Py_ssize_t k
    part.low, part.high = low[0], high[0]
    for k in range(4):
        part.faces[k].lean = (high[1 + k] - low[1 + k]) / height
        part.faces[k].at = low[1 + k] - part.faces[k].lean * low[0]
        part.faces[k].steep = sqrt(1.0 + part.faces[k].lean * part.faces[k].lean)


cdef struct Span:
    double[3] middle, half  # m, of the box around a part, and a little more


cdef double MARGIN_M = 1e-6  # far more than rounding moves a beam


cdef inline void set_span(Span* span, const double* low, const double* high) noexcept nogil:
    cdef Py_ssize_t k
    cdef double first, last
    span.middle[2], span.half[2] = (low[0] + high[0]) / 2.0, (high[0] - low[0]) / 2.0 + MARGIN_M
    for k in range(2):
        first, last = fmin(low[1 + 2 * k], high[1 + 2 * k]), fmax(low[2 + 2 * k], high[2 + 2 * k])
        span.middle[k], span.half[k] = (first + last) / 2.0, (last - first) / 2.0 + MARGIN_M


cdef inline void interval(const Span* span, const double* origin, const double* axis, double* low, double* high) noexcept nogil:
    """m, from and to, that a box reaches along an axis from an origin."""
    cdef double middle, half
    middle = (span.middle[0] - origin[0]) * axis[0] + (span.middle[1] - origin[1]) * axis[1] + (span.middle[2] - origin[2]) * axis[2]
    half = span.half[0] * fabs(axis[0]) + span.half[1] * fabs(axis[1]) + span.half[2] * fabs(axis[2])
    low[0], high[0] = middle - half, middle + half


cdef inline bint narrowed(
    const Span* span, const double* origin, const double* ahead, const double* left, const double* up,
    const double* rise, double aside, Py_ssize_t* low, Py_ssize_t* high,
) noexcept nogil:
    """Narrow the channels of an azimuth to those that may meet a box; whether there are any.

    rise: of each channel, up for each metre ahead;  aside: most that a channel goes to the side for each metre ahead
    """
    cdef double near, far, first, last
    interval(span, origin, ahead, &near, &far)
    if far <= 0.0:
        return False
    interval(span, origin, left, &first, &last)
    if first > far * aside or last < -far * aside:
        return False
    if near > MARGIN_M:
        interval(span, origin, up, &first, &last)
        first, last = first / (near if first < 0.0 else far), last / (near if last > 0.0 else far)
        while low[0] < high[0] and rise[low[0]] < first:
            low[0] += 1
        while low[0] < high[0] and rise[high[0] - 1] > last:
            high[0] -= 1
    return low[0] < high[0]


cdef struct Sides:
    double[6] before  # m, of the origin before each face; negative: behind it
    Py_ssize_t[6] faces  # those before which the origin is, then the others
    Py_ssize_t outer


cdef inline void set_sides(Sides* sides, const Part* part, const double* origin) noexcept nogil:
    cdef Py_ssize_t k, inner = 6
    sides.outer = 0
    sides.before[0], sides.before[1] = part.low - origin[2], origin[2] - part.high
    for k in range(4):
        sides.before[2 + k] = origin[k // 2] - part.faces[k].lean * origin[2] - part.faces[k].at
        if k % 2 == 0:
            sides.before[2 + k] = -sides.before[2 + k]
    for k in range(6):
        if sides.before[k] > 0.0:
            sides.faces[sides.outer] = k
            sides.outer += 1
        else:
            inner -= 1
            sides.faces[inner] = k


cdef inline double outward(const Part* part, Py_ssize_t k, const double* beam) noexcept nogil:
    """How much a beam goes away from a face for each metre."""
    if k < 2:
        return beam[2] if k else -beam[2]
    cdef double along = beam[(k - 2) // 2] - part.faces[k - 2].lean * beam[2]
    return along if k % 2 else -along


cdef inline double into_part(const Part* part, const Sides* sides, const double* beam, double nearest, double* slope) noexcept nogil:
    """m along a beam into a part, and the cosine to its face; inf: not met before `nearest`."""
    cdef double enter = -1.0, along, distance
    cdef Py_ssize_t i, k
    for i in range(sides.outer):
        k = sides.faces[i]
        along = outward(part, k, beam)
        if along > -1e-12:
            return INFINITY
        distance = -sides.before[k] / along
        if distance > enter:
            enter, slope[0] = distance, (-along if k < 2 else -along / part.faces[k - 2].steep)
    if not 0.0 <= enter < nearest:
        return INFINITY
    for i in range(sides.outer, 6):
        k = sides.faces[i]
        if sides.before[k] + enter * outward(part, k, beam) > 0.0:
            return INFINITY
    return enter


def nearest_surfaces(columns, channels, place, objects, heading, parts, windows, walls, wall_windows, double max_range_m):
    columns, channels = contiguous(columns), contiguous(channels)
    position, velocity, facing, mount = (contiguous(each) for each in (place.position, place.velocity, place.heading, place.mount))
    at, speed, yaw, spin = (contiguous(each) for each in (objects.position, objects.velocity, heading, objects.turn))
    lower, upper = contiguous(parts.low), contiguous(parts.high)
    start, end, top = contiguous(walls.start), contiguous(walls.end), contiguous(walls.top)
    cdef Py_ssize_t m = length(columns, 1), c = length(channels, 1), i, k, w, part, row, first, last, low, high, bottom, above_all, place_in
    cdef const double* time = float_data(columns, 2)
    cdef const double* cosine = time + m
    cdef const double* sine = time + 2 * m
    cdef const double* channel = float_data(channels, 2)
    cdef const double* R = float_data(mount, 2)
    cdef const double* lidar = float_data(position, 1)
    cdef const double* drift = float_data(velocity, 1)
    cdef const double* ahead_of = float_data(facing, 1)
    cdef double turn = place.turn, ground = place.ground_m
    cdef const double* box = float_data(at, 2)
    cdef const double* box_speed = float_data(speed, 2)
    cdef const double* box_heading = float_data(yaw, 2)
    cdef const double* box_turn = float_data(spin, 1)
    cdef const np.int64_t* parts_of = int_data(parts.first)
    cdef const double* below = float_data(lower, 2)
    cdef const double* above = float_data(upper, 2)
    cdef const np.int64_t* window = int_data(windows.reshape(-1))
    cdef const np.int64_t* wall_window = int_data(wall_windows.reshape(-1))
    cdef Py_ssize_t n_windows = length(windows), n_walls = length(wall_windows)
    cdef const double* wall_start = float_data(start, 2)
    cdef const double* wall_end = float_data(end, 2)
    cdef const double* wall_top = float_data(top, 1)
    # One block, which the next scan finds again: three smaller ones go back to the system, and cost its page faults.
    block = numpy.empty(20 * m * c, numpy.uint8)
    ranges, cosines, sources = (
        block[first * m * c : last * m * c].view(kind).reshape(m, c)
        for first, last, kind in ((0, 8, numpy.float64), (8, 16, numpy.float64), (16, 20, numpy.int32))
    )
    cdef double* range_m = writable_data(ranges, 2)
    cdef double* slope = writable_data(cosines, 2)
    cdef np.int32_t[:, ::1] source_view = sources
    cdef np.int32_t* source = &source_view[0, 0] if m * c else NULL
    axes_bytes = numpy.empty(m * sizeof(Axes), numpy.uint8)
    cdef np.uint8_t[::1] axes_view = axes_bytes
    cdef Axes* axes = <Axes*>&axes_view[0] if m else NULL
    cdef double met_slope = 0.0, co, si, x, y, z, fall, distance, height, span_x, span_y, wall_length, to_x, to_y, across, share
    cdef double[3] column0, column1, offset, origin, ahead, left, up, beam
    cdef Py_ssize_t n_parts = length(lower)
    shape_bytes = numpy.empty(max(n_parts, 1) * sizeof(Part), numpy.uint8)
    cdef np.uint8_t[::1] shape_view = shape_bytes
    cdef Part* shape = <Part*>&shape_view[0]
    span_bytes = numpy.empty(max(n_parts, 1) * sizeof(Span), numpy.uint8)
    cdef np.uint8_t[::1] span_view = span_bytes
    cdef Span* span = <Span*>&span_view[0]
    cdef Sides sides
    cdef double aside = 0.0
    rises = numpy.empty(c)
    cdef double* rise = writable_data(rises, 1)
    with nogil:
        for i in range(m):
            turned(ahead_of, turn * time[i], &co, &si)
            for k in range(3):
                axes[i].origin[k] = lidar[k] + drift[k] * time[i]
            for k in range(3):
                x = co * R[k] - si * R[3 + k]
                y = si * R[k] + co * R[3 + k]
                z = R[6 + k]
                if k == 0:
                    column0[0], column0[1], column0[2] = x, y, z
                elif k == 1:
                    column1[0], column1[1], column1[2] = x, y, z
                else:
                    axes[i].up[0], axes[i].up[1], axes[i].up[2] = x, y, z
            for k in range(3):
                axes[i].ahead[k] = cosine[i] * column0[k] + sine[i] * column1[k]
                axes[i].left[k] = cosine[i] * column1[k] - sine[i] * column0[k]
            x, y, z, height = axes[i].ahead[2], axes[i].left[2], axes[i].up[2], ground - axes[i].origin[2]
            for k in range(c):  # three loops: each is compiled to instructions for several numbers at a time
                fall = x * channel[k] + y * channel[c + k] + z * channel[2 * c + k]
                slope[i * c + k] = -fall
                distance = height / fall
                range_m[i * c + k] = distance if (fall < 0.0) & (distance >= 0.0) & (distance <= max_range_m) else INFINITY
            for k in range(c):
                slope[i * c + k] = slope[i * c + k] if range_m[i * c + k] < INFINITY else 0.0
            for k in range(c):
                source[i * c + k] = GROUND if range_m[i * c + k] < INFINITY else NOTHING
        for k in range(n_parts):
            set_part(&shape[k], &below[5 * k], &above[5 * k])
            set_span(&span[k], &below[5 * k], &above[5 * k])
        for k in range(c):
            rise[k] = channel[2 * c + k] / channel[k]
            aside = fmax(aside, fabs(channel[c + k] / channel[k]))
        for w in range(n_windows):
            row, first, last, low, high = window[5 * w], window[5 * w + 1], window[5 * w + 2], window[5 * w + 3], window[5 * w + 4]
            for i in range(first, last):
                turned(&box_heading[2 * row], box_turn[row] * time[i], &co, &si)
                for k in range(3):
                    offset[k] = axes[i].origin[k] - (box[3 * row + k] + box_speed[3 * row + k] * time[i])
                into(co, si, offset, origin)
                into(co, si, axes[i].ahead, ahead)
                into(co, si, axes[i].left, left)
                into(co, si, axes[i].up, up)
                for part in range(parts_of[row], parts_of[row + 1]):
                    bottom, above_all = low, high
                    if not narrowed(&span[part], origin, ahead, left, up, rise, aside, &bottom, &above_all):
                        continue
                    set_sides(&sides, &shape[part], origin)
                    for place_in in range(bottom, above_all):
                        x, y, z = channel[place_in], channel[c + place_in], channel[2 * c + place_in]
                        for k in range(3):
                            beam[k] = ahead[k] * x + left[k] * y + up[k] * z
                        distance = into_part(&shape[part], &sides, beam, range_m[i * c + place_in], &met_slope)
                        if distance <= max_range_m:
                            range_m[i * c + place_in], slope[i * c + place_in] = distance, met_slope
                            source[i * c + place_in] = <np.int32_t>row
        for w in range(n_walls):
            row, first, last = wall_window[5 * w], wall_window[5 * w + 1], wall_window[5 * w + 2]
            low, high = wall_window[5 * w + 3], wall_window[5 * w + 4]
            span_x, span_y = wall_end[2 * row] - wall_start[2 * row], wall_end[2 * row + 1] - wall_start[2 * row + 1]
            wall_length = sqrt(span_x * span_x + span_y * span_y)
            for i in range(first, last):
                to_x, to_y = wall_start[2 * row] - axes[i].origin[0], wall_start[2 * row + 1] - axes[i].origin[1]
                for place_in in range(low, high):
                    x, y, z = channel[place_in], channel[c + place_in], channel[2 * c + place_in]
                    for k in range(3):
                        beam[k] = axes[i].ahead[k] * x + axes[i].left[k] * y + axes[i].up[k] * z
                    across = beam[0] * span_y - beam[1] * span_x
                    if fabs(across) < 1e-12:
                        across = 1e-12
                    distance = (to_x * span_y - to_y * span_x) / across
                    if not (distance >= 0.0 and distance < range_m[i * c + place_in] and distance <= max_range_m):
                        continue
                    share = (to_x * beam[1] - to_y * beam[0]) / across
                    if share >= 0.0 and share <= 1.0 and axes[i].origin[2] + distance * beam[2] <= wall_top[row]:
                        range_m[i * c + place_in], slope[i * c + place_in] = distance, fabs(across) / wall_length
                        source[i * c + place_in] = WALL
    return ranges, sources, cosines


def surface_echoes(range_m, source, cosine, shades, float lit, float grazing):
    from mast_zenoh.sensing.returns import Echoes

    cdef const double[:, ::1] distance = numpy.ascontiguousarray(range_m)
    cdef const double[:, ::1] slope = numpy.ascontiguousarray(cosine)
    cdef const np.int32_t[:, ::1] kind = numpy.ascontiguousarray(source)
    cdef const float[::1] shade = numpy.ascontiguousarray(shades)
    cdef Py_ssize_t m = distance.shape[0], c = distance.shape[1], n = shade.shape[0], i, k, row
    cdef float near, across, least = 1e-6, one = 1.0, square
    block = numpy.empty((2, m, c), numpy.float32)
    cdef float[:, :, ::1] echo = block
    if not range_m.shape == source.shape == cosine.shape:
        raise ValueError("found arrays of a scan of several shapes, expected one")
    for i in range(m):
        for k in range(c):
            row = kind[i, k] + (n if kind[i, k] < 0 else 0)
            if not 0 <= row < n:
                raise IndexError(f"source: found {kind[i, k]}, expected a row of {n} shades")
            echo[1, i, k] = shade[row]
        for k in range(c):  # compiled to instructions for several numbers at a time
            near, across = <float>distance[i, k], <float>slope[i, k]
            square = near * near
            echo[0, i, k] = near
            echo[1, i, k] = echo[1, i, k] * (lit * across + grazing * (one - across * across)) / (square if square > least else least)
    return Echoes(block[0], source, block[1])


def measured_points(echoes, draws, receiver, firings):
    cdef const float[:, ::1] distance = numpy.ascontiguousarray(echoes.range_m)
    cdef const float[:, ::1] power = numpy.ascontiguousarray(echoes.power)
    cdef const np.int32_t[:, ::1] kind = numpy.ascontiguousarray(echoes.source)
    cdef const np.uint64_t[:, ::1] draw = numpy.ascontiguousarray(draws)
    cdef const float[::1] noise = receiver.noise
    cdef const float[::1] least = receiver.least
    cdef const float[:, ::1] start = firings.origin
    cdef const float[:, :, ::1] axes = firings.axes
    cdef const float[:, ::1] channel = firings.channels
    cdef const float[::1] time = firings.time_s
    cdef float unit = receiver.unit, measured, along, one = 1.0
    cdef double nearest = receiver.nearest_m, farthest = receiver.farthest_m
    cdef Py_ssize_t m = distance.shape[0], c = distance.shape[1], i, k, j, row, n = 0
    cdef np.uint64_t level = 4095
    if not echoes.range_m.shape == echoes.source.shape == echoes.power.shape == draws.shape:
        raise ValueError("found arrays of echoes of several shapes, expected one")
    if noise.shape[0] != 4096 or least.shape[0] != 4096 or start.shape[0] < m or axes.shape[0] < m or time.shape[0] < m or channel.shape[1] < c:
        raise ValueError("found too short a table or too few firings")
    beams, firsts = numpy.empty(m * c, numpy.uint8), numpy.zeros(m + 1, numpy.int64)
    cdef np.uint8_t[::1] beam = beams
    cdef np.int64_t[::1] first = firsts
    for i in range(m):
        for k in range(c):
            if not power[i, k] > 0:
                continue
            measured = distance[i, k] + noise[draw[i, k] & level]
            if power[i, k] >= least[(draw[i, k] >> 12) & level] and distance[i, k] >= nearest and measured <= farthest:
                beam[n] = <np.uint8_t>k
                n += 1
        first[i + 1] = n
    block = numpy.empty(29 * n, numpy.uint8)  # one, as in `nearest_surfaces`
    sources, positions, intensities, times, channels = (
        block[one_byte * n : last_byte * n].view(kind_of)
        for one_byte, last_byte, kind_of in (
            (0, 8, numpy.int64), (8, 20, numpy.float32), (20, 24, numpy.float32), (24, 28, numpy.float32), (28, 29, numpy.uint8)
        )
    )
    cdef float[::1] position = positions
    cdef float[::1] intensity = intensities
    cdef float[::1] at = times
    cdef np.uint8_t[::1] number = channels
    cdef np.int64_t[::1] of = sources
    for i in range(m):
        for j in range(first[i], first[i + 1]):
            k = beam[j]
            along = distance[i, k] + noise[draw[i, k] & level]
            for row in range(3):
                position[3 * j + row] = start[i, row] + along * (
                    axes[i, row, 0] * channel[0, k] + axes[i, row, 1] * channel[1, k] + axes[i, row, 2] * channel[2, k]
                )
            along = power[i, k] * (distance[i, k] * distance[i, k]) * unit
            intensity[j] = along if along < one else one
            at[j], number[j], of[j] = time[i], <np.uint8_t>k, kind[i, k]
    return positions.reshape(n, 3), intensities, times, channels, sources
