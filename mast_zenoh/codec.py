"""Messages to bytes and back: MessagePack, columnar, versioned, strictly checked.

    {"schema": "tracks", "version": 1, "source": "ego", "frame": 3, "time_ns": 300000000, "seq": 3,
     "body": {"position": ["<f8", [12, 3], b"..."], "agents": ["str", [2], ["ego", "infra_1"]], ...}}

Arrays are raw little-endian bytes in C order; decoding makes read-only views of them and copies nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError
from mast_zenoh.kernels import kernel
from mast_zenoh.messages import SCHEMAS, Body, Column, Header, Message, Schema
from mast_zenoh.states import CLASSES

MAX_BYTES = 16 * 1024 * 1024  #: no message is longer
MAX_ROWS = 100_000  #: no column has more rows
MAX_TEXT = 256  #: characters in one string
MAX_MAGNITUDE = 1e9  #: no quantity of a scene in SI units comes near it; more would overflow the filters

LEAST_QUATERNION = 1e-3  #: length of a quaternion; they are normalised by those who use them

_HEADER_KEYS = ("schema", "version", "source", "frame", "time_ns", "seq", "body")
_HEADER_NAMES = frozenset(_HEADER_KEYS)
_MAP_OF_6, _MAP_OF_7, _BODY_KEY = b"\x86", b"\x87", b"\xa4body"
_LONGEST_HEADER = 4096  #: bytes
_WIRE_DTYPE = {name: np.dtype(name) for name in ("float64", "int64", "int32", "uint8")}  # little-endian: see below
_DTYPE_NAME = {name: dtype.str for name, dtype in _WIRE_DTYPE.items()} | {"str": "str"}
_INDEX_LIMITS = {"class_id": len(CLASSES), "action": 3, "port": 5, "fate": 5}
_HEADER_LIMIT = 1 << 62
_MAX_SQUARES = MAX_MAGNITUDE**2
assert sys.byteorder == "little", "columns are sent as they lie in memory"


_MAX_PLANS = 1024


class _Planned(NamedTuple):
    """What one column of a body of known sizes must hold; `dtype` is None for text. `limit`: see `_limit`."""

    name: str
    dtype: np.dtype[Any] | None
    dtype_name: str
    shape: tuple[int, ...]
    dims: list[int]
    n_bytes: int
    limit: float


def _index_limit(column: Column) -> int:
    """What an index in this column must be below."""
    return _INDEX_LIMITS.get(column.name.removeprefix("add_").removeprefix("remove_").removeprefix("move_"), 256)


def _limit(column: Column) -> float:
    """What the values of a column are held to besides being finite: 0 for nothing. Of text the length."""
    if column.dtype == "str":
        return MAX_TEXT
    if column.dtype == "uint8":
        return _index_limit(column)
    return LEAST_QUATERNION**2 if column.dtype == "float64" and column.name.endswith("rotation") else 0.0


class _Layout:
    """The shapes that the columns of one schema must have, for given sizes of its letters; remembered."""

    def __init__(self, schema: Schema) -> None:
        #: for each letter, the column and the axis that give its size
        self._letters: dict[str, tuple[str, int]] = {}
        for column in schema.columns:
            for axis, size in enumerate(column.shape):
                if isinstance(size, str):
                    self._letters.setdefault(size, (column.name, axis))
        self.sources = tuple(self._letters.values())
        self._schema = schema
        self._plans: dict[tuple[int, ...], list[_Planned]] = {}
        self._fit: set[tuple[int, ...]] = set()  # sizes with which a message is not too long

    def named(self, sizes: tuple[int, ...]) -> dict[str, int]:
        """The sizes by letter."""
        return dict(zip(self._letters, sizes, strict=True))

    def plan(self, sizes: tuple[int, ...]) -> list[_Planned]:
        """For every column what a body must hold; `sizes` are those of `sources`, in their order.

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
                dtype = _WIRE_DTYPE.get(column.dtype)
                n_bytes = prod(shape) * (dtype.itemsize if dtype else 0)
                name = _DTYPE_NAME[column.dtype]
                plan.append(_Planned(column.name, dtype, name, shape, list(shape), n_bytes, _limit(column)))
            if len(self._plans) < _MAX_PLANS:
                self._plans[sizes] = plan
        return plan

    def sizes(self, body: Body) -> tuple[int, ...]:
        """The sizes of a body of arrays; raises KeyError or IndexError where a column or an axis is missing."""
        return tuple([body[name].shape[axis] for name, axis in self.sources])

    def quick(self, body: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """The columns of a packed body with nothing odd about it; None where there is, whatever it may be."""
        try:
            plan = self.plan(tuple([body[name][1][axis] for name, axis in self.sources]))
        except (KeyError, IndexError, TypeError, ValueError):
            return None
        columns = packed_columns(body, plan)
        return columns if columns is not None and sound_values(columns, plan) <= _MAX_SQUARES else None

    def sound(self, body: Body) -> bool:
        """Whether there is nothing odd about the values of a body that `conform` made; what it is, others find out."""
        sizes = self.sizes(body)
        plan = self.plan(sizes)
        if sizes not in self._fit:
            if sum([planned.n_bytes for planned in plan]) > MAX_BYTES:
                return False
            if len(self._fit) < _MAX_PLANS:
                self._fit.add(sizes)
        return sound_values(body, plan) <= _MAX_SQUARES


@kernel
def packed_columns(body: Mapping[str, Any], plan: list[_Planned]) -> dict[str, NDArray[Any]] | None:
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
def exact_columns(body: Mapping[str, Any], plan: list[_Planned]) -> dict[str, NDArray[Any]] | None:
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
def sound_values(columns: Mapping[str, NDArray[Any]], plan: list[_Planned]) -> float:
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


_LAYOUTS = {name: _Layout(schema) for name, schema in SCHEMAS.items()}


def conform(header: Header, body: Body) -> Message:
    """A message whose body has exactly the columns of its schema, read-only and contiguous.

    Raises MessageError where a column is missing, unknown, or of the wrong dtype or shape.
    """
    schema = SCHEMAS[header.schema]
    if len(body) != len(schema.columns):
        raise MessageError(_names_differ(schema.name, body, schema.columns))
    layout = _LAYOUTS[schema.name]
    sizes: dict[str, int] = {}
    try:
        found = layout.sizes(body)
        plan = layout.plan(found)
        exact = exact_columns(body, plan)
        if exact is not None:
            return Message(header, exact)
        shapes = [planned.shape for planned in plan]
    except (KeyError, IndexError, ValueError):
        shapes = []  # what is odd is told below
    columns: dict[str, NDArray[Any]] = {}
    for index, column in enumerate(schema.columns):
        name, wire = column.name, _WIRE_DTYPE.get(column.dtype)
        if name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        array = body[name]
        if wire is not None:
            if type(array) is not np.ndarray or array.dtype != wire or not (array.ndim and array.flags.c_contiguous):
                array = np.ascontiguousarray(array, dtype=wire)
            if array.flags.writeable:
                array = array.view()
                array.setflags(write=False)
        if not shapes or array.shape != shapes[index]:
            _check_shape(schema.name, column, array.shape, layout.named(found) if shapes else sizes)
        columns[name] = array
    return Message(header, columns)


def check_values(message: Message) -> None:
    """Raises MessageError where `decode` would, had the message that `conform` made been sent as bytes."""
    header = message.header
    _check_header(header)
    if _LAYOUTS[header.schema].sound(message.body):
        _check_references(message)
        return
    if sum(column.nbytes for column in message.body.values()) > MAX_BYTES:
        raise MessageError(f"{header.schema}: at most {MAX_BYTES} bytes allowed")
    for column in SCHEMAS[header.schema].columns:
        array = message.body[column.name]
        if column.dtype == "str":
            _check_texts(header.schema, column, array)
        _check_values(header.schema, column, array)
    _check_references(message)


def encode(message: Message) -> bytes:
    """The bytes of a message that `conform` made."""
    header, columns = message
    layout = _LAYOUTS[header.schema]
    body: dict[str, list[Any]] = {}
    for name, dtype, dtype_name, _, dims, _, _ in layout.plan(layout.sizes(columns)):
        array = columns[name]
        body[name] = [dtype_name, dims, list(array) if dtype is None else array.tobytes()]
    version = SCHEMAS[header.schema].version
    values = (header.schema, version, header.source, header.frame, header.time_ns, header.seq, body)
    packed: bytes = msgpack.packb(dict(zip(_HEADER_KEYS, values, strict=True)))
    return packed


def decode(payload: bytes, expected: str) -> Message:
    """The message in `payload`, which must be of the schema `expected` in this package's version.

    Raises MessageError for anything else: truncated, oversized, of another version, with a missing or
    further column, a forged shape, a value that is not finite.
    """
    header, body = _opened(payload, expected)
    schema = SCHEMAS[expected]
    if not isinstance(body, dict) or len(body) != len(schema.columns):
        raise MessageError(_names_differ(expected, body, schema.columns))
    message = Message(header, _columns(schema, body))
    _check_references(message)
    return message


class Unopened(Mapping[str, NDArray[Any]]):
    """The columns of a message whose body nobody has looked at: whoever does so first decodes them.

    Then raises MessageError where `decode` would have, as often as somebody looks.
    """

    __slots__ = ("_columns", "_expected", "_payload")

    def __init__(self, payload: bytes, expected: str) -> None:
        self._payload, self._expected = payload, expected
        self._columns: Body | None = None

    def _open(self) -> Body:
        if self._columns is None:
            self._columns = decode(self._payload, self._expected).body
        return self._columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._open()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._open())

    def __len__(self) -> int:
        return len(self._open())


