"""Rules that delay messages: delay, bandwidth, reordering, holding."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import MAX_DELAY_S, NANOSECONDS, Passage, Rule, expect, expect_duration, expect_probability

QUEUE_S = 0.5  #: s, default of `Bandwidth`, also of the fault

Distribution = Literal["constant", "normal", "gamma", "lognormal"]


class Delay(Rule):
    """Delays messages by a random time.

    mean_s, jitter_s: s, mean and standard deviation of the delay
    distribution:     "constant" (no jitter), "gamma", "lognormal", or "normal", truncated below 0 (mean_s and
                      jitter_s are those before truncation)
    """

    fate = "delayed"
    draws = True

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


class Reorder(Rule):
    """Delays some messages so that later ones overtake them.

    probability: that a message is delayed; by_s: s, its delay.
    """

    fate = "delayed"
    draws = True

    def __init__(self, probability: float, by_s: float, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_probability("probability", probability)
        expect_duration("by_s", by_s)
        self.probability = probability
        self._by_ns = round(by_s * NANOSECONDS)

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Uniform random numbers (count, 1)."""
        return rng.random((count, 1))

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
