"""What a stage remembers of objects and agents from batch to batch.

Both memories give each object or agent a row. The rows of the next batch may be others: a stage's own columns, named
with their first values, are taken along, and `carry` does so with any array.

    memory = ObjectMemory(doubt=0.0)                    # one value for each remembered object
    rows = memory.follow(time_ns, boxes.position, boxes.velocity)
    memory.of.doubt[rows] += doubt                      # of the clusters of this batch

How often each agent's claims have held up.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ClusterBoxes

#: Most objects that are remembered besides those of the latest batch.
MAX_OBJECTS = 4096
#: Most agents that are remembered besides those of the latest batch.
MAX_AGENTS = 1024

_Number = TypeVar("_Number", bound=np.generic)


#: First value of a column of times: that of the batch, ns.
NOW = "now"


class _Rows:
    """Rows that are kept, dropped and added, with columns of values.

    columns: by name, the value of a row that was not there before, a number, several or NOW

    origin: (m,) int64, the row of each before the last update; -1: new;  of: the columns, (m, ...) each
    """

    def __init__(self, **columns: Any) -> None:
        self._columns = columns
        firsts = {name: np.asarray(0 if first == NOW else first) for name, first in columns.items()}
        self.of = SimpleNamespace(**{name: np.zeros((0, *each.shape), each.dtype) for name, each in firsts.items()})
        self.origin: Ints = np.zeros(0, np.int64)
        self._unchanged = False  # whether all rows are the same as before the last update

    def __len__(self) -> int:
        return len(self.origin)

    def carry(self, values: NDArray[_Number], new: Any, axis: int = 0) -> NDArray[_Number]:
        """Values of the rows before the last update, as values of the rows after it.

        values: any shape, with the rows before along `axis`; new: value of rows that were not there
        """
        if self._unchanged and values.shape[axis] == len(self.origin):
            return values
        values = np.moveaxis(values, axis, 0)
        after = np.full((len(self.origin), *values.shape[1:]), new, values.dtype)
        known = self.origin >= 0
        after[known] = values[self.origin[known]]
        return np.moveaxis(after, 0, axis)

    def _carry_columns(self, time_ns: int) -> None:
        if self._unchanged:
            return
        for name, first in self._columns.items():
            setattr(self.of, name, self.carry(getattr(self.of, name), time_ns if first == NOW else first))


#: m, in the bird's-eye view, greatest distance of a cluster from the predicted position: the clusterer's radius, as
#: tracks of one object at one time are not farther apart.
GATE_M = 2.0
#: m/s², by which an object may accelerate; widens the gate with the time without a cluster.
ACCELERATION_MPS2 = 4.5


class ObjectMemory(_Rows):
    """Follows clusters from batch to batch by predicted position, the nearest first.

    forget_s: s, after which an object without a cluster is forgotten
    columns: of the caller, see `_Rows`; besides them there are

    position: (m, 3) m, velocity: (m, 3) m/s, of the last cluster of each object
    first_ns, seen_ns: (m,) ns, times of its first and its last cluster; frames: (m,) number of batches with one
    number: (m,) that it keeps for ever, and no other object has
    """

    def __init__(self, *, forget_s: float = 2.0, **columns: Any) -> None:
        nowhere = (0.0, 0.0, 0.0)
        super().__init__(position=nowhere, velocity=nowhere, first_ns=NOW, seen_ns=NOW, frames=0, number=-1, **columns)
        self._next = 0
        self._forget_ns = round(forget_s * 1e9)

    def follow(self, time_ns: int, position: Floats, velocity: Floats) -> Ints:
        """(c,) row of each cluster at `time_ns`, which is not before that of the last call.

        position: (c, 3) m, velocity: (c, 3) m/s. The order of the clusters decides between equal distances.
        """
        of, c = self.of, len(position)
        kept = _newest(of.seen_ns, time_ns - self._forget_ns, MAX_OBJECTS)
        gap = (time_ns - of.seen_ns[kept]) * 1e-9
        predicted = of.position[kept] + of.velocity[kept] * gap[:, None]
        gate = GATE_M + 0.5 * ACCELERATION_MPS2 * gap * gap
        i, j, dx, dy = neighbours(predicted, position, gate)
        # In space: a liar's box above an object must not take its number.
        distance = np.sqrt(dx**2 + dy**2 + (position[j, 2] - predicted[i, 2]) ** 2)
        near = distance <= gate[i]
        i, j = i[near], j[near]
        chosen = greedy_matching(i, j, distance[near])
        rows = np.full(c, -1, np.int64)
        rows[j[chosen]] = i[chosen]
        new = np.flatnonzero(rows < 0)
        rows[new] = len(kept) + np.arange(len(new))
        self._unchanged = len(kept) == len(self) and not len(new)
        self.origin = np.concatenate([kept, np.full(len(new), -1)])
        self._carry_columns(time_ns)
        of.position[rows], of.velocity[rows], of.seen_ns[rows] = position, velocity, time_ns
        of.frames[rows] += 1
        of.number[rows[new]] = self._next + np.arange(len(new))
        self._next += len(new)
        return rows

    def age_s(self, time_ns: int) -> Floats:
        """(m,) s since the first cluster of each object."""
        return np.asarray((time_ns - self.of.first_ns) * 1e-9)


#: s, over which the votes about an object are averaged.
VOTE_MEMORY_S = 0.5


class VoteMemory:
    """Follows objects, and averages the votes about them.

    memory_s: s, after which a vote counts 1/e; forget_s: s, after which an object without a cluster is forgotten

    objects: the memory, with the column balance, mean of votes for an object less votes against it
    """

    def __init__(self, memory_s: float, forget_s: float = 2.0, **columns: Any) -> None:
        self.objects = ObjectMemory(forget_s=forget_s, balance=np.nan, **columns)
        self._memory_s = memory_s
        self._time_ns: int | None = None
        self._kept = 1.0  # share of the balance before

    def follow(self, time_ns: int, boxes: ClusterBoxes) -> Ints:
        """(c,) rows of the objects of a batch's clusters in the memory. boxes: of the clusters"""
        elapsed = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        self._kept = np.exp(-elapsed / self._memory_s)
        return self.objects.follow(time_ns, boxes.position, boxes.velocity)

    def vote(self, rows: Ints, balance: Floats) -> Floats:
        """(c,) mean votes for each object of a batch less votes against it, with those of this batch.

        rows: (c,) of the objects; balance: (c,) votes of this batch, which count in full for a new object
        """
        before = self.objects.of.balance[rows]
        after: Floats = np.where(np.isnan(before), balance, self._kept * before + (1.0 - self._kept) * balance)
        self.objects.of.balance[rows] = after
        return after


