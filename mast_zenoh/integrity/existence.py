"""Which objects exist, as far as the agents that are believed report and see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ObjectTrust
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.free_space import occupied, sees_through
from mast_zenoh.integrity.memory import ObjectMemory
from mast_zenoh.integrity.visibility import FAR_M, MAX_AGE_S, Sightings

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
        self._objects = ObjectMemory()
        self._balance = np.zeros(0)
        self._established: Bools = np.zeros(0, np.bool_)
        self._claimed_ns = np.zeros(0, np.int64)  # time, ns, at which a believed agent reported it last
        self._time_ns: int | None = None

    def count(self, batch: Batch, boxes: ClusterBoxes, seen: Sightings, weight: Floats) -> Existence:
        """The votes of a batch.

        boxes, seen: of its clusters; weight: (a,) >= 0, of each agent's vote; 0: suspended
        """
        views = tuple(None if view is None or abs(view.age_s) > MAX_AGE_S else view for view in batch.views)
        reported, through = batch.reported, sees_through(batch, boxes, views)
        claims = reported & ~through & (weight > 0.0)
        silent = occupied(boxes, seen, views) & ~reported & ~through
        silent &= seen.distance <= boxes.sight_range(FAR_M)[:, None]
        confirming, contradicting = (claims | silent) @ weight, through @ weight
        rows = self._follow(batch.time_ns, boxes, confirming - contradicting)
        self._established[rows] |= claims.sum(axis=1) >= WITNESSES
        claimed = claims.any(axis=1)
        self._claimed_ns[rows] = np.where(claimed, batch.time_ns, self._claimed_ns[rows])
        recent = batch.time_ns - self._claimed_ns[rows] <= ESTABLISHED_S * 1e9
        supported = claimed | (self._established[rows] & recent)
        withheld = (self._balance[rows] < 0.0) | ~supported
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
        self._established |= self._objects.first_ns < before_ns

    def _follow(self, time_ns: int, boxes: ClusterBoxes, balance: Floats) -> Ints:
        """Rows (c,) of the clusters' objects in the memory, whose balance of votes is updated."""
        elapsed = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        rows = self._objects.follow(time_ns, boxes.position, boxes.velocity)
        share = np.exp(-elapsed / MEMORY_S)
        self._balance = self._objects.carry(self._balance, np.nan)
        self._established = self._objects.carry(self._established, False)
        self._claimed_ns = self._objects.carry(self._claimed_ns, time_ns)
        before = self._balance[rows]
        self._balance[rows] = np.where(np.isnan(before), balance, share * before + (1.0 - share) * balance)
        return rows