def decode_unopened(payload: bytes, expected: str) -> Message:
    """As `decode`, but only the header is checked now, and the body when somebody looks at it."""
    header = _quick_header(payload, expected) or decode_header(payload, expected)
    return Message(header, Unopened(payload, expected))


def _quick_header(payload: bytes, expected: str) -> Header | None:
    """The header of a message with nothing odd about it, without touching its body; None where there is."""
    end = payload.find(_BODY_KEY, 0, _LONGEST_HEADER)
    if payload[:1] != _MAP_OF_7 or end < 0 or len(payload) > MAX_BYTES:
        return None
    try:
        fields = msgpack.unpackb(_MAP_OF_6 + payload[1:end], strict_map_key=True, max_ext_len=0, max_map_len=6)
        schema, version, source, frame, time_ns, seq = [fields[name] for name in _HEADER_KEYS[:-1]]
    except Exception:  # whatever it is, the slow way finds out
        return None
    if schema != expected or type(version) is not int or version != SCHEMAS[expected].version:
        return None
    header = Header(schema, source, frame, time_ns, seq)
    _check_header(header)
    return header


def decode_header(payload: bytes, expected: str) -> Header:
    """The header of the message in `payload`; its body may be anything.

    Raises MessageError where `decode` would for all but the body.
    """
    return _opened(payload, expected)[0]


