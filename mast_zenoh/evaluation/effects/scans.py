"""Compares the points of scans before and after an interposer, beam by beam: which objects they made or hid."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.matching import connected_groups
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.messages.schemas import Body
from mast_zenoh.sensing.ground import CLEARANCE_M, GroundGrid, points_and_ground
from mast_zenoh.sensing.points import Points

#: The type of messages with scans.
POINTS = "points"
#: m: a beam whose returns before and after the interposer are nearer than this still meets the same object.
SAME_RETURN_M = 0.3
#: m, side of cells; connected ones are an object.
CELL_M = 0.8
#: Least points of an object that stand above the ground: fewer make no detection.
LEAST_POINTS = 5


def changed_points(before: Points, after: Points) -> tuple[Bools, Bools]:
    """Which points of a scan were removed (n,), and which were inserted (m,); one that was moved is both.

    Two returns of a beam are the same if they are near each other. So are two of beams that one scan lacks or has
    twice, as recorded points may not say their beams, and attacks may change them.
    """
    (keys, first), (others, second) = (_single(scan.keys()) for scan in (before, after))
    _, i, j = np.intersect1d(keys, others, assume_unique=True, return_indices=True)
    i, j = first[i], second[j]
    removed, inserted = np.ones(len(before), bool), np.ones(len(after), bool)
    left, right = np.setdiff1d(np.arange(len(before)), i), np.setdiff1d(np.arange(len(after)), j)
    same = np.linalg.norm(before.position[i] - after.position[j], axis=1) < SAME_RETURN_M
    removed[i], inserted[j] = ~same, ~same
    if len(left) and len(right):
        # Each place once: a tree cannot divide points at one place, and would compare each with all others.
        one, i = np.unique(before.position[left], axis=0, return_inverse=True)
        other, j = np.unique(after.position[right], axis=0, return_inverse=True)
        removed[left] = np.isinf(cKDTree(other).query(one, distance_upper_bound=SAME_RETURN_M)[0])[i.reshape(-1)]
        inserted[right] = np.isinf(cKDTree(one).query(other, distance_upper_bound=SAME_RETURN_M)[0])[j.reshape(-1)]
    return removed, inserted


def _single(keys: Ints) -> tuple[Ints, Ints]:
    """Those of keys that occur once, ascending, and their rows."""
    values, first, count = np.unique(keys, return_index=True, return_counts=True)
    return values[count == 1], first[count == 1]


def objects_of(points: Points, level: Floats, ground: GroundGrid) -> Iterator[tuple[Floats, int]]:
    """Yield (position (3,) m, number of points) of each object that points make, in the frame of the lidar.

    level: (3, 3) active, to a frame with z up, in which the ground is
    """
    upright = points.position.astype(np.float64) @ level.T
    standing = ground.height_of(upright) > CLEARANCE_M
    for rows in _components(upright):
        if np.count_nonzero(standing[rows]) >= LEAST_POINTS:
            part = upright[rows]
            yield level.T @ ((part.min(axis=0) + part.max(axis=0)) / 2.0), len(rows)


def _components(position: Floats) -> Iterator[Ints]:
    """Yield the rows of each connected group of points (n, 3), of which neighbours share a cell or a side or corner."""
    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    cells, of_point = np.unique(cell, axis=0, return_inverse=True)
    i, j = cKDTree(cells).query_pairs(1.5, output_type="ndarray").astype(np.int64).T
    label = connected_groups(len(cells), i, j)[of_point.reshape(-1)]
    order = np.argsort(label, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else ()


def compared(before: Body, after: Body) -> list[list[tuple[Floats, int]]]:
    """The objects that a scan has lost, and those that it has gained: (position (3,) m, points) each.

    before, after: columns of `points` messages; in the frame of the lidar
    """
    scans = Points.from_columns(before), Points.from_columns(after)
    levels = [rotation_from_quaternion(body["level_rotation"]) for body in (before, after)]
    _, ground = points_and_ground(scans[0].turned(levels[0]).position)
    changed = zip(scans, changed_points(*scans), levels, strict=True)
    return [list(objects_of(scan.select(rows), level, ground)) for scan, rows, level in changed]
