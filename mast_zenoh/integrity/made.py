"""MADE: how badly an agent's boxes match the ego's, tested against honest agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mast_zenoh.arrays.boxes import corners, intersection_area
from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.alarms import discoveries
from mast_zenoh.integrity.base import Assessment, Batch, ClusterBoxes, Integrity
from mast_zenoh.integrity.calibration import MATCH_LOSSES
from mast_zenoh.integrity.consensus import CheckCount, RecordedAdmission, check_agent, members_of, within_area
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import sightings

#: Most boxes of an agent that are matched, those with the best scores. The original limits all agents but the ego.
MAX_BOXES = 50


@dataclass(kw_only=True, eq=False)
class Made(Integrity):
    """Leaves out agents whose boxes match the ego's worse than honest agents' do.

    After the match loss of MADE, on tracks. MADE (Zhao et al., IROS 2024, arXiv:2310.11901; read in its code:
    shengyin1224/MADE db23118, match and bh_procedure). The match loss is the least total cost of matching the agent's
    boxes with the ego's, over the number of the ego's. A pair costs how much the agent's score is below the ego's, plus
    its generalised IoU loss, 0 to 2. One of the ego's boxes without a partner costs its score plus 1, if the agent has
    fewer boxes; boxes in excess cost nothing. A conformal p-value, (1 + number of calibration losses that are as great)
    / (1 + number of losses), says how rare a loss is among honest agents. The Benjamini-Hochberg procedure decides
    which agents of a batch are too rare.

    ego: name of the agent that is always trusted; in a batch without it, everybody is admitted
    alpha: false discovery rate in each batch
    dependent: whether alpha is divided by 1 + 1/2 + ... + 1/n for n agents (Benjamini and Yekutieli, Annals of
        Statistics 2001): all losses depend on the ego's boxes
    calibration: losses of honest agents; None: those of `calibration.MATCH_LOSSES`
    area_m: m, from the ego's sensor to each side of the square in which objects are compared
    record_s: s, after which an admission or exclusion counts 1/e in an agent's trust

    What differs from the original: it tests two losses of each agent, this and that of an autoencoder on features,
    which tracks lack; the procedure runs over both. Here it runs over the agents. The original constructs it with
    `dependency=True`, but the test that it then calls (`test_v2`) does not use the constant. It compares the ego's
    boxes with those of the ego fused with the agent. The tracks of both together always contain the ego's, which would
    hide everything but displacements, so that the agent's own boxes count, and of the ego's only those that the agent
    has in view or reports.

    Weaknesses: phantoms cost nothing, as boxes in excess are free; the ego decides; each batch is decided anew.
    """

    ego: str = "ego"
    alpha: float = 0.05
    dependent: bool = True
    calibration: Sequence[float] | None = None
    area_m: float = 32.0
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check_agent("ego", self.ego)
        check("more than 0 and less than 1", alpha=self.alpha)
        check("more than 0", area_m=self.area_m)
        check("True or False", dependent=self.dependent)
        self._losses = calibration_losses(MATCH_LOSSES if self.calibration is None else self.calibration)
        # Slow to import: done before the first batch.
        import scipy.optimize  # noqa: F401

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
        losses = match_losses(batch, ego, self.area_m)
        tested = np.flatnonzero(~np.isnan(losses))
        rejected = discovered(conformal(losses[tested], self._losses), self.alpha, dependent=self.dependent)
        self._count.add(len(tested))
        excluded = members_of(batch, tested[rejected].tolist())
        return self._admission.assess(batch, ~excluded, f"its boxes match those of {self.ego} too badly")


def calibration_losses(losses: Sequence[float]) -> Floats:
    """(n,) sorted losses.

    Raises ValueError unless there is one at least, and all are numbers of 0 or more.
    """
    try:
        values = np.sort(np.asarray(losses, np.float64))
    except (TypeError, ValueError):
        raise ValueError(f"calibration: found {losses!r}, expected losses of honest agents, numbers") from None
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or values[0] < 0.0:
        raise ValueError("calibration: found none, or one that is not finite or below 0, expected losses, 0 or more")
    return values


def match_losses(batch: Batch, ego: int, area_m: float) -> Floats:
    """(a,) match loss of each agent with the ego; NaN if there is nothing to match.

    NaN for the ego itself. ego: row of the agent; area_m: m, see `Made`
    """
    view, score = batch.views[ego], batch.states.score
    rows = _best_rows(batch, ego, view, area_m)
    own = _boxes(batch, rows)
    expected = _expected(batch, own) | batch.reported[batch.labels[rows]]
    losses = np.full(len(batch.agents), np.nan)
    for agent in range(len(batch.agents)):
        wanted = expected[:, agent]
        if agent != ego and wanted.any():
            others = _best_rows(batch, agent, view, area_m)
            losses[agent] = match_loss(_boxes(batch, others), score[others], own.select(wanted), score[rows[wanted]])
    return losses


def _best_rows(batch: Batch, agent: int, view: SweptView | None, area_m: float) -> Ints:
    """The MAX_BOXES tracks of an agent with the best scores in the area of a sensor."""
    rows = np.flatnonzero(batch.agent == agent)
    rows = rows[within_area(_boxes(batch, rows), view, area_m)]
    # By score, then by place, so that the order of the rows does not matter.
    order = np.lexsort((*batch.states.position[rows, :2].T, -batch.states.score[rows]))
    return rows[order[:MAX_BOXES]]


def _boxes(batch: Batch, rows: Ints) -> ClusterBoxes:
    states = batch.states
    return ClusterBoxes(states.position[rows], states.velocity[rows], states.size[rows], states.yaw[rows])


def _expected(batch: Batch, boxes: ClusterBoxes) -> Bools:
    """(c, a) boxes that each agent has in view; without a view, all of them."""
    seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views).in_view
    unknown = np.array([view is None for view in batch.views], np.bool_)
    return np.asarray(seen | unknown)


def match_loss(boxes: ClusterBoxes, score: Floats, target: ClusterBoxes, target_score: Floats) -> float:
    """Least cost of matching m boxes with n targets, 1 or more, over n.

    score: (m,), target_score: (n,), 0 to 1
    """
    from scipy.optimize import linear_sum_assignment

    m, n = len(score), len(target_score)
    cost = np.zeros((max(m, n), max(m, n)))
    cost[m:, :n] = 1.0 + target_score
    i, j = (rows.ravel() for rows in np.indices((m, n)))
    lacking = np.maximum(target_score[j] - score[i], 0.0)
    cost[:m, :n] = (lacking + giou_loss(boxes.select(i), target.select(j))).reshape(m, n)
    return float(cost[linear_sum_assignment(cost)].sum() / n)


def giou_loss(one: ClusterBoxes, other: ClusterBoxes) -> Floats:
    """(p,) generalised IoU loss of pairs of boxes in three dimensions, 0 to 2.

    1 - IoU + share of the enclosing box that is in neither. The enclosing box is the smallest upright one around both
    (Rezatofighi et al., CVPR 2019). 1 for two boxes without volume.
    """
    offset = (other.position - one.position)[:, :2]
    half, other_half = 0.5 * one.size[:, 2], 0.5 * other.size[:, 2]
    top, other_top = one.position[:, 2] + half, other.position[:, 2] + other_half
    bottom, other_bottom = one.position[:, 2] - half, other.position[:, 2] - other_half
    area = np.zeros(len(offset))
    reach = np.hypot(one.size[:, 0], one.size[:, 1]) + np.hypot(other.size[:, 0], other.size[:, 1])
    near = np.hypot(offset[:, 0], offset[:, 1]) <= 0.5 * reach
    area[near] = intersection_area(offset[near], one.size[near], one.yaw[near], other.size[near], other.yaw[near])
    common = area * np.maximum(np.minimum(top, other_top) - np.maximum(bottom, other_bottom), 0.0)
    union = one.size.prod(axis=1) + other.size.prod(axis=1) - common
    around = enclosing_area(one, other, offset) * (np.maximum(top, other_top) - np.minimum(bottom, other_bottom))
    iou = np.divide(common, union, out=np.zeros(len(offset)), where=union > 0.0)
    empty = np.divide(around - union, around, out=np.zeros(len(offset)), where=around > 0.0)
    return np.asarray(1.0 - iou + np.clip(empty, 0.0, 1.0))


def enclosing_area(one: ClusterBoxes, other: ClusterBoxes, offset: Floats) -> Floats:
    """(p,) m²: smallest rectangle around the outlines of two boxes.

    offset: (p, 2) m, from the first to the second. A side of the smallest rectangle lies along a side of the convex
    hull: a side of one of the boxes, or one that joins a corner of each.
    """
    points = np.concatenate([corners(one.size, one.yaw), corners(other.size, other.yaw) + offset[:, None]], axis=1)
    x, y = points[..., None, 0], points[..., None, 1]
    # A corner of each, and one side of each box: the other side gives the same rectangle.
    first, second = np.array([*product(range(4), range(4, 8)), (0, 1), (4, 5)]).T
    side = points[:, second] - points[:, first]
    length = np.hypot(side[..., 0], side[..., 1])
    cos, sin = (np.divide(side[..., axis], length, out=np.zeros_like(length), where=length > 0.0) for axis in (0, 1))
    cos, sin = cos[:, None], sin[:, None]
    area = np.ptp(x * cos + y * sin, axis=1) * np.ptp(y * cos - x * sin, axis=1)
    area = np.where(length > 0.0, area, np.inf).min(axis=1)
    return np.where(np.isfinite(area), area, 0.0)


def conformal(values: Floats, calibration: Floats) -> Floats:
    """(n,) conformal p-values: how rare as great a loss is among honest agents.

    calibration: (k,) losses of honest agents, sorted
    """
    as_great = len(calibration) - np.searchsorted(calibration, values, side="left")
    return np.asarray((as_great + 1.0) / (len(calibration) + 1.0))


def discovered(p: Floats, alpha: float, *, dependent: bool) -> Bools:
    """(n,) which p-values the Benjamini-Hochberg procedure rejects.

    alpha: false discovery rate; dependent: see `Made`
    """
    harmonic = float((1.0 / np.arange(1, len(p) + 1)).sum())
    return discoveries(p, alpha / harmonic if dependent and harmonic else alpha)
