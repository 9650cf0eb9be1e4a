"""The sequence of rules of one wire, and profiles of rules."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.links.base import NANOSECONDS, Passage, Rule
from mast_zenoh.links.transit import MAX_COPIES

_BLOCK = 256
_MAX_DELAY_NS = 3_600_000_000_000


@dataclass(slots=True)
class PassageOutcome:
    """The result of one message's passage.

    leaving: the delivered copies, and the delay of each, s
    fates:   its effects (links.FATES), each with the index of the first rule that caused it, or, for a delay, of the
             rule with the largest share; "dropped" only if no copy is delivered
    delay_s: s, delay of the first delivered copy
    """

    leaving: list[tuple[Passage, float]]
    fates: dict[str, int] = field(default_factory=dict)
    delay_s: float = 0.0


class Chain:
    """The sequence of rules of one wire.

    rules: in order; the chain copies them
    rng:   returns the random stream of a purpose

    A link preserves the order of messages, whatever their delays, unless a rule allows overtaking. Every rule has its
    own random stream, named by its type and its index among rules of that type, and indexed by the number of the
    message on the wire, so its random numbers do not depend on other rules or on when it is active.
    """

    def __init__(self, rules: Sequence[Rule], rng: Callable[..., np.random.Generator]) -> None:
        self.rules = copy.deepcopy(list(rules))
        self.needs_size = any(rule.needs_size for rule in self.rules)
        self.needs_position = any(rule.needs_position for rule in self.rules)
        self.needs_frame = any(rule.needs_frame for rule in self.rules)
        self.needs_detections = any(rule.needs_detections for rule in self.rules)
        of_type: Counter[str] = Counter()
        self._draws: list[_Draws | None] = []
        for rule in self.rules:
            name = type(rule).__name__
            self._draws.append(
                _Draws(rule, rng, (name, of_type[name])) if type(rule).sample is not Rule.sample else None
            )
            of_type[name] += 1
        self._number = -1  # of the newest message
        self._last_ns = 0  # when the last message that does not overtake leaves
        self._delaying_rule = -1  # the rule that delays it

    def carry(self, passage: Passage) -> PassageOutcome:
        """Apply the rules to the next message on the wire."""
        self._number += 1
        fates: dict[str, int] = {}
        max_delay_ns = 0
        passages = [passage]
        for index, rule in enumerate(self.rules):
            if not rule.active(passage.time_ns):
                continue
            draws = self._draws[index]
            survivors: list[Passage] = []
            for incoming in passages:
                results = rule.apply(incoming, draws.row(self._number, incoming.copy) if draws else ())
                if incoming.copy == 0 and not (len(results) == 1 and results[0] is incoming):
                    if not results:
                        fates.setdefault("dropped", index)
                    elif rule.fate == "delayed":
                        if results[0].delay_ns - incoming.delay_ns > max_delay_ns:
                            max_delay_ns, fates["delayed"] = results[0].delay_ns - incoming.delay_ns, index
                    else:
                        fates.setdefault(rule.fate, index)
                survivors += results
            if len(survivors) > len(passages):
                survivors = _number_copies(survivors)
            passages = survivors
            if not passages:
                return PassageOutcome([], {"dropped": fates.get("dropped", index)})
        fates.pop("dropped", None)
        return self._leave(passages, fates)

    def _leave(self, passages: Sequence[Passage], fates: dict[str, int]) -> PassageOutcome:
        """Compute when each copy leaves."""
        leaving = []
        for passage in passages:
            due = passage.now_ns + passage.delay_ns
            if not passage.overtakes:
                if due < self._last_ns:
                    due = self._last_ns
                    if passage is passages[0]:
                        fates["delayed"] = self._delaying_rule
                elif "delayed" in fates:
                    self._delaying_rule = fates["delayed"]
                self._last_ns = due
            leaving.append((passage, min(due - passage.now_ns, _MAX_DELAY_NS) / NANOSECONDS))
        return PassageOutcome(leaving, fates, leaving[0][1])


def _number_copies(passages: Sequence[Passage]) -> list[Passage]:
    """Number the copies of one message uniquely; keeps at most MAX_COPIES of them."""
    used = {passage.copy for passage in passages}
    next_number = max(used) + 1
    numbered, numbers = [], set()
    for passage in passages[: MAX_COPIES + 1]:
        if passage.copy in numbers:
            passage = passage._replace(copy=next_number)
            next_number += 1
        numbers.add(passage.copy)
        numbered.append(passage)
    return numbered


class _Draws:
    """Random numbers of one rule by message number, generated in blocks."""

    def __init__(self, rule: Rule, rng: Callable[..., np.random.Generator], purpose: tuple[str, int]) -> None:
        self._rule = rule
        self._rng = rng
        self._purpose = purpose
        self._stream: np.random.Generator | None = None
        self._rows: list[list[float]] = []
        self._begin = 0  # number of the first row

    def row(self, number: int, copy_: int) -> Sequence[float]:
        """Random numbers for a copy of a message.

        Message numbers never decrease by more than a block.
        """
        if self._stream is None:
            self._stream = self._rng(*self._purpose)
        while number >= self._begin + len(self._rows):
            self._begin += len(self._rows)
            self._rows = self._rule.sample(self._stream, _BLOCK).tolist()
        row = self._rows[number - self._begin]
        return self._rule.sample_copy(row, self._rng(*self._purpose, number, copy_)) if copy_ else row


#: Rules for messages from an agent (up) and to it (down), as in a scenario.
PROFILES: dict[str, dict[str, list[dict[str, Any]]]] = {
    "perfect": {"up": [], "down": []},
    "wired": {
        direction: [
            dict(type="Bandwidth", bits_per_s=1e9, queue_s=0.05),
            dict(type="Delay", mean_s=0.002, jitter_s=0.0005, distribution="gamma"),
            dict(type="Loss", probability=1e-5),
        ]
        for direction in ("up", "down")
    },
    "wireless_v2x": {
        direction: [
            dict(type="RangeLimit", range_m=320.0),
            dict(type="Bandwidth", bits_per_s=6e6, queue_s=0.1),
            dict(type="GilbertElliott", good_to_bad=0.02, bad_to_good=0.4, loss_good=0.01, loss_bad=1.0),
            dict(type="Delay", mean_s=0.02, jitter_s=0.01, distribution="gamma"),
        ]
        for direction in ("up", "down")
    },
}


def profile(name: str) -> dict[str, list[dict[str, Any]]]:
    """A copy of a profile's rules by direction; raises ConfigurationError if unknown."""
    if name not in PROFILES:
        raise ConfigurationError(f"no link profile {name!r}{nearest(name, PROFILES)}")
    return copy.deepcopy(PROFILES[name])
