"""Rules by which messages do not come at all: independent loss, bursts, range, partition."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import Passage, Rule, expect, expect_part


class Loss(Rule):
    """Each message is lost by itself. probability: that it is."""

    fate = "dropped"
    draws = True

    def __init__(self, probability: float, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_part("probability", probability)
        self.probability = probability

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 1) uniform from 0 to 1."""
        return rng.random((count, 1))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        return () if row[0] < self.probability else (passage,)


class GilbertElliott(Rule):
    """Messages are lost in bursts: the channel is good or bad, and changes between two messages.

    good_to_bad, bad_to_good: probabilities of a change from one message to the next
    loss_good, loss_bad:      probabilities that a message is lost in either state

    A bad time lasts 1 / bad_to_good messages on average; good_to_bad / (good_to_bad + bad_to_good) of all messages
    meet a bad channel, also the first one. The channel changes whether or not the rule is active.
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
        expect_part("good_to_bad", good_to_bad)
        expect_part("bad_to_good", bad_to_good)
        expect_part("loss_good", loss_good)
        expect_part("loss_bad", loss_bad)
        self.change = (good_to_bad, bad_to_good)
        self.loss = (loss_good, loss_bad)
        self._bad: bool | None = None

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 2): 1 for each message that meets a bad channel, and a uniform number from 0 to 1."""
        drawn = rng.random((count, 2))
        for row in drawn:
            if self._bad is None:
                total = sum(self.change)
                self._bad = bool(total and row[0] < self.change[0] / total)
            elif row[0] < self.change[self._bad]:
                self._bad = not self._bad
            row[0] = self._bad
        return drawn

    def again(self, row: Sequence[float], rng: np.random.Generator) -> Sequence[float]:
        """A copy meets the channel of its message."""
        return (row[0], float(rng.random()))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        return () if row[1] < self.loss[int(row[0])] else (passage,)


class RangeLimit(Rule):
    """Nothing comes through while the link's agent is out of reach of every gateway.

    range_m:  m, how far a gateway reaches
    gateways: (k, 3) m, world frame, where they are; in a scenario they are the agents that stand, unless given

    The agent is where its newest pose of an earlier frame says; before there is one, everything comes through.
    """

    fate = "dropped"
    locates = True

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
        """See `Rule.apply`."""
        if passage.position is None:
            return (passage,)
        nearest = np.linalg.norm(self.gateways - passage.position, axis=1).min()
        return (passage,) if nearest <= self.range_m else ()


class Cut(Rule):
    """Nothing comes through: a partition."""

    fate = "dropped"

    def __init__(self, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        return ()
