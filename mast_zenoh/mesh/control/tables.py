"""Tables that nodes hand in part by part, so that no process ever holds a long one; pure functions.

A node appends rows whenever it likes; a part leaves it when PART_ROWS rows have come together. So parts, which become
the row groups of a Parquet file, depend on the rows alone, not on when they were appended.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import MessageError

#: Rows and bytes of a part, at most; characters of text count as four bytes. A row has at most as many bytes.
PART_ROWS, PART_BYTES = 1 << 16, 16 << 20

MAX_TABLES = 100  #: that one node may hand in
MAX_COLUMNS = 1000  #: of one table

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
EXPECTED_NAME = "expected a name of at most 64 letters, digits, dots, hyphens and underscores that begins with no dot"

#: Columns by name, equally long: numbers, or text as Python objects.
Columns = dict[str, NDArray[Any]]


class TablePart(NamedTuple):
    """Rows of a table, which follow those of earlier parts.

    number: of the part among all that a process hands in, from 0
    """

    table: str
    number: int
    columns: Columns


def is_table_name(name: object) -> bool:
    """Whether a table, or a node's folder, can have this name."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def checked_columns(table: object, columns: object) -> Columns:
    """The columns of a table as arrays; raises MessageError if it is none, or has no valid name."""
    if not is_table_name(table):
        raise MessageError(f"table {table!r:.80}: {EXPECTED_NAME}")
    if not isinstance(columns, Mapping):
        raise MessageError(f"table {table}: found a {type(columns).__name__}, expected a dict of columns")
    if not 0 < len(columns) <= MAX_COLUMNS:
        raise MessageError(f"table {table}: found {len(columns)} columns, expected 1 to {MAX_COLUMNS}")
    arrays = {name: _column(table, name, values) for name, values in columns.items()}
    if len({len(array) for array in arrays.values()}) > 1:
        lengths = ", ".join(f"{name} {len(array)}" for name, array in arrays.items())
        raise MessageError(f"table {table}: columns of different lengths: {lengths:.200}")
    return arrays


def _column(table: object, name: object, values: Any) -> NDArray[Any]:
    """A column as an array; text as objects, which are as long as they are, not all as long as the longest."""
    if not isinstance(name, str):
        raise MessageError(f"table {table}: found the column {name!r:.80}, expected a name")
    try:
        texts = isinstance(values, (list, tuple)) and any(isinstance(value, str) for value in values)
        array = np.fromiter(values, object, len(values)) if texts else np.asarray(values)
    except (TypeError, ValueError) as error:
        raise MessageError(f"table {table}: column {name:.80}: {error}") from None
    if array.ndim != 1 or array.dtype.kind not in "biufOU":
        found = f"{array.ndim} dimensions of {array.dtype}"
        raise MessageError(f"table {table}: column {name:.80}: found {found}, expected one of numbers or text")
    if array.dtype.kind not in "OU":
        return array
    items = array.tolist()  # a list is read faster than an array of objects
    return np.fromiter(items if set(map(type, items)) <= {str} else map(str, items), object, len(items))


