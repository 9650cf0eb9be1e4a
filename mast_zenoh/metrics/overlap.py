"""Exact overlap of upright, rotated boxes, batched over pairs."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.metrics.boxes import Boxes

_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
#: m, tolerance for corners on a side, so that coinciding boxes overlap fully.
_TOLERANCE = 1e-9


def iou_3d(a: Boxes, b: Boxes) -> Floats:
    """Volume intersection over union (n,), 0 to 1, of box i of `a` and box i of `b`.

    Groups are ignored.
    The intersection is the exact area of the overlap of the rotated rectangles seen from above, times the overlap
    of the heights.
    """
    top = np.minimum(a.position[:, 2] + a.size[:, 2] / 2.0, b.position[:, 2] + b.size[:, 2] / 2.0)
    bottom = np.maximum(a.position[:, 2] - a.size[:, 2] / 2.0, b.position[:, 2] - b.size[:, 2] / 2.0)
    intersection = birdseye_intersection(a, b) * np.maximum(top - bottom, 0.0)
    union = a.size.prod(axis=1) + b.size.prod(axis=1) - intersection
    iou: Floats = np.divide(intersection, union, out=np.zeros(len(a)), where=union > 0.0)
    return iou


def birdseye_intersection(a: Boxes, b: Boxes) -> Floats:
    """(n,) m^2: intersection area of the outlines of box i of `a` and box i of `b`.

    The intersection is convex; its corners are corners of one box inside the other and crossings of sides. They are
    computed in the frame of `a` and sorted by angle about their centroid.
    """
    half_a, half_b = a.size[:, None, :2] / 2.0, b.size[:, None, :2] / 2.0
    centre = _rotate((b.position - a.position)[:, None, :2], -a.yaw)
    turn = b.yaw - a.yaw
    corners_a = _CORNERS * half_a
    corners_b = _rotate(_CORNERS * half_b, turn) + centre
    crossings, crossed = _crossings(corners_b, half_a)
    points = np.concatenate([corners_b, corners_a, crossings], axis=1)
    valid = np.concatenate(
        [_inside(corners_b, half_a), _inside(_rotate(corners_a - centre, -turn), half_b), crossed], axis=1
    )
    return _convex_area(points, valid)


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
