# cython: language_level=3, cdivision=True
"""Kernels for the rays of sensors: free space, and the boxes that rays reach or pass. The NumPy references document them."""

cimport numpy as np
from libc.math cimport INFINITY, NAN, atan2, cos, fabs, fmax, fmin, fmod, sin, sqrt

from mast_zenoh.kernels.arrays cimport (
    byte_data, contiguous, empty_matrix, empty_vector, float_data, int_data, length, writable_data, zero_vector,
)
from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double PI = 3.141592653589793
cdef double[3] ACROSS = [-1.0, 0.0, 1.0]
cdef double[5] AROUND = [-1.0, -0.5, 0.0, 0.5, 1.0]
cdef double[2] UP = [-0.3, 0.4]


cdef class View:
    """A view with its arrays, as C values."""
    cdef object arrays
    cdef const double* origin
    cdef const double* R
    cdef const double* cell
    cdef Py_ssize_t bands, sectors
    cdef double low, width, down, up, max_range, age_s

    def __cinit__(self, view, free, double age_s):
        position, rotation, free = contiguous(view.position), contiguous(view.rotation), contiguous(free)
        self.arrays = position, rotation, free
        self.origin, self.R, self.cell = float_data(position, 1), float_data(rotation, 2), float_data(free, 2)
        self.bands, self.sectors = length(free), length(free, 1)
        self.low, self.width = view.azimuth_min, view.azimuth_max - view.azimuth_min
        self.down, self.up, self.max_range = view.elevation_min, view.elevation_max, view.max_range
        self.age_s = age_s

    cdef inline bint ray(self, double x, double y, double z, double* distance, double* free) noexcept:
        """Whether a point is in the field of view; its distance and the free distance in its direction."""
        cdef const double* R = self.R
        cdef double u, v, w, ground, elevation, turned
        cdef Py_ssize_t band, sector
        cdef bint inside
        x, y, z = x - self.origin[0], y - self.origin[1], z - self.origin[2]
        u = x * R[0] + y * R[3] + z * R[6]
        v = x * R[1] + y * R[4] + z * R[7]
        w = x * R[2] + y * R[5] + z * R[8]
        ground = sqrt(u * u + v * v)
        distance[0], free[0] = sqrt(ground * ground + w * w), NAN
        if not distance[0] <= self.max_range:
            return False
        elevation = atan2(w, ground)
        turned = fmod(atan2(v, u) - self.low, 2 * PI)
        if turned < 0.0:
            turned += 2 * PI
        inside = self.down <= elevation <= self.up and turned <= self.width
        if inside and self.bands > 0 and self.sectors > 0:
            band = <Py_ssize_t>((elevation - self.down) * (self.bands / (self.up - self.down)))
            sector = <Py_ssize_t>(turned * (self.sectors / self.width))
            band, sector = min(band, self.bands - 1), min(sector, self.sectors - 1)
            free[0] = self.cell[band * self.sectors + sector]
        return inside

    cdef inline double away(self, double x, double y) noexcept:
        """m, on the ground."""
        x, y = x - self.origin[0], y - self.origin[1]
        return sqrt(x * x + y * y)


cdef list views_of(views):
    return [None if view is None else View(view.view, view.free, view.age_s) for view in views]


def free_ranges(points, view, free):
    cdef View seen = View(view, free, 0.0)
    points = contiguous(points)
    cdef const double* point = float_data(points, 2)
    cdef Py_ssize_t r, n = length(points)
    result, swept, within = empty_vector(np.NPY_DOUBLE, n), empty_vector(np.NPY_DOUBLE, n), empty_vector(np.NPY_BOOL, n)
    cdef double* distance = writable_data(result, 1)
    cdef double* free_distance = writable_data(swept, 1)
    cdef np.uint8_t* inside = byte_data(within)
    for r in range(n):
        inside[r] = seen.ray(point[0], point[1], point[2], &distance[r], &free_distance[r])
        point += 3
    return result, swept, within


cdef struct Box:
    double x, y, z, cos, sin, length, width, height  # half lengths and half widths with their margin


