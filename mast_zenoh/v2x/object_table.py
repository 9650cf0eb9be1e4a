"""A table of what a station remembers of each object that it perceives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mast_zenoh.arrays.states import Bools, Ints


class ObjectTable:
    """Rows of named columns by id of an object, without a Python object for each.

    columns: (name, dtype) or (name, dtype, shape) of each column besides `id` and `perceived_ns`, the time at which the
        object was last perceived
    most: number of objects that are remembered at most
    """

    def __init__(self, *columns: tuple[str, DTypeLike] | tuple[str, DTypeLike, int], most: int) -> None:
        self.dtype = np.dtype([("id", np.int64), ("perceived_ns", np.int64), *columns])
        self._most = most
        self._rows: NDArray[Any] = np.zeros(0, self.dtype)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def ids(self) -> Ints:
        """Ids of all objects, ascending."""
        return np.asarray(self._rows["id"])

    def read(self, ids: Ints) -> tuple[NDArray[Any], Bools]:
        """Rows (n,) of objects, zero for unknown ones, and which are known (n,)."""
        place, known = self._find(ids)
        rows = np.zeros(len(ids), self.dtype)
        rows[known] = self._rows[place[known]]
        return rows, known

    def write(self, rows: NDArray[Any]) -> None:
        """Replace or add rows (n,), no id twice.

        Beyond the limit, the objects that were last perceived stay, of equal ones those with low ids.
        """
        place, known = self._find(rows["id"])
        self._rows[place[known]] = rows[known]
        if known.all():
            return
        table = np.concatenate([self._rows, rows[~known]])
        table = table[table["id"].argsort()]
        if len(table) > self._most:
            table = table[np.sort(np.lexsort((table["id"], -table["perceived_ns"]))[: self._most])]
        self._rows = table

    def note_perceived(self, ids: Ints, time_ns: int) -> None:
        """Note that objects (n,) are perceived; unknown ones stay unknown."""
        place, known = self._find(ids)
        self._rows["perceived_ns"][place[known]] = time_ns

    def forget(self, before_ns: int) -> None:
        """Forget objects last perceived before a time."""
        perceived = self._rows["perceived_ns"]
        if len(perceived) and perceived.min() < before_ns:
            self._rows = self._rows[perceived >= before_ns]

    def _find(self, ids: Ints) -> tuple[Ints, Bools]:
        """Places (n,) of objects, and which are known (n,)."""
        if len(self._rows) == 0:
            return np.zeros(len(ids), np.int64), np.zeros(len(ids), bool)
        place = np.minimum(np.searchsorted(self._rows["id"], ids), len(self._rows) - 1)
        return place, np.asarray(self._rows["id"][place] == ids)
