"""Valid columns of each schema: dtypes, shapes and limits of values.

Nearly all messages are valid, so all columns are checked at once. `codec` explains what is wrong with the others.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple, TypeGuard, TypeVar

import msgpack
import numpy as np
from numpy.typing import NDArray

from mast_zenoh.kernels import kernel
from mast_zenoh.messages.schemas import SCHEMAS, Body, Column, Schema

MAX_BYTES = 16 * 1024 * 1024  #: limit of a message
MAX_ROWS = 200_000  #: limit of a column
MAX_TEXT = 256  #: characters in one string
MAX_MAGNITUDE = 1e9  #: limit of values in SI units, far above any scene; larger ones would overflow the filters

#: By dtype of a column: its NumPy dtype in memory (little-endian), and its name in a message.
WIRE_DTYPE = {name: np.dtype(name) for name in ("float64", "float32", "int64", "int32", "uint8")}
DTYPE_NAME = {name: dtype.str for name, dtype in WIRE_DTYPE.items()} | {"str": "str"}
TEXT = np.dtype(object)  #: of columns of text
assert sys.byteorder == "little", "columns are sent with their bytes in memory order"

Key = TypeVar("Key")

MAX_SQUARES = MAX_MAGNITUDE**2
_MAX_PLANS = 1024  # that are remembered by sizes, and by length
_SHORT_TEXT = 0xA0  # of MessagePack: this byte plus a length below 32 precedes a text


class BodyPlan(NamedTuple):
    """The valid columns of a body with known sizes, as kernels check them.

    dtypes: object for text
    packed: (name of the dtype, shape as a list, bytes) of the column in a message; text has no bytes
    prefixes: of each column in a message: all that precedes its data
    fits: whether the columns are within MAX_BYTES
    """

    names: tuple[str, ...]
    dtypes: tuple[np.dtype[Any], ...]
    shapes: tuple[tuple[int, ...], ...]
    packed: tuple[tuple[str, list[int], int], ...]
    prefixes: tuple[bytes, ...]
    fits: bool


def limit_of(column: Column) -> float:
    """The limit of a column's values, besides being finite.

    Of text: characters; of indices: the exclusive maximum; of floats: the least sum of squares. It says nothing of each
    of several quaternions, so none is enough: they are checked one by one.
    """
    if column.dtype == "str":
        return MAX_TEXT
    if column.least_length and isinstance(column.shape[0], str):
        return np.inf
    return column.below if column.dtype == "uint8" else column.least_length**2


class BodyLayout:
    """The shapes of one schema's columns for given sizes of its letters, cached."""

    def __init__(self, schema: Schema) -> None:
        # for each letter, the column and the axis that give its size
        self._letters: dict[str, tuple[str, int]] = {}
        for column in schema.columns:
            for axis, size in enumerate(column.shape):
                if isinstance(size, str):
                    self._letters.setdefault(size, (column.name, axis))
        self._sources = tuple(self._letters.values())
        self.schema = schema
        self._names = tuple(column.name for column in schema.columns)
        self._limits = tuple(map(limit_of, schema.columns))
        #: what precedes the source, and the columns, in a message
        self.header_prefix = (
            b"\x87" + msgpack.packb({"schema": schema.name, "version": schema.version, "source": 0})[1:-1]
        )
        self.body_prefix = msgpack.packb("body") + msgpack.Packer().pack_map_header(len(schema.columns))
        self._plans: dict[tuple[int, ...], BodyPlan] = {}
        self._plan_of_length: dict[int, BodyPlan] = {}  # of the newest body with so many bytes

    def sizes(self, body: Body) -> dict[str, int]:
        """Sizes of the letters, from arrays; raises KeyError or IndexError if missing."""
        return {letter: body[name].shape[axis] for letter, (name, axis) in self._letters.items()}

    def plan(self, sizes: tuple[int, ...]) -> BodyPlan:
        """The valid columns of a body.

        sizes: of the letters, in their order
        Raises ValueError for an invalid size.
        """
        plan = self._plans.get(sizes)
        if plan is None:
            if not all(type(size) is int and 0 <= size <= MAX_ROWS for size in sizes):
                raise ValueError
            plan = self._planned(dict(zip(self._letters, sizes, strict=True)))
            _remember(self._plans, sizes, plan)
        return plan

    def _planned(self, sizes: Mapping[str, int]) -> BodyPlan:
        """The plan for sizes by letter."""
        columns = self.schema.columns
        shapes = tuple(tuple(sizes[n] if isinstance(n, str) else n for n in column.shape) for column in columns)
        dtypes = tuple(WIRE_DTYPE.get(column.dtype, TEXT) for column in columns)
        n_bytes = [prod(shape) * dtype.itemsize * (dtype != TEXT) for shape, dtype in zip(shapes, dtypes, strict=True)]
        packed = tuple(zip([DTYPE_NAME[column.dtype] for column in columns], map(list, shapes), n_bytes, strict=True))
        return BodyPlan(
            names=self._names,
            dtypes=dtypes,
            shapes=shapes,
            packed=packed,
            prefixes=tuple(itertools.starmap(_prefix, zip(self._names, packed, strict=True))),
            fits=sum(n_bytes) <= MAX_BYTES,
        )

    def plan_of(self, body: Body) -> BodyPlan:
        """The plan for the sizes of arrays; raises KeyError, IndexError or ValueError."""
        sizes = tuple([body[name].shape[axis] for name, axis in self._sources])
        return self._plans.get(sizes) or self.plan(sizes)

    def split(self, payload: bytes, place: int) -> dict[str, NDArray[Any]] | None:
        """The columns of a message, values unchecked; None if it is not as expected, which does not make it invalid.

        place: in the message, after its header

        Expected is a message as `codec.encode` makes it, with the sizes of the last one of its length, or of the only
        ones that a message of numbers with so many bytes can have.
        """
        plan = self._plan_of_length.get(len(payload) - place) or self._plan_of_rows(len(payload) - place)
        if plan is None or not payload.startswith(self.body_prefix, place):
            return None
        return split_columns(payload, place + len(self.body_prefix), plan)

    def _plan_of_rows(self, n_bytes: int) -> BodyPlan | None:
        """The plan of a message of numbers in which only the number of rows varies; None for other types.

        n_bytes: of the message after its header
        """
        if len(self._sources) != 1 or TEXT in (none := self.plan((0,))).dtypes:
            return None
        one = self.plan((1,))
        per_row = sum(size for _, _, size in one.packed) - sum(size for _, _, size in none.packed)
        fixed = len(self.body_prefix) + sum(map(len, none.prefixes)) + sum(size for _, _, size in none.packed)
        rows = (n_bytes - fixed) // per_row  # the prefixes grow by less than a row
        if not 0 <= rows <= MAX_ROWS:
            return None
        plan = self.plan((rows,))
        _remember(self._plan_of_length, n_bytes, plan)
        return plan

    def unpack(self, body: Mapping[str, Any], n_bytes: int) -> dict[str, NDArray[Any]] | None:
        """The columns of a packed body, values unchecked; None if it is invalid in any way.

        n_bytes: of the message after its header, for `split`; 0: unknown
        """
        try:
            plan = self.plan(tuple([body[name][1][axis] for name, axis in self._sources]))
        except (KeyError, IndexError, TypeError, ValueError):
            return None
        columns = packed_columns(body, plan)
        if columns is not None and n_bytes:
            _remember(self._plan_of_length, n_bytes, plan)
        return columns

    def is_sound(self, columns: Body) -> bool:
        """Whether all values are valid, of columns with the right dtypes and shapes; if not, each may still be."""
        plain = columns if type(columns) is dict else dict(columns)  # as compiled functions need it
        return sound_values(plain, self._names, self._limits) <= MAX_SQUARES


