"""Look-up of rows of one table in another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints

#: Limit of combined codes, so that they fit int64.
_MAX_CODE = 1 << 62


def find(keys: tuple[Ints, ...], among: tuple[Ints, ...]) -> Ints:
    """For each row of the columns `keys`, the last equal row of `among` (n,); -1: none."""
    n = len(keys[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip(keys, among, strict=True)])
    key_codes, among_codes = codes[:n], codes[n:]
    order = among_codes.argsort(kind="stable")
    row = order[np.searchsorted(among_codes[order], key_codes, side="right") - 1]
    return np.where(among_codes[row] == key_codes, row, -1)


def _codes(columns: Sequence[Ints]) -> Ints:
    """A number for each row of integer `columns` (n,), equal only for equal rows."""
    code, size = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        low = int(column.min())
        span = int(column.max()) - low + 1
        if size * span > _MAX_CODE:  # too large a range to combine: use ranks instead
            low, span, column = 0, len(column), np.unique(column, return_inverse=True)[1]
            size, code = len(code), np.unique(code, return_inverse=True)[1]
        code = code * span + (column - low)
        size *= span
    return code


def occurs(keys: tuple[Ints, ...], among: tuple[Ints, ...]) -> Bools:
    """Whether each row of the columns `keys` is a row of `among` (n,)."""
    return np.asarray(find(keys, among) >= 0)


def latest(keys: tuple[Ints, ...], until: Ints, among: tuple[Ints, ...], when: Ints) -> Ints:
    """Latest equal row of `among` for each row of the columns `keys`; -1: none.

    Rows count if `when` <= `until` (n,).
    """
    n = len(keys[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip((*keys, until), (*among, when), strict=True)])
    key_codes, among_codes = codes[:n], codes[n:]
    order = among_codes.argsort(kind="stable")
    row = order[np.maximum(np.searchsorted(among_codes[order], key_codes, side="right") - 1, 0)]
    same = when[row] <= until
    for column, among_column in zip(keys, among, strict=True):
        same &= among_column[row] == column
    return np.where(same, row, -1)
