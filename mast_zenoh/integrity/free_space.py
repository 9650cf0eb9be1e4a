"""Spoofing and removal, judged by the space that sensors sweep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, Integrity, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.memory import ObjectMemory
from mast_zenoh.integrity.record import Record
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import BEFORE_M, BEHIND_M, FAR_M, OUTSIDE_M, OWN_M, Sightings, sightings

#: m, by which the position of an honest track may be wrong.
_ERROR_M = OUTSIDE_M
#: Sample points of the space around a box, in halves of its length and width, and in half heights of the box.
_ACROSS, _UP = (-1.0, -0.5, 0.0, 0.5, 1.0), (-0.3, 0.4)


class FreeSpace(Integrity):
    """Withholds objects whose place more agents see through than report or see occupied.

    The idea of CAD (Zhang et al., USENIX Security 2024): an object inside free space is spoofed, and occupied space
    that an agent reports no object in shows a removal. A claim that its agent's own sweep contradicts does not count,
    and its track is left out of the fusion. An agent whose rays end at an object counts for it, even if it reports
    none: then its silence is evidence of a removal and counts against it, as do claims in free space.

    memory_s: s, after which what was seen of an object counts 1/e: an object that was seen through stays withheld for
        a while where nobody can tell, and one that was confirmed is kept when rays pass it for a moment
    range_m: m, up to which silence about a car that the rays end at counts against an agent; for smaller objects, the
        distance at which they give as many returns
    record_s: s, after which evidence counts 1/e in an agent's trust

    An agent sees through an object if most of the box and of 0.8 m around it is in the agent's free space. CAD, too,
    compares areas: `Sightings.swept`, all of that space, misses a quarter of the phantoms in traffic. A dispute of one
    agent that reports and one that sees through counts against neither (TrustFlip, arXiv 2605.22122).

    Weaknesses: a liar that forges its view, too, needs as many honest views against it as liars report the object; a
    phantom that no other agent sees the place of is accepted, as are displacements below the tolerance; liars that
    claim free space at an object remove it where they outnumber its witnesses. Agents are never excluded.
    """

    def __init__(self, *, memory_s: float = 2.0, range_m: float = FAR_M, record_s: float = 30.0) -> None:
        for name, value in (("memory_s", memory_s), ("range_m", range_m)):
            if not value > 0.0:
                raise ValueError(f"{name}: found {value}, expected more than 0")
        self._memory_s = memory_s
        self._range_m = range_m
        self._record = Record(memory_s=record_s)
        self.reset()

    def reset(self) -> None:
        self._record.reset()
        self._objects = ObjectMemory(forget_s=self._memory_s)
        self._balance: Floats = np.zeros(0)  # of each object: mean of agents for it less agents against it
        self._last_ns: int | None = None

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        reported = batch.reported
        swept = sees_through(batch, boxes, batch.views)
        claims = reported & ~swept
        silent = occupied(boxes, seen, batch.views) & ~reported & ~swept
        silent &= seen.distance <= boxes.sight_range(self._range_m)[:, None]
        confirming, contradicting = (claims | silent).sum(axis=1), swept.sum(axis=1)
        withheld = self._remembered(batch.time_ns, boxes, confirming - contradicting) < 0.0
        # A removal needs two agents that report the object: a lone claim cannot accuse those that are silent about it.
        removed = silent & (claims.sum(axis=1) > 1)[:, None]
        spoofed = reported & withheld[:, None]
        agreed = claims & (confirming > 1)[:, None] & ~withheld[:, None]
        mean = self._record.update(
            batch.time_ns,
            batch.agents,
            agreed.sum(axis=0, dtype=np.float64),
            (spoofed | removed).sum(axis=0, dtype=np.float64),
        )
        trust = (1.0 + confirming) / (2.0 + confirming + contradicting)
        expected = (seen.in_view | reported).sum(axis=1)
        objects = ObjectTrust(trust, expected, confirming, contradicting, withheld)
        # A cluster that nobody's view supports keeps all members: it is tracked on, in case it is real.
        kept = claims | ~claims.any(axis=1, keepdims=True)
        weights = kept[batch.labels, batch.agent].astype(np.float64)
        return Assessment(weights, AgentTrust.of(mean), objects)

    def _remembered(self, time_ns: int, boxes: ClusterBoxes, balance: Ints) -> Floats:
        """(c,) the balance of each object with what is remembered of it; that of a new one as it is.

        balance: (c,) agents for each object less agents against it in this batch
        """
        elapsed = 0.0 if self._last_ns is None else (time_ns - self._last_ns) * 1e-9
        self._last_ns = time_ns
        rows = self._objects.follow(time_ns, boxes.position, boxes.velocity)
        share = np.exp(-elapsed / self._memory_s)
        self._balance = self._objects.carry(self._balance, np.nan)
        before = self._balance[rows]
        self._balance[rows] = np.where(np.isnan(before), balance, share * before + (1.0 - share) * balance)
        return self._balance[rows]


def occupied(boxes: ClusterBoxes, seen: Sightings, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether the rays of the agent's sensor towards the centre of a visible box end there."""
    ends = np.zeros(seen.in_view.shape, np.bool_)
    half = 0.5 * np.hypot(boxes.size[:, 0], boxes.size[:, 1])
    for column, view in enumerate(views):
        if view is None or view.free.size == 0 or len(half) == 0:
            continue
        distance, free, _ = view.ranges(boxes.position)
        with np.errstate(invalid="ignore"):
            ends[:, column] = (free >= distance - half - BEFORE_M) & (free <= distance + half + BEHIND_M)
    return np.asarray(ends & seen.in_view)


