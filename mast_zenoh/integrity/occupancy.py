"""Areas seen from above that sensors find free or occupied.

Free is what a ray passes on its way to its first return; occupied is the convex hull of returns that are close to each
other. Both come from the free distances in the agents' views, which include walls and leave out the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import connected_groups, pairs_near
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.agreement import select
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import TOLERANCES

#: Sample points of an area along each side of its rectangle.
SAMPLES = 12
#: Share of the end of the range from which a ray has no return.
_NO_RETURN = 1.0 - 1e-9
#: Most returns of one agent, four times the sectors of a sensor that sees all around (`sensing.raycast.CELL_DEG`): a
#: view may have any number, and the cost of areas grows with its square.
MAX_RETURNS = 720
#: Pairs of corners that are compared at a time.
_BLOCK = 250_000


def cell_centres(samples: int = SAMPLES) -> Floats:
    """(samples², 2) centres of equal cells of a square from -1 to 1."""
    middle = (np.arange(samples) + 0.5) * (2.0 / samples) - 1.0
    x, y = np.meshgrid(middle, middle, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()])


def sampled(boxes: ClusterBoxes) -> Floats:
    """(c, SAMPLES², 3) m: points that stand for equal parts of the area of boxes.

    At half their height.
    """
    flat = 0.5 * boxes.size[:, None, :2] * cell_centres()
    cos, sin = np.cos(boxes.yaw)[:, None], np.sin(boxes.yaw)[:, None]
    points = np.repeat(boxes.position[:, None, :], SAMPLES**2, axis=1)
    points[..., 0] += flat[..., 0] * cos - flat[..., 1] * sin
    points[..., 1] += flat[..., 0] * sin + flat[..., 1] * cos
    return points


def free_points(points: Floats, views: Sequence[SweptView | None], range_m: float) -> Bools:
    """(a, n) whether points (n, 3) are in the free space of each agent.

    range_m: m, on the ground, up to which space counts. The agent's own vehicle is in the way nearer than
    `Tolerances.own_m`. A view without free space knows none.
    """
    free = np.zeros((len(views), len(points)), np.bool_)
    for agent, view in enumerate(views):
        if view is None or view.free.size == 0:
            continue
        distance, until, inside = view.ranges(points)
        away = np.hypot(*(points[:, :2] - view.view.position[:2]).T)
        with np.errstate(invalid="ignore"):
            free[agent] = inside & (until > distance) & (away > TOLERANCES.own_m) & (away <= range_m)
    return free


def returns(view: SweptView, low_m: float, high_m: float, range_m: float) -> Floats:
    """(k, 2) m: the nearest return in each sector, seen from above.

    low_m, high_m: heights, world frame, between which returns count; range_m: m, on the ground

    At most MAX_RETURNS; of more, as many that are evenly spread over the sectors.
    """
    sensor, free = view.view, view.free
    if free.size == 0:
        return np.zeros((0, 2))
    bands, sectors = free.shape
    elevation = sensor.elevation_min + (np.arange(bands) + 0.5) * (sensor.elevation_max - sensor.elevation_min) / bands
    azimuth = sensor.azimuth_min + (np.arange(sectors) + 0.5) * (sensor.azimuth_max - sensor.azimuth_min) / sectors
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    ray = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    points = sensor.position + (free[..., None] * ray) @ sensor.rotation.T
    away = np.hypot(points[..., 0] - sensor.position[0], points[..., 1] - sensor.position[1])
    counted = (free < sensor.max_range * _NO_RETURN) & (points[..., 2] >= low_m) & (points[..., 2] <= high_m)
    counted &= (away > TOLERANCES.own_m) & (away <= range_m)
    nearest = np.where(counted, away, np.inf).argmin(axis=0)
    column = np.flatnonzero(counted.any(axis=0))
    if len(column) > MAX_RETURNS:
        column = column[np.arange(MAX_RETURNS) * len(column) // MAX_RETURNS]
    return np.asarray(points[nearest[column], column, :2])


@dataclass(frozen=True, slots=True, eq=False)
class OccupiedArea:
    """Convex hull of some returns.

    corners: (h, 2) m, counter-clockwise, world frame; area_m2: m²; agents: (k,) rows of those with a return in it
    """

    corners: Floats
    area_m2: float
    agents: Ints


@dataclass(frozen=True, kw_only=True)
class AreaLimits:
    """What can be a vehicle; the original's values.

    least_m2, most_m2: m², area; extent_m: m, greatest distance of two returns
    """

    least_m2: float = 0.5
    most_m2: float = 20.0
    extent_m: float = 8.0


def occupied_areas(points: Floats, agent: Ints, link_m: float, limits: AreaLimits) -> list[OccupiedArea]:
    """The areas of connected returns that may be vehicles.

    link_m: m, between connected returns; points: (n, 2) m; agent: (n,) row of each. The order of the points does not
    matter.
    """
    pairs = pairs_near(points, link_m)
    group = connected_groups(len(points), pairs.i, pairs.j)
    order = np.argsort(group, kind="stable")
    areas = []
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if len(rows) < 3 or np.ptp(points[rows], axis=0).max() > limits.extent_m:
            continue
        corners = hull(points[rows])
        if diameter(corners) > limits.extent_m:
            continue
        area = polygon_area(corners)
        if limits.least_m2 <= area <= limits.most_m2:
            areas.append(OccupiedArea(corners, area, np.unique(agent[rows])))
    return sorted(areas, key=lambda area: area.corners[0].tolist())


def hull(points: Floats) -> Floats:
    """(h, 2) corners of the convex hull of points (n, 2).

    Counter-clockwise from the leftmost one, by the monotone chain (Andrew, Information Processing Letters 1979).
    """
    ordered = np.unique(points, axis=0).tolist()
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(places: Sequence[Sequence[float]]) -> list[Sequence[float]]:
        kept: list[Sequence[float]] = []
        for x, y in places:
            while len(kept) > 1:
                (ax, ay), (bx, by) = kept[-2], kept[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                kept.pop()
            kept.append((x, y))
        return kept[:-1]

    return np.array([*chain(ordered), *chain(ordered[::-1])])


def diameter(corners: Floats) -> float:
    """Greatest distance in m of two corners (h, 2) m."""
    step = max(_BLOCK // len(corners), 1)
    return max(
        float(np.hypot(*(corners[start : start + step, None] - corners).transpose(2, 0, 1)).max())
        for start in range(0, len(corners), step)
    )


def polygon_area(corners: Floats) -> float:
    """Area in m² of a polygon, corners (h, 2) m counter-clockwise."""
    (x, y), (after_x, after_y) = corners.T, np.roll(corners, -1, axis=0).T
    return float(0.5 * (x * after_y - y * after_x).sum())


def inside_hull(points: Floats, corners: Floats) -> Bools:
    """(n,) which points (n, 2) are in a convex polygon.

    corners: (h, 2), counter-clockwise
    """
    side = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners
    return np.asarray((side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0] >= 0.0).all(axis=1))


def uncovered_m2(area: OccupiedArea, boxes: ClusterBoxes) -> float:
    """m² of an occupied area under no box.

    By the sample points of its bounding rectangle that are in the area.
    """
    low, high = area.corners.min(axis=0), area.corners.max(axis=0)
    points = 0.5 * (low + high) + 0.5 * (high - low) * cell_centres()
    points = points[inside_hull(points, area.corners)]
    reach = 0.5 * np.hypot(*(high - low)) + 0.5 * np.hypot(boxes.size[:, 0], boxes.size[:, 1])
    near = select(boxes, np.hypot(*(boxes.position[:, :2] - 0.5 * (low + high)).T) <= reach * (1.0 + 1e-9))
    return area.area_m2 * float((~near.cover(points).any(axis=1)).mean()) if len(points) else 0.0
