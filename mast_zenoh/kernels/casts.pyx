# cython: language_level=3, cdivision=True
"""Kernels for lidar returns. The NumPy references document them.

`nearest_hits` computes what its reference does, number by number. For `has_returns` a beam is cast twice, at boxes that are MARGIN_M larger and smaller: rounding cannot matter where both agree. Objects about
which they do not agree are left to the reference, so the results are equal to its results.
"""

cimport numpy as np
from libc.math cimport INFINITY, asin, atan2, ceil, cos, fabs, floor, fmax, fmin, sin, sqrt

import numpy

from mast_zenoh import kernels
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, int_data, length, writable_data, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793
#: m, far more than rounding moves a beam at the longest range, 10 km.
cdef double MARGIN_M = 1e-6
#: rad, the same for the window of beams that may hit a box.
cdef double MARGIN_RAD = 1e-7
#: Sine of the least angle between a beam and a wall at which the distance to the wall is precise.
cdef double PARALLEL = 1e-3


cdef enum Verdict:
    NO, YES, UNSURE


cdef struct Box:
    double x, y, radius, cos, sin  # x, y: m, from the sensor;  radius: m, of the circle around it
    double[3] origin, half  # the sensor in the frame of the box;  half of its size


cdef struct Beam:
    double x, y, z, flat  # world frame; flat: length on the ground


cdef Box box_at(const double* at, const double* size, double yaw, const double* sensor) noexcept:
    cdef Box box
    cdef double x = sensor[0] - at[0], y = sensor[1] - at[1]
    cdef Py_ssize_t axis
    box.x, box.y, box.cos, box.sin = -x, -y, cos(yaw), sin(yaw)
    box.origin[0], box.origin[1] = box.cos * x + box.sin * y, box.cos * y - box.sin * x
    box.origin[2] = sensor[2] - at[2]
    for axis in range(3):
        box.half[axis] = 0.5 * size[axis]
    box.radius = sqrt(box.half[0] * box.half[0] + box.half[1] * box.half[1])
    return box


cdef double distance_to(Box* box) noexcept:
    """m from the sensor to the box."""
    cdef double total = 0.0, beyond
    cdef Py_ssize_t axis
    for axis in range(3):
        beyond = fabs(box.origin[axis]) - box.half[axis]
        if not beyond < 0.0:  # NaN stays
            total += beyond * beyond
    return sqrt(total)


cdef inline bint clip(double along, double origin, double half, double* enter, double* leave) noexcept:
    """Clip a beam to the slab between two faces; whether anything is left."""
    cdef double centre, span
    if fabs(along) < 1e-12:
        along = 1e-12
    centre, span = -origin / along, half / fabs(along)
    enter[0], leave[0] = fmax(enter[0], centre - span), fmin(leave[0], centre + span)
    return half >= 0.0 and enter[0] <= leave[0]


cdef inline bint hits(Box* box, Beam* beam, double margin, double range_m, double* enter) noexcept:
    """Whether a beam hits a box that is larger by a margin, and the distance m at which it enters it."""
    cdef double leave = range_m + margin
    enter[0] = 0.0
    return (
        clip(box.cos * beam.x + box.sin * beam.y, box.origin[0], box.half[0] + margin, enter, &leave)
        and clip(box.cos * beam.y - box.sin * beam.x, box.origin[1], box.half[1] + margin, enter, &leave)
        and clip(beam.z, box.origin[2], box.half[2] + margin, enter, &leave)
    )


cdef inline Verdict box_hides(Box* box, Beam* beam, double range_m, double least, double most) noexcept:
    """Whether a box hides what a beam meets between two distances m."""
    cdef double enter, reach = box.radius * beam.flat + MARGIN_M
    if fabs(beam.x * box.y - beam.y * box.x) > reach or beam.x * box.x + beam.y * box.y < -reach:
        return NO
    if not hits(box, beam, MARGIN_M, range_m, &enter) or enter > most:
        return NO
    return YES if hits(box, beam, -MARGIN_M, range_m, &enter) and enter < least else UNSURE


