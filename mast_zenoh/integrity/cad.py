"""CAD: boxes in free space are spoofed, occupied space under no box is a removal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.consensus import CheckCount
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.integrity.occupancy import (
    AreaLimits,
    OccupiedArea,
    free_points,
    occupied_areas,
    returns,
    sampled,
    uncovered_m2,
)
from mast_zenoh.integrity.visibility import current, sightings

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
    return occupied_areas(np.concatenate([np.zeros((0, 2)), *parts]), agent, link_m, AreaLimits())
