"""Base of stages that admit agents by checks of groups: perception, checks, trust.

A group's perception is what the centre would have from it alone: the median boxes of the objects that it reports.
How far two sets of boxes agree: matched boxes, and their share in all of them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.boxes import intersection_area
from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import min_cost_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import (
    SUSPENDED,
    UNKNOWN,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    Integrity,
    ObjectTrust,
)
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.integrity.views import SweptView


class CheckCount:
    """Counts the checks of a stage.

    batches: with a reference to check against; without_reference: others; checks: in all batches; most: in one
    """

    def __init__(self) -> None:
        self.batches = self.without_reference = self.checks = self.most = 0

    def add(self, checks: int) -> None:
        """Count a batch with some checks."""
        self.batches += 1
        self.checks += checks
        self.most = max(self.most, checks)

    def facts(self) -> dict[str, Any]:
        """The counts, and the mean number of checks in a batch; None before the first one."""
        return {
            "batches": self.batches,
            "batches_without_reference": self.without_reference,
            "checks": self.checks,
            "checks_per_batch": self.checks / self.batches if self.batches else None,
            "most_checks": self.most,
        }


def members_of(batch: Batch, rows: Sequence[int]) -> Bools:
    """(a,) which agents of a batch are in some rows."""
    members = np.zeros(len(batch.agents), np.bool_)
    members[list(rows)] = True
    return members


def perception(batch: Batch, members: Bools) -> ClusterBoxes:
    """The median boxes of the objects that some agents report, of their tracks alone.

    members: (a,)
    """
    reported: Bools = np.asarray((batch.reported & members).any(axis=1))
    return ClusterBoxes.of(batch, np.broadcast_to(members, batch.reported.shape)).select(reported)


def within_area(boxes: ClusterBoxes, view: SweptView | None, area_m: float) -> Bools:
    """(c,) boxes whose centres are in a square around a sensor, aligned with it.

    view: of the sensor; None: all boxes are; area_m: m, from the sensor to the sides of the square
    """
    if view is None:
        return np.ones(len(boxes.yaw), np.bool_)
    x, y, _ = ((boxes.position - view.view.position) @ view.view.rotation).T
    return np.asarray((np.abs(x) <= area_m) & (np.abs(y) <= area_m))


class EgoReference:
    """The perception of one trusted agent, with which those of groups are compared.

    ego: row of the agent; area_m: m, see `within_area`; match_iou: of matched boxes

    checks: number of groups that were compared, also again
    """

    def __init__(self, batch: Batch, ego: int, area_m: float, match_iou: float) -> None:
        self._batch, self._ego, self._match_iou = batch, ego, match_iou
        self._area_m = area_m
        self._boxes = self._seen([])
        self._known: dict[tuple[int, ...], float] = {}  # many draws of few agents repeat groups
        self.checks = 0

    def _seen(self, group: Sequence[int]) -> ClusterBoxes:
        boxes = perception(self._batch, members_of(self._batch, [self._ego, *group]))
        return boxes.select(within_area(boxes, self._batch.views[self._ego], self._area_m))

    def agreement(self, group: Sequence[int]) -> float:
        """Jaccard index of the ego's perception alone and with a group, rows of agents."""
        self.checks += 1
        members = tuple(sorted(group))
        if members not in self._known:
            self._known[members] = agreement(self._boxes, self._seen(members), self._match_iou)
        return self._known[members]


def admission(batch: Batch, admitted: Bools, mean: Floats, reason: str) -> Assessment:
    """Suspend the agents that are not admitted, and withhold what only they report.

    admitted: (a,); mean: (a,) trust in agents, 0 to 1; reason: of each suspension
    """
    state = np.where(admitted, UNKNOWN, SUSPENDED).astype(np.uint8)
    claims = batch.reported & admitted
    members, confirming = batch.reported.sum(axis=1), claims.sum(axis=1)
    objects = ObjectTrust.of(members, confirming, members - confirming, confirming == 0)
    reasons = tuple("" if is_admitted else reason for is_admitted in admitted.tolist())
    return Assessment(batch.weights(claims), AgentTrust.of(mean, state, reasons), objects)


class RecordedAdmission:
    """Admits agents, and trusts them as often as they were admitted.

    record_s: s, after which an admission or exclusion counts 1/e in an agent's trust
    """

    def __init__(self, record_s: float) -> None:
        self._record = BetaReputation(record_s=record_s)

    def assess(self, batch: Batch, admitted: Bools, reason: str = "") -> Assessment:
        """See `admission`."""
        mean = self._record.update(batch, admitted[None], ~admitted[None])
        return admission(batch, admitted, mean, reason)


