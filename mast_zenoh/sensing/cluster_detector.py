"""A detector of points without training: ground by grid, connected cells, rectangles, classes by size and height.

Coordinates are rounded to whole millimetres, far below a lidar's noise. So sums and comparisons are exact, and neither
the order of the points nor the kernel in use changes a detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Detections, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.sensing.ground import CLEARANCE_M, REACH_M, SLOPE, Millimetres, points_and_ground
from mast_zenoh.sensing.point_detector import PointDetector
from mast_zenoh.sensing.points import Points

#: mm: no road user is higher than the first; points above the second are overhead.
_TALLEST, _OVERHEAD = 4200, 4500
#: mm: what has points overhead, as below a bridge or a tree, is not higher; what is longer is a wall or a hedge.
_MAY_BE_BELOW, _LONGEST = 2600, 14_000
#: Most clusters that are used.
_CLUSTERS = 1000
#: Tangent of the angle between two channels of common lidars.
_CHANNEL = 0.007
#: deg, between turns of a rectangle; of them, how many are skipped in a first search.
_TURN_DEG, _COARSE = 1.0, 5
#: mm and cells, of the outline on which rectangles are fitted;  mm, nearer to a side all points count the same.
_OUTLINE, _ACROSS, _NEAR = 100, 200, 50.0


@kernel
def clusters_above(
    points: Millimetres,
    ground: Millimetres,
    reach_mm: int,
    body: tuple[int, int],
    cell_mm: int,
    growth_mm: int,
    limits: tuple[int, int, int, int],
) -> tuple[Millimetres, Ints, float]:
    """Points (k, 4) of the clusters that may be objects, where each starts (c + 1,), and how steep the scan is.

    Points at heights of objects belong to cells; cells with points are connected if not more than k apart, where k is 1
    and grows by 1 each `growth_mm` from the lidar. Clusters are in the order of their first cells; their points are x,
    y, z, and the height above the ground, mm. Steep: the greatest z by distance in plan, of points in cells or above.

    points: (n, 4) as of `lowest_by_cell`;  ground: (g, g) mm, z of the ground in its cells
    body: mm, heights between which the points of objects are
    limits: of an object: least points; mm, greatest height, the same below points overhead, greatest length
    """
    height, cell = points[:, 2] - ground.reshape(-1)[points[:, 3]], (points[:, :2] + reach_mm) // cell_mm
    inside = (height > body[0]) & (height <= body[1])
    cells = np.unique(cell[inside], axis=0)
    reach = 1 + np.abs(cells * cell_mm - reach_mm).max(axis=1, initial=0) // growth_mm
    number = np.full(len(cells), -1)
    for seed in range(len(cells)):
        waiting = [seed] if number[seed] < 0 else []
        number[waiting] = number.max() + 1
        while waiting:
            k = waiting.pop()
            near = (number < 0) & (np.abs(cells - cells[k]).max(axis=1) <= np.maximum(reach, reach[k]))
            number[near] = number[k]
            waiting.extend(np.flatnonzero(near).tolist())
    of_cell = dict(zip(map(tuple, cells.tolist()), number.tolist(), strict=True))
    of_point = np.array([of_cell.get((i, j), -1) for i, j in cell.tolist()], np.int64)
    of_point[height <= body[0]] = -1
    least, tallest, below, longest = limits
    parts = [np.zeros((0, 4), np.int32)]
    for k in range(number.max(initial=-1) + 1):
        part = np.column_stack([points[:, :3], height])[inside & (of_point == k)]
        top, overhead = part[:, 3].max(), ((of_point == k) & ~inside).any()
        across = np.hypot(*np.ptp(part[:, :2].astype(np.float64), axis=0))
        if len(part) >= least and top <= (below if overhead else tallest) and across < longest:
            parts.append(part)
    x, y, z = points[of_point >= 0, :3].T.astype(np.float64)
    steepest = float((z / np.sqrt(x * x + y * y + 1.0)).max(initial=-(1 << 30)))
    return np.concatenate(parts), np.cumsum([len(part) for part in parts]), steepest


@kernel
def fitted_rectangles(
    points: Millimetres, start: Ints, axes: Floats, coarse: int, least_mm: int, across: int, near_mm: float
) -> tuple[Ints, Floats]:
    """Row of `axes` (c,) along which a rectangle fits the points of each cluster best, and extents (c, 11) of points.

    The search of Zhang et al. 2017 (Efficient L-shape fitting for vehicle detection using laser scanners, IV,
    algorithm 4, closeness), on the means of the points in the cells of a grid, with all four sides. Extents, m: least
    and greatest along both sides; lengths of the upper part along both; least and greatest height above the ground,
    least z of the ground. Then the greatest z by distance in plan, and the number of points.

    points, start: as of `clusters_above`
    axes: (t, 2) cosine and sine, evenly over half a turn: the second half are those that are at a right angle. Of the
        first, every `coarse`-th is tried, then those beside the best; the result is that of the longer side
    least_mm: side of cells, of which there are at most `across` in a row;  near_mm: nearer to a side counts the same
    """
    turns = len(axes) // 2
    best, extents = np.zeros(len(start) - 1, np.int64), np.zeros((len(start) - 1, 11))
    for c, (first, end) in enumerate(pairwise(start)):
        part = points[first:end]
        at = part[:, :2] - part[:, :2].min(axis=0)
        cell = at // max(least_mm, int(at.max()) // across + 1)
        _, of_row = np.unique(cell[:, 0] * (across + 1) + cell[:, 1], return_inverse=True)
        count = np.bincount(of_row.ravel())
        x, y = (np.bincount(of_row.ravel(), weights=side) / count for side in at.T)

        def closeness(turn: int, x: Floats = x, y: Floats = y) -> int:
            sides = _along(axes[turn, 0], axes[turn, 1], x, y)
            gap = np.minimum(*(np.minimum(side - side.min(), side.max() - side) for side in sides))
            return int((1e6 / np.maximum(gap, near_mm)).astype(np.int64).sum())

        scores = {turn: closeness(turn) for turn in range(0, turns, coarse)}
        coarsely = max(scores, key=lambda turn: scores[turn])
        order = [coarsely, *((coarsely + k) % turns for k in range(1 - coarse, coarse))]
        best[c] = max(order, key=closeness)
        x, y, z, height = part.T.astype(np.float64)
        sides = np.stack(_along(axes[best[c], 0], axes[best[c], 1], x / 1000.0, y / 1000.0))
        if np.diff(np.ptp(sides, axis=1)) > 0.0:
            best[c], sides = best[c] + turns, np.stack([sides[1], -sides[0]])
        extents[c, :4] = *sides.min(axis=1), *sides.max(axis=1)
        if (upper := height > 0.75 * height.max()).any():
            extents[c, 4:6] = np.ptp(sides[:, upper], axis=1)
        extents[c, 6:9] = height.min() / 1000.0, height.max() / 1000.0, (z - height).min() / 1000.0
        extents[c, 9:] = (z / np.sqrt(x * x + y * y + 1.0)).max(), len(part)
    return best, extents


def _along(cosine: Floats, sine: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """How far x and y are along and across an axis; with the opposite sine, x and y of what is along and across it."""
    return x * cosine + y * sine, y * cosine - x * sine


#: (t, 2) cosine and sine of the turns that are tried, and of those at a right angle to them.
_ANGLES = np.radians(np.arange(0.0, 90.0, _TURN_DEG))
_COSINE, _SINE = np.cos(_ANGLES), np.sin(_ANGLES)
_AXES = np.concatenate([np.stack([_COSINE, _SINE], axis=1), np.stack([-_SINE, _COSINE], axis=1)])
_ANGLES = np.concatenate([_ANGLES, _ANGLES + 0.5 * np.pi])


class Rectangles(NamedTuple):
    """Rectangles around c clusters in plan, and what else their points tell. Their first axis is the longer one.

    yaw: (c,) rad;  low, high: (c, 2) m from the lidar along both axes;  axes: (c, 2) cosine and sine of yaw
    upper: (c, 2) m, extent of the points of the upper part, 0 without any
    bottom, top: (c,) m above the ground, of the lowest and highest point;  floor: (c,) m, z of the lowest ground
    steepest: (c,) greatest z by distance in plan;  points: (c,) how many there are
    """

    yaw: Floats
    low: Floats
    high: Floats
    axes: Floats
    upper: Floats
    bottom: Floats
    top: Floats
    floor: Floats
    steepest: Floats
    points: Floats

    def select(self, rows: Bools | Ints) -> Rectangles:
        """Some of them, or all in another order."""
        return Rectangles(*(column[rows] for column in self))


def rectangles(points: Millimetres, start: Ints) -> Rectangles:
    """Rectangles around the points of clusters, which are as `clusters_above` gives them."""
    turn, extents = fitted_rectangles(points, start, _AXES, _COARSE, _OUTLINE, _ACROSS, _NEAR)
    low, high, upper = extents[:, :2], extents[:, 2:4], extents[:, 4:6]
    return Rectangles(_ANGLES[turn], low, high, _AXES[turn], upper, *extents[:, 6:].T)


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


def kinds_of(box: Rectangles) -> Ints:
    """(c,) row of each cluster in the table of classes, -1: no road user."""
    (length, width), low, high, count = (box.high - box.low).T, box.bottom, box.top, box.points
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


def joined(points: Millimetres, start: Ints, box: Rectangles) -> Rectangles:
    """Rectangles of clusters, with one for all pieces of a vehicle: lidars with few channels see them in stripes."""
    (length, width), tall = (box.high - box.low).T, box.top > 2.3
    person = (length < 2.4) & (width < 1.0) & (box.top > 1.35) & (box.top < 2.2) & (box.bottom < 0.7)
    low = ~tall & ~(person & (box.upper.max(axis=1, initial=0.0) < 0.9))
    ends, (cosine, sine) = np.array([box.low, box.high]), box.axes.T
    corners = np.array(_along(cosine, -sine, ends[[0, 1, 0, 1], :, 0], ends[[0, 0, 1, 1], :, 1]))
    middle, reach = (corners[:, 0] + corners[:, 3]) / 2.0, 0.75 * np.hypot(length, width)
    together = low[:, None] & low & (box.points[:, None] >= box.points)
    together |= tall[:, None] & tall & (np.abs(box.top[:, None] - box.top) < 0.6)
    apart = np.abs(middle[:, :, None] - middle[:, None])
    together &= (apart < reach[:, None] + reach + 5.0).all(axis=0)  # others are too far apart in any case
    np.fill_diagonal(together, False)
    first, second = np.nonzero(together)
    sides = np.array(_along(cosine[first], sine[first], *corners[:, :, second]))
    (least, most), before, behind = (sides.min(axis=1), sides.max(axis=1)), box.low[first].T, box.high[first].T
    gap = np.maximum(least - behind, before - most).max(axis=0)
    longer, shorter = np.sort(np.maximum(most, behind) - np.minimum(least, before), axis=0)[::-1]
    limits = np.where(tall[first], np.array([(12.8,), (2.8,), (2.8,)]), np.array([(5.2,), (2.2,), (1.6,)]))
    group = np.arange(len(tall))
    for pair in np.flatnonzero((np.stack([longer, shorter, gap]) < limits).all(axis=0)):
        group[group == group[second[pair]]] = group[first[pair]]
    numbers, row, pieces = np.unique(group, return_index=True, return_counts=True)
    several = np.flatnonzero(pieces > 1)
    if not len(several):
        return box
    members = [np.flatnonzero(group == number) for number in numbers[several]]
    parts = [np.concatenate([points[start[k] : start[k + 1]] for k in rows]) for rows in members]
    whole, box = rectangles(np.concatenate(parts), np.cumsum([0, *map(len, parts)])), box.select(row)
    for column, others in zip(box, whole, strict=True):
        column[several] = others
    return box


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
    """The same rectangles; of those in `which` (c,), the axis to the left comes first."""
    turned = which[:, None]
    low = np.where(turned, np.stack([box.low[:, 1], -box.high[:, 0]], axis=1), box.low)
    high = np.where(turned, np.stack([box.high[:, 1], -box.low[:, 0]], axis=1), box.high)
    axes = np.where(turned, np.stack([-box.axes[:, 1], box.axes[:, 0]], axis=1), box.axes)
    upper = np.where(turned, box.upper[:, ::-1], box.upper)
    return box._replace(yaw=box.yaw + 0.5 * np.pi * which, low=low, high=high, axes=axes, upper=upper)


@dataclass(kw_only=True, eq=False)
class ClusterDetector(PointDetector):
    """Finds road users as clusters of points; cannot tell front from rear.

    It needs no training. Headings are known up to half a turn, and trackers do not correct them by the velocity. Of
    more than 1,000 clusters, which only a forged scan has, it uses those with the most points: time is bounded.

    reach_m:     m, largest x and y of points that are used
    min_points:  least number of points of an object
    clearance_m: m, height up to which points belong to the ground
    slope:       m a metre, how steep the ground may be against a plane
    cell_m:      m, side of the cells that are connected
    growth_m:    m, distance from the lidar for each cell of gap that is bridged
    """

    reach_m: float = REACH_M
    min_points: int = 5
    clearance_m: float = CLEARANCE_M
    slope: float = SLOPE
    cell_m: float = 0.35
    growth_m: float = 30.0

    def __post_init__(self) -> None:
        check("10 to 250", reach_m=self.reach_m)
        check("1 to 1000", min_points=self.min_points, growth_m=self.growth_m)
        check("0 to 1", clearance_m=self.clearance_m)
        check("0 to 0.5", slope=self.slope)
        check("0.2 to 2", cell_m=self.cell_m)

    def detect(self, points: Points) -> Detections:
        points_mm, ground = points_and_ground(points.position, self.reach_m, self.slope)
        body = round(1000 * self.clearance_m), _OVERHEAD
        cells = round(1000 * self.cell_m), round(1000 * self.growth_m)
        limits = self.min_points, _TALLEST, _MAY_BE_BELOW, _LONGEST
        return boxes_of(*clusters_above(points_mm, *ground, body, *cells, limits))


def boxes_of(points: Millimetres, start: Ints, steepest: float) -> Detections:
    """The detections of clusters, as `clusters_above` gives them; none of those that cannot be road users."""
    if not len(points):
        return Detections.empty()
    if len(start) > _CLUSTERS + 1:
        parts = np.split(points, start[1:-1])
        parts = [parts[k] for k in np.sort(np.argsort(-np.diff(start), kind="stable")[:_CLUSTERS])]
        points, start = np.concatenate(parts), np.cumsum([0, *map(len, parts)])
    box = joined(points, start, rectangles(points, start))
    kind = kinds_of(box)
    # What reaches up to the end of the view may be higher: flat pieces and corners of walls.
    (length, width), straight = (box.high - box.low).T, (box.upper > 0.92 * (box.high - box.low)).all(axis=1)
    wall = (width < 0.2) | (straight & (length < 6.0))
    wall &= (box.top > 2.3) & ~((length > 2.1) & (length < 2.7) & (width < 2.1))
    kept = (kind >= 0) & ~(wall & (box.steepest > steepest - _CHANNEL))
    if not kept.any():
        return Detections.empty()
    box, kind = box.select(kept), kind[kept]
    sight = np.abs(box.low + box.high)  # a short face of a vehicle is its front or rear: its length is along the view
    vehicle = (kind >= _CAR) & ((box.high - box.low)[:, 0] < np.where(kind == _CAR, 2.1, 2.7))
    box = turned_left(box, vehicle & (sight[:, 1] > sight[:, 0]))
    usual, seen, count = _USUAL[kind], (box.high - box.low).min(axis=1), box.points
    box, missing = completed(box, usual[:, :2])
    middle, extent = (box.low + box.high) / 2.0, box.high - box.low
    cosine, sine = box.axes.T
    height = np.maximum(box.top, usual[:, 2])
    position = np.stack([*_along(cosine, -sine, *middle.T), box.floor + height / 2.0], axis=1)
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
    detections = Detections(position, np.maximum(size, 0.1), yaw, score, _CLASS_IDS[kind], covariance)
    return detections.select(~_within_others(detections, kind, count))


def _within_others(detections: Detections, kind: Ints, count: Floats) -> Bools:
    """(n,) whether the middle of a detection is within a vehicle of more points, or it is no vehicle itself."""
    offset = detections.position.T[:2, :, None] - detections.position.T[:2, None]
    apart = np.abs(_along(np.cos(detections.yaw), np.sin(detections.yaw), *offset))
    inside = (apart < detections.size.T[:2, None] / 2.0).all(axis=0)
    other = (kind >= _CAR) & ((count > count[:, None]) | (kind[:, None] < _CAR))
    return np.asarray((inside & other & ~np.eye(len(count), dtype=bool)).any(axis=1))