def _opened(payload: bytes, expected: str) -> tuple[Header, Any]:
    """The header, checked, and the body as it is packed."""
    if len(payload) > MAX_BYTES:
        raise MessageError(f"{expected}: {len(payload)} bytes, at most {MAX_BYTES} allowed")
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True, max_ext_len=0, max_map_len=64, max_array_len=MAX_ROWS)
    except Exception as error:
        raise MessageError(f"{expected}: not MessagePack: {type(error).__name__}: {error}") from None
    if not isinstance(fields, dict) or fields.keys() != _HEADER_NAMES:
        raise MessageError(f"{expected}: not a map of {', '.join(_HEADER_KEYS)}")
    schema, version, source, frame, time_ns, seq, body = [fields[name] for name in _HEADER_KEYS]
    wanted = SCHEMAS[expected].version
    if schema != expected or type(version) is not int or version != wanted:
        found = f"{str(schema)[:40]} version {str(version)[:10]}"
        raise MessageError(f"{expected}: found {found}, expected {expected} version {wanted}")
    header = Header(expected, source, frame, time_ns, seq)
    _check_header(header)
    return header, body


def _columns(schema: Schema, body: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The columns of a body, checked."""
    columns = _LAYOUTS[schema.name].quick(body)
    if columns is not None:
        return columns
    # Something is odd: the slow way finds out what, and says it.
    columns = {}
    sizes: dict[str, int] = {}
    for column in schema.columns:
        if column.name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        array = _array(schema.name, column, body[column.name], sizes)
        _check_values(schema.name, column, array)
        columns[column.name] = array
    return columns


def _check_header(header: Header) -> None:
    if not isinstance(header.source, str) or len(header.source) > MAX_TEXT:
        raise MessageError(f"{header.schema}: source is not a name")
    for name, value in (("frame", header.frame), ("time_ns", header.time_ns), ("seq", header.seq)):
        if type(value) is not int or not 0 <= value < _HEADER_LIMIT:
            raise MessageError(f"{header.schema}: {name} is {str(value)[:40]}, expected a whole number from 0")


def _array(schema: str, column: Column, packed: Any, sizes: dict[str, int]) -> NDArray[Any]:
    if not isinstance(packed, list) or len(packed) != 3:
        raise MessageError(f"{schema}.{column.name}: not [dtype, shape, data]")
    dtype, shape, data = packed
    if dtype != _DTYPE_NAME[column.dtype]:
        raise MessageError(f"{schema}.{column.name}: dtype {str(dtype)[:20]}, expected {_DTYPE_NAME[column.dtype]}")
    if not isinstance(shape, list) or not all(type(size) is int for size in shape):
        raise MessageError(f"{schema}.{column.name}: shape is not a list of whole numbers")
    _check_shape(schema, column, tuple(shape), sizes)
    if column.dtype == "str":
        if not isinstance(data, list) or [len(data)] != shape:
            raise MessageError(f"{schema}.{column.name}: not a list of {shape[0]} short strings")
        _check_texts(schema, column, data)
        texts = np.empty(len(data), dtype=object)
        texts[:] = data
        return texts
    wire = _WIRE_DTYPE[column.dtype]
    if not isinstance(data, bytes) or len(data) != prod(shape) * wire.itemsize:
        raise MessageError(f"{schema}.{column.name}: data do not fill the shape {shape}")
    return np.frombuffer(data, dtype=wire).reshape(shape)


def _check_shape(schema: str, column: Column, shape: tuple[int, ...], sizes: dict[str, int]) -> None:
    if len(shape) == len(column.shape):
        for size, wanted in zip(shape, column.shape, strict=True):
            if not 0 <= size <= MAX_ROWS:
                break
            if size != (sizes.setdefault(wanted, size) if isinstance(wanted, str) else wanted):
                break
        else:
            return
    known = ", ".join(f"{name} = {size}" for name, size in sizes.items())
    expected = f"({', '.join(map(str, column.shape))})" + (f" with {known}" if known else "")
    raise MessageError(f"{schema}.{column.name}: shape {shape}, expected {expected}")


def _check_texts(schema: str, column: Column, texts: Sequence[object] | NDArray[Any]) -> None:
    if not all(isinstance(item, str) and len(item) <= MAX_TEXT for item in texts):
        raise MessageError(f"{schema}.{column.name}: not a list of {len(texts)} short strings")


def _check_values(schema: str, column: Column, array: NDArray[Any]) -> None:
    if column.dtype == "float64":
        # The sum of squares is not finite as soon as one value is, and too large where one is absurd: one pass, no
        # temporary. The mean, not the sum, is limited, so that what is made of many sound messages is sound.
        flat = array.reshape(-1)
        squares = np.vdot(flat, flat)
        if not squares <= _MAX_SQUARES * max(len(flat), 1):
            raise MessageError(f"{schema}.{column.name}: a value is not finite or beyond {MAX_MAGNITUDE:g}")
        if column.name.endswith("rotation") and squares < LEAST_QUATERNION**2:
            raise MessageError(f"{schema}.{column.name}: a quaternion of no length, which is no rotation")
    elif column.dtype == "uint8" and array.size:
        limit = _index_limit(column)
        if int(array.max()) >= limit:
            raise MessageError(f"{schema}.{column.name}: index {int(array.max())}, expected below {limit}")


def _check_references(message: Message) -> None:
    """What must hold between columns: row numbers exist, ids are unique."""
    schema, body = message.header.schema, message.body
    if schema == "collated":
        agent, rows = body["agent"], len(body["agents"])
        if agent.size and not (agent.min() >= 0 and agent.max() < rows):
            raise MessageError(f"collated.agent: a row outside `agents`, which has {rows}")
    elif schema in ("tracks", "picture") and len(set(body["id"].tolist())) != len(body["id"]):
        raise MessageError(f"{schema}.id: an id occurs twice")


def _names_differ(schema: str, body: Any, columns: tuple[Column, ...]) -> str:
    wanted = {column.name for column in columns}
    found = set(map(str, body)) if isinstance(body, Mapping) else set()
    return f"{schema}: columns missing: {sorted(wanted - found)}, unknown: {sorted(found - wanted)[:8]}"
