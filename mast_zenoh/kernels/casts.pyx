# cython: language_level=3, cdivision=True
"""Kernels for lidar returns. The NumPy references document them.

A beam is cast twice, at boxes that are MARGIN_M larger and smaller: rounding cannot matter where both agree. Beams about
which they do not agree are left to the reference, so the results are equal to its results.
"""

cimport numpy as np
from libc.math cimport INFINITY, asin, atan2, ceil, cos, fabs, floor, fmax, fmin, isfinite, sin, sqrt

import numpy

from mast_zenoh import kernels
from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_vector, float_data, int_data, length, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793
#: m, far more than rounding moves a beam at the longest range, 10 km.
cdef double MARGIN_M = 1e-6
#: rad, the same for the window of beams that may hit a box.
cdef double MARGIN_RAD = 1e-7
#: More returns than any lidar has beams.
cdef Py_ssize_t MANY = 1 << 40
#: The most beams of a box that are left to the reference one by one; of more, it casts all.
cdef Py_ssize_t OPEN_BEAMS = 1024
cdef Py_ssize_t NOTHING = -1
#: Sine of the least angle between a beam and a wall at which the distance to the wall is precise.
cdef double PARALLEL = 1e-3


cdef enum Verdict:
    NO, YES, UNSURE


cdef struct Returns:
    Py_ssize_t certain, open  # open: left to the reference


cdef struct Box:
    Py_ssize_t row  # of the boxes; -1: none of them
    double x, y, radius, cos, sin  # x, y: m, from the sensor;  radius: m, of the circle around it
    double[3] origin, half  # the sensor in the frame of the box;  half of its size
    double nearest  # m, from the sensor
    bint apart  # from the box that is looked at
    bint thick  # in all directions, so that there is a box that is smaller by MARGIN_M on each side


cdef struct Beam:
    double x, y, z, flat  # world frame; flat: length on the ground


cdef bint are_finite(const double* values, Py_ssize_t n) noexcept:
    cdef Py_ssize_t k
    for k in range(n):
        if not isfinite(values[k]):
            return False
    return True


cdef struct Column:
    double x, y, z  # the direction on the sensor's level of all beams at an azimuth, world frame


cdef struct Cast:
    double enter, leave  # m, along the beam, in the box that is larger by MARGIN_M
    double inner_enter, inner_leave  # in the one that is smaller
    bint inner  # whether the beam hits that


cdef double distance_to(Box* box) noexcept:
    """m from the sensor to the box."""
    cdef double total = 0.0, beyond
    cdef Py_ssize_t axis
    for axis in range(3):
        beyond = fabs(box.origin[axis]) - box.half[axis]
        if not beyond < 0.0:  # NaN stays
            total += beyond * beyond
    return sqrt(total)


cdef Box box_at(const double* at, const double* size, double yaw, const double* sensor) noexcept:
    cdef Box box
    cdef double x = sensor[0] - at[0], y = sensor[1] - at[1]
    cdef Py_ssize_t axis
    box.row = -1
    box.x, box.y, box.cos, box.sin = -x, -y, cos(yaw), sin(yaw)
    box.origin[0], box.origin[1] = box.cos * x + box.sin * y, box.cos * y - box.sin * x
    box.origin[2] = sensor[2] - at[2]
    box.thick = True
    for axis in range(3):
        box.half[axis] = 0.5 * size[axis]
        box.thick = box.thick and box.half[axis] >= MARGIN_M
    box.radius = sqrt(box.half[0] * box.half[0] + box.half[1] * box.half[1])
    box.nearest = distance_to(&box)
    return box


cdef enum Place:
    BEHIND, APART, ANYWHERE


