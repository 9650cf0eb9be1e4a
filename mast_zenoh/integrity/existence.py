"""Which objects exist, as far as the agents that are believed report and see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.memory import ObjectMemory
from mast_zenoh.integrity.visibility import FAR_M, MAX_AGE_S, Sightings, free_and_occupied

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

    def update(self, time_ns: int, boxes: ClusterBoxes, balance: Floats) -> Ints:
        """(c,) rows of the clusters' objects in the memory, after the votes of a batch.

        boxes: of its clusters; balance: (c,) votes for each less votes against it; of a new object, they count in full
        """
        elapsed = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        rows = self.objects.follow(time_ns, boxes.position, boxes.velocity)
        share = np.exp(-elapsed / self._memory_s)
        self.balance = self.objects.carry(self.balance, np.nan)
        before = self.balance[rows]
        self.balance[rows] = np.where(np.isnan(before), balance, share * before + (1.0 - share) * balance)
        return rows


class ExistenceVotes:
    """Counts the votes about each object, with a short memory.

    An agent that reports an object, or whose rays end at it, votes for it; one that sees through its place votes
    against it, even if it reports it. The votes are weighted by trust.

    An object is withheld while the votes against it weigh more, or while only suspended agents report it, unless
    WITNESSES agents have confirmed it before, or it was known before the agent began to lie: then it stays for
    ESTABLISHED_S. Views that are too old to be held against their agents have no vote.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all objects."""
        self._votes = VoteMemory(MEMORY_S)
        self._established: Bools = np.zeros(0, np.bool_)
        self._claimed_ns = np.zeros(0, np.int64)  # time, ns, at which a believed agent reported it last

    def count(self, batch: Batch, boxes: ClusterBoxes, seen: Sightings, weight: Floats) -> Existence:
        """The votes of a batch.

        boxes, seen: of its clusters; weight: (a,) >= 0, of each agent's vote; 0: suspended
        """
        views = tuple(None if view is None or abs(view.age_s) > MAX_AGE_S else view for view in batch.views)
        reported = batch.reported
        through, silent = free_and_occupied(batch, boxes, seen, views, FAR_M)
        claims = reported & ~through & (weight > 0.0)
        confirming, contradicting = (claims | silent) @ weight, through @ weight
        rows = self._votes.update(batch.time_ns, boxes, confirming - contradicting)
        self._established = self._votes.objects.carry(self._established, False)
        self._claimed_ns = self._votes.objects.carry(self._claimed_ns, batch.time_ns)
        self._established[rows] |= claims.sum(axis=1) >= WITNESSES
        claimed = claims.any(axis=1)
        self._claimed_ns[rows] = np.where(claimed, batch.time_ns, self._claimed_ns[rows])
        recent = batch.time_ns - self._claimed_ns[rows] <= ESTABLISHED_S * 1e9
        supported = claimed | (self._established[rows] & recent)
        withheld = (self._votes.balance[rows] < 0.0) | ~supported
        believed = reported & (weight > 0.0) & ~through
        kept = believed | ~believed.any(axis=1, keepdims=True)  # else the object could not be tracked on
        objects = ObjectTrust(
            (1.0 + confirming) / (2.0 + confirming + contradicting),
            (seen.in_view | reported).sum(axis=1),
            claims.sum(axis=1),
            (through & (weight > 0.0)).sum(axis=1),
            withheld,
        )
        return Existence(objects, kept[batch.labels, batch.agent].astype(np.float64))

    def vouch(self, before_ns: int) -> None:
        """Believe the objects that were known before a time, whoever reports them from now on.

        For the moment in which an agent is suspended: what it reported before it began to lie is no lie.
        """
        self._established |= self._votes.objects.first_ns < before_ns
