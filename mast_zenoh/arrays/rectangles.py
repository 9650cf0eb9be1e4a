"""Rectangles seen from above: how far two of them overlap."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats

_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
#: m, tolerance for corners on a side, so that coinciding boxes overlap fully.
_TOLERANCE = 1e-9
#: m2; rectangles with a smaller intersection only touch.
_TOUCH_M2 = 1e-6


def overlapping(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats) -> Bools:
    """(n,) whether rectangles and others overlap, and not only touch. Parameters as for `intersection_area`."""
    reach = 0.5 * (np.hypot(size[:, 0], size[:, 1]) + np.hypot(other_size[:, 0], other_size[:, 1]))
    overlaps = np.hypot(offset[:, 0], offset[:, 1]) <= reach
    rows = np.flatnonzero(overlaps)
    if len(rows):  # usually, none is near
        parts = (part[rows] for part in (offset, size, yaw, other_size, other_yaw))
        overlaps[rows] = intersection_area(*parts) > _TOUCH_M2
    return overlaps


def intersection_area(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats) -> Floats:
    """(n,) m^2: intersection area of rectangles and others at `offset`.

    offset: (n, 2) m, from the centre of each to that of the other; size, other_size: (n, >= 2) m, length and width
    yaw, other_yaw: (n,) rad

    The intersection is convex; its corners are corners of one rectangle inside the other and crossings of sides. They
    are computed in the frame of the first and sorted by angle about their centroid.
    """
    half, half_other = size[:, None, :2] / 2.0, other_size[:, None, :2] / 2.0
    centre = _rotate(offset[:, None, :], -yaw)
    turn = other_yaw - yaw
    corners = _CORNERS * half
    other_corners = _rotate(_CORNERS * half_other, turn) + centre
    crossings, crossed = _crossings(other_corners, half)
    points = np.concatenate([other_corners, corners, crossings], axis=1)
    valid = np.concatenate(
        [_inside(other_corners, half), _inside(_rotate(corners - centre, -turn), half_other), crossed], axis=1
    )
    return _convex_area(points, valid)


def corners(size: Floats, yaw: Floats) -> Floats:
    """(n, 4, 2) m: corners of rectangles from their centres. size: (n, >= 2) m; yaw: (n,) rad"""
    return _rotate(_CORNERS * (size[:, None, :2] / 2.0), yaw)


def _rotate(points: Floats, angle: Floats) -> Floats:
    """Points (n, k, 2) rotated by angles (n,)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack([c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1]], axis=-1)


def _inside(points: Floats, half: Floats) -> Bools:
    return np.asarray(np.all(np.abs(points) <= half + _TOLERANCE, axis=-1))


def _crossings(corners: Floats, half: Floats) -> tuple[Floats, Bools]:
    """Crossings (n, 16, 2) of outlines (n, 4, 2) with boxes, and their validity.

    half: (n, 1, 2), half sizes of the boxes
    """
    along = np.roll(corners, -1, axis=1) - corners
    points, valid = [], []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (sign * half[..., axis] - corners[..., axis]) / along[..., axis]
            point = corners + t[..., None] * along
            other = np.abs(point[..., 1 - axis]) <= half[..., 1 - axis]
        valid.append((t >= 0.0) & (t <= 1.0) & other)
        points.append(point)
    return np.concatenate(points, axis=1), np.concatenate(valid, axis=1)


def _convex_area(points: Floats, valid: Bools) -> Floats:
    """Areas (n,) of the convex outlines of the valid points; 0 without any.

    points: (n, k, 2)
    """
    nonempty = valid.any(axis=1)
    points = np.where(valid[..., None], points, 0.0)
    centroid = points.sum(axis=1) / np.maximum(valid.sum(axis=1), 1)[:, None]
    offset = points - centroid[:, None, :]
    angle = np.where(valid, np.arctan2(offset[..., 1], offset[..., 0]), np.inf)
    order = np.argsort(angle, axis=1)
    ring = np.take_along_axis(offset, order[..., None], axis=1)
    # Invalid points repeat the first corner: sides of zero length add no area.
    ring = np.where(np.take_along_axis(valid, order, axis=1)[..., None], ring, ring[:, :1])
    next_corner = np.roll(ring, -1, axis=1)
    area = np.sum(ring[..., 0] * next_corner[..., 1] - ring[..., 1] * next_corner[..., 0], axis=1) / 2.0
    return np.where(nonempty, np.abs(area), 0.0)
