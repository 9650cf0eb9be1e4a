"""Number and seed of fuzz messages: `make fuzz` sends more."""

from typing import NamedTuple


class Fuzzing(NamedTuple):
    """long: many more messages than usual; seed: of all random draws."""

    long: bool
    seed: int