cdef inline Verdict wall_hides(
    double x, double y, double end_x, double end_y, double top, Beam* beam, double least, double most
) noexcept:
    """As `box_hides`, for a wall from x, y to end_x, end_y, m from the sensor; top: m above it."""
    cdef double one = beam.x * y - beam.y * x, other = beam.x * end_y - beam.y * end_x
    cdef double span_x = end_x - x, span_y = end_y - y, distance, height, across
    if (one > MARGIN_M and other > MARGIN_M) or (one < -MARGIN_M and other < -MARGIN_M):
        return NO
    across = beam.x * span_y - beam.y * span_x
    if fabs(across) <= PARALLEL * beam.flat * sqrt(span_x * span_x + span_y * span_y) or beam.flat < PARALLEL:
        return UNSURE
    distance = (x * span_y - y * span_x) / across
    height = distance * beam.z
    if distance < -MARGIN_M or distance > most + MARGIN_M or height > top + MARGIN_M:
        return NO
    if fabs(one) <= MARGIN_M or fabs(other) <= MARGIN_M:
        return UNSURE
    return YES if MARGIN_M < distance < least - MARGIN_M and height < top - MARGIN_M else UNSURE


cdef class Scene:
    """A lidar, and the boxes and walls around it, as C values."""
    cdef object arrays
    cdef const double* sensor
    cdef const double* R
    cdef const double* azimuth
    cdef const double* elevation
    cdef const double* flat
    cdef const double* rise
    cdef const double* start
    cdef const double* end
    cdef const double* top
    cdef const double* box_position
    cdef const double* box_size
    cdef const double* box_yaw
    cdef const np.int64_t* box_id
    cdef Box* boxes
    cdef Py_ssize_t azimuths, channels, walls, n_boxes, turn, last_box, last_wall
    cdef double step, range_m

    def __cinit__(self, sensor, walls, occluders):
        lidar = sensor.lidar
        cdef np.int64_t own = sensor.own
        cdef Py_ssize_t r, m = len(occluders.id)
        cdef Box box
        position, rotation = contiguous(sensor.position), contiguous(sensor.rotation)
        azimuth, elevation = lidar.azimuths, lidar.elevations
        flat, rise = numpy.cos(elevation), numpy.sin(elevation)
        self.sensor, self.R = float_data(position, 1), float_data(rotation, 2)
        self.azimuth, self.elevation = float_data(azimuth, 1), float_data(elevation, 1)
        self.flat, self.rise = float_data(flat, 1), float_data(rise, 1)
        self.azimuths, self.channels, self.range_m = length(azimuth), length(elevation), lidar.max_range_m
        self.step = lidar.azimuth_step_deg * (PI / 180.0)
        self.turn = max(round(2 * PI / self.step), self.azimuths)
        self.arrays = [position, rotation, azimuth, elevation, flat, rise]
        self.walls = self.n_boxes = self.last_box = self.last_wall = 0
        if walls is not None:
            start, end, top = contiguous(walls.start), contiguous(walls.end), contiguous(walls.top)
            self.start, self.end, self.top = float_data(start, 2), float_data(end, 2), float_data(top, 1)
            self.walls = length(top)
            self.arrays += [start, end, top]
        at, size, yaw, number = (
            contiguous(occluders.position), contiguous(occluders.size), contiguous(occluders.yaw), contiguous(occluders.id)
        )
        self.arrays += [at, size, yaw, number]
        self.box_position, self.box_size, self.box_yaw = float_data(at, 2), float_data(size, 2), float_data(yaw, 1)
        self.box_id = int_data(number)
        storage = empty_vector(np.NPY_UINT8, m * sizeof(Box))
        self.arrays.append(storage)
        self.boxes = <Box*>byte_data(storage)
        for r in range(m):
            if own < 0 or self.box_id[r] != own:
                box = box_at(self.box_position + 3 * r, self.box_size + 3 * r, self.box_yaw[r], self.sensor)
                if distance_to(&box) <= self.range_m + MARGIN_M:
                    self.boxes[self.n_boxes] = box
                    self.n_boxes += 1

    cdef bint whole_turn(self) noexcept:
        """Whether the steps fill a turn, so that beams have the same place after it."""
        return fabs(self.turn * self.step - 2 * PI) < 1e-9

    cdef inline Verdict hides(self, Beam* beam, double least, double most) noexcept:
        """Whether something hides what a beam meets between two distances m. What hid the last one is asked first."""
        cdef Py_ssize_t k, row
        cdef bint unsure = False
        cdef Verdict verdict
        for k in range(self.n_boxes):
            row = self.last_box + k
            row = row if row < self.n_boxes else row - self.n_boxes
            verdict = box_hides(&self.boxes[row], beam, self.range_m, least, most)
            if verdict == YES:
                self.last_box = row
                return YES
            unsure |= verdict == UNSURE
        for k in range(self.walls):
            row = self.last_wall + k
            row = row if row < self.walls else row - self.walls
            verdict = wall_hides(
                self.start[2 * row] - self.sensor[0], self.start[2 * row + 1] - self.sensor[1],
                self.end[2 * row] - self.sensor[0], self.end[2 * row + 1] - self.sensor[1],
                self.top[row] - self.sensor[2], beam, least, most,
            )
            if verdict == YES:
                self.last_wall = row
                return YES
            unsure |= verdict == UNSURE
        return UNSURE if unsure else NO

    cdef Verdict has_returns(self, Box* box, Py_ssize_t least) noexcept:
        """Whether a box has so many returns."""
        cdef const double* R = self.R
        cdef double nearest = distance_to(box), farthest = 0.0, bearing, low = INFINITY, high = -INFINITY, angle
        cdef double z_low = INFINITY, z_high = -INFINITY, down, up, along, across, x, y, z, u, v, w, enter, most, c, s
        cdef Py_ssize_t corner, k, first, count, column, channel, certain = 0, possible = 0
        cdef Beam beam
        cdef bint hit
        cdef Verdict hidden
        if least <= 0:
            return YES
        if not nearest <= self.range_m + MARGIN_M:
            return NO
        # The window of beams that may hit the box, as in the reference.
        x, y, z = box.x, box.y, -box.origin[2]
        bearing = atan2(R[1] * x + R[4] * y + R[7] * z, R[0] * x + R[3] * y + R[6] * z)
        for corner in range(8):
            along = box.half[0] if corner & 1 else -box.half[0]
            across = box.half[1] if corner & 2 else -box.half[1]
            x, y = box.x + box.cos * along - box.sin * across, box.y + box.sin * along + box.cos * across
            z = (box.half[2] if corner & 4 else -box.half[2]) - box.origin[2]
            u, v, w = R[0] * x + R[3] * y + R[6] * z, R[1] * x + R[4] * y + R[7] * z, R[2] * x + R[5] * y + R[8] * z
            angle = atan2(v, u) - bearing
            angle = angle - 2 * PI if angle >= PI else angle + 2 * PI if angle < -PI else angle
            low, high, z_low, z_high = fmin(low, angle), fmax(high, angle), fmin(z_low, w), fmax(z_high, w)
            farthest = fmax(farthest, sqrt(u * u + v * v + w * w))
        if high - low >= PI - MARGIN_RAD:
            low, high = -PI, PI
        nearest = fmax(nearest, 1e-6)
        down = asin(fmax(fmin(z_low / (nearest if z_low < 0 else farthest), 1.0), -1.0)) - MARGIN_RAD
        up = asin(fmax(fmin(z_high / (nearest if z_high > 0 else farthest), 1.0), -1.0)) + MARGIN_RAD
        first = <Py_ssize_t>ceil((bearing + low - MARGIN_RAD - self.azimuth[0]) / self.step)
        count = <Py_ssize_t>floor((bearing + high + MARGIN_RAD - self.azimuth[0]) / self.step) - first + 1
        for k in range(min(count, self.turn)):
            column = (first + k) % self.turn
            column = column + self.turn if column < 0 else column
            if column >= self.azimuths:
                continue
            c, s = cos(self.azimuth[column]), sin(self.azimuth[column])
            for channel in range(self.channels):
                if self.elevation[channel] < down:
                    continue
                if self.elevation[channel] > up:
                    break
                u, v, w = self.flat[channel] * c, self.flat[channel] * s, self.rise[channel]
                beam.x, beam.y = R[0] * u + R[1] * v + R[2] * w, R[3] * u + R[4] * v + R[5] * w
                beam.z = R[6] * u + R[7] * v + R[8] * w
                beam.flat = sqrt(beam.x * beam.x + beam.y * beam.y)
                if not hits(box, &beam, MARGIN_M, self.range_m, &enter):
                    continue
                hit = hits(box, &beam, -MARGIN_M, self.range_m, &most)
                hidden = self.hides(&beam, enter, most if hit else INFINITY)
                certain += hit and hidden == NO
                possible += hidden != YES
                if certain >= least:
                    return YES
        return NO if possible < least else UNSURE


