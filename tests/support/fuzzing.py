"""How long the fuzz tests are, and from which seed they draw: `make fuzz` asks for the longer ones."""

from __future__ import annotations

from typing import NamedTuple


class Fuzzing(NamedTuple):
    """long: many more messages than in the ordinary run; seed: of all that is drawn at random."""

    long: bool
    seed: int
