"""Which rows of one table occur in another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints

_MOST = 1 << 62


def find(wanted: tuple[Ints, ...], among: tuple[Ints, ...]) -> Ints:
    """(n,) for each row of `wanted` columns a row of `among` that equals it, -1: none."""
    n = len(wanted[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip(wanted, among, strict=True)])
    ours, theirs = codes[:n], codes[n:]
    order = theirs.argsort(kind="stable")
    row = order[np.searchsorted(theirs[order], ours, side="right") - 1]
    return np.where(theirs[row] == ours, row, -1)


def _codes(columns: Sequence[Ints]) -> Ints:
    """(n,) a number for each row of integer `columns`, the same for equal rows only."""
    code, size = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        least = int(column.min())
        span = int(column.max()) - least + 1
        if size * span > _MOST:  # too far apart to be written side by side: their ranks instead
            least, span, column = 0, len(column), np.unique(column, return_inverse=True)[1]
            size, code = len(code), np.unique(code, return_inverse=True)[1]
        code = code * span + (column - least)
        size *= span
    return code


def occurs(wanted: tuple[Ints, ...], among: tuple[Ints, ...]) -> Bools:
    """(n,) whether each row of `wanted` columns is a row of `among`."""
    return np.asarray(find(wanted, among) >= 0)


def latest(wanted: tuple[Ints, ...], until: Ints, among: tuple[Ints, ...], when: Ints) -> Ints:
    """(n,) for each row of `wanted` columns the row of `among` that equals it and of which `when` is the latest up to
    `until` (n,), -1: none."""
    n = len(wanted[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip((*wanted, until), (*among, when), strict=True)])
    ours, theirs = codes[:n], codes[n:]
    order = theirs.argsort(kind="stable")
    row = order[np.maximum(np.searchsorted(theirs[order], ours, side="right") - 1, 0)]
    same = when[row] <= until
    for mine, others in zip(wanted, among, strict=True):
        same &= others[row] == mine
    return np.where(same, row, -1)
