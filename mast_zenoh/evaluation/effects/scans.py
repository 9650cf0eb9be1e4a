"""Compares the points of scans before and after an interposer, beam by beam: which objects they made or hid."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.matching import connected_groups
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.messages.schemas import Body
from mast_zenoh.sensing.points import Points

#: The type of messages with scans.
POINTS = "points"
#: m: a beam whose returns before and after the interposer are nearer than this still meets the same object.
SAME_RETURN_M = 0.3
#: m, side of cells; connected ones are an object.
CELL_M = 0.8
#: Least points of an object, and m, least height: fewer or flatter ones make no detection.
LEAST_POINTS, LEAST_HEIGHT_M = 5, 0.25


def changed_points(before: Points, after: Points) -> tuple[Bools, Bools]:
    """Which points of a scan were removed (n,), and which were inserted (m,); one that was moved is both."""
    keys = before.keys(), after.keys()
    if not all(len(np.unique(each)) == len(each) for each in keys):  # recorded ones may not say their beams
        return ~_among(before.position, after.position), ~_among(after.position, before.position)
    _, i, j = np.intersect1d(*keys, assume_unique=True, return_indices=True)
    removed, inserted = np.ones(len(before), bool), np.ones(len(after), bool)
    same = np.linalg.norm(before.position[i] - after.position[j], axis=1) < SAME_RETURN_M
    removed[i], inserted[j] = ~same, ~same
    return removed, inserted


def _among(these: np.ndarray, others: np.ndarray) -> Bools:
    """(n,) whether rows (n, 3) are among other rows (m, 3), bit for bit."""
    one, other = (np.ascontiguousarray(rows).view("V12").reshape(-1) for rows in (these, others))
    return np.asarray(np.isin(one, other))


def objects_of(points: Points, level: Floats) -> Iterator[tuple[Floats, int]]:
    """Yield (position (3,) m, number of points) of each object that points make, in the frame of the lidar.

    level: (3, 3) active, to a frame with z up
    """
    upright = points.position.astype(np.float64) @ level.T
    for rows in _components(upright):
        if len(rows) >= LEAST_POINTS and np.ptp(upright[rows, 2]) >= LEAST_HEIGHT_M:
            yield level.T @ _middle(upright[rows]), len(rows)


def _components(position: Floats) -> Iterator[Ints]:
    """Yield the rows of each connected group of points (n, 3), of which neighbours share a cell or a side or corner."""
    from scipy.spatial import cKDTree  # slow to load

    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    cells, of_point = np.unique(cell, axis=0, return_inverse=True)
    i, j = cKDTree(cells).query_pairs(1.5, output_type="ndarray").astype(np.int64).T
    label = connected_groups(len(cells), i, j)[of_point.reshape(-1)]
    order = np.argsort(label, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(order) else ()


def _middle(position: Floats) -> Floats:
    """(3,) m, the middle of the box around points (n, 3)."""
    return np.asarray((position.min(axis=0) + position.max(axis=0)) / 2.0)


def compared(before: Body, after: Body) -> tuple[list[tuple[Floats, int]], list[tuple[Floats, int]]]:
    """The objects that a scan has lost, and those that it has gained: (position (3,) m, points) each.

    before, after: columns of `points` messages; in the frame of the lidar
    """
    scans = Points.from_columns(before), Points.from_columns(after)
    changed = changed_points(*scans)
    removed, inserted = (
        list(objects_of(scan.select(rows), rotation_from_quaternion(body["level_rotation"])))
        for scan, rows, body in zip(scans, changed, (before, after), strict=True)
    )
    return removed, inserted