def _remember(plans: dict[Key, BodyPlan], key: Key, plan: BodyPlan) -> None:
    """Remember a plan. If there is no room, all others are forgotten, so that one sender cannot keep it full."""
    if len(plans) >= _MAX_PLANS:
        plans.clear()
    plans[key] = plan


def has_dtype(array: object, dtype: np.dtype[Any]) -> TypeGuard[NDArray[Any]]:
    """Whether this is an array of a dtype itself: longlong, for example, is equal to int64, but has another number."""
    return type(array) is np.ndarray and array.dtype == dtype and array.dtype.num == dtype.num


def _prefix(name: str, packed: tuple[str, list[int], int]) -> bytes:
    """What precedes the data of a column in a message: its name, dtype, shape and length; packed: see `BodyPlan`."""
    dtype, shape, n_bytes = packed
    prefix: bytes = msgpack.packb({name: [dtype, shape, 0]})[1:-1]
    if dtype == "str":
        return prefix + bytes(msgpack.Packer().pack_array_header(shape[0]))
    size = next(size for size in (1, 2, 4) if n_bytes < 256**size)
    return prefix + {1: b"\xc4", 2: b"\xc5", 4: b"\xc6"}[size] + n_bytes.to_bytes(size, "big")


@kernel
def packed_columns(body: Mapping[str, Any], plan: BodyPlan) -> dict[str, NDArray[Any]] | None:
    """The columns of a packed body if all match the plan, else None; values unchecked."""
    columns: dict[str, NDArray[Any]] = {}
    for name, dtype, shape, (dtype_name, dims, n_bytes) in zip(
        plan.names, plan.dtypes, plan.shapes, plan.packed, strict=True
    ):
        packed = body.get(name)
        if type(packed) is not list or len(packed) != 3:
            return None
        found_name, found_dims, data = packed
        if found_name != dtype_name or type(found_dims) is not list or found_dims != dims:
            return None
        for size in found_dims:
            if type(size) is not int:  # 3.0 and True are equal to whole numbers
                return None
        if dtype_name == "str":
            if type(data) is not list or [len(data)] != dims or not all(type(text) is str for text in data):
                return None
            columns[name] = array = np.empty(len(data), object)
            array[:] = data
        elif type(data) is not bytes or len(data) != n_bytes:
            return None
        else:
            columns[name] = np.ndarray(shape, dtype, data)
    return columns


