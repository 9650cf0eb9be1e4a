"""What a message is to the network, and what a rule is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats

NANOSECONDS = 1e9
LONGEST_S = 600.0  #: no rule holds a message up for longer


class Passage(NamedTuple):
    """One copy of a message on its way through a link: what the rules know of it, and what they have done to it.

    time_ns:  scene time of its passage, that of the newest clock
    now_ns:   the time on the clock by which delays run: the same in lock-step, the wall clock in real time
    size:     bytes of the message; 0 unless a rule of the link weighs it
    position: (3,) m, world frame, where the link's agent was in an earlier frame; None where nobody knows
    referenced: it has a frame of reference, in which its columns are
    copy:     0 for the message itself, from 1 for copies made on the way
    delay_ns: by how much it is late so far
    overtakes: it does not wait for those before it
    skew_ns:  by how much the time in its header is wrong
    shift, turn: m (x, y) and rad by which its frame of reference is wrong
    flips:    places of the bits that are flipped, as parts (0 to 1) of its length
    """

    time_ns: int
    now_ns: int
    size: int = 0
    position: Floats | None = None
    referenced: bool = False
    copy: int = 0
    delay_ns: int = 0
    overtakes: bool = False
    skew_ns: int = 0
    shift: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0
    flips: tuple[float, ...] = ()


class Rule(ABC):
    """Acts on the messages of one wire for a time.

    at, until: s of scene time from which on it acts, and before which it ends; None: to the end

    A rule may remember what it has done (a queue, the state of a channel): every wire has rules of its own. Its draws
    are given to it: a row for every message that comes on the wire, whether or not the rule is asked about that one, so
    that no rule changes what another one draws. Raises ValueError for parameters that make no sense.
    """

    fate: ClassVar[str]  #: what it does to a message: one of links.FATES
    draws: ClassVar[bool] = False  #: it needs a row of draws for every message
    weighs: ClassVar[bool] = False  #: it needs the size of the message
    locates: ClassVar[bool] = False  #: it needs the position of the agent
    displaces: ClassVar[bool] = False  #: it needs to know whether there is a frame of reference

    def __init__(self, at: float = 0.0, until: float | None = None) -> None:
        expect("at", at, math.isfinite(at) and at >= 0.0, "0 s or more")
        if until is not None:
            expect("until", until, math.isfinite(until) and until > at, f"more than `at`, which is {at}, or None")
        self.at, self.until = at, until
        self._from_ns = round(at * NANOSECONDS)
        self._before_ns = None if until is None else round(until * NANOSECONDS)

    def active(self, time_ns: int) -> bool:
        """Whether it acts at a scene time."""
        return self._from_ns <= time_ns and (self._before_ns is None or time_ns < self._before_ns)

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, k) draws for the next `count` messages of the wire."""
        return np.empty((count, 0))

    def again(self, row: Sequence[float], rng: np.random.Generator) -> Sequence[float]:
        """The draws for a further copy of the message whose draws are `row`."""
        drawn: Sequence[float] = self.sample(rng, 1)[0].tolist()
        return drawn

    def restamps_s(self, duration_s: float) -> float:
        """s, by how much `skew_ns` may be off zero in a run of that length; a rule that sets it says so."""
        return 0.0

    @abstractmethod
    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """What becomes of a message: nothing, itself, itself changed, or several of it, itself first."""


def expect(name: str, value: object, holds: bool, expected: str) -> None:
    """Raises ValueError where a parameter is not as expected."""
    if not holds:
        raise ValueError(f"{name}: found {value}, expected {expected}")


def expect_part(name: str, value: float) -> None:
    """Raises ValueError where a probability is none."""
    expect(name, value, 0.0 <= value <= 1.0, "0 to 1")


def expect_duration(name: str, value: float) -> None:
    """Raises ValueError where a time in seconds is negative or absurd."""
    expect(name, value, 0.0 <= value <= LONGEST_S, f"0 to {LONGEST_S:.0f} s")
