"""Forges a view so that it agrees with the lies about objects.

Where an object is hidden, the view claims free space; where one is invented, it claims that something returns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.arrays.states import Bools, ObjectStates, concatenate
from mast_zenoh.attacks.targets import Tampering
from mast_zenoh.integrity.views import SweptView

#: m by which a hidden object is larger than its box, so that its edges are free, too; and by which space is claimed
#: free behind it.
MARGIN_M, BEHIND_M = 0.8, 3.0
#: m; something that returns this far before an object is another object.
BEFORE_M = 2.0
#: m; a smaller displacement leaves an object in its place.
SAME_PLACE_M = 0.5
#: m; nearer to the sensor than this, an object covers no definite directions.
NEAREST_M = 0.5


class ViewForger:
    """Remembers the lies of the newest frame, and forges the view of that frame."""

    def __init__(self) -> None:
        self._frame = -1
        self._lies: list[tuple[ObjectStates, Tampering]] = []

    def remember(self, frame: int, objects: ObjectStates, tampering: Tampering) -> None:
        """Add the lies about the n objects of one message of a frame."""
        if frame != self._frame:
            self._frame, self._lies = frame, []
        self._lies.append((objects, tampering))

    def forge(self, frame: int, swept: SweptView) -> SweptView:
        """The view with the lies of a frame; unchanged for a frame without any."""
        if frame != self._frame:
            return swept
        hidden, invented = [], []
        for objects, tampering in self._lies:
            before, after = objects.select(tampering.moved_index), tampering.moved
            if len(after):
                displaced = np.hypot(*(after.position - before.position)[:, :2].T) > SAME_PLACE_M
                before, after = before.select(displaced), after.select(displaced)
            hidden += [objects.select(~tampering.keep), before]
            invented += [tampering.added, after]
        return blocked(opened(swept, concatenate(hidden)), concatenate(invented))


def opened(swept: SweptView, boxes: ObjectStates) -> SweptView:
    """The view with free space through k boxes, as far as it is free beside them.

    A direction in which something returns before a box stays as it is.
    """
    free = swept.free
    for cells, sectors, near, far in _directions(swept, boxes, MARGIN_M):
        beside = np.flatnonzero(_neighbours(sectors, swept))
        behind = np.full(len(free), far + BEHIND_M)
        if len(beside):
            behind = np.maximum(behind, free[:, beside].max(axis=1))
        behind = np.minimum(behind, swept.view.max_range)[:, None]
        changed = cells & (free > near - BEFORE_M)
        free = np.where(changed, np.maximum(free, behind), free)
    return swept if free is swept.free else replace(swept, free=free)


def blocked(swept: SweptView, boxes: ObjectStates) -> SweptView:
    """The view with returns from k boxes: nothing behind their nearest points is free."""
    free = swept.free
    for cells, _, near, _ in _directions(swept, boxes, 0.0):
        free = np.where(cells, np.minimum(free, near), free)
    return swept if free is swept.free else replace(swept, free=free)


def _directions(swept: SweptView, boxes: ObjectStates, margin_m: float) -> Iterator[tuple[Bools, Bools, float, float]]:
    """Of each box in view: its cells (bands, sectors), its sectors (sectors,), and its range from and to, m.

    The cells are those between the outermost directions of its corners. margin_m: by which boxes are larger
    """
    if swept.free.size == 0 or len(boxes) == 0:
        return
    view, (bands, sectors) = swept.view, swept.free.shape
    width, height = view.azimuth_max - view.azimuth_min, view.elevation_max - view.elevation_min
    full = width > 2 * np.pi - 1e-6
    with np.errstate(over="ignore", invalid="ignore"):
        corners = box_corners(boxes.position, boxes.size + 2.0 * margin_m, boxes.yaw)
        points = np.concatenate([boxes.position[:, None], corners], axis=1)
        x, y, z = np.moveaxis((points - view.position) @ view.rotation, -1, 0)
        ground = np.hypot(x, y)
        distance = np.hypot(ground, z)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, ground)
        turn = (azimuth - azimuth[:, :1] + np.pi) % (2 * np.pi) - np.pi  # from the centre of the box
        centre = (azimuth[:, 0] - view.azimuth_min) % (2 * np.pi)
        centre -= np.where(centre > np.pi + 0.5 * width, 2 * np.pi, 0.0)
        limits = np.stack(
            [
                np.floor((centre + turn.min(axis=1)) * (sectors / width)),
                np.floor((centre + turn.max(axis=1)) * (sectors / width)),
                np.floor((elevation.min(axis=1) - view.elevation_min) * (bands / height)),
                np.floor((elevation.max(axis=1) - view.elevation_min) * (bands / height)),
            ],
            axis=1,
        )
    sector, band = np.arange(sectors), np.arange(bands)
    for row in range(len(boxes)):
        near, far = float(distance[row].min()), float(distance[row].max())
        if not (np.isfinite(limits[row]).all() and np.isfinite(far) and NEAREST_M < near <= view.max_range):
            continue
        first, last, low, high = limits[row].tolist()
        of_sectors = (sector - first) % sectors <= last - first if full else (sector >= first) & (sector <= last)
        of_bands = (band >= low) & (band <= high)
        if of_sectors.any() and of_bands.any():
            yield of_bands[:, None] & of_sectors, of_sectors, near, far


def _neighbours(of_box: Bools, swept: SweptView) -> Bools:
    """The sectors (sectors,) next to those of a box."""
    view = swept.view
    left, right = np.roll(of_box, 1), np.roll(of_box, -1)
    if view.azimuth_max - view.azimuth_min <= 2 * np.pi - 1e-6:
        left[0], right[-1] = False, False
    return (left | right) & ~of_box