def _text_at(payload: bytes, place: int) -> str | None:
    """The ASCII text at a place in a message, after a byte with its length; None if there is none."""
    n_bytes = payload[place] - _SHORT_TEXT if place < len(payload) else -1
    text = payload[place + 1 : place + 1 + n_bytes]
    return text.decode() if 0 <= n_bytes < 32 and len(text) == n_bytes and text.isascii() else None


@kernel
def split_header(payload: bytes, prefix: bytes) -> tuple[str, int, int, int, int] | None:
    """The source, frame, time_ns, seq and length of a header as `codec.encode` makes it; None for any other.

    prefix: the header up to the source
    """
    source = _text_at(payload, len(prefix)) if payload.startswith(prefix) else None
    if source is None:
        return None
    place = len(prefix) + 1 + len(source)
    numbers = []
    for name in (b"\xa5frame", b"\xa7time_ns", b"\xa3seq"):
        place += len(name) + 1
        first = payload[place - 1] if payload.startswith(name, place - 1 - len(name)) and place <= len(payload) else 255
        size = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}.get(first, 0)
        if (first >= 128 and not size) or place + size > len(payload):
            return None
        numbers.append(int.from_bytes(payload[place : place + size], "big") if size else first)
        place += size
    frame, time_ns, seq = numbers
    return None if max(numbers) >= 1 << 63 else (source, frame, time_ns, seq, place)


@kernel
def split_columns(payload: bytes, place: int, plan: BodyPlan) -> dict[str, NDArray[Any]] | None:
    """The columns that end a message, packed exactly as planned; None if they are not. Values are unchecked.

    place: of the first column
    """
    columns: dict[str, NDArray[Any]] = {}
    for name, dtype, shape, prefix, (_, _, n_bytes) in zip(
        plan.names, plan.dtypes, plan.shapes, plan.prefixes, plan.packed, strict=True
    ):
        if not payload.startswith(prefix, place):
            return None
        place += len(prefix)
        if dtype == TEXT:
            columns[name] = array = np.empty(shape, object)
            for row in range(len(array)):
                text = _text_at(payload, place)
                if text is None:
                    return None
                array[row] = text
                place += 1 + len(text)
        else:
            data = payload[place : place + n_bytes]
            if len(data) != n_bytes:
                return None
            columns[name] = np.ndarray(shape, dtype, data)
            place += n_bytes
    return columns if place == len(payload) else None


@kernel
def exact_columns(
    body: Mapping[str, Any],
    names: tuple[str, ...],
    dtypes: tuple[np.dtype[Any], ...],
    shapes: tuple[tuple[int, ...], ...],
) -> dict[str, NDArray[Any]] | None:
    """The columns of a body, read-only; None unless dtypes and shapes match exactly.

    Arrays must be contiguous.
    """
    columns: dict[str, NDArray[Any]] = {}
    for name, dtype, shape in zip(names, dtypes, shapes, strict=True):
        array = body.get(name)
        if not has_dtype(array, dtype) or array.shape != shape:
            return None
        if dtype is not TEXT:
            if not array.flags.c_contiguous:
                return None
            if array.flags.writeable:
                array = array.view()
                array.setflags(write=False)
        columns[name] = array
    return columns


@kernel
def sound_values(columns: Mapping[str, NDArray[Any]], names: tuple[str, ...], limits: tuple[float, ...]) -> float:
    """The sum of squares of all floating-point values; infinite if any value is invalid.

    columns: arrays of the names; limits: see `limit_of`
    """
    # All numbers in one sum: if it is within the limit, the sum of every column is too.
    squares = 0.0
    for name, limit in zip(names, limits, strict=True):
        array = columns[name]
        if array.dtype is TEXT:
            for item in array:
                if not isinstance(item, str) or len(item) > limit:
                    return float("inf")
        elif array.dtype.kind == "f":
            own = np.vdot(array.astype(np.float64), array)
            squares += own
            if own < limit:
                return float("inf")
        elif array.dtype == np.uint8 and array.size and max(array.tobytes()) >= limit:
            return float("inf")
    return float(squares)


#: The layouts of all message types that the codec knows.
LAYOUTS = {name: BodyLayout(schema) for name, schema in SCHEMAS.items()}

_layout_of_recording = lru_cache(maxsize=64)(BodyLayout)


def layout_of(schema: Schema) -> BodyLayout:
    """The layout of a message type, which may be of a recording and unknown here."""
    layout = LAYOUTS.get(schema.name)
    return layout if layout is not None and layout.schema is schema else _layout_of_recording(schema)
