"""Row orders equal a full sort for every permutation of the rows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, canonical_order, row_order


@given(keys=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 2)), max_size=8))
def test_few_rows_are_ordered_like_a_full_sort(keys: list[tuple[int, int, int]]) -> None:
    group, id_, tie = np.array(keys, np.int64).reshape(-1, 3).T
    ties = (tie.astype(float),)
    assert row_order(id_, group, ties=lambda: ties).tolist() == np.lexsort((*ties, id_, group)).tolist()
    assert row_order(id_, ties=lambda: ties).tolist() == np.lexsort((*ties, id_)).tolist()


@pytest.mark.parametrize("spread", [1, 3, 1000, 1_000_000])
@pytest.mark.parametrize("n", [0, 1, 2, 50, 3000])
def test_sorted_and_unsorted_rows_are_ordered_like_a_full_sort(n: int, spread: int) -> None:
    random = np.random.default_rng(spread)
    ids, groups = random.integers(0, spread, n), random.integers(0, 4, n)
    tie = random.permutation(n).astype(float)
    for first, second in ((ids, groups), (np.sort(ids), groups), (np.sort(ids), np.sort(groups)), (groups, ids)):
        assert row_order(first, second, ties=lambda: (tie,)).tolist() == np.lexsort((tie, first, second)).tolist()
        assert row_order(first, second).tolist() == np.lexsort((first, second)).tolist()


@pytest.mark.parametrize("rounded", [False, True])
def test_the_canonical_order_does_not_depend_on_the_order_of_the_rows(rounded: bool) -> None:
    random = np.random.default_rng(7)
    position = random.normal(0.0, 2.0, (40, 3))
    objects = ObjectStates.of(np.round(position) if rounded else position, id=np.arange(40))
    shuffle = random.permutation(40)
    sorted_, again = objects, objects.select(shuffle)
    assert np.array_equal(sorted_.select(canonical_order(sorted_)).id, again.select(canonical_order(again)).id)


def test_ties_between_equal_objects_are_broken_by_source() -> None:
    objects = ObjectStates.of(np.zeros((3, 3)), id=np.zeros(3, np.int64))
    assert canonical_order(objects, np.array([2, 0, 1])).tolist() == [1, 2, 0]
