"""Which rows of one table occur in another."""

from __future__ import annotations

import numpy as np

from mast_zenoh.states import Bools, Ints


def find(wanted: tuple[Ints, ...], among: tuple[Ints, ...]) -> Ints:
    """(n,) for each row of `wanted` columns a row of `among` that equals it, -1: none."""
    n = len(wanted[0])
    code = np.zeros(n + len(among[0]), np.int64)
    for ours, theirs in zip(wanted, among, strict=True):
        values, column = np.unique(np.concatenate([ours, theirs]), return_inverse=True)
        _, code = np.unique(code * max(len(values), 1) + column, return_inverse=True)
    row = np.full(int(code.max(initial=-1)) + 1, -1, np.int64)
    row[code[n:]] = np.arange(len(among[0]))
    return np.asarray(row[code[:n]])


def occurs(wanted: tuple[Ints, ...], among: tuple[Ints, ...]) -> Bools:
    """(n,) whether each row of `wanted` columns is a row of `among`."""
    return np.asarray(find(wanted, among) >= 0)
