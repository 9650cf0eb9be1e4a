"""A detector of points without training: ground by grid, connected cells, rectangles, classes by size and height.

Coordinates are rounded to whole millimetres, far below a lidar's noise. So sums and comparisons are exact, and neither
the order of the points nor the kernel in use changes a detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Detections, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.point_detector import PointDetector
from mast_zenoh.sensing.points import Points, Singles

#: Whole millimetres.
Millimetres = NDArray[np.int32]

#: mm: no point here; farthest from the height of the lidar; side of the cells in which the ground is even.
_NONE, _DEPTH, _GROUND_CELL = 1 << 30, 50_000, 2000
#: mm: no road user is higher; points above are not looked at; lower than its neighbours, a point is none of the ground.
_TALLEST, _OVERHEAD, _PIT = 4200, 4500, 100
#: mm: what is not higher may be below a bridge, or a tree; what is longer is a wall or a hedge.
_MAY_BE_BELOW, _LONGEST = 2600, 14_000
#: mm a mm, how fast the ground may rise over cells without points.
_UNSEEN_SLOPE = 0.01
#: Tangent of the angle between two channels of common lidars.
_CHANNEL = 0.007
#: Keeps a plane level where few points say otherwise: as many m² of points, unless steep.
_STIFF = np.diag([0.0, 1e3, 1e3])
#: deg, between turns of a rectangle; of them, how many are skipped in a first search.
_TURN_DEG, _COARSE = 1.0, 5
#: mm and cells, of the outline on which rectangles are fitted;  mm, nearer to a side all points count the same.
_OUTLINE, _ACROSS, _NEAR = 100, 200, 50.0


@kernel
def lowest_by_cell(position: Singles, reach_mm: int, depth_mm: int, cell_mm: int) -> tuple[Millimetres, Millimetres]:
    """Points (m, 3) mm within reach of the lidar, and the lowest z (g, g) of each cell, x first.

    position: (n, 3) m, of which some may not be numbers
    reach_mm: largest x and y, depth_mm: largest z, of either sign
    """
    scaled = position.astype(np.float64) * 1000.0
    limit, shift = (reach_mm - 1.0, reach_mm - 1.0, float(depth_mm)), (reach_mm, reach_mm, depth_mm)
    scaled = scaled[(np.abs(scaled) < limit).all(axis=1)]
    whole = (scaled + shift + 0.5).astype(np.int32) - np.array(shift, np.int32)
    side = 2 * reach_mm // cell_mm
    lowest = np.full((side, side), _NONE, np.int32)
    cell = (whole[:, :2] + reach_mm) // cell_mm
    np.minimum.at(lowest, (cell[:, 0], cell[:, 1]), whole[:, 2])
    return whole, lowest


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


@kernel
def connected_cells(
    whole: Millimetres, ground: Millimetres, reach_mm: int, body: tuple[int, int], cell_mm: int, growth_mm: int
) -> tuple[Millimetres, Millimetres, Millimetres]:
    """Components of points, as (n,) numbers, heights, and (c, 8) what is in each.

    Components are numbered by their first cells; -1: on the ground or overhead. Heights are mm above the ground. Cells
    with points are connected if not more than k cells apart, where k is 1 and grows by 1 each `growth_mm` from the
    lidar. Of a component: how many points, least and greatest x and y, the greatest height, how many points are
    overhead, straight above its cells, and of both the greatest z by distance in plan, times 10,000.

    ground: (g, g) mm, z of the ground;  body: mm, heights of points of objects: above, up to
    """
    coarse = (whole[:, :2] + reach_mm) // (2 * reach_mm // len(ground))
    height = whole[:, 2] - ground[coarse[:, 0], coarse[:, 1]]
    label = np.full(len(whole), -1, np.int32)
    rows = np.flatnonzero((height > body[0]) & (height <= body[1]))
    side = 2 * reach_mm // cell_mm + 1
    place = (whole[rows, :2] + reach_mm) // cell_mm
    cells, of_row = np.unique(place[:, 0] * side + place[:, 1], return_inverse=True)
    at = {int(cell): k for k, cell in enumerate(cells)}
    component = np.full(len(cells), -1, np.int64)
    links: list[list[int]] = [[] for _ in cells]
    for k, cell in enumerate(cells):
        i, j = divmod(int(cell), side)
        reach = 1 + max(abs(i * cell_mm - reach_mm), abs(j * cell_mm - reach_mm)) // growth_mm
        for u in range(max(i - reach, 0), min(i + reach, side - 1) + 1):
            for v in range(max(j - reach, 0), min(j + reach, side - 1) + 1):
                other = at.get(u * side + v)
                if other is not None:
                    links[k].append(other)
                    links[other].append(k)
    for k in range(len(cells)):
        if component[k] < 0:
            number, open_cells = component.max(initial=-1) + 1, [k]
            component[k] = number
            while open_cells:
                for other in links[open_cells.pop()]:
                    if component[other] < 0:
                        component[other] = number
                        open_cells.append(other)
    label[rows] = component[of_row.ravel()]
    over = np.flatnonzero(height > body[1])
    place = (whole[over, :2] + reach_mm) // cell_mm
    below = [component[at[cell]] if cell in at else -1 for cell in (place[:, 0] * side + place[:, 1]).tolist()]
    of_over = np.array(below, np.int64)
    over, of_over = over[of_over >= 0], of_over[of_over >= 0]
    summary = np.zeros((int(component.max(initial=-1)) + 1, 8), np.int32)
    summary[:, 1::2], summary[:, 2:6:2], summary[:, 5] = _NONE, -_NONE, 0
    for column, (reduce, values) in enumerate(
        (
            (np.add, np.ones(len(whole), np.int32)),
            (np.minimum, whole[:, 0]),
            (np.maximum, whole[:, 0]),
            (np.minimum, whole[:, 1]),
            (np.maximum, whole[:, 1]),
            (np.maximum, height),
        )
    ):
        reduce.at(summary[:, column], label[rows], values[rows])
    np.add.at(summary[:, 6], of_over, 1)
    summary[:, 7] = -_NONE
    for part, numbers in ((rows, label[rows]), (over, of_over)):
        x, y, z = whole[part].astype(np.float64).T
        np.maximum.at(summary[:, 7], numbers, np.floor(1e4 * z / np.sqrt(x * x + y * y + 1.0)).astype(np.int32))
    return label, height.astype(np.int32), summary


@kernel
def rectangle_turns(
    plan: Millimetres, start: Ints, axes: Floats, coarse: int, least_mm: int, across: int, near_mm: float
) -> Ints:
    """(c,) row of `axes` along which a rectangle fits the points of each cluster best.

    The search of Zhang et al. 2017 (Efficient L-shape fitting for vehicle detection using laser scanners, IV,
    algorithm 4, closeness), on the means of the points in the cells of a grid, with all four sides.

    plan: (n, 2) mm, sorted by cluster;  start: (c + 1,) first row of each
    axes: (t, 2) cosine and sine, evenly over a quarter turn; every `coarse`-th first, then those beside the best
    least_mm: side of cells, of which there are at most `across` in a row;  near_mm: nearer to a side counts the same
    """
    turns = len(axes)
    best = np.zeros(len(start) - 1, np.int64)
    for c, (first, end) in enumerate(pairwise(start)):
        at = plan[first:end] - plan[first:end].min(axis=0)
        cell_mm = max(least_mm, int(at.max()) // across + 1)
        cell = at // cell_mm
        _, of_row = np.unique(cell[:, 0] * (across + 1) + cell[:, 1], return_inverse=True)
        count = np.bincount(of_row.ravel())
        x, y = (np.bincount(of_row.ravel(), weights=each) / count for each in at.T)

        def closeness(turn: int, x: Floats = x, y: Floats = y) -> int:
            cosine, sine = axes[turn]
            sides = x * cosine + y * sine, y * cosine - x * sine
            gap = np.minimum(*(np.minimum(side - side.min(), side.max() - side) for side in sides))
            return int((1e6 / np.maximum(gap, near_mm)).astype(np.int64).sum())

        scores = {turn: closeness(turn) for turn in range(0, turns, coarse)}
        middle = max(scores, key=lambda turn: scores[turn])
        order = [middle, *((middle + k) % turns for k in range(1 - coarse, coarse))]
        best[c] = max(order, key=closeness)
    return best


#: (t, 2) cosine and sine of the turns that are tried.
_ANGLES = np.radians(np.arange(0.0, 90.0, _TURN_DEG))
_AXES = np.ascontiguousarray(np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1))


class Clusters(NamedTuple):
    """Points of c clusters, one cluster after the other.

    whole: (n, 3) mm, height: (n,) mm above the ground, start: (c + 1,) first row of each cluster
    """

    whole: Millimetres
    height: Millimetres
    start: Ints

    def of_each(self, reduce: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
        """(c,) of values (n,), the highest or lowest of each cluster."""
        return np.asarray(reduce.reduceat(values, self.start[:-1]))

    def select(self, kept: Bools) -> Clusters:
        """Some of the clusters."""
        count = np.diff(self.start)
        rows = np.repeat(kept, count)
        start = np.concatenate([[0], np.cumsum(count[kept])])
        return Clusters(self.whole[rows], self.height[rows], start)

    def heights(self) -> tuple[Floats, Floats]:
        """(c,) m, of the lowest and of the highest point above the ground."""
        return self.of_each(np.minimum, self.height) / 1000.0, self.of_each(np.maximum, self.height) / 1000.0

    def merged(self, group: Ints) -> Clusters:
        """Clusters of clusters; group: (c,) number of each, from 0."""
        each = np.repeat(group, np.diff(self.start))
        rows = np.argsort(each, kind="stable")
        return Clusters(self.whole[rows], self.height[rows], np.concatenate([[0], np.cumsum(np.bincount(each))]))


class Rectangles(NamedTuple):
    """Rectangles around c clusters in plan. Their first axis is the longer one.

    yaw: (c,) rad;  low, high: (c, 2) m from the lidar along both axes;  axes: (c, 2) cosine and sine of yaw
    upper: (c, 2) m, extent of the points of the upper part, 0 without any
    """

    yaw: Floats
    low: Floats
    high: Floats
    axes: Floats
    upper: Floats


def ground_of(lowest: Millimetres, slope: float) -> Millimetres:
    """(g, g) mm, z of the ground, from the lowest points of cells; `slope`: how steep it may be against a plane."""
    if not (lowest != _NONE).any():
        return np.zeros_like(lowest)
    steps = int(slope * _GROUND_CELL), int(_UNSEEN_SLOPE * _GROUND_CELL)
    return ground_surface(lowest, _plane(lowest), *steps, _PIT)


def _plane(lowest: Millimetres) -> Millimetres:
    """(g, g) mm, the plane through most of the lowest points near the lidar, which is above it."""
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


def grouped(whole: Millimetres, height: Millimetres, label: Millimetres, kept: Bools) -> Clusters:
    """The points of the components that are kept, in the order of their numbers."""
    rows = np.flatnonzero(np.append(kept, False)[label])
    labels = label[rows]
    narrow = labels.astype(np.uint16) if len(kept) <= 1 << 16 else labels  # sorted in linear time
    rows = rows[np.argsort(narrow, kind="stable")]
    count = np.bincount(labels, minlength=len(kept))[kept]
    return Clusters(whole[rows], height[rows], np.concatenate([[0], np.cumsum(count)]))


def may_be_objects(summary: Millimetres, least: int) -> Bools:
    """(c,) whether components, as `connected_cells` describes them, have enough points and are not too large."""
    count, low_x, high_x, low_y, high_y, top, over, _ = summary.T
    tall = (top > _TALLEST) | ((top > _MAY_BE_BELOW) & (over > 0))
    diagonal = np.hypot((high_x - low_x).astype(np.float64), (high_y - low_y).astype(np.float64))
    return np.asarray((count >= least) & ~tall & (diagonal < _LONGEST))


def rectangles(clusters: Clusters) -> Rectangles:
    """Rectangles around the points of clusters."""
    plan = np.ascontiguousarray(clusters.whole[:, :2])
    turn = rectangle_turns(plan, clusters.start, _AXES, _COARSE, _OUTLINE, _ACROSS, _NEAR)
    each = np.repeat(_AXES[turn], np.diff(clusters.start), axis=0)
    x, y = plan.T / 1000.0
    sides = x * each[:, 0] + y * each[:, 1], y * each[:, 0] - x * each[:, 1]
    low = np.stack([clusters.of_each(np.minimum, side) for side in sides], axis=1)
    high = np.stack([clusters.of_each(np.maximum, side) for side in sides], axis=1)
    top = clusters.of_each(np.maximum, clusters.height)
    upper = clusters.height > np.repeat(0.75 * top, np.diff(clusters.start))
    ends = [
        clusters.of_each(reduce, np.where(upper, side, none))
        for side in sides
        for reduce, none in ((np.minimum, np.inf), (np.maximum, -np.inf))
    ]
    across = np.maximum(np.stack([ends[1] - ends[0], ends[3] - ends[2]], axis=1), 0.0)
    swapped = high[:, 1] - low[:, 1] > high[:, 0] - low[:, 0]
    return turned_left(Rectangles(_ANGLES[turn], low, high, _AXES[turn], across), swapped)


#: Classes, and of each, m: the usual length and width, the least height.
_KINDS = {
    "pedestrian": (0.6, 0.6, 1.5),
    "bicycle": (1.8, 0.65, 1.6),
    "motorcycle": (2.1, 0.75, 1.4),
    "car": (4.4, 1.8, 1.4),
    "truck": (7.5, 2.4, 2.6),
    "bus": (11.5, 2.5, 2.9),
}
_CLASS_IDS = np.array([CLASS_INDEX[name] for name in _KINDS], np.uint8)
_USUAL = np.array(list(_KINDS.values()))
#: Share of those with many points that are right.
_RIGHT = np.array([0.88, 0.95, 0.9, 0.98, 0.65, 0.8])
_PEDESTRIAN, _BICYCLE, _MOTORCYCLE, _CAR, _TRUCK, _BUS = range(len(_KINDS))


def kinds_of(box: Rectangles, low: Floats, high: Floats, count: Ints) -> Ints:
    """(c,) row of each cluster in the table of classes, -1: no road user.

    low, high: (c,) m, of the lowest and the highest point above the ground;  count: (c,) points
    """
    length, width = (box.high - box.low).T
    kind = np.full(len(high), _CAR)
    kind[(high > 2.3) | (length > 5.6)] = _TRUCK
    kind[(high > 2.3) & (length > 9.5)] = _BUS
    cycle = (length > 1.0) & (length < 2.4) & (width < 1.0) & (high > 1.2) & (high < 2.2)
    cycle &= box.upper.max(axis=1, initial=0.0) < 0.9
    kind[cycle] = _BICYCLE
    kind[cycle & (length > 2.0)] = _MOTORCYCLE
    small = (length < 1.2) & (width < 1.0)
    kind[small & (high < 2.2)] = _PEDESTRIAN
    none = (small & ((high < 1.1) | (high >= 2.2))) | (low > 1.25) | (high < 0.6) | (width > 3.2)
    none |= (length > 5.6) & (high < 2.2)  # a hedge
    straight = box.upper > 0.92 * (box.high - box.low)  # of its sides, up to the top: those of cars lean
    block = straight[:, 0] & (straight[:, 1] | (length > 2.4)) & (width < 1.65) & (count >= 12)
    none |= (kind == _CAR) & block & ((high > 1.25) | ((length > 2.4) & (width > 0.5) & (width < 1.3)))  # a hedge's
    none |= ((length < 0.12) & (count >= 6)) | (small & (width < 0.17) & (count >= 40))  # a post, a plate
    # Pieces of walls; poles and signs in hedges.
    tall = (high > 2.3) & (width < 0.35) & (length < 5.0) & (length > 2.7)
    none |= tall | ((high > 2.3) & ((length < 1.5) | ((length < 2.1) & (count > 60)) | (count < 8)))
    kind[none] = -1
    return kind


def _plan(along: Floats, across: Floats, cosine: Floats, sine: Floats) -> tuple[Floats, Floats]:
    """x and y, m, of places along and across an axis."""
    return along * cosine - across * sine, along * sine + across * cosine


def joined(clusters: Clusters, box: Rectangles, low: Floats, high: Floats) -> Ints:
    """(c,) number of the vehicle that each cluster is a piece of: lidars with few channels see them in stripes.

    low, high: (c,) m, of the lowest and the highest point above the ground
    """
    count, extent = np.diff(clusters.start), box.high - box.low
    cosine, sine = box.axes.T
    along = np.stack([box.low[:, 0], box.high[:, 0], box.low[:, 0], box.high[:, 0]], axis=1)
    across = np.stack([box.low[:, 1], box.low[:, 1], box.high[:, 1], box.high[:, 1]], axis=1)
    x, y = _plan(along, across, cosine[:, None], sine[:, None])
    sides = [
        cosine[:, None, None] * x + sine[:, None, None] * y,
        cosine[:, None, None] * y - sine[:, None, None] * x,
    ]
    least, most = (np.stack([reduce(side, axis=2) for side in sides], axis=2) for reduce in (np.min, np.max))
    gap = np.maximum(np.maximum(least - box.high[:, None], box.low[:, None] - most), 0.0).max(axis=2)
    both = np.maximum(most, box.high[:, None]) - np.minimum(least, box.low[:, None])
    longer, shorter = both.max(axis=2), both.min(axis=2)
    person = (extent[:, 0] < 2.4) & (extent[:, 1] < 1.0) & (high > 1.35) & (high < 2.2) & (low < 0.7)
    person &= box.upper.max(axis=1, initial=0.0) < 0.9
    tall = high > 2.3
    car = (~tall & ~person & (count[:, None] <= count)).T & ~(tall | person)[None]
    together = car & (longer < 5.2) & (shorter < 2.2) & (gap < 1.6)
    level = np.abs(high[:, None] - high) < 0.6
    together |= tall[:, None] & tall & level & (longer < 12.8) & (shorter < 2.8) & (gap < 2.8)
    np.fill_diagonal(together, False)
    group = np.arange(len(count))
    if not together.any():
        return group
    for first, second in zip(*np.nonzero(together), strict=True):
        group[group == group[second]] = group[first]
    return np.unique(group, return_inverse=True)[1].ravel()


def completed(box: Rectangles, size: Floats) -> tuple[Rectangles, Floats]:
    """Rectangles with at least about the usual `size` (c, 2) m, and how much longer they are now (c, 2) m.

    What was not seen is on the side away from the lidar; on both sides of a face that the lidar looks at squarely.
    """
    extent = box.high - box.low
    missing = np.where(extent < 0.88 * size, size - extent, 0.0)
    beyond, before = box.low >= 0.0, box.high <= 0.0
    low = box.low - missing * np.where(beyond, 0.0, np.where(before, 1.0, 0.5))
    high = box.high + missing * np.where(beyond, 1.0, np.where(before, 0.0, 0.5))
    return box._replace(low=low, high=high), missing


def turned_left(box: Rectangles, which: Bools) -> Rectangles:
    """The same rectangles: of some, the second axis is the first now."""
    turned = which[:, None]
    low = np.where(turned, np.stack([box.low[:, 1], -box.high[:, 0]], axis=1), box.low)
    high = np.where(turned, np.stack([box.high[:, 1], -box.low[:, 0]], axis=1), box.high)
    axes = np.where(turned, np.stack([-box.axes[:, 1], box.axes[:, 0]], axis=1), box.axes)
    return Rectangles(box.yaw + 0.5 * np.pi * which, low, high, axes, np.where(turned, box.upper[:, ::-1], box.upper))


def fit_box(position: Floats | Singles) -> tuple[Floats, Floats, float]:
    """The upright box around the points (n, 3) m of one object: its middle (3,) m, size (3,) m, and yaw, rad.

    The length is the longer side in plan; yaw is -90 to 90 degrees. Points that are not numbers are left out. Raises
    ValueError if none is left, or if they are farther apart than a kilometre.
    """
    points = np.asarray(position, np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    low = points.min(axis=0, initial=np.inf)
    spread = float((points.max(axis=0, initial=-np.inf) - low).max())
    if not 0.0 <= spread <= 1000.0:
        raise ValueError(
            f"position: found {len(points)} points {max(spread, 0.0):g} m apart, expected some within 1 km"
        )
    whole = np.rint((points - low) * 1000.0).astype(np.int32)
    box = rectangles(Clusters(whole, whole[:, 2], np.array([0, len(whole)])))
    middle, axis = (box.low[0] + box.high[0]) / 2.0, box.axes[0]
    x, y = _plan(middle[0], middle[1], axis[0], axis[1])
    size = np.append(box.high - box.low, whole[:, 2].max() / 1000.0)
    return low + np.array([x, y, size[2] / 2.0]), size, float(wrap_angle(2.0 * box.yaw[0]) / 2.0)


@dataclass(kw_only=True, eq=False)
class ClusterDetector(PointDetector):
    """Finds road users as clusters of points above the ground, without any training.

    reach_m:     m, largest x and y of points that are used
    min_points:  least number of points of an object
    clearance_m: m, lower than this above the ground points are part of it
    slope:       m a metre, how steep the ground may be against a plane
    cell_m:      m, side of the cells that are connected
    growth_m:    m: each so far from the lidar, a gap of one more cell is bridged
    """

    reach_m: float = 100.0
    min_points: int = 5
    clearance_m: float = 0.25
    slope: float = 0.06
    cell_m: float = 0.35
    growth_m: float = 30.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("reach_m", 10.0, 250.0),
            ("min_points", 1, 1000),
            ("clearance_m", 0.0, 1.0),
            ("slope", 0.0, 0.5),
            ("cell_m", 0.2, 2.0),
            ("growth_m", 1.0, 1000.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: found {getattr(self, name)}, expected {low:g} to {high:g}")

    def detect(self, points: Points) -> Detections:
        reach = int(np.ceil(self.reach_m * 1000 / _GROUND_CELL)) * _GROUND_CELL
        whole, lowest = lowest_by_cell(np.ascontiguousarray(points.position, np.float32), reach, _DEPTH, _GROUND_CELL)
        ground = ground_of(lowest, self.slope)
        body = round(1000 * self.clearance_m), _OVERHEAD
        cells = round(1000 * self.cell_m), round(1000 * self.growth_m)
        label, height, summary = connected_cells(whole, ground, reach, body, *cells)
        steepest = float(summary[:, 7].max(initial=-_NONE)) / 1e4
        return boxes_of(grouped(whole, height, label, may_be_objects(summary, self.min_points)), steepest)


def _steepness(whole: Millimetres) -> Singles:
    """(n,) z by distance in plan of points (n, 3) mm from the lidar."""
    x, y, z = whole.T.astype(np.float32)
    steepness: Singles = z / np.sqrt(x * x + y * y + np.float32(1.0))
    return steepness


def boxes_of(clusters: Clusters, steepest: float) -> Detections:
    """The detections of clusters; none of those that cannot be road users. steepest: of `_steepness`, in the scan"""
    if not len(clusters.height):
        return Detections.empty()
    box = rectangles(clusters)
    group = joined(clusters, box, *clusters.heights())
    if group.max() < len(group) - 1:
        clusters = clusters.merged(group)
        box = rectangles(clusters)
    low, top = clusters.heights()
    kind = kinds_of(box, low, top, np.diff(clusters.start))
    # What reaches up to the end of the view may be higher: flat pieces and corners of walls.
    (length, width), straight = (box.high - box.low).T, (box.upper > 0.92 * (box.high - box.low)).all(axis=1)
    wall = (width < 0.2) | (straight & (length < 6.0))
    wall &= (top > 2.3) & ~((length > 2.1) & (length < 2.7) & (width < 2.1))
    cut = clusters.of_each(np.maximum, _steepness(clusters.whole)) > steepest - _CHANNEL
    kept = (kind >= 0) & ~(wall & cut)
    if not kept.any():
        return Detections.empty()
    clusters, box, top, kind = clusters.select(kept), Rectangles(*(each[kept] for each in box)), top[kept], kind[kept]
    sight = np.abs(box.low + box.high)  # a short face of a vehicle is its front or rear: its length is along the view
    vehicle = (kind >= _CAR) & ((box.high - box.low)[:, 0] < np.where(kind == _CAR, 2.1, 2.7))
    box = turned_left(box, vehicle & (sight[:, 1] > sight[:, 0]))
    usual, seen = _USUAL[kind], (box.high - box.low).min(axis=1)
    box, missing = completed(box, usual[:, :2])
    middle, extent = (box.low + box.high) / 2.0, box.high - box.low
    cosine, sine = box.axes.T
    height = np.maximum(top, usual[:, 2])
    floor = clusters.of_each(np.minimum, clusters.whole[:, 2] - clusters.height) / 1000.0
    position = np.stack([*_plan(middle[:, 0], middle[:, 1], cosine, sine), floor + height / 2.0], axis=1)
    count = np.diff(clusters.start)
    # These numbers are fitted to scans of our own (docs/explanation-points.md).
    few = np.where(kind >= _CAR, 1.2, 0.2) / count
    plan = 0.06**2 + few[:, None] + (0.2 * missing) ** 2
    variance = np.concatenate([plan, (0.05**2 + 0.03 / count)[:, None]], axis=1)
    rotation = np.zeros((len(kind), 3, 3))
    rotation[:, 0, 0], rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 1, 1] = cosine, -sine, sine, cosine
    rotation[:, 2, 2] = 1.0
    covariance = (rotation * variance[:, None]) @ rotation.transpose(0, 2, 1)
    score = _RIGHT[kind] * np.where((kind == _CAR) & (seen < 1.45), np.where(seen < 1.2, 0.65, 0.9), 1.0)
    score *= 1.0 - np.where(kind >= _TRUCK, np.exp(-count / 20.0), 0.4 * np.exp(-count / 8.0))
    yaw = wrap_angle(2.0 * box.yaw) / 2.0
    size = np.concatenate([extent, height[:, None]], axis=1)
    found = Detections(position, np.maximum(size, 0.1), yaw, score, _CLASS_IDS[kind], covariance)
    return found.select(~_within_others(found, kind, count))


def _within_others(found: Detections, kind: Ints, count: Ints) -> Bools:
    """(n,) whether the middle of a detection is within a vehicle of more points, or it is no vehicle itself."""
    offset = found.position[:, None, :2] - found.position[None, :, :2]
    cosine, sine = np.cos(found.yaw), np.sin(found.yaw)
    along = np.abs(offset[..., 0] * cosine + offset[..., 1] * sine) < found.size[:, 0] / 2.0
    across = np.abs(offset[..., 1] * cosine - offset[..., 0] * sine) < found.size[:, 1] / 2.0
    other = (kind >= _CAR) & ((count > count[:, None]) | (kind[:, None] < _CAR))
    return np.asarray((along & across & other & ~np.eye(len(count), dtype=bool)).any(axis=1))
