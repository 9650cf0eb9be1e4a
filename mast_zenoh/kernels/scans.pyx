# cython: language_level=3, cdivision=True
"""A kernel for the scans of lidars. The NumPy reference documents it, and makes the same numbers."""

cimport numpy as np
from libc.math cimport INFINITY, fabs, fmin, sqrt

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


cdef inline bint clip(double before, double along, double steep, double* enter, double* leave, double* slope) noexcept nogil:
    """Clip a beam at a face, at a distance `before` it that grows by `along` a metre; whether anything is left."""
    cdef double distance
    if fabs(along) < 1e-12:
        along = 1e-12
    distance = -before / along
    if along < 0.0:
        if distance > enter[0]:
            enter[0], slope[0] = distance, -along / steep
    elif distance < leave[0]:
        leave[0] = distance
    return enter[0] <= leave[0]


cdef inline double into_part(Part* part, const double* origin, const double* beam, double nearest, double* slope) noexcept nogil:
    """m along a beam into a part, and the cosine to its face; inf: not met before `nearest`."""
    cdef double enter = -INFINITY, leave = nearest
    cdef Face* face = part.faces
    if (
        clip(-(origin[2] - part.low), -beam[2], 1.0, &enter, &leave, slope)
        and clip(origin[2] - part.high, beam[2], 1.0, &enter, &leave, slope)
        and clip(-(origin[0] - face[0].lean * origin[2] - face[0].at), -(beam[0] - face[0].lean * beam[2]), face[0].steep, &enter, &leave, slope)
        and clip(origin[0] - face[1].lean * origin[2] - face[1].at, beam[0] - face[1].lean * beam[2], face[1].steep, &enter, &leave, slope)
        and clip(-(origin[1] - face[2].lean * origin[2] - face[2].at), -(beam[1] - face[2].lean * beam[2]), face[2].steep, &enter, &leave, slope)
        and clip(origin[1] - face[3].lean * origin[2] - face[3].at, beam[1] - face[3].lean * beam[2], face[3].steep, &enter, &leave, slope)
        and enter >= 0.0
    ):
        return enter
    return INFINITY


def nearest_surfaces(columns, channels, place, objects, heading, parts, windows, walls, wall_windows, double max_range_m):
    columns, channels = contiguous(columns), contiguous(channels)
    position, velocity, facing, mount = (contiguous(each) for each in (place.position, place.velocity, place.heading, place.mount))
    at, speed, yaw, spin = (contiguous(each) for each in (objects.position, objects.velocity, heading, objects.turn))
    lower, upper = contiguous(parts.low), contiguous(parts.high)
    start, end, top = contiguous(walls.start), contiguous(walls.end), contiguous(walls.top)
    cdef Py_ssize_t m = length(columns, 1), c = length(channels, 1), i, k, w, part, row, first, last, low, high, place_in
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
    ranges, cosines = empty_matrix(m, c), empty_matrix(m, c)
    sources = numpy.empty((m, c), numpy.int32)
    cdef double* range_m = writable_data(ranges, 2)
    cdef double* slope = writable_data(cosines, 2)
    cdef np.int32_t[:, ::1] source_view = sources
    cdef np.int32_t* source = &source_view[0, 0] if m * c else NULL
    axes_bytes = numpy.empty(m * sizeof(Axes), numpy.uint8)
    cdef np.uint8_t[::1] axes_view = axes_bytes
    cdef Axes* axes = <Axes*>&axes_view[0] if m else NULL
    cdef double co, si, x, y, z, fall, distance, nearest, met_slope, height, span_x, span_y, wall_length, to_x, to_y, across, share
    cdef double[3] column0, column1, offset, origin, ahead, left, up, beam
    cdef Py_ssize_t n_parts = length(lower)
    shape_bytes = numpy.empty(max(n_parts, 1) * sizeof(Part), numpy.uint8)
    cdef np.uint8_t[::1] shape_view = shape_bytes
    cdef Part* shape = <Part*>&shape_view[0]
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
                for place_in in range(low, high):
                    x, y, z = channel[place_in], channel[c + place_in], channel[2 * c + place_in]
                    for k in range(3):
                        beam[k] = ahead[k] * x + left[k] * y + up[k] * z
                    nearest = fmin(range_m[i * c + place_in], max_range_m)
                    for part in range(parts_of[row], parts_of[row + 1]):
                        distance = into_part(&shape[part], origin, beam, nearest, &met_slope)
                        if distance < range_m[i * c + place_in] and distance <= max_range_m:
                            nearest = range_m[i * c + place_in] = distance
                            slope[i * c + place_in], source[i * c + place_in] = met_slope, <np.int32_t>row
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
