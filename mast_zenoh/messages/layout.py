"""Layout of a message's columns, from its schema: dtype, shape, and limits of values.

Nearly all messages are valid, which is checked here in one pass. For the others, `validation` explains the error.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.kernels import kernel
from mast_zenoh.messages.schemas import SCHEMAS, Body, Column, Schema

MAX_BYTES = 16 * 1024 * 1024  #: no message is longer
MAX_ROWS = 100_000  #: no column has more rows
MAX_TEXT = 256  #: characters in one string
MAX_MAGNITUDE = 1e9  #: far above any quantity of a scene in SI units; larger values would overflow the filters
MIN_QUATERNION = 1e-3  #: length of a quaternion; nodes normalise quaternions before use

#: By dtype of a column: its NumPy dtype in memory (little-endian), and its name in a message.
WIRE_DTYPE = {name: np.dtype(name) for name in ("float64", "int64", "int32", "uint8")}
DTYPE_NAME = {name: dtype.str for name, dtype in WIRE_DTYPE.items()} | {"str": "str"}
assert sys.byteorder == "little", "columns are sent as they lie in memory"

#: Exclusive upper limit of the values of a column of indices, by its name; 256 for others.
INDEX_LIMITS = {"class_id": len(CLASSES), "action": 3, "port": 5, "fate": 5}

MAX_SQUARES = MAX_MAGNITUDE**2
_MAX_PLANS = 1024


class Planned(NamedTuple):
    """What one column of a body of known sizes must hold; `dtype` is None for text; `limit` as from `_limit`."""

    name: str
    dtype: np.dtype[Any] | None
    dtype_name: str
    shape: tuple[int, ...]
    dims: list[int]
    n_bytes: int
    limit: float


def index_limit(column: Column) -> int:
    """Exclusive upper limit of the indices in a column."""
    return INDEX_LIMITS.get(column.name.removeprefix("add_").removeprefix("remove_").removeprefix("move_"), 256)


def _limit(column: Column) -> float:
    """The limit of a column's values: text length, index, or squared quaternion length; 0 for none."""
    if column.dtype == "str":
        return MAX_TEXT
    if column.dtype == "uint8":
        return index_limit(column)
    return MIN_QUATERNION**2 if column.dtype == "float64" and column.name.endswith("rotation") else 0.0


class Layout:
    """The shapes of one schema's columns for given sizes of its letters, cached."""

    def __init__(self, schema: Schema) -> None:
        # for each letter, the column and the axis that give its size
        self._letters: dict[str, tuple[str, int]] = {}
        for column in schema.columns:
            for axis, size in enumerate(column.shape):
                if isinstance(size, str):
                    self._letters.setdefault(size, (column.name, axis))
        self._sources = tuple(self._letters.values())
        self._schema = schema
        self._plans: dict[tuple[int, ...], list[Planned]] = {}
        self._fitting: set[tuple[int, ...]] = set()  # sizes of messages within MAX_BYTES

    def named(self, sizes: tuple[int, ...]) -> dict[str, int]:
        """The sizes by letter."""
        return dict(zip(self._letters, sizes, strict=True))

    def plan(self, sizes: tuple[int, ...]) -> list[Planned]:
        """What every column of a body must hold; `sizes` are those of the letters, in their order.

        Raises ValueError for an invalid size.
        """
        plan = self._plans.get(sizes)
        if plan is None:
            if not all(type(size) is int and 0 <= size <= MAX_ROWS for size in sizes):
                raise ValueError
            size_of = self.named(sizes)
            plan = []
            for column in self._schema.columns:
                shape = tuple(size_of[size] if isinstance(size, str) else size for size in column.shape)
                dtype = WIRE_DTYPE.get(column.dtype)
                n_bytes = prod(shape) * (dtype.itemsize if dtype else 0)
                name = DTYPE_NAME[column.dtype]
                plan.append(Planned(column.name, dtype, name, shape, list(shape), n_bytes, _limit(column)))
            if len(self._plans) < _MAX_PLANS:
                self._plans[sizes] = plan
        return plan

    def sizes(self, body: Body) -> tuple[int, ...]:
        """The sizes of the letters, from arrays; raises KeyError or IndexError if a column or an axis is missing."""
        return tuple([body[name].shape[axis] for name, axis in self._sources])

    def unpack(self, body: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """The columns of a packed body; None if it is invalid in any way."""
        try:
            plan = self.plan(tuple([body[name][1][axis] for name, axis in self._sources]))
        except (KeyError, IndexError, TypeError, ValueError):
            return None
        columns = packed_columns(body, plan)
        return columns if columns is not None and sound_values(columns, plan) <= MAX_SQUARES else None

    def is_valid(self, body: Body) -> bool:
        """Whether the values of a body that `conform` made are valid."""
        sizes = self.sizes(body)
        plan = self.plan(sizes)
        if sizes not in self._fitting:
            if sum([planned.n_bytes for planned in plan]) > MAX_BYTES:
                return False
            if len(self._fitting) < _MAX_PLANS:
                self._fitting.add(sizes)
        return sound_values(body, plan) <= MAX_SQUARES


@kernel
def packed_columns(body: Mapping[str, Any], plan: list[Planned]) -> dict[str, NDArray[Any]] | None:
    """The columns of a packed body if all match the plan, else None; values are not checked."""
    columns: dict[str, NDArray[Any]] = {}
    for planned in plan:
        packed = body.get(planned.name)
        if type(packed) is not list or len(packed) != 3:
            return None
        dtype_name, dims, data = packed
        if dtype_name != planned.dtype_name or type(dims) is not list or dims != planned.dims:
            return None
        for size in dims:
            if type(size) is not int:  # 3.0 and True are equal to whole numbers
                return None
        if planned.dtype is None:
            if type(data) is not list or [len(data)] != dims or not all(type(text) is str for text in data):
                return None
            columns[planned.name] = array = np.empty(len(data), object)
            array[:] = data
        elif type(data) is not bytes or len(data) != planned.n_bytes:
            return None
        else:
            columns[planned.name] = np.ndarray(planned.shape, planned.dtype, data)
    return columns


@kernel
def exact_columns(body: Mapping[str, Any], plan: list[Planned]) -> dict[str, NDArray[Any]] | None:
    """The columns of a body, read-only, if they are contiguous arrays that match the plan, else None."""
    columns: dict[str, NDArray[Any]] = {}
    for planned in plan:
        array = body.get(planned.name)
        if type(array) is not np.ndarray or array.dtype != (planned.dtype or object) or array.shape != planned.shape:
            return None
        if planned.dtype is not None:
            if not array.flags.c_contiguous:
                return None
            if array.flags.writeable:
                array = array.view()
                array.setflags(write=False)
        columns[planned.name] = array
    return columns


@kernel
def sound_values(columns: Mapping[str, NDArray[Any]], plan: list[Planned]) -> float:
    """The sum of the squares of all float64 values; infinite if another value is beyond its limit.

    columns: arrays that match the plan
    """
    # All numbers at once: if the total is within the limit, so is every column.
    squares = 0.0
    for planned in plan:
        array = columns[planned.name]
        if planned.dtype is None:
            for item in array:
                if not isinstance(item, str) or len(item) > planned.limit:
                    return float("inf")
        elif planned.dtype_name == "<f8":
            own = np.vdot(array, array)
            squares += own
            if own < planned.limit:
                return float("inf")
        elif planned.dtype_name == "|u1" and array.size and max(array.tobytes()) >= planned.limit:
            return float("inf")
    return float(squares)


LAYOUTS = {name: Layout(schema) for name, schema in SCHEMAS.items()}
