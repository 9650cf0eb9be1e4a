"""Rules that delay, lose and repeat messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import (
    MAX_DELAY_S,
    NANOSECONDS,
    Passage,
    RandomRule,
    Rule,
    expect,
    expect_duration,
    expect_probability,
)

QUEUE_S = 0.5  #: s, default of `Bandwidth`, also of the fault

Distribution = Literal["constant", "normal", "gamma", "lognormal"]


class Delay(Rule):
    """Delays messages by a random time.

    mean_s, jitter_s: s, mean and standard deviation of the delay
    distribution:     "constant" (no jitter), "gamma", "lognormal", or "normal", truncated below 0 (mean_s and
                      jitter_s are those before truncation)
    """

    fate = "delayed"

    def __init__(
        self,
        mean_s: float,
        jitter_s: float = 0.0,
        distribution: Distribution = "gamma",
        at: float = 0.0,
        until: float | None = None,
    ) -> None:
        super().__init__(at, until)
        expect_duration("mean_s", mean_s)
        expect_duration("jitter_s", jitter_s)
        if distribution == "constant":
            expect("jitter_s", jitter_s, jitter_s == 0.0, "0 s for a constant delay")
        elif distribution == "normal":
            import scipy.special  # noqa: F401  # slow to import: done before the first message
        else:
            expect("mean_s", mean_s, mean_s > 0.0 or jitter_s == 0.0, f"more than 0 s for {distribution} jitter")
        self.mean_s, self.jitter_s, self.distribution = mean_s, jitter_s, distribution

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Delays (count, 1) s."""
        mean, std = self.mean_s, self.jitter_s
        if std == 0.0:
            delay: Floats = np.full(count, mean)
        elif self.distribution == "gamma":
            delay = rng.gamma((mean / std) ** 2, std**2 / mean, count)
        elif self.distribution == "lognormal":
            variance = math.log1p((std / mean) ** 2)
            delay = rng.lognormal(math.log(mean) - variance / 2.0, math.sqrt(variance), count)
        else:  # truncated normal, by inverse transform sampling
            from scipy.special import ndtr, ndtri

            below = ndtr(-mean / std)
            delay = mean + std * ndtri(below + rng.random(count) * (1.0 - below))
        return np.clip(delay, 0.0, MAX_DELAY_S).reshape(count, 1)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return (passage._replace(delay_ns=passage.delay_ns + round(row[0] * NANOSECONDS)),)


class Bandwidth(Rule):
    """Transmits messages one after the other; drops messages that would wait too long.

    The queue is limited by time (tail drop).
    bits_per_s: bandwidth; queue_s: s, longest time that a message may wait for transmission.

    Only the payload counts, without protocol headers.
    """

    fate = "delayed"
    needs_size = True

    def __init__(
        self, bits_per_s: float, queue_s: float = QUEUE_S, at: float = 0.0, until: float | None = None
    ) -> None:
        super().__init__(at, until)
        expect("bits_per_s", bits_per_s, 1.0 <= bits_per_s < math.inf, "1 or more")
        expect_duration("queue_s", queue_s)
        self.bits_per_s = bits_per_s
        self._queue_ns = round(queue_s * NANOSECONDS)
        self._free_ns = 0  # when the last transmission ends

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        arrival = passage.now_ns + passage.delay_ns
        start = max(arrival, self._free_ns)
        if start - arrival > self._queue_ns:
            return ()
        self._free_ns = start + round(passage.size * 8.0 / self.bits_per_s * NANOSECONDS)
        return (passage._replace(delay_ns=self._free_ns - passage.now_ns),)


class Reorder(RandomRule):
    """Delays some messages so that later ones overtake them.

    probability: that a message is delayed; by_s: s, its delay.
    """

    fate = "delayed"

    def __init__(self, probability: float, by_s: float, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(probability, at, until)
        expect_duration("by_s", by_s)
        self._by_ns = round(by_s * NANOSECONDS)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        if row[0] >= self.probability:
            return (passage,)
        return (passage._replace(delay_ns=passage.delay_ns + self._by_ns, overtakes=True),)


class Hold(Rule):
    """Holds all messages until `until`, then delivers them in order, as after a pause."""

    fate = "delayed"

    def __init__(self, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        if until is None:
            raise ValueError("until: found None, expected the time at which held messages are delivered")
        expect_duration("until - at", until - at)

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        assert self._before_ns is not None
        return (passage._replace(delay_ns=max(passage.delay_ns, self._before_ns - passage.time_ns)),)


class Loss(RandomRule):
    """Drops messages independently. probability: that a message is lost."""

    fate = "dropped"

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

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return ()


MAX_COPIES = 1000
FLOOD_COPIES = 5  #: default, also of the fault


class Duplicate(RandomRule):
    """Repeats some messages with the same number.

    Later rules act on each copy independently.
    probability: that a message is repeated; copies: number of additional copies.
    """

    fate = "duplicated"

    def __init__(self, probability: float, copies: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(probability, at, until)
        expect("copies", copies, 1 <= copies <= MAX_COPIES, f"1 to {MAX_COPIES}")
        self.copies = copies

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return (passage,) * (1 + self.copies) if row[0] < self.probability else (passage,)


class Flood(Rule):
    """Repeats every message. copies: number of additional copies."""

    fate = "duplicated"

    def __init__(self, copies: int = FLOOD_COPIES, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect("copies", copies, 1 <= copies <= MAX_COPIES, f"1 to {MAX_COPIES}")
        self.copies = copies

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        return (passage,) * (1 + self.copies)