class _WaitingRows:
    """The rows of a table that wait for their part.

    kinds: type of each column, of its first rows; {} before;  begun: whether a part has been cut off
    """

    def __init__(self) -> None:
        self.kinds: dict[str, str] = {}
        self.begun = False
        self.count = self._bytes = 0
        self._pieces: list[Columns] = []
        self._sizes: list[Ints] = []  # of the rows of each piece, bytes

    def add(self, columns: Columns) -> None:
        """Add rows; raises MessageError if their columns differ from those before."""
        kinds = {name: array.dtype.str if array.dtype.kind != "O" else "text" for name, array in columns.items()}
        sizes = _row_bytes(columns)
        count = len(sizes)
        if sizes.max(initial=0) > PART_BYTES:
            most = int(sizes.argmax())
            raise MessageError(f"found {sizes[most]} bytes in row {most}, expected at most {PART_BYTES}")
        if self.kinds and count and list(kinds.items()) != list(self.kinds.items()):
            raise MessageError(f"found columns {kinds}, expected those of the rows before: {self.kinds}")
        if not self.kinds:
            self._pieces.clear()  # without rows, whose types say nothing
            self._sizes.clear()
        if count or not self.kinds:  # numbers are copied: the node may use its arrays again
            self._pieces.append(
                {name: array.copy() if kinds[name] != "text" else array for name, array in columns.items()}
            )
            self._sizes.append(sizes)
        if count:
            self.kinds = kinds
        self.count += count
        self._bytes += int(sizes.sum())

    @property
    def is_full(self) -> bool:
        """Whether there are enough rows for a part."""
        return self.count >= PART_ROWS or self._bytes >= PART_BYTES

    def joined(self) -> Columns:
        """All rows."""
        return {name: np.concatenate([piece[name] for piece in self._pieces]) for name in self._pieces[0]}

    def cut(self, *, everything: bool) -> Iterator[Columns]:
        """Cut off parts, each as long as it may be; the rest waits, unless `everything` is wanted."""
        columns, sizes, start, count = self.joined(), np.concatenate(self._sizes), 0, self.count
        until = np.cumsum(sizes)
        while start < count or (everything and not self.begun):
            most = PART_BYTES + int(until[start - 1] if start else 0)
            end = min(start + PART_ROWS, int(np.searchsorted(until, most, side="right")))
            if end == count < start + PART_ROWS and not everything:
                break
            yield {name: array[start:end] for name, array in columns.items()}
            self.begun, start = True, end
        rest = {name: array[start:].copy() for name, array in columns.items()}
        self._pieces, self._sizes, self.count = [rest], [sizes[start:]], count - start
        self._bytes = int(sizes[start:].sum())


class PartedTables:
    """The tables of one process of a node, cut into parts.

    hand_in: takes each part; None: the rows stay here until `close`
    """

    def __init__(self) -> None:
        self.hand_in: Callable[[TablePart], None] | None = None
        self._number = 0
        self._tables: dict[str, _WaitingRows] = {}

    def append(self, table: str, columns: Mapping[str, Any]) -> None:
        """Append rows to a table; raises MessageError for an invalid table, or for other columns than before."""
        arrays = checked_columns(table, columns)
        if table not in self._tables and len(self._tables) >= MAX_TABLES:
            raise MessageError(f"table {table}: found more than {MAX_TABLES} tables, expected at most as many")
        rows = self._tables.setdefault(table, _WaitingRows())
        try:
            rows.add(arrays)
        except MessageError as error:
            raise MessageError(f"table {table}: {error}") from None
        if rows.is_full:
            self._hand_in(table, everything=False)

    def close(self, results: dict[str, Any]) -> dict[str, Any]:
        """Hand in the rest, and the tables in a node's results; returns the results with the others.

        An invalid table is replaced by a sentence that says why. Without `hand_in`, all tables are in the results.
        """
        tables = results.get("tables", {})
        if not isinstance(tables, Mapping):
            return results
        kept: dict[Any, Any] = {}
        for table, columns in tables.items():
            try:
                self.append(table, columns)
            except MessageError as error:
                kept[table] = str(error)
        for table, rows in self._tables.items():
            if self.hand_in is None:
                kept.setdefault(table, rows.joined())
            else:
                self._hand_in(table, everything=True)
        rest = {key: value for key, value in results.items() if key != "tables"}
        return {**rest, "tables": kept} if kept else rest

    def _hand_in(self, table: str, *, everything: bool) -> None:
        if self.hand_in is not None:
            for columns in self._tables[table].cut(everything=everything):
                self.hand_in(TablePart(table, self._number, columns))
                self._number += 1


def _row_bytes(columns: Columns) -> Ints:
    """Bytes of each row (n,), at most: each character of text has up to four, and its length another five."""
    sizes = np.zeros(len(next(iter(columns.values()))), np.int64)
    for array in columns.values():
        text = array.dtype == object
        sizes += 5 + 4 * np.fromiter(map(len, array.tolist()), np.int64, len(array)) if text else array.itemsize
    return sizes