cdef Place place_of(Box* other, Box* box) noexcept:
    """Where another box certainly is: apart from a box, and behind a plane that it cannot hide it from the sensor.

    The planes are parallel to a face of one of the two.
    """
    cdef double[5] at, reach, other_at, other_reach
    cdef double c = fabs(box.cos * other.cos + box.sin * other.sin), s = fabs(box.cos * other.sin - box.sin * other.cos)
    cdef double far
    cdef Py_ssize_t axis
    cdef Place place = ANYWHERE
    at[0], at[1] = box.cos * box.x + box.sin * box.y, box.cos * box.y - box.sin * box.x
    other_at[0], other_at[1] = box.cos * other.x + box.sin * other.y, box.cos * other.y - box.sin * other.x
    at[2], at[3] = other.cos * box.x + other.sin * box.y, other.cos * box.y - other.sin * box.x
    other_at[2], other_at[3] = other.cos * other.x + other.sin * other.y, other.cos * other.y - other.sin * other.x
    at[4], other_at[4] = -box.origin[2], -other.origin[2]
    reach[0], reach[1], other_reach[2], other_reach[3] = box.half[0], box.half[1], other.half[0], other.half[1]
    other_reach[0], other_reach[1] = c * other.half[0] + s * other.half[1], s * other.half[0] + c * other.half[1]
    reach[2], reach[3] = c * box.half[0] + s * box.half[1], s * box.half[0] + c * box.half[1]
    reach[4], other_reach[4] = box.half[2], other.half[2]
    for axis in range(5):
        far = 1.0 if other_at[axis] > at[axis] else -1.0
        if far * (other_at[axis] - at[axis]) > reach[axis] + other_reach[axis] + 9.0 * MARGIN_M:
            place = APART
            if far * other_at[axis] > other_reach[axis] + 9.0 * MARGIN_M:
                return BEHIND
    return place


cdef inline double least_of(double one, double other) noexcept:
    """The smaller number; `one` if the other is NaN. A call of `fmin` costs more than all else about a beam."""
    return other if other < one else one


cdef inline double most_of(double one, double other) noexcept:
    """The larger number; `one` if the other is NaN."""
    return other if other > one else one


cdef inline bint clip(double along, double origin, double half, Cast* cast) noexcept:
    """Clip a beam to the slabs between two faces of both boxes; whether anything of the larger one is left."""
    cdef double per_m, margin, centre, span
    if fabs(along) < 1e-12:
        along = 1e-12
    per_m = 1.0 / along
    centre, span, margin = -origin * per_m, half * fabs(per_m), MARGIN_M * fabs(per_m)
    cast.enter, cast.leave = most_of(cast.enter, centre - span - margin), least_of(cast.leave, centre + span + margin)
    cast.inner_enter = most_of(cast.inner_enter, centre - span + margin)
    cast.inner_leave = least_of(cast.inner_leave, centre + span - margin)
    return cast.enter <= cast.leave


cdef inline bint hits(Box* box, Beam* beam, double range_m, Cast* cast) noexcept:
    """Whether a beam hits a box that is larger by MARGIN_M, and where; `cast.inner`: also one that is smaller by it."""
    cast.enter = cast.inner_enter = 0.0
    cast.leave, cast.inner_leave = range_m + MARGIN_M, range_m - MARGIN_M
    if not (
        clip(box.cos * beam.x + box.sin * beam.y, box.origin[0], box.half[0], cast)
        and clip(box.cos * beam.y - box.sin * beam.x, box.origin[1], box.half[1], cast)
        and clip(beam.z, box.origin[2], box.half[2], cast)
    ):
        return False
    cast.inner = box.thick and cast.inner_enter <= cast.inner_leave
    return True