def has_returns(position, size, yaw, sensor, walls, occluders, Py_ssize_t least):
    cdef Scene scene = Scene(sensor, walls, occluders)
    if not scene.whole_turn():
        return kernels.REFERENCES["has_returns"](position, size, yaw, sensor, walls, occluders, least)
    places, sizes, yaws = contiguous(position), contiguous(size), contiguous(yaw)
    cdef const double* at = float_data(places, 2)
    cdef const double* extent = float_data(sizes, 2)
    cdef const double* heading = float_data(yaws, 1)
    cdef Py_ssize_t r, n = length(places)
    cdef Box box
    cdef Verdict verdict
    result, open_rows = zero_vector(np.NPY_BOOL, n), zero_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* enough = byte_data(result)
    cdef np.uint8_t* unsure = byte_data(open_rows)
    for r in range(n):
        box = box_at(at + 3 * r, extent + 3 * r, heading[r], scene.sensor)
        verdict = scene.has_returns(&box, least)
        enough[r], unsure[r] = verdict == YES, verdict == UNSURE
    if open_rows.any():
        result[open_rows] = kernels.REFERENCES["has_returns"](
            position[open_rows], size[open_rows], yaw[open_rows], sensor, walls, occluders, least
        )
    return result


#: Distance and box of the nearest hit of each beam, -1: none; used again, as making them takes a third of the time.
#: None while it is used.
_beams = None