cdef inline Box box_at(const double* at, const double* size, double yaw, double margin) noexcept:
    cdef Box box
    box.x, box.y, box.z, box.cos, box.sin = at[0], at[1], at[2], cos(yaw), sin(yaw)
    box.length, box.width = fmax(0.5 * size[0] + margin, 0.0), fmax(0.5 * size[1] + margin, 0.0)
    box.height = 0.5 * size[2]
    return box


cdef inline bint point_ray(View view, Box box, double i, double j, double k, double* distance, double* free) noexcept:
    """As `View.ray`, for a point of a box in half lengths, half widths and half heights."""
    cdef double along = box.length * i, across = box.width * j
    return view.ray(
        box.x + (along * box.cos - across * box.sin), box.y + (along * box.sin + across * box.cos), box.z + box.height * k,
        distance, free,
    )


cdef bint reaches(View view, Box box, double before, double share) noexcept:
    """Whether rays reach at least a share of the points of a box."""
    cdef Py_ssize_t i, j, k, reached = 0, rest = 18
    cdef double distance, free
    for i in range(3):
        for j in range(3):
            for k in range(2):
                reached += point_ray(view, box, ACROSS[i], ACROSS[j], UP[k], &distance, &free) and not free < distance - before
                rest -= 1
                if reached / 18.0 >= share:
                    return True
                if (reached + rest) / 18.0 < share:
                    return False
    return False


cdef bint passes(View view, Box box, double behind) noexcept:
    """Whether rays pass all points of a box that are in the field of view."""
    cdef Py_ssize_t i, j, k
    cdef double distance, free
    cdef bint inside, some = False
    for i in range(3):
        for j in range(3):
            for k in range(2):
                inside = point_ray(view, box, ACROSS[i], ACROSS[j], UP[k], &distance, &free)
                if free > distance + behind:
                    some = True
                elif inside:
                    return False
    return some


cdef bint passes_most(View view, Box box, double behind, double needed) noexcept:
    """Whether rays pass more than a share of the points around a box."""
    cdef Py_ssize_t i, j, k, passed = 0, rest = 50
    cdef double distance, free
    for i in range(5):
        for j in range(5):
            for k in range(2):
                point_ray(view, box, AROUND[i], AROUND[j], UP[k], &distance, &free)
                passed += free > distance + behind
                rest -= 1
                if passed / 50.0 > needed:
                    return True
                if not (passed + rest) / 50.0 > needed:
                    return False
    return False


cdef bint in_field(View view, Box box) noexcept:
    """Whether a point of a box is in the field of view."""
    cdef Py_ssize_t i, j, k
    cdef double distance, free
    for i in range(3):
        for j in range(3):
            for k in range(2):
                if point_ray(view, box, ACROSS[i], ACROSS[j], UP[k], &distance, &free):
                    return True
    return False


def box_visibility(position, size, yaw, error_m, views, only, tolerances):
    position, size, yaw = contiguous(position), contiguous(size), contiguous(yaw)
    cdef const double* at = float_data(position, 2)
    cdef const double* extent = float_data(size, 2)
    cdef const double* heading = float_data(yaw, 1)
    cdef const double* error = float_data(error_m, 1)
    cdef const np.int64_t* number = NULL if only is None else int_data(only)
    cdef double inside = tolerances.inside_m, outside = tolerances.outside_m, behind = tolerances.behind_m
    cdef double before = tolerances.before_m, own = tolerances.own_m, far = tolerances.far_m
    cdef double share = tolerances.in_view, max_age = tolerances.max_age_s, away
    cdef list looking = views_of(views)
    cdef Py_ssize_t r, column, c = length(position), n = len(looking), a = n if only is None else 1
    cdef View view
    visible, through, distances = zero_vector(np.NPY_BOOL, c * a), zero_vector(np.NPY_BOOL, c * a), empty_matrix(c, a)
    cdef np.uint8_t* in_view = byte_data(visible)
    cdef np.uint8_t* swept = byte_data(through)
    cdef double* distance = writable_data(distances, 2)
    for r in range(c):
        for column in range(a):
            distance[column] = INFINITY
            view = looking[column if number == NULL else number[r]]
            if view is None or fabs(view.age_s) > max_age:
                continue
            distance[column] = away = view.away(at[0], at[1])
            if away > own:
                in_view[column] = reaches(view, box_at(at, extent, heading[r], -inside), before, share)
                if in_view[column] and away <= far:
                    swept[column] = passes(view, box_at(at, extent, heading[r], outside + error[r]), behind)
        at, extent, in_view, swept, distance = at + 3, extent + 3, in_view + a, swept + a, distance + a
    return visible.reshape(c, a), through.reshape(c, a), distances