@dataclass(kw_only=True, eq=False)
class EgoConsensus(Integrity):
    """Base of stages that admit agents by agreement with one trusted agent, the ego.

    ego: name of the agent that is always trusted; in a batch without it, everybody is admitted
    match_iou: intersection over union, seen from above, from which two boxes are one object
    area_m: m, from the ego's sensor to each side of the square in which objects are compared
    record_s: s, after which an admission or exclusion counts 1/e in an agent's trust
    """

    needs_views = False

    ego: str = "ego"
    match_iou: float = 0.5
    area_m: float = 32.0
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check_agent("ego", self.ego)
        check("more than 0 and at most 1", match_iou=self.match_iou)
        check("more than 0", area_m=self.area_m)
        self.reset()

    def reset(self) -> None:
        self._admission = RecordedAdmission(self.record_s)
        self._count = CheckCount()

    def facts(self) -> dict[str, Any]:
        return self._count.facts()

    def assess(self, batch: Batch) -> Assessment:
        if self.ego not in batch.agents:
            self._count.without_reference += 1
            return self._admission.assess(batch, np.ones(len(batch.agents), np.bool_))
        ego = batch.agents.index(self.ego)
        reference = EgoReference(batch, ego, self.area_m, self.match_iou)
        others = [row for row in range(len(batch.agents)) if row != ego]
        admitted = self._admit(batch.time_ns, others, reference)
        self._count.add(reference.checks)
        return self._admission.assess(
            batch, members_of(batch, [ego, *admitted]), f"not among the agents that agree with {self.ego}"
        )

    @abstractmethod
    def _admit(self, time_ns: int, others: Sequence[int], reference: EgoReference) -> Sequence[int]:
        """The rows of the agents that are admitted besides the ego, of `others`."""


def check_agent(name: str, value: Any) -> None:
    """Raise ValueError for a value that cannot be the name of an agent."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{name}: found {value!r}, expected the name of an agent")


# -- agreement of boxes ------------------------------------------------------------------------------------------------


def matched_boxes(one: ClusterBoxes, other: ClusterBoxes, least_iou: float) -> tuple[Ints, Ints]:
    """Rows (k,) of `one` and (k,) of `other` that are matched one to one.

    The matching with the greatest sum of intersection over union of the outlines seen from above; of it, the pairs with
    `least_iou` or more, as in ROBOSAC (ICCV 2023; `associate_2_detections` in its code).
    """
    half = 0.5 * np.hypot(one.size[:, 0], one.size[:, 1])
    reach = 0.5 * np.hypot(other.size[:, 0], other.size[:, 1]).max(initial=0.0)
    i, j, dx, dy = neighbours(one.position, other.position, half + reach)
    offset = np.column_stack([dx, dy])
    iou = outline_iou(offset, one.size[i], one.yaw[i], other.size[j], other.yaw[j])
    overlapping = iou > 0.0
    i, j, iou = i[overlapping], j[overlapping], iou[overlapping]
    chosen = min_cost_matching(i, j, -iou) & (iou >= least_iou)
    return i[chosen], j[chosen]


def outline_iou(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats) -> Floats:
    """(p,) intersection over union of pairs of outlines, seen from above.

    offset: (p, 2) m, from the first to the second; size, other_size: (p, >= 2) m; yaw, other_yaw: (p,) rad. 0 where
    both have no area.
    """
    intersection = intersection_area(offset, size, yaw, other_size, other_yaw)
    union = size[:, 0] * size[:, 1] + other_size[:, 0] * other_size[:, 1] - intersection
    return np.divide(intersection, union, out=np.zeros(len(offset)), where=union > 0.0)


def jaccard(one: int, other: int, matched: int) -> float:
    """Share of the matched among all boxes of two sets of `one` and `other` boxes.

    0 if one of the sets is empty, as in ROBOSAC: nothing confirms the other one.
    """
    if not one or not other:
        return 0.0
    return matched / (one + other - matched)


def agreement(one: ClusterBoxes, other: ClusterBoxes, least_iou: float) -> float:
    """Jaccard index of two sets of boxes; see `matched_boxes` and `jaccard`."""
    matched, _ = matched_boxes(one, other, least_iou)
    return jaccard(len(one.yaw), len(other.yaw), len(matched))
