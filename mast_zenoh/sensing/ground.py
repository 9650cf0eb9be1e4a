"""The ground in a scan: its height in cells of a grid, and the cell of each point.

Coordinates are rounded to whole millimetres, so sums and comparisons are exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.points import Singles

#: Whole millimetres.
Millimetres = NDArray[np.int32]

#: m, largest x and y of points that are used; m a metre, how steep the ground may be against a plane; m above the
#: ground: lower points are part of it.
REACH_M, SLOPE, CLEARANCE_M = 100.0, 0.06, 0.25
#: mm: a cell without points; farthest from the height of the lidar; side of the cells, each of level ground.
_NONE, _DEPTH, _CELL = 1 << 30, 50_000, 2000
#: mm: a point that is lower than its neighbours by more is not of the ground.
_PIT = 100
#: mm a mm, how fast the ground may rise over cells without points.
_UNSEEN_SLOPE = 0.01
#: Keeps a plane level where points are few: m², added to the sums of the squares of their x and y.
_STIFF = np.diag([0.0, 1e3, 1e3])


class GroundGrid(NamedTuple):
    """The ground around a lidar: z (g, g) mm of cells, x first, and mm from the lidar to the ends of the grid."""

    z_mm: Millimetres
    reach_mm: int

    def height_of(self, position: Floats) -> Floats:
        """(n,) m, of positions (n, 3) m above it; infinite beyond its ends, and without any points."""
        cell = np.floor((position[:, :2] * 1000.0 + self.reach_mm) / _CELL).astype(np.int64)
        inside = ((cell >= 0) & (cell < len(self.z_mm))).all(axis=1)
        row, column = np.where(inside, cell.T, 0)
        z_mm = self.z_mm[row, column]
        return np.where(inside & (z_mm < _NONE // 2), position[:, 2] - z_mm / 1000.0, np.inf)


def points_and_ground(
    position: Singles, reach_m: float = REACH_M, slope: float = SLOPE
) -> tuple[Millimetres, GroundGrid]:
    """Points (m, 4) of a scan, x y z mm and cell, and the ground below them.

    position: (n, 3) m, z up; left out are those that are farther than `reach_m` in x or y, or are not numbers
    slope:    m a metre, how steep the ground may be against a plane
    """
    reach = int(np.ceil(reach_m * 1000 / _CELL)) * _CELL
    points, lowest = lowest_by_cell(np.asarray(position, np.float32), reach, _DEPTH, _CELL)
    plane, steps = _plane(lowest), (int(slope * _CELL), int(_UNSEEN_SLOPE * _CELL))
    return points, GroundGrid(ground_surface(_without_echoes(lowest, plane, slope), plane, *steps, _PIT), reach)


def _without_echoes(lowest: Millimetres, plane: Millimetres, slope: float) -> Millimetres:
    """(g, g) mm, `lowest` without returns from below the road, which real scans have by way of glass and wet surfaces.

    Such a return is lower than the steepest ground could be (dropped), or lower than the median of the cells around by
    more than `_PIT` (replaced by that).
    """
    row, column = np.nonzero(lowest < plane - _PIT)
    if not len(row):
        return lowest
    away = np.hypot(row - len(lowest) / 2.0, column - len(lowest) / 2.0) * _CELL
    deep = (lowest - plane)[row, column] < -2.0 * _PIT - slope * away
    cleaned = np.where(lowest == _NONE, _NONE, lowest - plane)
    cleaned[row[deep], column[deep]] = _NONE
    row, column = row[~deep], column[~deep]
    padded = np.pad(cleaned, 2, constant_values=_NONE)
    around = np.sort([padded[row + i, column + j] for i in range(5) for j in range(5)], axis=0)
    half = around[(around < _NONE).sum(axis=0) // 2, np.arange(len(row))]
    cleaned[row, column] = np.where(cleaned[row, column] < half - _PIT, half, cleaned[row, column])
    return np.asarray(np.where(cleaned == _NONE, _NONE, cleaned + plane), np.int32)


@kernel
def lowest_by_cell(position: Singles, reach_mm: int, depth_mm: int, cell_mm: int) -> tuple[Millimetres, Millimetres]:
    """Points (m, 4), x y z mm and cell, within reach of the lidar, and the lowest z (g, g) mm of each cell, x first.

    position: (n, 3) m, of which some may not be numbers
    reach_mm: largest x and y, depth_mm: largest z, of either sign
    """
    scaled, limit = position.astype(np.float64) * 1000.0, max(reach_mm, depth_mm)
    whole = (np.where(np.abs(scaled) < limit, scaled, limit) + limit + 0.5).astype(np.int32) - limit
    whole = whole[(np.abs(whole) < (reach_mm, reach_mm, depth_mm)).all(axis=1)]
    side = 2 * reach_mm // cell_mm
    cell = (whole[:, :2] + reach_mm) // cell_mm @ np.array([side, 1], np.int32)
    lowest = np.full((side, side), _NONE, np.int32)
    np.minimum.at(lowest.reshape(-1), cell, whole[:, 2])
    return np.column_stack([whole, cell]), lowest


@kernel
def ground_surface(lowest: Millimetres, plane: Millimetres, step_mm: int, unseen_mm: int, pit_mm: int) -> Millimetres:
    """(g, h) mm, the highest surface below the `lowest` points that is not steep, measured from a `plane` (g, h).

    From a cell to the next it rises by at most `step_mm`, to one without points by `unseen_mm`, to one across a corner
    by 1.4 times as much. A lowest point that is lower than those around it by more than `pit_mm` is raised to that.
    """
    seen = lowest != _NONE
    g, h = lowest.shape

    def around(height: Millimetres) -> list[Millimetres]:
        padded = np.pad(height, 1, constant_values=_NONE)
        return [padded[i : i + g, j : j + h] for i in range(3) for j in range(3) if (i, j) != (1, 1)]

    height = np.where(seen, lowest - plane, _NONE)
    lower = np.minimum.reduce(around(height))
    height = np.where(seen & (lower != _NONE), np.maximum(height, lower - pit_mm), height)
    step = np.where(seen, step_mm, unseen_mm)
    across = step + step * 2 // 5
    while True:
        beside = around(height)
        rises = (across, step, across, step, step, across, step, across)
        surface = np.minimum.reduce([height, *(each + rise for each, rise in zip(beside, rises, strict=True))])
        if np.array_equal(surface, height):
            return np.asarray(surface + plane, np.int32)
        height = surface


def _plane(lowest: Millimetres) -> Millimetres:
    """(g, g) mm, the plane through most of the lowest points near the lidar, all below it."""
    middle = 2.0 * np.arange(len(lowest)) - (len(lowest) - 1.0)  # halves of cells: with mm, all sums are exact
    cells = np.flatnonzero(lowest < 0)
    if not len(cells):
        return np.zeros_like(lowest)
    z, x, y = lowest.ravel()[cells].astype(np.float64), middle[cells // len(lowest)], middle[cells % len(lowest)]
    square = x * x + y * y
    few = min(30, len(z) - 1)
    near = square <= max(4.0 * float(np.partition(square, few)[few]), 30.0**2)
    columns, z = np.stack([np.ones_like(x), x, y], axis=1)[near], z[near]
    solution = np.array([np.partition(z, len(z) // 3)[len(z) // 3], 0.0, 0.0])
    for band in (1000.0, 600.0, 350.0, 200.0):
        error = z - columns @ solution
        close = (error < band) & (error > -3.0 * band)
        rows = columns[close]
        if len(rows) >= 6:
            solution = np.linalg.solve(rows.T @ rows + _STIFF, rows.T @ z[close])
    plane = solution[0] + solution[1] * middle[:, None] + solution[2] * middle
    return np.asarray(np.rint(plane), np.int32)