cdef inline Verdict box_hides(Box* box, Beam* beam, double range_m, double least, double most) noexcept:
    """Whether a box hides what a beam meets between two distances m."""
    cdef double reach = box.radius * beam.flat + MARGIN_M
    cdef Cast cast
    if fabs(beam.x * box.y - beam.y * box.x) > reach or beam.x * box.x + beam.y * box.y < -reach:
        return NO
    if not hits(box, beam, range_m, &cast) or cast.enter > most:
        return NO
    return YES if cast.inner and cast.inner_enter < least else UNSURE


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
    cdef Box* boxes
    cdef np.int64_t* near_boxes  # rows of the boxes and walls that may hide the box that is looked at
    cdef np.int64_t* near_walls
    cdef np.int64_t* open_azimuths  # (OPEN_BEAMS,) each: of the beams that may have a return from it
    cdef np.int64_t* open_channels
    cdef object open_beams
    cdef Py_ssize_t azimuths, channels, walls, n_boxes, n_near_boxes, n_near_walls, turn, last_box, last_wall
    cdef Py_ssize_t hider  # which of the near boxes hides the last beam from the box that is looked at; NOTHING: none
    cdef double step, range_m
    cdef bint sound  # arrays of one length, without NaN and infinity, and no box that touches the sensor

    def __cinit__(self, lidar, sensor_position, sensor_rotation, walls, box_position, box_size, box_yaw, own):
        """own: (m,) which boxes are left out"""
        cdef Py_ssize_t r, m = len(box_yaw)
        cdef Box box
        self.sound = True
        position, rotation = contiguous(sensor_position), contiguous(sensor_rotation)
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
            self.sound &= length(start) == length(end) == self.walls and length(start, 1) == length(end, 1) == 2
        at, size, yaw = contiguous(box_position), contiguous(box_size), contiguous(box_yaw)
        self.arrays += [at, size, yaw, own]
        self.box_position, self.box_size, self.box_yaw = float_data(at, 2), float_data(size, 2), float_data(yaw, 1)
        cdef const np.uint8_t* left_out = byte_data(own)
        storage = empty_vector(np.NPY_UINT8, m * sizeof(Box))
        near_boxes, near_walls = empty_vector(np.NPY_INT64, m), empty_vector(np.NPY_INT64, self.walls)
        azimuths, channels = empty_vector(np.NPY_INT64, OPEN_BEAMS), empty_vector(np.NPY_INT64, OPEN_BEAMS)
        self.open_azimuths, self.open_channels, self.open_beams = int_data(azimuths), int_data(channels), (azimuths, channels)
        self.arrays += [storage, near_boxes, near_walls]
        self.sound &= length(at) == length(size) == length(own) == m and length(at, 1) == length(size, 1) == 3
        self.sound &= length(position) == length(rotation) == length(rotation, 1) == 3 and self.azimuths > 0
        self.sound = self.sound and are_finite(self.sensor, 3) and are_finite(self.R, 9) and are_finite(
            self.box_position, 3 * m) and are_finite(self.box_size, 3 * m) and are_finite(self.box_yaw, m) and (
            are_finite(self.start, 2 * self.walls) and are_finite(self.end, 2 * self.walls))
        # The beams fill a turn, so that they have the same places after it.
        self.sound = self.sound and fabs(self.turn * self.step - 2 * PI) < 1e-9
        self.boxes = <Box*>byte_data(storage)
        self.near_boxes, self.near_walls = int_data(near_boxes), int_data(near_walls)
        for r in range(m if self.sound else 0):
            if not left_out[r]:
                box = box_at(self.box_position + 3 * r, self.box_size + 3 * r, self.box_yaw[r], self.sensor)
                self.sound &= box.nearest > MARGIN_M  # on its faces, rounding decides about half of all beams
                if box.nearest <= self.range_m + MARGIN_M:
                    self.boxes[self.n_boxes] = box
                    self.boxes[self.n_boxes].row = r
                    self.n_boxes += 1

    cdef void look_at(self, Box* box) noexcept:
        """Find what may hide a box: what reaches into the strip from the sensor to it, as wide as the box."""
        cdef double distance = sqrt(box.x * box.x + box.y * box.y), x = 1.0, y = 0.0, one, other
        cdef double wide = box.radius + 4.0 * MARGIN_M, x_start, y_start, x_end, y_end
        cdef Py_ssize_t row
        cdef Place place
        self.n_near_boxes = self.n_near_walls = self.last_box = self.last_wall = 0
        if distance <= wide:  # the strip has no direction
            distance, wide = INFINITY, INFINITY
        else:
            x, y = box.x / distance, box.y / distance
        for row in range(self.n_boxes):
            one = self.boxes[row].radius + wide
            if self.boxes[row].row == box.row or fabs(x * self.boxes[row].y - y * self.boxes[row].x) > one:
                continue
            if -one <= x * self.boxes[row].x + y * self.boxes[row].y <= distance + one:
                place = place_of(&self.boxes[row], box)
                if place == BEHIND:
                    continue
                self.boxes[row].apart = place == APART
                self.near_boxes[self.n_near_boxes] = row
                self.n_near_boxes += 1
        for row in range(self.walls):
            x_start, y_start = self.start[2 * row] - self.sensor[0], self.start[2 * row + 1] - self.sensor[1]
            x_end, y_end = self.end[2 * row] - self.sensor[0], self.end[2 * row + 1] - self.sensor[1]
            one, other = x * y_start - y * x_start, x * y_end - y * x_end
            if (one > wide and other > wide) or (one < -wide and other < -wide):
                continue
            one, other = x * x_start + y * y_start, x * x_end + y * y_end
            if (one > distance + wide and other > distance + wide) or (one < -wide and other < -wide):
                continue
            self.near_walls[self.n_near_walls] = row
            self.n_near_walls += 1

    cdef inline Verdict hides(self, Beam* beam, double least, double most) noexcept:
        """Whether something hides what a beam meets between two distances m. What hid the last one is asked first."""
        cdef Py_ssize_t k, place, row
        cdef bint unsure = False
        cdef Verdict verdict
        for k in range(self.n_near_boxes):
            place = self.last_box + k
            place = place if place < self.n_near_boxes else place - self.n_near_boxes
            verdict = box_hides(&self.boxes[self.near_boxes[place]], beam, self.range_m, least, most)
            if verdict == YES:
                self.last_box = self.hider = place
                return YES
            unsure |= verdict == UNSURE
        for k in range(self.n_near_walls):
            place = self.last_wall + k
            place = place if place < self.n_near_walls else place - self.n_near_walls
            row = self.near_walls[place]
            verdict = wall_hides(
                self.start[2 * row] - self.sensor[0], self.start[2 * row + 1] - self.sensor[1],
                self.end[2 * row] - self.sensor[0], self.end[2 * row + 1] - self.sensor[1],
                self.top[row] - self.sensor[2], beam, least, most,
            )
            if verdict == YES:
                self.last_wall = place
                return YES
            unsure |= verdict == UNSURE
        return UNSURE if unsure else NO

    cdef inline Verdict meets(self, Box* box, Column* column, Py_ssize_t channel) noexcept:
        """Whether a beam has a return from a box."""
        cdef double flat = self.flat[channel], rise = self.rise[channel]
        cdef Beam beam
        cdef Cast cast
        cdef Verdict hidden
        beam.x = flat * column.x + rise * self.R[2]
        beam.y = flat * column.y + rise * self.R[5]
        beam.z = flat * column.z + rise * self.R[8]
        self.hider = NOTHING
        if not hits(box, &beam, self.range_m, &cast):
            return NO
        if self.n_near_boxes == 0 and self.n_near_walls == 0:
            return YES if cast.inner else UNSURE
        beam.flat = sqrt(beam.x * beam.x + beam.y * beam.y)
        hidden = self.hides(&beam, cast.enter, cast.inner_enter if cast.inner else INFINITY)
        if hidden == YES:
            return NO
        return YES if cast.inner and hidden == NO else UNSURE

    cdef bint is_clear(self, Column* column) noexcept:
        """Whether nothing can hide a box from the beams at an azimuth. Only seen at once if they are in a vertical plane."""
        cdef Py_ssize_t k, row
        cdef double reach, one, other, flat = sqrt(column.x * column.x + column.y * column.y)
        cdef Box* box
        if self.R[2] != 0.0 or self.R[5] != 0.0:
            return self.n_near_boxes == self.n_near_walls == 0
        for k in range(self.n_near_boxes):
            box = &self.boxes[self.near_boxes[k]]
            reach = flat * (box.radius + 2.0 * MARGIN_M)
            if fabs(column.x * box.y - column.y * box.x) <= reach and column.x * box.x + column.y * box.y >= -reach:
                return False
        for k in range(self.n_near_walls):
            row = self.near_walls[k]
            one = column.x * (self.start[2 * row + 1] - self.sensor[1]) - column.y * (self.start[2 * row] - self.sensor[0])
            other = column.x * (self.end[2 * row + 1] - self.sensor[1]) - column.y * (self.end[2 * row] - self.sensor[0])
            if least_of(one, other) <= 2.0 * flat * MARGIN_M and most_of(one, other) >= -2.0 * flat * MARGIN_M:
                return False
        return True

    cdef Py_ssize_t last_hidden(self, Box* box, Column* column, Py_ssize_t bottom, Py_ssize_t top) noexcept:
        """The last channel up to `top` in which the box that hid the last beam, in channel `bottom`, does so, too."""
        cdef Py_ssize_t middle, hider = self.hider
        while bottom < top:
            middle = (bottom + top + 1) // 2
            self.meets(box, column, middle)
            if self.hider == hider:
                bottom = middle
            else:
                top = middle - 1
        return bottom

    cdef inline bint count(self, Box* box, Column* column, Py_ssize_t azimuth, Py_ssize_t channel, Returns* found) noexcept:
        """Count a beam; whether it certainly has a return from a box, or would have if no other box hid that."""
        cdef Verdict verdict = self.meets(box, column, channel)
        if verdict == UNSURE:
            if found.open < OPEN_BEAMS:
                self.open_azimuths[found.open], self.open_channels[found.open] = azimuth, channel
            found.open += 1
        found.certain += verdict == YES
        return verdict == YES or self.hider != NOTHING

    cdef Returns returns(self, Box* box, Py_ssize_t enough) noexcept:
        """How many returns a box has; counting ends at `enough` that are certain."""
        cdef const double* R = self.R
        cdef double nearest = box.nearest, farthest = 0.0, bearing, low = INFINITY, high = -INFINITY, angle
        cdef double z_low = INFINITY, z_high = -INFINITY, down, up, along, across, x, y, z, u, v, w, c, s
        cdef Py_ssize_t corner, k, first, count, azimuth, bottom, top, lowest = 0, highest
        cdef Column column
        cdef Returns found
        found.certain = found.open = 0
        if not nearest <= self.range_m + MARGIN_M:
            return found
        self.look_at(box)
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
        while lowest < self.channels and self.elevation[lowest] < down:
            lowest += 1
        highest = lowest
        while highest < self.channels and not self.elevation[highest] > up:
            highest += 1
        for k in range(min(count, self.turn)):
            azimuth = (first + k) % self.turn
            azimuth = azimuth + self.turn if azimuth < 0 else azimuth
            if azimuth >= self.azimuths:
                continue
            c, s = cos(self.azimuth[azimuth]), sin(self.azimuth[azimuth])
            column.x, column.y, column.z = R[0] * c + R[1] * s, R[3] * c + R[4] * s, R[6] * c + R[7] * s
            bottom, top, self.hider = lowest, highest - 1, NOTHING
            while bottom <= top and not self.count(box, &column, azimuth, bottom, &found):
                bottom += 1
            # A column meets each box in one piece, and of two that are apart the same one first.
            if self.is_clear(&column):
                while top > bottom and not self.count(box, &column, azimuth, top, &found):
                    top -= 1
                found.certain += max(top - bottom - 1, 0)
                bottom = top
            elif self.hider != NOTHING and self.boxes[self.near_boxes[self.hider]].apart:
                bottom = self.last_hidden(box, &column, bottom, top)
            for bottom in range(bottom + 1, top + 1):
                self.count(box, &column, azimuth, bottom, &found)
            if found.certain >= enough:
                return found
        return found


