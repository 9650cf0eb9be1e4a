"""One-to-one matching has the least total cost, also with ties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mast_zenoh import kernels
from mast_zenoh.arrays.matching import min_cost_matching, uncontested

EITHER = pytest.mark.parametrize(
    "choose", [min_cost_matching, kernels.REFERENCES["min_cost_matching"]], ids=["used", "reference"]
)


@st.composite
def contested(draw):
    """Pairs in any order, with gaps in the row and column numbers, and ties."""
    n, m, gap = draw(st.integers(1, 12)), draw(st.integers(1, 12)), draw(st.integers(1, 3))
    near = draw(st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, m - 1)), unique=True))
    cost = draw(st.lists(st.integers(-4, -1), min_size=len(near), max_size=len(near)))
    rows, columns = np.array(near, np.int64).reshape(-1, 2).T * gap
    return rows.copy(), columns.copy(), np.array(cost, float)


@EITHER
@given(contested())
def test_matching_has_the_least_total_cost(choose, pairs) -> None:
    row, column, cost = pairs
    chosen = choose(row, column, cost)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    table = np.zeros((row.max(initial=0) + 1, column.max(initial=0) + 1))
    table[row, column] = cost
    assert cost[chosen].sum() == table[linear_sum_assignment(table)].sum()
    assert chosen[uncontested(row, column)].all()


@EITHER
@pytest.mark.parametrize("wrong", [np.nan, -np.inf])
def test_non_finite_costs_are_refused(choose, wrong: float) -> None:
    with pytest.raises(ValueError, match="not finite"):
        choose(np.array([0, 0]), np.array([0, 1]), np.array([-1.0, wrong]))