def nearest_hits(across, up, double range_m, rotation, origin, half, box, azimuth, channels):
    across, up, rotation, origin, half = (
        contiguous(across), contiguous(up), contiguous(rotation), contiguous(origin), contiguous(half)
    )
    box, azimuth, channels = contiguous(box), contiguous(azimuth), contiguous(channels).reshape(-1)
    cdef const double* wide = float_data(across, 2)
    cdef const double* high = float_data(up, 2)
    cdef const double* R = float_data(rotation, 3)
    cdef const double* sensor = float_data(origin, 2)
    cdef const double* extent = float_data(half, 2)
    cdef const np.int64_t* row = int_data(box)
    cdef const np.int64_t* column = int_data(azimuth)
    cdef const np.int64_t* limits = int_data(channels)
    cdef Py_ssize_t azimuths = length(across, 1), elevations = length(up, 1), beams = azimuths * elevations
    cdef Py_ssize_t k, axis, channel, beam, found = 0, n = length(box)
    cdef double enter, leave, direction, centre, span
    cdef double[3] along, lift, start, size
    global _beams
    scratch, _beams = _beams, None
    if scratch is None or len(scratch[0]) < beams:
        scratch = numpy.empty(beams), numpy.full(beams, -1)
    cdef double* nearest = writable_data(scratch[0], 1)
    cdef np.int64_t* owner = int_data(scratch[1])
    for k in range(n):
        for axis in range(3):
            along[axis] = R[9 * row[k] + 3 * axis] * wide[column[k]] + R[9 * row[k] + 3 * axis + 1] * wide[azimuths + column[k]]
            lift[axis] = R[9 * row[k] + 3 * axis + 2]
            start[axis], size[axis] = -sensor[3 * row[k] + axis], extent[3 * row[k] + axis]
        for channel in range(limits[2 * k], limits[2 * k + 1]):
            enter, leave = 0.0, range_m
            for axis in range(3):
                direction = high[channel] * along[axis] + high[elevations + channel] * lift[axis]
                if fabs(direction) < 1e-12:
                    direction = 1e-12
                centre, span = start[axis] / direction, size[axis] / fabs(direction)
                enter = centre - span if centre - span > enter else enter  # no function of C, which would ask for NaN
                leave = centre + span if centre + span < leave else leave
                if enter > leave:
                    break
            beam = column[k] * elevations + channel
            if enter <= leave and (owner[beam] < 0 or enter < nearest[beam]):
                found += owner[beam] < 0
                nearest[beam], owner[beam] = enter, row[k]
    hit_box, hit_beam = empty_vector(np.NPY_INT64, found), empty_vector(np.NPY_INT64, found)
    distances, directions = empty_vector(np.NPY_DOUBLE, found), empty_matrix(found, 3)
    cdef np.int64_t* to_box = int_data(hit_box)
    cdef np.int64_t* to_beam = int_data(hit_beam)
    cdef double* distance = writable_data(distances, 1)
    cdef double* towards = writable_data(directions, 2)
    found = 0
    for beam in range(beams):
        if owner[beam] >= 0:
            channel, k = beam % elevations, beam // elevations
            to_box[found], to_beam[found], distance[found] = owner[beam], beam, nearest[beam]
            towards[3 * found] = high[channel] * wide[k]
            towards[3 * found + 1] = high[channel] * wide[azimuths + k]
            towards[3 * found + 2] = high[elevations + channel]
            owner[beam] = -1
            found += 1
    _beams = scratch
    return hit_box, hit_beam, distances, directions