def ray_evidence(position, velocity, size, yaw, views, only, tolerances):
    position, velocity, size, yaw = contiguous(position), contiguous(velocity), contiguous(size), contiguous(yaw)
    cdef const double* at = float_data(position, 2)
    cdef const double* speed = float_data(velocity, 2)
    cdef const double* extent = float_data(size, 2)
    cdef const double* heading = float_data(yaw, 1)
    cdef const np.int64_t* number = NULL if only is None else int_data(only)
    cdef double outside = tolerances.outside_m, behind = tolerances.behind_m, before = tolerances.before_m
    cdef double own = tolerances.own_m, far = tolerances.far_m, away, half, needed, range_m, free
    cdef list looking = views_of(views)
    cdef Py_ssize_t r, column, k, c = length(position), n = len(looking), a = n if only is None else 1
    cdef View view
    cdef double[3] moved
    seen_through, ending = zero_vector(np.NPY_BOOL, c * a), zero_vector(np.NPY_BOOL, c * a)
    cdef np.uint8_t* through = byte_data(seen_through)
    cdef np.uint8_t* ends = byte_data(ending)
    for r in range(c):
        half = 0.5 * fmin(extent[0], extent[1])
        needed = 1.0 - 0.5 * half / (half + outside)
        half = 0.5 * sqrt(extent[0] * extent[0] + extent[1] * extent[1])
        for column in range(a):
            view = looking[column if number == NULL else number[r]]
            if view is None or view.bands == 0 or view.sectors == 0:
                continue
            for k in range(3):
                moved[k] = at[k] - speed[k] * view.age_s
            away = view.away(moved[0], moved[1])
            if away > own and away <= far:
                through[column] = passes_most(view, box_at(moved, extent, heading[r], outside), behind, needed)
            view.ray(at[0], at[1], at[2], &range_m, &free)
            ends[column] = free >= range_m - half - before and free <= range_m + half + behind
        at, speed, extent, through, ends = at + 3, speed + 3, extent + 3, through + a, ends + a
    return seen_through.reshape(c, a), ending.reshape(c, a)


def outside_view(position, size, yaw, margin_m, views, only, tolerances):
    position, size, yaw = contiguous(position), contiguous(size), contiguous(yaw)
    cdef const double* at = float_data(position, 2)
    cdef const double* extent = float_data(size, 2)
    cdef const double* heading = float_data(yaw, 1)
    cdef const double* margin = float_data(margin_m, 1)
    cdef const np.int64_t* number = int_data(only)
    cdef double own = tolerances.own_m
    cdef list looking = views_of(views)
    cdef Py_ssize_t r, c = length(position)
    cdef View view
    result = zero_vector(np.NPY_BOOL, c)
    cdef np.uint8_t* outside = byte_data(result)
    for r in range(c):
        view = looking[number[r]]
        if view is not None and view.away(at[0], at[1]) > own:
            outside[r] = not in_field(view, box_at(at, extent, heading[r], margin[r]))
        at, extent = at + 3, extent + 3
    return result


def passed_beside(position, size, yaw, views, tolerances):
    position, size, yaw = contiguous(position), contiguous(size), contiguous(yaw)
    cdef const double* at = float_data(position, 2)
    cdef const double* extent = float_data(size, 2)
    cdef const double* heading = float_data(yaw, 1)
    cdef double own = tolerances.own_m, beside = tolerances.beside_m, needed = tolerances.beside_share
    cdef list looking = views_of(views)
    cdef Py_ssize_t r, column, c = length(position), a = len(looking)
    cdef View view
    result = zero_vector(np.NPY_BOOL, c * a)
    cdef np.uint8_t* passed = byte_data(result)
    for r in range(c):
        for column in range(a):
            view = looking[column]
            if view is not None and view.away(at[0], at[1]) > own:
                passed[column] = passes_most(view, box_at(at, extent, heading[r], beside), beside, needed)
        at, extent, passed = at + 3, extent + 3, passed + a
    return result.reshape(c, a)
