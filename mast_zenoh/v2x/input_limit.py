"""Limits on the rows that fusion gets in a frame, so that no agent can delay it by a flood of objects.

The delay of fusion grows faster than the number of rows, and an attacker sends as many as it likes: so CP-FREEZER
(arXiv:2508.01062) makes perception up to 90 times slower. A limit alone would only move the harm, as the flood would
displace the rows of others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, row_order, within_runs


class Selection(NamedTuple):
    """The rows that fusion gets.

    rows:    (k,) int64, rows to keep, ascending
    agents:  (a,) int64, agents with rows in this frame, ascending
    dropped: (a,) int64, number of rows of each that are left out
    """

    rows: Ints
    agents: Ints
    dropped: Ints


class InputLimit(ABC):
    """Chooses which rows of a frame are fused; call it once in each frame."""

    @abstractmethod
    def select(self, agent: Ints, ids: Ints, score: Floats) -> Selection:
        """The rows to keep, of n rows in any order.

        agent: (n,) int64, the same number for an agent in every frame
        ids:   (n,) int64, of objects, unique within an agent
        score: (n,) in [0, 1], as the agents claim
        """

    @abstractmethod
    def reset(self) -> None:
        """Forget all frames."""


class NoInputLimit(InputLimit):
    """Keeps all rows."""

    def select(self, agent: Ints, ids: Ints, score: Floats) -> Selection:
        agents = np.unique(agent)
        return Selection(np.arange(len(agent), dtype=np.int64), agents, np.zeros(len(agents), np.int64))

    def reset(self) -> None:
        pass


@dataclass(kw_only=True, eq=False)
class FairInput(InputLimit):
    """Shares a number of rows fairly between agents, and keeps the oldest objects of an agent that exceeds its share.

    Between agents: max-min fairness. An agent keeps all its rows, or at least as many as any other. Of `a` agents, each
    keeps all rows up to `rows / a`, whatever the others send. Claims have no influence; agents are told apart by their
    wires, which the launcher assigns, so that one attacker is one agent.

    Within an agent that exceeds its share, only its own rows count. First come objects that were kept before, the
    oldest first; then new ones, by score. A part of the share is reserved for new ones, so that a person who steps into
    the street is seen. What was kept longest never loses its place: a flood on the wire of an honest agent can displace
    its youngest objects only. Ids that an agent uses twice come last and are not kept.

    rows: number of rows that are kept in a frame at most
    reserve: part of an exceeded share that is kept for new objects, if there are any
    memory_frames: number of frames after which an object that was not kept is new again
    """

    rows: int = 2000
    reserve: float = 0.25
    memory_frames: int = 10

    def __post_init__(self) -> None:
        check("1 or more", rows=self.rows, memory_frames=self.memory_frames)
        check("0 to 1", reserve=self.reserve)
        self.reset()

    def reset(self) -> None:
        self._frame = 0
        self._kept = KeptObjects.none()

    def select(self, agent: Ints, ids: Ints, score: Floats) -> Selection:
        self._frame += 1
        order = row_order(ids, agent)
        agent, ids, score = agent[order], ids[order], score[order]
        start = _starts(agent)
        count = np.diff(start, append=len(agent))
        share = fair_shares(count, self.rows)
        since = self._kept.since(agent, ids, start, self._frame)
        repeated = _repeated(agent, ids)
        kept = np.ones(len(agent), bool)
        exceeded = share < count
        if exceeded.any():
            crowded = np.repeat(exceeded, count).nonzero()[0]
            kept[crowded] = False
            best = self._best(share[exceeded], count[exceeded], since[crowded], score[crowded], repeated[crowded])
            kept[crowded[best]] = True
        self._remember(agent, ids, since, kept & ~repeated)
        dropped = count - np.add.reduceat(kept, start, dtype=np.int64) if len(start) else count
        return Selection(np.sort(order[kept]), agent[start], dropped)

    def _best(self, share: Ints, count: Ints, since: Ints, score: Floats, repeated: Bools) -> Ints:
        """(k,) rows to keep, of agents that exceed their shares.

        share, count: (e,) of e agents, whose rows follow each other, sorted by id; since, score, repeated: (r,)
        """
        start = np.cumsum(count) - count
        seniority = np.minimum(self._frame - since, _OLDEST)  # 0 for new objects
        place = np.where(repeated, _OLDEST + 1, _OLDEST - seniority).astype(np.uint16)
        disbelief = ((1.0 - np.clip(score, 0.0, 1.0)) * 65535.0).astype(np.uint16)
        owner = np.repeat(np.arange(len(count)), count)
        # Numbers of 16 bits are sorted ten times as fast as those of 64. Ties keep the order of ids.
        order = np.lexsort((disbelief, place, owner.astype(np.uint16) if len(count) <= 65536 else owner))
        known, new = (
            np.add.reduceat(member & ~repeated, start, dtype=np.int64) for member in (seniority > 0, seniority == 0)
        )
        n_new = np.minimum(new, np.maximum(share - known, (share * self.reserve).astype(np.int64)))
        n_known = np.minimum(known, share - n_new)
        return np.asarray(order[np.concatenate([_runs(start, n_known), _runs(start + known, n_new)])])

    def _remember(self, agent: Ints, ids: Ints, since: Ints, kept: Bools) -> None:
        """Remember the rows that are kept, and what was kept in the last frames."""
        now = np.full(np.count_nonzero(kept), self._frame)
        current = KeptObjects(agent[kept], ids[kept], since[kept], now)
        self._kept = self._kept.updated(current, self._frame - self.memory_frames)


#: Seniority of objects, in frames, is compared up to this.
_OLDEST = 65534


def _runs(start: Ints, length: Ints) -> Ints:
    """Numbers from start to start + length - 1 for each of e runs, one run after the other: (sum of length,)."""
    return np.repeat(start, length) + within_runs(length)


def _starts(agent: Ints) -> Ints:
    """(a,) first row of each agent, of sorted rows (n,)."""
    return np.flatnonzero(np.diff(agent, prepend=agent[:1] - 1))


def _repeated(agent: Ints, ids: Ints) -> Bools:
    """(n,) whether a sorted row has the agent and the id of another."""
    equal = (agent[1:] == agent[:-1]) & (ids[1:] == ids[:-1])
    repeated = np.zeros(len(agent), bool)
    repeated[1:] |= equal
    repeated[:-1] |= equal
    return repeated


def fair_shares(count: Ints, rows: int) -> Ints:
    """(a,) number of rows that each agent may keep: max-min fair, their sum at most `rows`.

    count: (a,) rows of each agent. Agents with few rows keep all; the others get equally many, those that come first
    one more if the rows cannot be divided.
    """
    ascending = count.argsort(kind="stable")
    sorted_count = count[ascending]
    left = rows - (np.cumsum(sorted_count) - sorted_count)  # for this agent and those with more rows
    sharing = len(count) - np.arange(len(count))
    exceeds = sorted_count > left // sharing
    if not exceeds.any():
        return count.copy()
    first = int(exceeds.argmax())
    level, remainder = divmod(int(left[first]), int(sharing[first]))
    share = np.minimum(count, level)
    share[np.flatnonzero(count > level)[:remainder]] += 1
    return share


@dataclass(frozen=True, slots=True, eq=False)
class KeptObjects:
    """Objects that were kept in the last frames, sorted by agent and id, no pair twice.

    agent, ids: (m,) int64; since: (m,) frame since which each is kept; last: (m,) frame in which it was kept last
    """

    agent: Ints
    ids: Ints
    since_frame: Ints
    last_frame: Ints

    @classmethod
    def none(cls) -> KeptObjects:
        """No objects."""
        return cls(*np.zeros((4, 0), np.int64))

    def find(self, agent: Ints, ids: Ints, start: Ints) -> tuple[Ints, Bools]:
        """Rows (n,) of objects, sorted by agent and id, and whether they are there (n,).

        start: (a,) first row of each agent
        """
        row = np.zeros(len(ids), np.int64)
        of_agent = agent[start]
        lows, highs = (np.searchsorted(self.agent, of_agent, side).tolist() for side in ("left", "right"))
        ends = np.append(start[1:], len(ids))[: len(start)].tolist()
        for begin, end, low, high in zip(start.tolist(), ends, lows, highs, strict=True):
            row[begin:end] = low + np.searchsorted(self.ids[low:high], ids[begin:end])
        row = np.minimum(row, max(len(self.ids) - 1, 0))
        if len(self.ids) == 0:
            return row, np.zeros(len(ids), bool)
        return row, np.asarray((self.ids[row] == ids) & (self.agent[row] == agent))

    def since(self, agent: Ints, ids: Ints, start: Ints, frame: int) -> Ints:
        """(n,) frame since which each object is kept; `frame` for new ones. See `find`."""
        row, known = self.find(agent, ids, start)
        since = np.full(len(ids), frame)
        since[known] = self.since_frame[row[known]]
        return since

    def updated(self, current: KeptObjects, oldest: int) -> KeptObjects:
        """These objects and those of the current frame.

        oldest: frame; what was not kept since then is forgotten
        """
        refreshed = current.find(self.agent, self.ids, _starts(self.agent))[1]
        others = ~refreshed & (self.last_frame > oldest)
        if not others.any():
            return current
        columns = [
            np.concatenate([new, old[others]])
            for new, old in (
                (current.agent, self.agent),
                (current.ids, self.ids),
                (current.since_frame, self.since_frame),
                (current.last_frame, self.last_frame),
            )
        ]
        order = row_order(columns[1], columns[0])
        return KeptObjects(*(column[order] for column in columns))