def has_returns(position, size, yaw, sensor, walls, occluders, Py_ssize_t least):
    own = numpy.zeros(len(occluders.id), numpy.bool_) if sensor.own < 0 else occluders.id == sensor.own
    cdef Scene scene = Scene(
        sensor.lidar, sensor.position, sensor.rotation, walls, occluders.position, occluders.size, occluders.yaw, own
    )
    places, sizes, yaws = contiguous(position), contiguous(size), contiguous(yaw)
    cdef Py_ssize_t r, n = length(places)
    if not scene.sound or not (
        length(sizes) == length(yaws) == n and length(places, 1) == length(sizes, 1) == 3
        and are_finite(float_data(places, 2), 3 * n) and are_finite(float_data(sizes, 2), 3 * n)
        and are_finite(float_data(yaws, 1), n)
    ):
        return kernels.REFERENCES["has_returns"](position, size, yaw, sensor, walls, occluders, least)
    cdef const double* at = float_data(places, 2)
    cdef const double* extent = float_data(sizes, 2)
    cdef const double* heading = float_data(yaws, 1)
    cdef Box box
    cdef Returns found
    result, open_rows = zero_vector(np.NPY_BOOL, n), zero_vector(np.NPY_BOOL, n)
    cdef np.uint8_t* enough = byte_data(result)
    cdef np.uint8_t* unsure = byte_data(open_rows)
    for r in range(n):
        if least <= 0:
            enough[r] = True
            continue
        box = box_at(at + 3 * r, extent + 3 * r, heading[r], scene.sensor)
        if box.nearest <= MARGIN_M:
            unsure[r] = True
            continue
        found = scene.returns(&box, least)
        enough[r], unsure[r] = found.certain >= least, found.certain < least <= found.certain + found.open
    if open_rows.any():
        result[open_rows] = kernels.REFERENCES["has_returns"](
            position[open_rows], size[open_rows], yaw[open_rows], sensor, walls, occluders, least
        )
    return result


