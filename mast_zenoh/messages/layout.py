"""What the columns of a message must be, by their schema: dtype, shape, and the limits of their values.

Nearly all messages are valid, which is found out here in one go. `validation` explains what is wrong with the others.
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
MAX_MAGNITUDE = 1e9  #: no quantity of a scene in SI units comes near it; more would overflow the filters
LEAST_QUATERNION = 1e-3  #: length of a quaternion; they are normalised by those who use them

#: By dtype of a column: what it is in memory, little-endian, and what it is called in a message.
WIRE_DTYPE = {name: np.dtype(name) for name in ("float64", "int64", "int32", "uint8")}
DTYPE_NAME = {name: dtype.str for name, dtype in WIRE_DTYPE.items()} | {"str": "str"}
assert sys.byteorder == "little", "columns are sent as they lie in memory"

#: By name of a column of indices: what they are below; 256 of others.
INDEX_LIMITS = {"class_id": len(CLASSES), "action": 3, "port": 5, "fate": 5}

MAX_SQUARES = MAX_MAGNITUDE**2
_MAX_PLANS = 1024


class Planned(NamedTuple):
    """What one column of a body of known sizes must hold; `dtype` is None for text. `limit`: see `_limit`."""

    name: str
    dtype: np.dtype[Any] | None
    dtype_name: str
    shape: tuple[int, ...]
    dims: list[int]
    n_bytes: int
    limit: float


def index_limit(column: Column) -> int:
    """What an index in this column must be below."""
    return INDEX_LIMITS.get(column.name.removeprefix("add_").removeprefix("remove_").removeprefix("move_"), 256)


def _limit(column: Column) -> float:
    """What the values of a column are held to besides being finite: 0 for nothing. Of text the length."""
    if column.dtype == "str":
        return MAX_TEXT
    if column.dtype == "uint8":
        return index_limit(column)
    return LEAST_QUATERNION**2 if column.dtype == "float64" and column.name.endswith("rotation") else 0.0


class Layout:
    """The shapes that the columns of one schema must have, for given sizes of its letters; remembered."""

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
        self._fit: set[tuple[int, ...]] = set()  # sizes with which a message is not too long

    def named(self, sizes: tuple[int, ...]) -> dict[str, int]:
        """The sizes by letter."""
        return dict(zip(self._letters, sizes, strict=True))

    def plan(self, sizes: tuple[int, ...]) -> list[Planned]:
        """For every column what a body must hold; `sizes` are those of the letters, in their order.

        Raises ValueError if one is no size.
        """
        plan = self._plans.get(sizes)
        if plan is None:
            if not all(type(size) is int and 0 <= size <= MAX_ROWS for size in sizes):
                raise ValueError
            of = self.named(sizes)
            plan = []
            for column in self._schema.columns:
                shape = tuple(of[size] if isinstance(size, str) else size for size in column.shape)
                dtype = WIRE_DTYPE.get(column.dtype)
                n_bytes = prod(shape) * (dtype.itemsize if dtype else 0)
                name = DTYPE_NAME[column.dtype]
                plan.append(Planned(column.name, dtype, name, shape, list(shape), n_bytes, _limit(column)))
            if len(self._plans) < _MAX_PLANS:
                self._plans[sizes] = plan
        return plan

    def sizes(self, body: Body) -> tuple[int, ...]:
        """The sizes of the letters, from arrays; raises KeyError or IndexError where a column or an axis is missing."""
        return tuple([body[name].shape[axis] for name, axis in self._sources])

    def quick(self, body: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """The columns of a packed body with nothing odd about it; None where there is, whatever it may be."""
        try:
            plan = self.plan(tuple([body[name][1][axis] for name, axis in self._sources]))
        except (KeyError, IndexError, TypeError, ValueError):
            return None
        columns = packed_columns(body, plan)
        return columns if columns is not None and sound_values(columns, plan) <= MAX_SQUARES else None

    def sound(self, body: Body) -> bool:
        """Whether there is nothing odd about the values of a body that `conform` made; what it is, others find out."""
        sizes = self.sizes(body)
        plan = self.plan(sizes)
        if sizes not in self._fit:
            if sum([planned.n_bytes for planned in plan]) > MAX_BYTES:
                return False
            if len(self._fit) < _MAX_PLANS:
                self._fit.add(sizes)
        return sound_values(body, plan) <= MAX_SQUARES


@kernel
def packed_columns(body: Mapping[str, Any], plan: list[Planned]) -> dict[str, NDArray[Any]] | None:
    """The columns of a packed body, if all are as planned; their values may be anything."""
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
    """The columns of a body, read-only, if they are arrays as planned, of contiguous memory."""
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
    """The sum of the squares of all that is float64; infinite where anything else is beyond its limit.

    columns: arrays as planned
    """
    # All numbers at once. Less than the limit in all is less than what a column may have by itself.
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
