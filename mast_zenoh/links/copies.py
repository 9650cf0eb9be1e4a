"""Rules that repeat messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import Passage, Rule, expect, expect_probability

MAX_COPIES = 1000
FLOOD_COPIES = 5  #: default, also of the fault


class Duplicate(Rule):
    """Repeats some messages with the same number.

    Later rules act on each copy independently.
    probability: that a message is repeated; copies: number of additional copies.
    """

    fate = "duplicated"
    draws = True

    def __init__(self, probability: float, copies: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_probability("probability", probability)
        expect("copies", copies, 1 <= copies <= MAX_COPIES, f"1 to {MAX_COPIES}")
        self.probability = probability
        self.copies = copies

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """Uniform random numbers (count, 1)."""
        return rng.random((count, 1))

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
