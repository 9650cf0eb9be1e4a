"""The rules of one wire in their order: what becomes of each of its messages, and when it leaves."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.links.base import NANOSECONDS, Passage, Rule
from mast_zenoh.links.copies import MOST_COPIES

_BLOCK = 256
_LONGEST_NS = 3_600_000_000_000


@dataclass(slots=True)
class Outcome:
    """What became of one message.

    leaving: the copies that come through, and after how many seconds each
    fates:   what happened to it (links.FATES), each with the index of the rule that did it: the first one, and for a
             delay the one that gave most of it; "dropped" only where no copy comes through
    delay_s: s, by how much the first copy that comes through is late
    """

    leaving: list[tuple[Passage, float]]
    fates: dict[str, int] = field(default_factory=dict)
    delay_s: float = 0.0


class Chain:
    """The rules of one wire.

    rules: in their order; the chain makes copies of its own
    rng:   gives the random stream of a purpose

    A link is a pipe: what comes first leaves first, however short the delay of the second, unless a rule lets it be
    overtaken. Every rule has a stream of its own, named by its type and its place among those of its type, and takes
    from it by the number of the message on the wire: what it draws depends on no other rule, nor on when it is active.
    """

    def __init__(self, rules: Sequence[Rule], rng: Callable[..., np.random.Generator]) -> None:
        self.rules = copy.deepcopy(list(rules))
        self.weighs = any(rule.weighs for rule in self.rules)
        self.locates = any(rule.locates for rule in self.rules)
        self.displaces = any(rule.displaces for rule in self.rules)
        of_type: Counter[str] = Counter()
        self._draws: list[_Draws | None] = []
        for rule in self.rules:
            name = type(rule).__name__
            self._draws.append(_Draws(rule, rng, (name, of_type[name])) if rule.draws else None)
            of_type[name] += 1
        self._number = -1  # of the newest message
        self._last_ns = 0  # when the last one leaves that does not overtake
        self._holder = -1  # the rule that it is late by

    def carry(self, passage: Passage) -> Outcome:
        """What becomes of the next message on the wire."""
        self._number += 1
        fates: dict[str, int] = {}
        most = 0
        passages = [passage]
        for index, rule in enumerate(self.rules):
            if not rule.active(passage.time_ns):
                continue
            draws = self._draws[index]
            survivors: list[Passage] = []
            for before in passages:
                became = rule.apply(before, draws.row(self._number, before.copy) if draws else ())
                if before.copy == 0 and not (len(became) == 1 and became[0] is before):
                    if not became:
                        fates.setdefault("dropped", index)
                    elif rule.fate == "delayed":
                        if became[0].delay_ns - before.delay_ns > most:
                            most, fates["delayed"] = became[0].delay_ns - before.delay_ns, index
                    else:
                        fates.setdefault(rule.fate, index)
                survivors += became
            if len(survivors) > len(passages):
                survivors = _numbered(survivors)
            passages = survivors
            if not passages:
                return Outcome([], {"dropped": fates.get("dropped", index)})
        fates.pop("dropped", None)
        return self._leave(passages, fates)

    def _leave(self, passages: Sequence[Passage], fates: dict[str, int]) -> Outcome:
        """When each copy leaves."""
        leaving = []
        for passage in passages:
            due = passage.now_ns + passage.delay_ns
            if not passage.overtakes:
                if due < self._last_ns:
                    due = self._last_ns
                    if passage is passages[0]:
                        fates["delayed"] = self._holder
                elif "delayed" in fates:
                    self._holder = fates["delayed"]
                self._last_ns = due
            leaving.append((passage, min(due - passage.now_ns, _LONGEST_NS) / NANOSECONDS))
        return Outcome(leaving, fates, leaving[0][1])


def _numbered(passages: Sequence[Passage]) -> list[Passage]:
    """Copies of one message, each with a number of its own that those which had one keep; no more than there may be."""
    used = {passage.copy for passage in passages}
    fresh = max(used) + 1
    found, seen = [], set()
    for passage in passages[: MOST_COPIES + 1]:
        if passage.copy in seen:
            passage = passage._replace(copy=fresh)
            fresh += 1
        seen.add(passage.copy)
        found.append(passage)
    return found


class _Draws:
    """What one rule draws, by the number of the message; drawn in blocks."""

    def __init__(self, rule: Rule, rng: Callable[..., np.random.Generator], purpose: tuple[str, int]) -> None:
        self._rule = rule
        self._rng = rng
        self._purpose = purpose
        self._stream: np.random.Generator | None = None
        self._rows: list[list[float]] = []
        self._begin = 0  # number of the first row

    def row(self, number: int, copy_: int) -> Sequence[float]:
        """The draws of a copy of a message; numbers never go back by more than a block."""
        if self._stream is None:
            self._stream = self._rng(*self._purpose)
        while number >= self._begin + len(self._rows):
            self._begin += len(self._rows)
            self._rows = self._rule.sample(self._stream, _BLOCK).tolist()
        row = self._rows[number - self._begin]
        return self._rule.again(row, self._rng(*self._purpose, number, copy_)) if copy_ else row
