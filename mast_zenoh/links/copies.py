"""Rules by which messages come more than once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.links.base import Passage, Rule, expect, expect_part

MOST_COPIES = 1000
FLOOD_COPIES = 5  #: default, also of the fault


class Duplicate(Rule):
    """Some messages come more than once, with the same number. The rules that follow act on each copy by itself.

    probability: that a message does; copies: how many more.
    """

    fate = "duplicated"
    draws = True

    def __init__(self, probability: float, copies: int = 1, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect_part("probability", probability)
        expect("copies", copies, 1 <= copies <= MOST_COPIES, f"1 to {MOST_COPIES}")
        self.probability = probability
        self.copies = copies

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, 1) uniform from 0 to 1."""
        return rng.random((count, 1))

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        return (passage,) * (1 + self.copies) if row[0] < self.probability else (passage,)


class Flood(Rule):
    """Every message comes many times: a storm. copies: how many more."""

    fate = "duplicated"

    def __init__(self, copies: int = FLOOD_COPIES, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        expect("copies", copies, 1 <= copies <= MOST_COPIES, f"1 to {MOST_COPIES}")
        self.copies = copies

    def apply(self, passage: Passage, row: Sequence[float]) -> tuple[Passage, ...]:
        """See `Rule.apply`."""
        return (passage,) * (1 + self.copies)
