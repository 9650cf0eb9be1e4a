"""Which measurement belongs to which track: one-to-one choices among gated pairs."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.matching import alone, cheapest, greedy
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel

#: Rows times columns up to which the best choice is looked for: it takes their power of 3/2 in time.
LARGEST = 1_000_000


class Assignment(ABC):
    """Chooses pairs such that every row and every column is used at most once."""

    def match(self, row: Ints, column: Ints, cost: Floats) -> Ints:
        """(k,) int64, ascending: the chosen ones of p pairs.

        row, column: (p,) int64 >= 0, no pair twice; cost: (p,), what choosing the pair costs against leaving both ends
        alone. Pairs of cost >= 0 are never chosen.
        """
        useful, chosen = useful_pairs(row, column, cost)
        rest = (~chosen).nonzero()[0]
        if len(rest) == 0:
            return useful
        contested = useful[rest]
        chosen[rest] = self._choose(row[contested], column[contested], cost[contested])
        best: Ints = useful[chosen]
        return best

    @abstractmethod
    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        """(p,) bool: the chosen ones of p contested pairs of negative cost."""


@kernel
def useful_pairs(row: Ints, column: Ints, cost: Floats) -> tuple[Ints, Bools]:
    """(k,) int64, ascending: the pairs of negative cost; (k,) bool: which of those have row and column for themselves.

    Those are chosen by any sensible rule: most pairs of a frame are.
    """
    useful: Ints = (cost < 0.0).nonzero()[0]
    return useful, alone(row[useful], column[useful])


class BipartiteAssignment(Assignment):
    """The choice of least total cost, see `matching.cheapest`.

    Where more than LARGEST pairs are possible, the greedy choice: only a hostile source brings so many.
    """

    def __init__(self) -> None:
        pass

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        if _different(row) * _different(column) > LARGEST:
            return greedy(row, column, cost)
        return cheapest(row, column, cost)


class GreedyAssignment(Assignment):
    """The cheapest pair first, see `matching.greedy`."""

    def __init__(self) -> None:
        pass

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        return greedy(row, column, cost)


def _different(values: Ints) -> int:
    """How many different ones there are; values >= 0."""
    return int(np.count_nonzero(np.bincount(values)))
