"""CAD: boxes in free space are spoofed, occupied space under no box is a removal.

Areas are seen from above. Free is what a ray passes on its way to its first return; occupied is the convex hull of
returns that are close to each other. Both come from the free distances in the agents' views, which include walls and
leave out the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import connected_groups, pairs_near
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.consensus import CheckCount
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import TOLERANCES, current, sightings

#: m, heights above the ground between which returns may be those of a vehicle, as in the original.
LOW_M, HIGH_M = -0.5, 3.0


@dataclass(kw_only=True, eq=False)
class Cad(Integrity):
    """Withholds boxes in free space and counts occupied space under no box.

    After CAD, on tracks. Collaborative anomaly detection (Zhang et al., USENIX Security 2024; read in its code:
    zqzqz/AdvCollaborativePerception 6ecb29f, perception_defender and detection_util). The free and the occupied areas
    of all agents, seen from above, are merged. The spoofed area of a box is its area within free space; the removed
    area of an occupied area is that under no box. More than `threshold_m2` of either is an anomaly: a spoofed object is
    withheld; a removal counts against the agents that have returns there, and no track of them.

    threshold_m2: m², least area of an anomaly (thres of its PerceptionDefender)
    range_m: m, from a sensor on the ground, up to which its space counts
    link_m: m, between returns of one occupied area; chosen: directions are some 2 degrees apart
    record_s: s, after which an outcome counts 1/e in an agent's trust

    `FreeSpace` counts agents that see through an object against those that report it, with tolerances. Here, one
    agent's free space is enough, and an occupied area counts even if nobody reports an object there.

    What cannot be carried over: the original divides each point cloud into ground, road and objects, with a map of the
    lanes. A view has the nearest return in each direction alone, walls included. Areas must only be within the
    original's limits for objects: 0.5 to 20 m², at most 8 m across, -0.5 to 3 m above the ground, which here is the
    median of the lower sides of the boxes.

    Weaknesses: one agent that claims free space withholds every object in it; pieces of walls count as removals; small
    objects have less area than the threshold; a removal alarm brings no object back. Agents are never excluded.
    """

    threshold_m2: float = 1.7
    range_m: float = 50.0
    link_m: float = 1.0
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check("more than 0", threshold_m2=self.threshold_m2, range_m=self.range_m, link_m=self.link_m)
        self.reset()

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)
        self._count = CheckCount()
        self._spoofed = self._removed = 0

    def facts(self) -> dict[str, Any]:
        return self._count.facts() | {"spoofed": self._spoofed, "removed": self._removed}

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        reported, views = batch.reported, current(batch.views)
        free = free_m2(batch, boxes, self.range_m)
        by_agent, spoofed = free[:, :-1] > self.threshold_m2, free[:, -1] > self.threshold_m2
        areas = areas_of(batch, boxes, self.range_m, self.link_m)
        removed = [area for area in areas if uncovered_m2(area, boxes) > self.threshold_m2]
        if any(view is not None for view in views):
            self._count.add(len(spoofed) + len(areas))
        else:
            self._count.without_reference += 1
        self._spoofed += int(spoofed.sum())
        self._removed += len(removed)
        silent = np.zeros((len(removed), len(batch.agents)), np.bool_)
        for row, area in enumerate(removed):
            silent[row, area.agents] = True
        confirming, contradicting = reported.sum(axis=1), by_agent.sum(axis=1)
        agreed = reported & (~spoofed & (confirming > 1))[:, None]
        mean = self._record.update(batch, agreed, np.concatenate([reported & spoofed[:, None], silent]))
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        objects = ObjectTrust.of((seen.in_view | reported).sum(axis=1), confirming, contradicting, spoofed)
        return Assessment(None, AgentTrust.of(mean), objects)


def free_m2(batch: Batch, boxes: ClusterBoxes, range_m: float) -> Floats:
    """(c, a + 1) m² of boxes in each agent's free space; last column: in that of any."""
    points = sampled(boxes)
    c, k = points.shape[:2]
    free: Bools = free_points(points.reshape(-1, 3), current(batch.views), range_m).reshape(len(batch.views), c, k)
    merged = np.concatenate([free, free.any(axis=0, keepdims=True)])
    return np.asarray((boxes.size[:, 0] * boxes.size[:, 1])[:, None] * merged.mean(axis=2).T)


def areas_of(batch: Batch, boxes: ClusterBoxes, range_m: float, link_m: float) -> list[OccupiedArea]:
    """The occupied areas of all agents together that may be vehicles.

    boxes: of the clusters, which show the ground
    """
    if not len(boxes.yaw):
        return []
    ground = float(np.median(boxes.position[:, 2] - 0.5 * boxes.size[:, 2]))
    parts = [
        np.zeros((0, 2)) if view is None else returns(view, ground + LOW_M, ground + HIGH_M, range_m)
        for view in current(batch.views)
    ]
    agent = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return occupied_areas(np.concatenate([np.zeros((0, 2)), *parts]), agent, link_m)


# -- areas -------------------------------------------------------------------------------------------------------------

#: Sample points of an area along each side of its rectangle.
SAMPLES = 12
#: Share of the end of the range from which a ray has no return.
_NO_RETURN = 1.0 - 1e-9
#: Most returns of one agent, four times the sectors of a sensor that sees all around (`sensing.raycast.CELL_DEG`): a
#: view may have any number, and the cost of areas grows with its square.
MAX_RETURNS = 720
#: m² and m: areas and the greatest distance of two returns of what can be a vehicle; the original's values.
_LEAST_M2, _MOST_M2, _EXTENT_M = 0.5, 20.0, 8.0
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


def occupied_areas(points: Floats, agent: Ints, link_m: float) -> list[OccupiedArea]:
    """The areas of connected returns that may be vehicles.

    link_m: m, between connected returns; points: (n, 2) m; agent: (n,) row of each. The order of the points does not
    matter.
    """
    pairs = pairs_near(points, link_m)
    group = connected_groups(len(points), pairs.i, pairs.j)
    order = np.argsort(group, kind="stable")
    areas = []
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if len(rows) < 3 or np.ptp(points[rows], axis=0).max() > _EXTENT_M:
            continue
        corners = hull(points[rows])
        if diameter(corners) > _EXTENT_M:
            continue
        area = polygon_area(corners)
        if _LEAST_M2 <= area <= _MOST_M2:
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
    near = boxes.select(np.hypot(*(boxes.position[:, :2] - 0.5 * (low + high)).T) <= reach * (1.0 + 1e-9))
    return area.area_m2 * float((~near.cover(points).any(axis=1)).mean()) if len(points) else 0.0
