"""Votes of agents about objects: by reports (KOfN) and by the space that sensors sweep (FreeSpace)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, ClusterBoxes, Integrity, ObjectTrust
from mast_zenoh.integrity.memory import BetaReputation, VoteMemory
from mast_zenoh.integrity.visibility import FAR_M, rays_at, sightings, silent_about


@dataclass(kw_only=True, eq=False)
class KOfN(Integrity):
    """Withholds objects that fewer than k of the agents that should see them report.

    The k-out-of-n rule of distributed detection (Viswanathan and Varshney, Proceedings of the IEEE 1997, section III).
    An agent votes for an object that it reports, and against one whose place it sees through. The votes for an object
    must exceed those against it by k, or, if fewer than k agents should see it, those of all of them.

    k: number of agents
    range_m: m, up to which an agent must see a car in its field of view that nothing hides, and smaller objects up to
        the distance at which they give as many returns
    record_s: s, after which the outcome of an agent's vote counts 1/e in its trust

    Weaknesses: an object that one agent alone should see needs no other witness; k colluding agents are believed, and
    k - 1 silent ones of n = k hide an object; each frame is decided anew, so that objects flicker. Without views every
    object is accepted. Agents are never excluded.
    """

    k: int = 2
    range_m: float = FAR_M
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check("1 or more", k=self.k)
        check("more than 0", range_m=self.range_m)
        self.reset()

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        reported = batch.reported
        expected = reported | (seen.in_view & (seen.distance <= boxes.sight_range(self.range_m)[:, None]))
        confirming, contradicting, should = (votes.sum(axis=1) for votes in (reported, seen.fully_clear, expected))
        withheld = confirming - contradicting < np.minimum(self.k, should)
        corroborated = ~withheld & (confirming > 1)
        mean = self._record.update(batch, reported & corroborated[:, None], reported & withheld[:, None])
        trust = (1.0 + confirming) / (2.0 + np.maximum(should, confirming + contradicting))
        return Assessment(
            None, AgentTrust.of(mean), ObjectTrust(trust, should, confirming, contradicting, np.asarray(withheld))
        )

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)


@dataclass(kw_only=True, eq=False)
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

    memory_s: float = 2.0
    range_m: float = FAR_M
    record_s: float = 30.0

    def __post_init__(self) -> None:
        check("more than 0", memory_s=self.memory_s, range_m=self.range_m)
        self.reset()

    def reset(self) -> None:
        self._record = BetaReputation(record_s=self.record_s)
        self._votes = VoteMemory(self.memory_s, forget_s=self.memory_s)

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        reported = batch.reported
        rays = rays_at(batch, boxes, batch.views)
        clear, silent = rays.mostly_clear, silent_about(batch, boxes, seen, rays, self.range_m)
        claims = reported & ~clear
        confirming, contradicting = (claims | silent).sum(axis=1), clear.sum(axis=1)
        withheld = self._votes.vote(self._votes.follow(batch.time_ns, boxes), confirming - contradicting) < 0.0
        # A removal needs two agents that report the object: a lone claim cannot accuse those that are silent about it.
        removed = silent & (claims.sum(axis=1) > 1)[:, None]
        spoofed = reported & withheld[:, None]
        agreed = claims & (confirming > 1)[:, None] & ~withheld[:, None]
        mean = self._record.update(batch, agreed, spoofed | removed)
        expected = (seen.in_view | reported).sum(axis=1)
        objects = ObjectTrust.of(expected, confirming, contradicting, withheld)
        return Assessment(batch.weights(claims), AgentTrust.of(mean), objects)
