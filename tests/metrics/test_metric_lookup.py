"""Rows of one table are looked up in another."""

from __future__ import annotations

import numpy as np
import pytest

from mast_zenoh.metrics.boxes import find, occurs


@pytest.mark.parametrize("far", [1, 1 << 31, 1 << 61])
def test_find_returns_the_last_equal_row(far):
    random = np.random.default_rng(far)
    keys, among = ([random.integers(-3, 4, n) * far for _ in range(3)] for n in (200, 150))
    row = {key: k for k, key in enumerate(zip(*map(np.ndarray.tolist, among), strict=True))}
    expected = [row.get(key, -1) for key in zip(*map(np.ndarray.tolist, keys), strict=True)]
    assert max(expected) >= 0
    assert find(tuple(keys), tuple(among)).tolist() == expected
    assert occurs(tuple(keys), tuple(among)).tolist() == [each >= 0 for each in expected]


def test_find_in_empty_tables_returns_nothing():
    none, one = (np.zeros(0, np.int64),), (np.ones(1, np.int64),)
    assert find(one, none).tolist() == [-1]
    assert find(none, one).tolist() == []
