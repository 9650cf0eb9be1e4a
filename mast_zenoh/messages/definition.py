"""What a message type is: named columns with dtypes and shapes, checked when they are defined."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import prod

#: The dtypes that a column can have. `str` is text.
DTYPES = ("float64", "int64", "int32", "uint8", "str")
MAX_COLUMNS = 60  #: effects on rows keep a bit for each column
MAX_SIZE = 100_000  #: the largest size of a shape, fixed or by letter
MAX_AXES = 8

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_INDICES = 256  # of uint8
_MOST_VALUES = 1 << 59  # of eight bytes


@dataclass(frozen=True, slots=True)
class Column:
    """One column, as used by senders, receivers and the documentation.

    name:  lower-case letters, digits and _
    dtype: float64, int64, int32, uint8, or str for text
    shape: sizes; equal letters are equal sizes in one message: ("n", 3) is a row of three numbers for each of n objects
    unit, meaning: for readers; "" where there is none
    below: for indices (uint8): exclusive upper limit
    least_length: for quaternions and matrices (float64): minimum square root of the sum of squares

    Raises ValueError for anything else.
    """

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    unit: str = ""
    meaning: str = ""
    below: int = 256
    least_length: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(self.shape))
        for text in (self.unit, self.meaning):
            if not isinstance(text, str):
                raise ValueError(f"column {self.name!r}: unit and meaning: found {text!r:.40}, expected a string")
        _check_column(self.name, self.dtype, self.shape, self.below, self.least_length)


@dataclass(frozen=True, slots=True)
class Schema:
    """One message type: name, version, meaning, columns.

    A node names it in its ports: `outputs = {"gusts": GUSTS}`. Raises ValueError for an invalid name, and for two
    columns with the same name.
    """

    name: str
    version: int
    meaning: str
    columns: tuple[Column, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        _check_schema(self.name, self.version, [column.name for column in self.columns])


def _check_column(name: object, dtype: object, shape: Sequence[object], below: object, least_length: object) -> None:
    """Check one column; see `schemas.Column`."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"column {name!r}: expected a name of lower-case letters, digits and _, at most 64")
    if dtype not in DTYPES:
        raise ValueError(f"column {name!r}: dtype: found {dtype!r}, expected one of {', '.join(DTYPES)}")
    if len(shape) > MAX_AXES:
        raise ValueError(f"column {name!r}: shape: found {len(shape)} sizes, expected at most {MAX_AXES}")
    if not shape:
        raise ValueError(f"column {name!r}: shape: found (), expected a size, such as (1,) or ('n',)")
    for size in shape:
        letter = isinstance(size, str) and size.isidentifier()
        if not letter and not (type(size) is int and 1 <= size <= MAX_SIZE):
            expected = f"1 to {MAX_SIZE}, or a letter such as 'n'"
            raise ValueError(f"column {name!r}: shape: found {size!r}, expected {expected}")
    # The largest array of a shape must be possible, or a forged message would raise an error of NumPy.
    largest = prod(size if isinstance(size, int) else MAX_SIZE for size in shape)
    if largest >= _MOST_VALUES:
        raise ValueError(f"column {name!r}: shape: found {tuple(shape)}, expected fewer or smaller sizes")
    if dtype == "str" and len(shape) != 1:
        raise ValueError(f"column {name!r}: shape: found {len(shape)} sizes, expected one for text")
    if type(below) is not int or not 1 <= below <= _INDICES or (below < _INDICES and dtype != "uint8"):
        raise ValueError(f"column {name!r}: below: found {below!r}, expected 1 to {_INDICES}, for uint8 only")
    if not isinstance(least_length, (int, float)) or not 0.0 <= least_length < float("inf"):
        raise ValueError(f"column {name!r}: least_length: found {least_length!r}, expected 0 or more")
    if least_length and dtype != "float64":
        raise ValueError(f"column {name!r}: least_length: found {least_length!r}, expected 0 for {dtype}")


def _check_schema(name: object, version: object, columns: Collection[str]) -> None:
    """Check a message type; columns: the names of its columns."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"message type {name!r}: expected a name of lower-case letters, digits and _, at most 64")
    if type(version) is not int or not 1 <= version < 1 << 31:
        raise ValueError(f"message type {name!r}: version: found {version!r}, expected a whole number from 1")
    if len(columns) > MAX_COLUMNS:
        raise ValueError(f"message type {name!r}: {len(columns)} columns, expected at most {MAX_COLUMNS}")
    twice = sorted({column for column in columns if list(columns).count(column) > 1})
    if twice:
        raise ValueError(f"message type {name!r}: column {twice[0]!r} occurs twice, expected different names")
