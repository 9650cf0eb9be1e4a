"""Voting: enough of the agents that should see an object must report it."""

from __future__ import annotations

import numpy as np

from mast_zenoh.integrity.base import AgentTrust, Assessment, Batch, Integrity, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.reputation import BetaReputation
from mast_zenoh.integrity.visibility import FAR_M, sightings


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

    def __init__(self, *, k: int = 2, range_m: float = FAR_M, record_s: float = 30.0) -> None:
        if k < 1:
            raise ValueError(f"k: found {k}, expected 1 or more")
        if not range_m > 0.0:
            raise ValueError(f"range_m: found {range_m}, expected more than 0")
        self._k = k
        self._range_m = range_m
        self._record = BetaReputation(memory_s=record_s)

    def assess(self, batch: Batch) -> Assessment:
        boxes = ClusterBoxes.of(batch)
        seen = sightings(boxes.position, boxes.size, boxes.yaw, batch.views)
        reported = batch.reported
        expected = reported | (seen.in_view & (seen.distance <= boxes.sight_range(self._range_m)[:, None]))
        confirming, contradicting, should = (votes.sum(axis=1) for votes in (reported, seen.fully_clear, expected))
        withheld = confirming - contradicting < np.minimum(self._k, should)
        corroborated = ~withheld & (confirming > 1)
        upheld, refuted = (
            (reported & each[:, None]).sum(axis=0, dtype=np.float64) for each in (corroborated, withheld)
        )
        mean = self._record.update(batch.time_ns, batch.agents, upheld, refuted)
        trust = (1.0 + confirming) / (2.0 + np.maximum(should, confirming + contradicting))
        return Assessment(
            None, AgentTrust.of(mean), ObjectTrust(trust, should, confirming, contradicting, np.asarray(withheld))
        )

    def reset(self) -> None:
        self._record.reset()
