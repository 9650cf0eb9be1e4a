"""Rules that drop messages: independent loss, bursts, range, partition."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import Passage, Rule, expect, expect_probability


class Loss(Rule):
    """Drops messages independently. probability: that a message is lost."""

    fate = "dropped"
    draws = True

    def __init__(self, probability: float, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_probability("probability", probability)
        self.probability = probability

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Uniform random numbers (count, 1)."""
        return rng.random((count, 1))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return () if row[0] < self.probability else (passage,)


class GilbertElliott(Rule):
    """Drops messages in bursts: the channel is good or bad, and changes at random.

    good_to_bad, bad_to_good: probabilities of a change from one message to the next
    loss_good, loss_bad:      probabilities that a message is lost in either state

    A bad period lasts 1 / bad_to_good messages on average; a message, including the first, meets a bad channel with
    probability good_to_bad / (good_to_bad + bad_to_good). The channel also changes while the rule is inactive.
    Source: E. N. Gilbert, "Capacity of a burst-noise channel", BSTJ 39 (1960); E. O. Elliott, "Estimates of error rates
    for codes on burst-noise channels", BSTJ 42 (1963).
    """

    fate = "dropped"
    draws = True

    def __init__(
        self,
        good_to_bad: float,
        bad_to_good: float,
        loss_good: float = 0.0,
        loss_bad: float = 1.0,
        at: float = 0.0,
        until: float | None = None,
    ) -> None:
        super().__init__(at, until)
        expect_probability("good_to_bad", good_to_bad)
        expect_probability("bad_to_good", bad_to_good)
        expect_probability("loss_good", loss_good)
        expect_probability("loss_bad", loss_bad)
        self.change = (good_to_bad, bad_to_good)
        self.loss = (loss_good, loss_bad)
        self._bad: bool | None = None

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 2): 1 for a bad channel, else 0; and a uniform random number."""
        samples = rng.random((count, 2))
        for row in samples:
            if self._bad is None:
                total = sum(self.change)
                self._bad = bool(total and row[0] < self.change[0] / total)
            elif row[0] < self.change[self._bad]:
                self._bad = not self._bad
            row[0] = self._bad
        return samples

    def sample_copy(self, row: Sequence[float], rng: np.random.Generator) -> Sequence[float]:
        """Random numbers for a copy, with the channel state of its message."""
        return (row[0], float(rng.random()))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return () if row[1] < self.loss[int(row[0])] else (passage,)


class RangeLimit(Rule):
    """Drops every message while the link's agent is out of range of every gateway.

    range_m:  m, range of a gateway
    gateways: positions (k, 3) m, world frame; in a scenario, the static agents by default

    The agent's position is its newest pose from an earlier frame; before the first pose, nothing is dropped.
    """

    fate = "dropped"
    needs_position = True

    def __init__(
        self,
        range_m: float,
        gateways: tuple[tuple[float, float, float], ...] = (),
        at: float = 0.0,
        until: float | None = None,
    ) -> None:
        super().__init__(at, until)
        expect("range_m", range_m, range_m > 0.0, "more than 0 m")
        expect("gateways", "none", len(gateways) > 0, "the position (x, y, z) of at least one")
        self.range_m = range_m
        self.gateways = np.array(gateways, np.float64)
        expect("gateways", gateways, bool(np.isfinite(self.gateways).all()), "finite positions (x, y, z)")

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        if passage.position is None:
            return (passage,)
        nearest = np.linalg.norm(self.gateways - passage.position, axis=1).min()
        return (passage,) if nearest <= self.range_m else ()


class Cut(Rule):
    """Drops every message: a partition."""

    fate = "dropped"

    def __init__(self, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return ()
