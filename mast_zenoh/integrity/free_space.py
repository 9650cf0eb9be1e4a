"""Spoofing and removal, judged by the space that sensors sweep."""

from __future__ import annotations

import numpy as np

from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, Integrity, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.existence import VoteMemory
from mast_zenoh.integrity.reputation import BetaReputation
from mast_zenoh.integrity.visibility import FAR_M, rays_at, sightings, silent_about


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
    compares areas: `Sightings.fully_clear`, all of that space, misses a quarter of the phantoms in traffic. A dispute
    of one agent that reports and one that sees through counts against neither (TrustFlip, arXiv 2605.22122).

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
        self._record = BetaReputation(memory_s=record_s)
        self.reset()

    def reset(self) -> None:
        self._record.reset()
        self._votes = VoteMemory(self._memory_s, forget_s=self._memory_s)

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        reported = batch.reported
        rays = rays_at(batch, boxes, batch.views)
        clear, silent = rays.mostly_clear, silent_about(batch, boxes, seen, rays, self._range_m)
        claims = reported & ~clear
        confirming, contradicting = (claims | silent).sum(axis=1), clear.sum(axis=1)
        withheld = self._votes.vote(self._votes.follow(batch.time_ns, boxes), confirming - contradicting) < 0.0
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
