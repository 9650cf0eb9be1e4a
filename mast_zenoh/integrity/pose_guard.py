"""PoseGuard: the fused picture near the ego against the ego's own sight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.consensus import CheckCount, check_agent
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.integrity.visibility import current, seen_through


@dataclass(kw_only=True, eq=False)
class PoseGuard(Integrity):
    """Compares fused objects near the ego with the ego's own.

    After PoseGuard, on tracks, from summaries only. PoseGuard (Zhang, Zhang, Mao: From Stealthy Data Fabrication to
    Unsafe Driving, arXiv:2605.01301, section 5.3.2). There is no public code, and only summaries of the paper were at
    hand: the order of the steps is theirs, every number here is chosen. First, only objects in the safety region are
    checked. Second, an object is genuine if its fused box agrees with the ego's own. Third, where they disagree, the
    agents are found that move it.

    An object in the region is fused as the median of all its tracks. If the ego reports it too, and both centres are
    within `agree_m`, it is genuine. Otherwise, tracks farther than that from the ego's are left out of its fusion. If
    the ego does not report it, and sees through its place, it is withheld.

    ego: name of the agent that is always trusted; in a batch without it, or without its view, nothing is checked
    region_m: m, from the ego on the ground, radius of the safety region
    agree_m: m, on the ground, within which two positions agree
    record_s: s, after which a track that agreed or was left out counts 1/e in its agent's trust

    What cannot be carried over: the third step of the original compares the features of each agent at an object, and
    tracks have none; here it compares positions.

    Weaknesses: displacements below `agree_m` pass, and those from 0.3 m on are within the noise of honest tracks; no
    object outside the region, or that the ego does not see, is checked; the ego decides. Agents are never excluded.
    """

    ego: str = "ego"
    region_m: float = 30.0
    agree_m: float = 0.5
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check_agent("ego", self.ego)
        check("more than 0", region_m=self.region_m, agree_m=self.agree_m)
        self.reset()

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)
        self._count = CheckCount()
        self._left_out = self._withheld = 0

    def facts(self) -> dict[str, Any]:
        counted = {"tracks_left_out": self._left_out, "objects_withheld": self._withheld}
        return self._count.facts() | counted

    def assess(self, batch: Batch) -> Assessment:
        reported, c = batch.reported, batch.clusters
        left_out, unseen = np.zeros_like(reported), np.zeros(c, np.bool_)
        checked = np.zeros(c, np.bool_)
        ego = batch.agents.index(self.ego) if self.ego in batch.agents else -1
        view = batch.views[ego] if ego >= 0 else None
        if view is None:
            self._count.without_reference += 1
        else:
            boxes = ClusterBoxes.of(batch)
            place = view.view.position[:2]
            checked = np.hypot(*(boxes.position[:, :2] - place).T) <= self.region_m
            left_out = moved_tracks(batch, boxes, ego, self.agree_m) & checked[:, None]
            unseen = checked & ~reported[:, ego] & seen_through(boxes, current([view]))[:, 0]
            self._count.add(int(checked.sum()))
            self._left_out += int(left_out.sum())
            self._withheld += int(unseen.sum())
        claims = reported & ~left_out & ~unseen[:, None]
        own = reported[:, ego] if ego >= 0 else np.zeros(c, np.bool_)
        compared = reported & checked[:, None] & (own | unseen)[:, None]
        mean = self._record.update(batch, compared & claims, compared & ~claims)
        members, confirming = reported.sum(axis=1), claims.sum(axis=1)
        objects = ObjectTrust.of(members, confirming, members - confirming, unseen)
        return Assessment(batch.weights(claims), AgentTrust.of(mean), objects)


def moved_tracks(batch: Batch, boxes: ClusterBoxes, ego: int, agree_m: float) -> Bools:
    """(c, a) tracks that move the fused object away from the ego's own.

    boxes: fused; ego: row of the agent; agree_m: m, see `PoseGuard`
    """
    shared = batch.reported[:, ego]
    own: Floats = batch.states.position[batch.member[:, ego], :2] if len(batch.states) else np.zeros((0, 2))
    fused_off = np.hypot(*(boxes.position[:, :2] - own).T)
    off = np.hypot(*np.moveaxis(batch.states.position[batch.member, :2] - own[:, None], -1, 0))
    return np.asarray(batch.reported & (shared & (fused_off > agree_m))[:, None] & (off > agree_m))
