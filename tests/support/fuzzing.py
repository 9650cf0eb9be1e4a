"""Number and seed of random draws: `--fuzz` makes many more."""

from typing import NamedTuple


class Fuzzing(NamedTuple):
    """long: many more draws than usual; seed: of random messages."""

    long: bool
    seed: int

    def draws(self, usual: int, many: int) -> int:
        """The number of draws of a test."""
        return many if self.long else usual
