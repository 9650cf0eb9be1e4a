"""Which objects exist, as far as the agents that are believed report and see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.memory import AgentMemory, ObjectMemory
from mast_zenoh.integrity.visibility import FAR_M, RayEvidence, Sightings, silent_about

#: s, over which the votes about an object are averaged.
MEMORY_S = 0.5
#: Agents that must confirm an object at one time, so that it is believed when only suspended agents report it later.
WITNESSES = 2
#: s, for which it is believed then.
ESTABLISHED_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Existence:
    """What is believed of the c clusters of a batch.

    objects: their trust; kept: (n,) weights of their tracks, 0 for those of agents that are not believed
    """

    objects: ObjectTrust
    kept: Floats


class VoteMemory:
    """Follows objects, and averages the votes about them.

    memory_s: s, after which a vote counts 1/e; forget_s: s, after which an object without a cluster is forgotten

    objects: the memory; balance: (m,) of each remembered object, mean of votes for it less votes against it
    """

    def __init__(self, memory_s: float, forget_s: float = 2.0) -> None:
        self.objects = ObjectMemory(forget_s=forget_s)
        self.balance: Floats = np.zeros(0)
        self._memory_s = memory_s
        self._time_ns: int | None = None
        self._kept = 1.0  # share of the balance before

    def follow(self, time_ns: int, boxes: ClusterBoxes) -> Ints:
        """(c,) rows of the objects of a batch's clusters in the memory. boxes: of the clusters"""
        elapsed = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        self._kept = np.exp(-elapsed / self._memory_s)
        rows = self.objects.follow(time_ns, boxes.position, boxes.velocity)
        self.balance = self.objects.carry(self.balance, np.nan)
        return rows

    def vote(self, rows: Ints, balance: Floats) -> Floats:
        """(c,) mean votes for each object of a batch less votes against it, with those of this batch.

        rows: (c,) of the objects; balance: (c,) votes of this batch, which count in full for a new object
        """
        before = self.balance[rows]
        after: Floats = np.where(np.isnan(before), balance, self._kept * before + (1.0 - self._kept) * balance)
        self.balance[rows] = after
        return after


class ExistenceVotes:
    """Counts the votes about each object, with a short memory.

    An agent that reports an object, or whose rays end at it, votes for it; one that sees through its place votes
    against it, even if it reports it. The votes are weighted by trust.

    An object is withheld while the votes against it weigh more, or while only suspended agents report it, unless an
    agent that is not suspended has confirmed it together with another one, or it was known before the agents began to
    lie: then it stays for ESTABLISHED_S.

    agents: the memory of agents; it is updated by the caller
    """

    def __init__(self, agents: AgentMemory) -> None:
        self._agents = agents
        self._votes = VoteMemory(MEMORY_S)
        self._rows: Ints = np.zeros(0, np.int64)  # of the clusters of the last batch
        self._witnessed: Bools = np.zeros((0, 0), np.bool_)  # (m, k) which agents confirmed an object with another one
        self._known: Bools = np.zeros(0, np.bool_)  # whether nobody lied yet when it appeared
        self._claimed_ns = np.zeros(0, np.int64)  # time, ns, at which a believed agent reported it last

    def follow(self, time_ns: int, boxes: ClusterBoxes) -> Ints:
        """(c,) numbers of the objects of a batch's clusters, which they keep, see `ObjectMemory`."""
        self._rows = self._votes.follow(time_ns, boxes)
        objects = self._votes.objects
        self._known = objects.carry(self._known, False)
        self._claimed_ns = objects.carry(self._claimed_ns, time_ns)
        self._witnessed = self._agents.carry(objects.carry(self._witnessed, False), False, axis=1)
        return objects.number[self._rows]

    def count(
        self,
        batch: Batch,
        boxes: ClusterBoxes,
        seen: Sightings,
        rays: RayEvidence,
        impossible: Bools,
        believed: Bools,
        agent_rows: Ints,
    ) -> Existence:
        """The votes of a batch whose objects are followed.

        boxes, seen, rays: of its clusters, see `visibility`; impossible: (c, a) reports that are none
        believed: (k,) agents in the memory that are not suspended; agent_rows: (a,)
        """
        reported, rows, voter = batch.reported, self._rows, believed[agent_rows]
        clear, silent = rays.mostly_clear, silent_about(batch, boxes, seen, rays, FAR_M)
        claims = reported & ~clear & ~impossible & voter
        votes = voter.astype(np.float64)
        confirming, contradicting = (claims | silent) @ votes, clear @ votes
        balance = self._votes.vote(rows, confirming - contradicting)
        together = claims.sum(axis=1) >= WITNESSES
        self._witnessed[rows[:, None], agent_rows] |= claims & together[:, None]
        claimed = claims.any(axis=1)
        self._claimed_ns[rows] = np.where(claimed, batch.time_ns, self._claimed_ns[rows])
        recent = batch.time_ns - self._claimed_ns[rows] <= ESTABLISHED_S * 1e9
        established = self._known[rows] | (self._witnessed[rows] & believed).any(axis=1)
        withheld = (balance < 0.0) | ~(claimed | (established & recent))
        kept = claims | ~claims.any(axis=1, keepdims=True)  # else the object could not be tracked on
        objects = ObjectTrust(
            (1.0 + confirming) / (2.0 + confirming + contradicting),
            (seen.in_view | reported).sum(axis=1),
            claims.sum(axis=1),
            (clear & voter).sum(axis=1),
            withheld,
        )
        return Existence(objects, kept[batch.labels, batch.agent].astype(np.float64))

    def keep_known(self, before_ns: int) -> None:
        """Believe the objects that were known before a time, regardless of which agents report them later.

        For the moment in which an agent is suspended: what it reported before it began to lie is no lie.
        """
        self._known |= self._votes.objects.first_ns < before_ns