def lidar_points(
    lidar, sensor_position, sensor_rotation, position, size, yaw, walls=None, Py_ssize_t own=-1, beams=None
):
    cdef Py_ssize_t r, k, row, n = len(yaw)
    carrier = zero_vector(np.NPY_BOOL, n)
    if own >= 0:
        carrier[own] = True
    cdef Scene scene = Scene(lidar, sensor_position, sensor_rotation, walls, position, size, yaw, carrier)
    cdef Returns found
    reference = kernels.REFERENCES["lidar_points"]
    if beams is not None or not scene.sound:
        return reference(lidar, sensor_position, sensor_rotation, position, size, yaw, walls, own, beams)
    points = numpy.zeros(n, numpy.int32)
    for r in range(scene.n_boxes):
        row = scene.boxes[r].row
        found = scene.returns(&scene.boxes[r], MANY)
        points[row] = found.certain
        if not found.open:
            continue
        # Of two boxes at the same distance, the one in the lower row has the beam. All others are out of the way.
        rows = sorted([row, *[scene.boxes[scene.near_boxes[k]].row for k in range(scene.n_near_boxes)]])
        left = None if found.open > OPEN_BEAMS else tuple(beams[:found.open] for beams in scene.open_beams)
        boxes = position[rows], size[rows], yaw[rows]
        there = reference(lidar, sensor_position, sensor_rotation, *boxes, walls, -1, left)[rows.index(row)]
        points[row] = there if left is None else found.certain + there
    return points