def seen_through(boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether the agent's sensor sees through a box and the space around it, up to FAR_M.

    A box that is displaced by _ERROR_M or less, e, still hides a share of w / (w + e) of its surroundings, w half its
    width, from any side. It is seen through if less than half as much is hidden.

    A view that is older than the boxes shows the places where they were then.
    """
    through = np.zeros((len(boxes.yaw), len(views)), np.bool_)
    points = _points(boxes)
    half_width = 0.5 * np.minimum(boxes.size[:, 0], boxes.size[:, 1])
    needed = 1.0 - 0.5 * half_width / (half_width + _ERROR_M)
    for column, view in enumerate(views):
        if view is None or view.free.size == 0 or len(points) == 0:
            continue
        moved = boxes.velocity * view.age_s
        distance, free, _ = view.ranges((points - moved[:, None, :]).reshape(-1, 3))
        with np.errstate(invalid="ignore"):
            share = (free > distance + BEHIND_M).reshape(points.shape[:2]).mean(axis=1)
        away = np.hypot(*((boxes.position - moved)[:, :2] - view.view.position[:2]).T)
        through[:, column] = (share > needed) & (away > OWN_M) & (away <= FAR_M)
    return through


def sees_through(batch: Batch, boxes: ClusterBoxes, views: Sequence[SweptView | None]) -> Bools:
    """(c, a) whether the agent's sensor sees through an object: through its own track of it, if it reports one.

    Another agent's track must not make an honest claim look like a lie.
    """
    through = seen_through(boxes, views)
    for column, view in enumerate(views):
        rows = batch.member[:, column]
        reported = rows >= 0
        if view is None or not reported.any():
            continue
        states = batch.states.select(rows[reported])
        own = ClusterBoxes(states.position, states.velocity, states.size, states.yaw)
        through[reported, column] = seen_through(own, (view,))[:, 0]
    return through


def _points(boxes: ClusterBoxes) -> Floats:
    """(c, p, 3) sample points of boxes and the space around them, m, world frame."""
    along, across, up = (part.ravel() for part in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    half = 0.5 * boxes.size[:, None, :]
    x, y = along * (half[..., 0] + _ERROR_M), across * (half[..., 1] + _ERROR_M)
    c, s = np.cos(boxes.yaw)[:, None], np.sin(boxes.yaw)[:, None]
    local = np.stack([c * x - s * y, s * x + c * y, up * half[..., 2]], axis=-1)
    return np.asarray(boxes.position[:, None, :] + local)
