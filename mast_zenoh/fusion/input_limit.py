"""Limits on the rows that fusion gets in a frame, so that no agent can delay it by a flood of objects.

The delay of fusion grows faster than the number of rows, and an attacker sends as many as it likes: so CP-FREEZER
(arXiv:2508.01062) makes perception up to 90 times slower. A limit alone would only move the harm, as the flood would
displace the rows of others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints, lowest_rows


class ClaimedObjects(NamedTuple):
    """Objects of an agent.

    ids: (n,) int64, of its tracks, unique; score: (n,) in [0, 1], as it claims
    beyond: number of rows that its message had besides, which are not used in any case
    """

    ids: Ints
    score: Floats
    beyond: int = 0


#: By agent, for each of its objects the frame since which it is kept.
Kept = Mapping[str, Mapping[int, int]]


class InputLimit(ABC):
    """Chooses which rows of a frame are fused; call `select` once in each frame."""

    #: number of rows that are kept in a frame at most; None: all are
    rows: int | None = None

    @abstractmethod
    def select(self, objects: Mapping[str, ClaimedObjects]) -> dict[str, Ints]:
        """(k,) rows to keep, ascending, of each agent that does not keep all; the other agents are left out.

        objects: by agent. The result does not depend on the order of agents or rows.
        """

    @property
    def kept(self) -> Kept:
        """The objects that were kept lately; never changed afterwards."""
        return {}

    def cut(self, kept: Mapping[int, int], objects: ClaimedObjects, rows: int) -> Ints:
        """(k,) rows, ascending, at most `rows`, of an agent's message with more: only these are decoded and checked.

        kept: of the agent, from `kept` after any earlier frame
        """
        raise NotImplementedError(f"{type(self).__name__} has `rows`, but does not define `cut`")


class NoInputLimit(InputLimit):
    """Keeps all rows."""

    def select(self, objects: Mapping[str, ClaimedObjects]) -> dict[str, Ints]:
        return {}


@dataclass(kw_only=True, eq=False)
class FairInput(InputLimit):
    """Shares a number of rows fairly between agents, and keeps the oldest objects of an agent that exceeds its share.

    Between agents: max-min fairness. An agent keeps all its rows, or its share. Of `a` agents, each keeps all rows up
    to `rows / a`, whatever the others send. Claims have no influence; agents are told apart by their wires, which the
    launcher assigns, so that one attacker is one agent.

    An agent that exceeds its share does not get all of it, but as many rows as it had when it last kept within it, and
    room for new ones; at least `rows / a`. So a flood costs about what its agent did before; the others share the rest.

    Within such an agent, only its own rows count. First come objects that were kept before, the oldest first; then new
    ones, by score. A part is reserved for new ones, so that a person who steps into the street is seen. What was kept
    longest never loses its place: a flood on the wire of an honest agent displaces no object that was there before, as
    far as the agent's share has room for these and for new ones.

    rows: number of rows that are kept in a frame at most
    reserve: part of the rows of an agent that exceeds its share that is for new objects, if there are any
    memory_frames: number of frames after which an object that was not kept is new again
    """

    rows: int = 2000
    reserve: float = 0.25
    memory_frames: int = 10

    def __post_init__(self) -> None:
        check("1 or more", rows=self.rows, memory_frames=self.memory_frames)
        check("0 to 1", reserve=self.reserve)
        self._frame = 0
        self._since: dict[str, dict[int, int]] = {}
        self._absent: dict[str, dict[int, int]] = {}  # objects that are not kept now, and the frame when they were last
        self._usual: dict[str, int] = {}  # rows of each agent when it last kept within its share

    @property
    def kept(self) -> Kept:
        return self._since

    def select(self, objects: Mapping[str, ClaimedObjects]) -> dict[str, Ints]:
        self._frame += 1
        selected: dict[str, Ints] = {}
        usual = {name: len(ids) for name, (ids, _, _) in objects.items() if len(ids)}
        counts = {name: count + objects[name].beyond for name, count in usual.items()}
        if sum(counts.values()) > self.rows:
            exceeding = {name for name, share in fair_shares(counts, self.rows).items() if share < counts[name]}
            for name in exceeding:
                most = max(self.rows // len(counts), self._with_reserve(self._usual.get(name, 0)))
                counts[name] = min(counts[name], most)
            for name, share in fair_shares(counts, self.rows).items():  # what these do not get is for the others
                if share < usual[name]:
                    selected[name] = self._best(self._since.get(name, {}), objects[name], share)
            usual = {name: count for name, count in usual.items() if name not in exceeding}
        self._usual |= usual
        self._remember({name: own.ids[selected.get(name, slice(None))] for name, own in objects.items()})
        return selected

    def cut(self, kept: Mapping[int, int], objects: ClaimedObjects, rows: int) -> Ints:
        return self._best(kept, objects, rows)

    def _with_reserve(self, count: int) -> int:
        """Rows of which as many as `count` are not for new objects."""
        return ceil(count / (1.0 - self.reserve)) if self.reserve < 1.0 else self.rows

    def _best(self, since: Mapping[int, int], objects: ClaimedObjects, count: int) -> Ints:
        """(count,) rows to keep of an agent with more, ascending. since: of its objects that were kept before"""
        ids, score, _ = objects
        old = rows_of(ids, np.array(sorted(since), np.int64))
        n_new = min(len(ids) - len(old), max(count - len(old), int(count * self.reserve)))
        rank = -score
        rank[old] = np.inf
        fresh = lowest_rows([rank, ids], n_new)
        if count - n_new < len(old):
            age = np.array([since[id_] for id_ in ids[old].tolist()], np.int64)
            old = old[np.lexsort([ids[old], age])[: count - n_new]]
        return np.sort(np.concatenate([old, fresh]))

    def _remember(self, kept: Mapping[str, Ints]) -> None:
        """Remember what is kept in this frame, and what was in the last ones."""
        frame, before = self._frame, self._since
        oldest = frame - self.memory_frames
        self._since = {}
        for name in before.keys() | kept.keys():
            known = before.get(name, {})
            since = {id_: known.get(id_, frame) for id_ in kept[name].tolist()} if name in kept else {}
            missing, absent = known.keys() - since.keys(), self._absent.pop(name, {})
            if missing:
                absent = {id_: absent.get(id_, frame - 1) for id_ in missing}
                absent = {id_: last for id_, last in absent.items() if last > oldest}
                since |= {id_: known[id_] for id_ in absent}
                self._absent[name] = absent
            if since:
                self._since[name] = since


#: Entries of the table with which known ids are found: a power of two.
_TABLE = 4096


def rows_of(ids: Ints, known: Ints) -> Ints:
    """(k,) rows, ascending, of those of n ids that are among m known ones, ascending; fast for few of many."""
    if not len(known):
        return np.zeros(0, np.int64)
    table = np.zeros(_TABLE, bool)
    table[known & (_TABLE - 1)] = True
    likely = np.flatnonzero(table[ids & (_TABLE - 1)])
    place = np.minimum(np.searchsorted(known, ids[likely]), len(known) - 1)
    return np.asarray(likely[known[place] == ids[likely]])


def fair_shares(counts: Mapping[str, int], rows: int) -> dict[str, int]:
    """Number of rows that each agent may keep: max-min fair, their sum at most `rows`.

    counts: rows of each agent. Agents with few rows keep all; the others get equally many, those that come first in the
    order of names one more if the rows cannot be divided.
    """
    shares, left = dict(counts), rows
    for served, name in enumerate(ordered := sorted(counts, key=lambda name: (counts[name], name))):
        level, remainder = divmod(left, len(counts) - served)
        if counts[name] > level:
            crowded = sorted(ordered[served:])
            return shares | {each: level + (rank < remainder) for rank, each in enumerate(crowded)}
        left -= counts[name]
    return shares
