"""Cuts polygons at a plane, so that a projection never divides by a depth that is not positive."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats


def clip_polygon(corners: Floats, side: Floats) -> Floats:
    """The part of a polygon on the positive side of a plane (Sutherland and Hodgman, CACM 1974).

    corners: (n, d) in order;  side: (n,) signed distances of the corners from the plane, 0 or more is kept
    Returns (k, d): `corners` itself if nothing is cut off, k = 0 if everything is.
    """
    inside = side >= 0.0
    if inside.all():
        return corners
    following, there = np.roll(corners, -1, axis=0), np.roll(side, -1)
    crosses = inside != (there >= 0.0)
    span = np.where(crosses, side - there, 1.0)  # not 0 where an edge crosses: the signs differ
    cuts = corners + np.where(crosses, side / span, 0.0)[:, None] * (following - corners)
    # Each corner comes before the crossing on the edge that begins in it.
    points = np.stack([corners, cuts], axis=1).reshape(-1, corners.shape[1])
    return np.asarray(points[np.stack([inside, crosses], axis=1).ravel()])
