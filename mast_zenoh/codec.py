"""Messages to bytes and back: MessagePack, columnar, versioned, strictly checked.

    {"schema": "tracks", "version": 1, "source": "ego", "frame": 3, "time_ns": 300000000, "seq": 3,
     "body": {"position": ["<f8", [12, 3], b"..."], "agents": ["str", [2], ["ego", "infra_1"]], ...}}

Arrays are raw little-endian bytes in C order; decoding makes read-only views of them and copies nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import prod
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import SCHEMAS, Body, Column, Header, Message
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
assert sys.byteorder == "little", "columns are sent as they lie in memory"


def conform(header: Header, body: Body) -> Message:
    """A message whose body has exactly the columns of its schema, read-only and contiguous.

    Raises MessageError where a column is missing, unknown, or of the wrong dtype or shape.
    """
    schema = SCHEMAS[header.schema]
    if len(body) != len(schema.columns):
        raise MessageError(_names_differ(schema.name, body, schema.columns))
    sizes: dict[str, int] = {}
    columns: dict[str, NDArray[Any]] = {}
    for column in schema.columns:
        if column.name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        array = body[column.name]
        if column.dtype != "str":
            array = np.ascontiguousarray(array, dtype=_WIRE_DTYPE[column.dtype])
            if array.flags.writeable:
                array = array.view()
                array.flags.writeable = False
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
    sizes: dict[str, int] = {}
    columns: dict[str, NDArray[Any]] = {}
    for column in schema.columns:
        if column.name not in body:
            raise MessageError(_names_differ(expected, body, schema.columns))
        array = _array(expected, column, body[column.name], sizes)
        _check_values(expected, column, array)
        columns[column.name] = array
    message = Message(header, columns)
    _check_references(message)
    return message


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
        texts = np.empty(len(data), dtype=object)
        texts[:] = data
        _check_texts(schema, column, texts)
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


def _check_texts(schema: str, column: Column, array: NDArray[Any]) -> None:
    if not all(isinstance(item, str) and len(item) <= MAX_TEXT for item in array):
        raise MessageError(f"{schema}.{column.name}: not a list of {len(array)} short strings")


def _check_values(schema: str, column: Column, array: NDArray[Any]) -> None:
    if column.dtype == "float64":
        # The sum of squares is not finite, or too large, as soon as one value is: one pass, no temporary.
        if array.size and not np.vdot(array, array) <= MAX_MAGNITUDE**2:
            raise MessageError(f"{schema}.{column.name}: a value is not finite or beyond {MAX_MAGNITUDE:g}")
        if column.name.endswith("rotation") and np.vdot(array, array) < LEAST_QUATERNION**2:
            raise MessageError(f"{schema}.{column.name}: a quaternion of no length, which is no rotation")
    elif column.dtype == "uint8" and array.size:
        limit = _INDEX_LIMITS.get(column.name.removeprefix("add_").removeprefix("remove_").removeprefix("move_"), 256)
        if int(array.max()) >= limit:
            raise MessageError(f"{schema}.{column.name}: index {int(array.max())}, expected below {limit}")


def _check_references(message: Message) -> None:
    """What must hold between columns, and would break whoever fuses these tracks."""
    schema, body = message.header.schema, message.body
    if schema == "collated":
        agent, rows = body["agent"], len(body["agents"])
        if agent.size and not (0 <= agent.min() and agent.max() < rows):
            raise MessageError(f"collated.agent: a row outside `agents`, which has {rows}")
    elif schema in ("tracks", "picture") and len(body["id"]):
        if len(set(body["id"].tolist())) != len(body["id"]):
            raise MessageError(f"{schema}.id: an id occurs twice")
        try:
            np.linalg.cholesky(body["covariance"])
        except np.linalg.LinAlgError:
            raise MessageError(f"{schema}.covariance: not positive definite") from None


def _names_differ(schema: str, body: Any, columns: tuple[Column, ...]) -> str:
    wanted = {column.name for column in columns}
    found = set(map(str, body)) if isinstance(body, Mapping) else set()
    return f"{schema}: columns missing: {sorted(wanted - found)}, unknown: {sorted(found - wanted)[:8]}"