class AgentMemory(_Rows):
    """Remembers agents by name.

    forget_s: s, after which an absent agent is forgotten;  columns: of the caller, see `_Rows`

    names: of the m agents that are remembered;  rows: (a,) of the agents of the last batch
    """

    def __init__(self, *, forget_s: float = 60.0, **columns: Any) -> None:
        super().__init__(seen_ns=NOW, **columns)
        self.names: tuple[str, ...] = ()
        self.rows: Ints = np.zeros(0, np.int64)
        self._forget_ns = round(forget_s * 1e9)

    def meet(self, time_ns: int, names: tuple[str, ...]) -> Ints:
        """(a,) row of each agent in a batch at `time_ns`."""
        kept = _newest(self.of.seen_ns, time_ns - self._forget_ns, MAX_AGENTS)
        self._unchanged = len(kept) == len(self.names)
        remembered = [self.names[row] for row in kept.tolist()]
        row_of = {name: row for row, name in enumerate(remembered)}
        new = [name for name in names if name not in row_of]
        row_of |= {name: len(remembered) + row for row, name in enumerate(new)}
        self._unchanged = self._unchanged and not new
        self.names = (*remembered, *new)
        self.origin = np.concatenate([kept, np.full(len(new), -1, np.int64)])
        self._carry_columns(time_ns)
        self.rows = np.array([row_of[name] for name in names], np.int64)
        self.of.seen_ns[self.rows] = time_ns
        return self.rows


def _newest(seen_ns: Ints, since_ns: int, most: int) -> Ints:
    """Rows that were seen at `since_ns` or later, at most the `most` newest, in their order."""
    rows = np.flatnonzero(seen_ns >= since_ns)
    if len(rows) > most:
        rows = np.sort(rows[np.argsort(-seen_ns[rows], kind="stable")[:most]])
    return rows


#: s between independent pieces of evidence about one object: consecutive offsets of two honest tracks correlate at 0.8
#: at 10 Hz, which leaves about one independent sample a second.
INDEPENDENT_S = 1.0


class BetaReputation:
    """Beta record of each agent: claims upheld and refuted, with forgetting.

    The mean is (1 + upheld) / (2 + upheld + refuted), so that a new agent has 0.5.

    record_s: s, after which a claim counts 1/e
    """

    def __init__(self, *, record_s: float) -> None:
        check("more than 0", record_s=record_s)
        self._record_s = record_s
        self._agents = AgentMemory(counts=(0.0, 0.0))
        self._last_ns: int | None = None

    def mean(self, names: tuple[str, ...]) -> Floats:
        """(a,) the present mean of agents; 0.5 for unknown ones."""
        known = dict(zip(self._agents.names, _mean(self._agents.of.counts).tolist(), strict=True))
        return np.array([known.get(name, 0.5) for name in names], np.float64)

    def update(self, batch: Batch, upheld: Bools, refuted: Bools) -> Floats:
        """(a,) the mean after a batch.

        upheld: (k, a), refuted: (m, a) claims of its agents, such as those about its clusters. Each counts for the time
        since the last batch, at most INDEPENDENT_S, so that an object counts once a second however often it is
        reported.
        """
        elapsed = 0.0 if self._last_ns is None else (batch.time_ns - self._last_ns) * 1e-9
        self._last_ns = batch.time_ns
        rows = self._agents.meet(batch.time_ns, batch.agents)
        counts = self._agents.of.counts
        counts *= np.exp(-elapsed / self._record_s)
        claims = np.column_stack([upheld.sum(axis=0), refuted.sum(axis=0)])
        counts[rows] += claims * min(elapsed / INDEPENDENT_S, 1.0)
        return _mean(counts)[rows]


def _mean(counts: Floats) -> Floats:
    """(m,) means of (m, 2) counts of upheld and refuted claims."""
    return np.asarray((1.0 + counts[:, 0]) / (2.0 + counts.sum(axis=1)))
