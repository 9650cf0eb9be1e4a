"""One-to-one assignment of measurements to tracks among gated pairs."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, min_cost_matching, uncontested
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel

#: Largest number of rows times columns for an optimal assignment, whose run time grows with its power of 3/2.
MAX_PAIRS = 1_000_000


class Assignment(ABC):
    """Chooses pairs such that every row and every column is used at most once."""

    def match(self, row: Ints, column: Ints, cost: Floats) -> Ints:
        """(k,) int64, ascending: rows of the chosen pairs among p.

        row, column: (p,) int64 >= 0, no pair twice; cost: (p,), cost of choosing the pair relative to
        leaving both unassigned. Pairs with cost >= 0 are never chosen.
        """
        useful, chosen = useful_pairs(row, column, cost)
        contested_rows = (~chosen).nonzero()[0]
        if len(contested_rows) == 0:
            return useful
        contested = useful[contested_rows]
        chosen[contested_rows] = self._choose(row[contested], column[contested], cost[contested])
        matches: Ints = useful[chosen]
        return matches

    @abstractmethod
    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        """(p,) bool: which of p contested pairs with negative cost to choose."""


@kernel
def useful_pairs(row: Ints, column: Ints, cost: Floats) -> tuple[Ints, Bools]:
    """Pairs (k,) with negative cost, and which of them (k,) are uncontested.

    The indices are ascending. Uncontested pairs share no row or column; most pairs are, and they are always chosen.
    """
    useful: Ints = (cost < 0.0).nonzero()[0]
    return useful, uncontested(row[useful], column[useful])


class BipartiteAssignment(Assignment):
    """Minimises the total cost, see `matching.min_cost_matching`.

    Falls back to greedy assignment above MAX_PAIRS possible pairs; only a hostile source sends so many.
    """

    def __init__(self) -> None:
        pass

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        if _count_distinct(row) * _count_distinct(column) > MAX_PAIRS:
            return greedy_matching(row, column, cost)
        return min_cost_matching(row, column, cost)


class GreedyAssignment(Assignment):
    """Chooses the cheapest pair first, see `matching.greedy_matching`."""

    def __init__(self) -> None:
        pass

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        return greedy_matching(row, column, cost)


def _count_distinct(values: Ints) -> int:
    """Number of distinct values; values >= 0."""
    return int(np.count_nonzero(np.bincount(values)))
