"""Boxes of objects, and how far their outlines overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints, ascending, row_order


@dataclass(frozen=True, slots=True)
class Boxes:
    """n upright boxes of the truth or of an estimate, to be compared or drawn; never paired between groups.

    group:    (n,) int64, 0 or more: the frame, or a frame of one of several estimates
    id:       (n,) int64, identity of the object or track
    position: (n, 3) m, centre, world frame
    size:     (n, 3) m, length width height
    yaw:      (n,) rad
    """

    group: Ints
    id: Ints
    position: Floats
    size: Floats
    yaw: Floats

    def __len__(self) -> int:
        return len(self.id)

    def select(self, index: NDArray[np.integer] | NDArray[np.bool_] | slice) -> Boxes:
        """The rows selected by a mask, an index array or a slice; slices are views."""
        if isinstance(index, slice):
            return Boxes(*[getattr(self, field.name)[index] for field in fields(self)])
        rows = index.nonzero()[0] if index.dtype == bool else index
        return Boxes(*[getattr(self, field.name).take(rows, 0) for field in fields(self)])

    @classmethod
    def unnamed(cls, position: Floats, size: Floats, yaw: Floats) -> Boxes:
        """Boxes of one group without identity, to be drawn."""
        return cls(np.zeros(len(yaw), np.int64), np.full(len(yaw), -1), position, size, yaw)

    def in_group(self, group: Ints) -> Boxes:
        """The same boxes in other groups (n,)."""
        return replace(self, group=group)

    @classmethod
    def join(cls, parts: Sequence[Boxes]) -> Boxes:
        """All boxes of `parts`, in order."""
        empty = cls.unnamed(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return cls(*(np.concatenate([getattr(part, field.name) for part in (empty, *parts)]) for field in fields(cls)))

    def sorted(self) -> tuple[Boxes, Ints]:
        """The boxes sorted by group, id and position, and (n,) their original rows.

        Returns the same object if already sorted.
        """
        if ascending(self.id, self.group):
            return self, np.arange(len(self), dtype=np.int64)
        order = row_order(self.id, self.group, ties=lambda: self.position.T[::-1])
        return self.select(order), order


_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
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

    In the frame of the first, it is the area below the sides of the other, as far as they are inside: above its upper
    sides minus above its lower ones, each cut off at the first's sides.
    """
    half_x, half_y = size[:, 0, None] / 2.0, size[:, 1, None] / 2.0
    corner = _rotate(_CORNERS * (other_size[:, None, :2] / 2.0), other_yaw - yaw) + _rotate(offset[:, None, :], -yaw)
    x, y = corner[..., 0], corner[..., 1]
    dx, dy = np.roll(x, -1, axis=1) - x, np.roll(y, -1, axis=1) - y
    begin_x, end_x = np.clip(x, -half_x, half_x), np.clip(x + dx, -half_x, half_x)
    slope = np.divide(dy, dx, out=np.zeros_like(dy), where=dx != 0.0)  # upright sides have no area below them
    begin_y, end_y = y + (begin_x - x) * slope, y + (end_x - x) * slope
    low, high = np.clip(begin_y, -half_y, half_y), np.clip(end_y, -half_y, half_y)
    # A side is inside for a part of its way, and on the edge for the others.
    inside = np.divide(high - low, end_y - begin_y, out=np.zeros_like(dy), where=end_y != begin_y)
    mean_y = (low + high) / 2.0
    mean_y += inside * ((begin_y + end_y) / 2.0 - mean_y)
    return np.asarray(np.abs(((end_x - begin_x) * mean_y).sum(axis=1)))


def corners(size: Floats, yaw: Floats) -> Floats:
    """(n, 4, 2) m: corners of rectangles from their centres. size: (n, >= 2) m; yaw: (n,) rad"""
    return _rotate(_CORNERS * (size[:, None, :2] / 2.0), yaw)


def _rotate(points: Floats, angle: Floats) -> Floats:
    """Points (n, k, 2) rotated by angles (n,)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack([c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1]], axis=-1)
