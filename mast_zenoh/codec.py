"""Messages to bytes and back: MessagePack, columnar, versioned, strictly checked.

    {"schema": "tracks", "version": 1, "source": "ego", "frame": 3, "time_ns": 300000000, "seq": 3,
     "body": {"position": ["<f8", [12, 3], b"..."], "agents": ["str", [2], ["ego", "infra_1"]], ...}}

Arrays are raw little-endian bytes in C order; decoding makes read-only views of them and copies nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import SCHEMAS, Body, Column, Header, Message, Schema
from mast_zenoh.states import CLASSES

MAX_BYTES = 16 * 1024 * 1024  #: no message is longer
MAX_ROWS = 100_000  #: no column has more rows
MAX_TEXT = 256  #: characters in one string
MAX_MAGNITUDE = 1e9  #: no quantity of a scene in SI units comes near it; more would overflow the filters

LEAST_QUATERNION = 1e-3  #: length of a quaternion; they are normalised by those who use them

_HEADER_KEYS = ("schema", "version", "source", "frame", "time_ns", "seq", "body")
_WIRE_DTYPE = {name: np.dtype(name).newbyteorder("<") for name in ("float64", "int64", "int32", "uint8")}
_DTYPE_NAME = {name: dtype.str for name, dtype in _WIRE_DTYPE.items()} | {"str": "str"}
_INDEX_LIMITS = {"class_id": len(CLASSES), "action": 3}
_HEADER_LIMIT = 1 << 62
_MAX_SQUARES = MAX_MAGNITUDE**2
_WHOLE = {int}
assert sys.byteorder == "little", "columns are sent as they lie in memory"


class _Layout:
    """The shapes that the columns of one schema must have, for given sizes of its letters; remembered."""

    def __init__(self, schema: Schema) -> None:
        self.dtypes = [_WIRE_DTYPE.get(column.dtype) for column in schema.columns]
        #: for each letter, the column and the axis that give its size
        self._letters: dict[str, tuple[str, int]] = {}
        for column in schema.columns:
            for axis, size in enumerate(column.shape):
                if isinstance(size, str):
                    self._letters.setdefault(size, (column.name, axis))
        self.sources = tuple(self._letters.values())
        self._templates = [column.shape for column in schema.columns]
        self._known: dict[tuple[int, ...], list[tuple[int, ...]]] = {}

    def shapes(self, sizes: tuple[int, ...]) -> list[tuple[int, ...]]:
        """The shape of every column; `sizes` are those of `sources`, in their order. ValueError if one is no size."""
        found = self._known.get(sizes)
        if found is None:
            if not all(type(size) is int and 0 <= size <= MAX_ROWS for size in sizes):
                raise ValueError
            of = self.named(sizes)
            found = [tuple(of[s] if isinstance(s, str) else s for s in shape) for shape in self._templates]
            if len(self._known) < 1024:
                self._known[sizes] = found
        return found

    def named(self, sizes: tuple[int, ...]) -> dict[str, int]:
        """The sizes by letter."""
        return dict(zip(self._letters, sizes, strict=True))


_LAYOUTS = {name: _Layout(schema) for name, schema in SCHEMAS.items()}


def conform(header: Header, body: Body) -> Message:
    """A message whose body has exactly the columns of its schema, read-only and contiguous.

    Raises MessageError where a column is missing, unknown, or of the wrong dtype or shape.
    """
    schema = SCHEMAS[header.schema]
    if len(body) != len(schema.columns):
        raise MessageError(_names_differ(schema.name, body, schema.columns))
    layout = _LAYOUTS[schema.name]
    shapes: list[tuple[int, ...]] | None = None
    sizes: dict[str, int] = {}
    try:
        found = tuple([body[name].shape[axis] for name, axis in layout.sources])
        shapes, sizes = layout.shapes(found), layout.named(found)
    except (KeyError, IndexError, ValueError):
        pass  # what is odd is told below
    columns: dict[str, NDArray[Any]] = {}
    for index, column in enumerate(schema.columns):
        if column.name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        array = body[column.name]
        wire = layout.dtypes[index]
        if wire is not None:
            array = np.ascontiguousarray(array, dtype=wire)
            if array.flags.writeable:
                array = array.view()
                array.flags.writeable = False
        if shapes is None or array.shape != shapes[index]:
            _check_shape(schema.name, column, array.shape, sizes)
        columns[column.name] = array
    return Message(header, columns)


def check_values(message: Message) -> None:
    """Raises MessageError where `decode` would, had the message that `conform` made been sent as bytes."""
    header = message.header
    _check_header(header)
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
    header, schema = message.header, SCHEMAS[message.header.schema]
    body: dict[str, list[Any]] = {}
    for column in schema.columns:
        array = message.body[column.name]
        data = list(array) if column.dtype == "str" else array.tobytes()
        body[column.name] = [_DTYPE_NAME[column.dtype], list(array.shape), data]
    values = (schema.name, schema.version, header.source, header.frame, header.time_ns, header.seq, body)
    packed: bytes = msgpack.packb(dict(zip(_HEADER_KEYS, values, strict=True)))
    return packed


def decode(payload: bytes, expected: str) -> Message:
    """The message in `payload`, which must be of the schema `expected` in this package's version.

    Raises MessageError for anything else: truncated, oversized, of another version, with a missing or
    further column, a forged shape, a value that is not finite.
    """
    if len(payload) > MAX_BYTES:
        raise MessageError(f"{expected}: {len(payload)} bytes, at most {MAX_BYTES} allowed")
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True, max_ext_len=0, max_map_len=64, max_array_len=MAX_ROWS)
    except Exception as error:
        raise MessageError(f"{expected}: not MessagePack: {type(error).__name__}: {error}") from None
    if not isinstance(fields, dict) or fields.keys() != set(_HEADER_KEYS):
        raise MessageError(f"{expected}: not a map of {', '.join(_HEADER_KEYS)}")
    schema = SCHEMAS[expected]
    version = fields["version"]
    if fields["schema"] != schema.name or type(version) is not int or version != schema.version:
        found = f"{str(fields['schema'])[:40]} version {str(version)[:10]}"
        raise MessageError(f"{expected}: found {found}, expected {schema.name} version {schema.version}")
    header = Header(*(fields[name] for name in ("schema", "source", "frame", "time_ns", "seq")))
    _check_header(header)
    body = fields["body"]
    if not isinstance(body, dict) or len(body) != len(schema.columns):
        raise MessageError(_names_differ(expected, body, schema.columns))
    message = Message(header, _columns(schema, body))
    _check_references(message)
    return message


def _columns(schema: Schema, body: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The columns of a body, checked. The way of a sound message is short; what is odd in any way goes through
    `_array`, which takes its time and says what is wrong.
    """
    layout = _LAYOUTS[schema.name]
    shapes: list[tuple[int, ...]] | None = None
    sizes: dict[str, int] = {}
    try:
        found = tuple([body[name][1][axis] for name, axis in layout.sources])
        shapes, sizes = layout.shapes(found), layout.named(found)
    except (KeyError, IndexError, TypeError, ValueError):
        pass  # what is odd is told below
    columns: dict[str, NDArray[Any]] = {}
    for index, column in enumerate(schema.columns):
        packed = body.get(column.name)
        if packed is None:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        wire = layout.dtypes[index]
        if (
            shapes is not None
            and wire is not None
            and type(packed) is list
            and len(packed) == 3
            and packed[0] == wire.str
            and type(packed[1]) is list
            and tuple(packed[1]) == shapes[index]
            and set(map(type, packed[1])) == _WHOLE  # 3.0 and True are equal to whole numbers
            and type(packed[2]) is bytes
            and len(packed[2]) == prod(shapes[index]) * wire.itemsize
        ):
            array = np.frombuffer(packed[2], wire)
            if len(shapes[index]) > 1:
                array = array.reshape(shapes[index])
        else:
            array = _array(schema.name, column, packed, sizes)
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
        limit = _INDEX_LIMITS.get(column.name.removeprefix("add_").removeprefix("remove_").removeprefix("move_"), 256)
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
