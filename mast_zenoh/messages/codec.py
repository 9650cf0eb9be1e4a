"""Encodes and decodes messages: columnar MessagePack, versioned, strictly checked.

    {"schema": "tracks", "version": 1, "source": "ego", "frame": 3, "time_ns": 300000000, "seq": 3,
     "body": {"position": ["<f8", [12, 3], b"..."], "agents": ["str", [2], ["ego", "infra_1"]], ...}}

The body of a wire with a codec has its bytes instead, see `packed`.

Arrays are raw little-endian bytes in C order; decoding returns read-only views and copies nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import prod
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError
from mast_zenoh.messages.layout import (
    DTYPE_NAME,
    LAYOUTS,
    MAX_BYTES,
    MAX_MAGNITUDE,
    MAX_ROWS,
    MAX_SQUARES,
    MAX_TEXT,
    TEXT,
    WIRE_DTYPE,
    exact_columns,
    has_dtype,
    layout_of,
    split_header,
)
from mast_zenoh.messages.limits import NO_LIMITS, RowChoice, RowLimits
from mast_zenoh.messages.packed import CODECS, Packed, sent_body, unpack_body
from mast_zenoh.messages.schemas import SCHEMAS, Body, Column, Header, Message, Schema, text

_HEADER_KEYS = ("schema", "version", "source", "frame", "time_ns", "seq", "body")
_HEADER_NAMES = frozenset(_HEADER_KEYS)
_BODY_KEY = b"\xa4body"
_pack = msgpack.Packer().pack  # one for all messages: each would begin with a buffer of 256 KiB
_HEADER_LIMIT = 1 << 62


def conform(header: Header, body: Body) -> Message:
    """A message with exactly the columns of its schema, read-only and contiguous.

    Raises MessageError if a column is missing or unknown, or has the wrong dtype or shape.
    """
    schema = SCHEMAS[header.schema]
    if len(body) != len(schema.columns):
        raise MessageError(_names_differ(schema.name, body, schema.columns))
    layout = LAYOUTS[schema.name]
    sizes: dict[str, int] = {}
    try:
        plan = layout.plan_of(body)
        exact = exact_columns(body, plan.names, plan.dtypes, plan.shapes)
        if exact is not None:
            return Message(header, exact)
        shapes, sizes = plan.shapes, layout.sizes(body)
    except (AttributeError, KeyError, IndexError, ValueError):
        shapes = ()  # the loop below raises the error
    columns: dict[str, NDArray[Any]] = {}
    for index, column in enumerate(schema.columns):
        name, wire = column.name, WIRE_DTYPE.get(column.dtype)
        if name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        array = body[name]
        if wire is not None:
            if not (has_dtype(array, wire) and array.ndim and array.flags.c_contiguous):
                array = _converted(schema.name, column.name, array, wire)
            if array.flags.writeable:
                array = array.view()
                array.setflags(write=False)
        elif not isinstance(array, np.ndarray):
            raise MessageError(f"{schema.name}.{name}: found a {type(array).__name__}, expected text(...)")
        if not shapes or array.shape != shapes[index]:
            _check_shape(schema.name, column, array.shape, sizes)
        columns[name] = array
    return Message(header, columns)


def _converted(schema: str, column: str, array: Any, wire: np.dtype[Any]) -> NDArray[Any]:
    """A contiguous array converted to dtype `wire`; raises MessageError if values change."""
    try:
        original = np.asarray(array)
    except ValueError as error:
        raise MessageError(f"{schema}.{column}: not an array: {error}") from None
    if original.dtype.kind not in "biuf":
        raise MessageError(f"{schema}.{column}: found {original.dtype}, expected {wire}")
    with np.errstate(all="ignore"):
        converted = np.ascontiguousarray(original, dtype=wire)
        # rounding to a float is not an error
        if wire.kind != "f" and not np.array_equal(original, converted):
            raise MessageError(f"{schema}.{column}: found {original.dtype} values that {wire} cannot represent")
    return converted.view(wire)  # also of a type that is equal to it, such as longlong


def check_values(message: Message, limits: RowLimits = NO_LIMITS) -> None:
    """Raise MessageError if `decode` would refuse a message that `conform` made."""
    header, full = message
    _check_kept(message, limits.shortened(header.schema, full, header.schema))


def limited(message: Message, limits: RowLimits, limit_of: str | None = None) -> Message:
    """The message as `decode` returns it: without the rows beyond the limit of its type."""
    header, body = message
    kept = limits.shortened(header.schema, body, limit_of or header.schema)
    return message if kept is body else Message(header, kept)


def received(message: Message, limits: RowLimits, flaw: str, choice: RowChoice | None) -> Message:
    """A message that `conform` made, as `decode` returns it to a receiver with a choice of rows.

    flaw: why `check_values` refuses it; empty: it does not

    Raises MessageError if `decode` would.
    """
    header, body = message
    kept = limits.shortened(header.schema, body, header.schema, choice)
    if kept is not body and choice is not None:
        _check_kept(message, kept)  # other rows than the sender's check has seen
    elif flaw:
        raise MessageError(flaw)
    return message if kept is body else Message(header, kept)


def _check_kept(message: Message, kept: Body) -> None:
    """Raise MessageError for a message that is too long, or whose header or kept rows are invalid."""
    header, full = message
    check_header(header)
    layout = LAYOUTS[header.schema]
    if not layout.plan_of(full).fits:
        raise MessageError(f"{header.schema}: at most {MAX_BYTES} bytes allowed")
    if not layout.is_sound(kept):
        _check_columns(layout.schema, kept)
    _check_references(message if kept is full else Message(header, kept))


def encode(message: Message) -> bytes:
    """Encode a message that `conform` made."""
    header, columns = message
    layout = LAYOUTS[header.schema]
    numbers = _pack({"frame": header.frame, "time_ns": header.time_ns, "seq": header.seq})[1:]
    if type(columns) is Packed:
        start = [layout.header_prefix, _pack(header.source), numbers, _BODY_KEY]
        return b"".join([*start, _pack(sent_body(columns))])
    plan = layout.plan_of(columns)
    parts = [layout.header_prefix, _pack(header.source), numbers, layout.body_prefix]
    for name, prefix, dtype in zip(plan.names, plan.prefixes, plan.dtypes, strict=True):
        parts.append(prefix)
        parts += map(_pack, columns[name]) if dtype is TEXT else (columns[name],)
    return b"".join(parts)


def decode(
    payload: bytes,
    expected: str | Schema,
    limits: RowLimits = NO_LIMITS,
    limit_of: str | None = None,
    choice: RowChoice | None = None,
) -> Message:
    """Decode a message of type `expected`: its name, or the schema of a recording.

    limit_of: which of the limits holds, None: that of its type; rows beyond it are left out, and not checked
    choice: which rows are left out; None: those with the lowest scores

    Raises MessageError for anything else: a truncated or oversized message, another version, a missing or unknown
    column, a forged shape, a value that is not finite.
    """
    schema = SCHEMAS[expected] if isinstance(expected, str) else expected
    layout = layout_of(schema)
    header, place = _quick_header(payload, schema) or (None, 0)
    columns: Body | None = None if header is None else layout.split(payload, place)
    if header is None or columns is None:
        limits.check_length(schema.name, len(payload))
        header, body = _unpack(payload, schema)
        columns = _packed(schema, body)
    if columns is None:
        if not isinstance(body, dict) or len(body) != len(schema.columns):
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        columns = layout.unpack(body, len(payload) - place if place else 0) or _columns(schema, body)
    kept = limits.shortened(schema.name, columns, limit_of or schema.name, choice)
    if not layout.is_sound(kept):
        _check_columns(schema, kept)
    message = Message(header, kept)
    _check_references(message)
    return message


class LazyBody(Mapping[str, NDArray[Any]]):
    """The columns of a message, decoded on first access.

    Every access raises MessageError if `decode` would have done so.
    """

    __slots__ = ("_columns", "_expected", "_payload")

    def __init__(self, payload: bytes, expected: str | Schema) -> None:
        self._payload, self._expected = payload, expected
        self._columns: Body | None = None

    def _decoded(self) -> Body:
        if self._columns is None:
            self._columns = decode(self._payload, self._expected).body
        return self._columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._decoded()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._decoded())

    def __len__(self) -> int:
        return len(self._decoded())


def known_objects(before: Body, after: Body) -> int | None:
    """How many objects the sender of a message knows, with those that a change adds and removes; None: no such count.

    before: as received; raises MessageError if it is lazy, and invalid
    """
    decoded = before._decoded() if isinstance(before, LazyBody) else before
    return max(decoded.known - len(decoded["id"]) + len(after["id"]), 0) if type(decoded) is Packed else None


def decode_lazily(payload: bytes, expected: str | Schema) -> Message:
    """Decode the header now, and the body on first access."""
    return Message(decode_header_only(payload, expected), LazyBody(payload, expected))


def decode_header_only(payload: bytes, expected: str | Schema) -> Header:
    """Decode the header of a message without checking its body.

    Raises MessageError if `decode` would do so because of the header.
    """
    schema = SCHEMAS[expected] if isinstance(expected, str) else expected
    return (_quick_header(payload, schema) or _unpack(payload, schema))[0]


def _quick_header(payload: bytes, expected: Schema) -> tuple[Header, int] | None:
    """The header of a message and where it ends; None if anything is unusual."""
    found = split_header(payload, layout_of(expected).header_prefix)
    if found is None or not payload.startswith(_BODY_KEY, found[-1]) or len(payload) > MAX_BYTES:
        return None
    source, frame, time_ns, seq, end = found
    header = Header(expected.name, source, frame, time_ns, seq)
    check_header(header)
    return header, end


def decode_header(payload: bytes, expected: str | Schema) -> Header:
    """Decode the header of a message, whatever its body.

    Raises MessageError if `decode` would do so for any reason other than the body's columns.
    """
    schema = SCHEMAS[expected] if isinstance(expected, str) else expected
    layout = layout_of(schema)
    header, place = _quick_header(payload, schema) or (None, 0)
    if header is not None and layout.split(payload, place) is not None:
        return header
    header, body = _unpack(payload, schema)
    if place and isinstance(body, dict):
        layout.unpack(body, len(payload) - place)  # the next one of this length is split
    return header


def _unpack(payload: bytes, expected: Schema) -> tuple[Header, Any]:
    """(header, packed body) of a message; the header is checked."""
    name = expected.name
    if len(payload) > MAX_BYTES:
        raise MessageError(f"{name}: {len(payload)} bytes, at most {MAX_BYTES} allowed")
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True, max_ext_len=0, max_map_len=64, max_array_len=MAX_ROWS)
    except Exception as error:
        raise MessageError(f"{name}: not MessagePack: {type(error).__name__}: {error}") from None
    if not isinstance(fields, dict) or fields.keys() != _HEADER_NAMES:
        raise MessageError(f"{name}: not a map of {', '.join(_HEADER_KEYS)}")
    schema, version, source, frame, time_ns, seq, body = [fields[key] for key in _HEADER_KEYS]
    if schema != name or type(version) is not int or version != expected.version:
        actual = f"{str(schema)[:40]} version {str(version)[:10]}"
        raise MessageError(f"{name}: found {actual}, expected {name} version {expected.version}")
    header = Header(name, source, frame, time_ns, seq)
    check_header(header)
    return header, body


def _packed(schema: Schema, body: Any) -> Body | None:
    """The columns of a body that travels in another format; None if it does not."""
    if not isinstance(body, dict) or not 1 <= len(body) <= 2:
        return None
    codec = next(iter(body))
    if codec not in CODECS or schema.name not in CODECS[codec].messages:
        return None
    return unpack_body(body)


def _columns(schema: Schema, body: Mapping[str, Any]) -> Body:
    """The columns of a packed body; raises MessageError for one that `BodyLayout.unpack` does not accept."""
    columns: dict[str, NDArray[Any]] = {}
    sizes: dict[str, int] = {}
    for column in schema.columns:
        if column.name not in body:
            raise MessageError(_names_differ(schema.name, body, schema.columns))
        columns[column.name] = _array_of(schema.name, column, body[column.name], sizes)
    return columns


def _check_columns(schema: Schema, columns: Body) -> None:
    """Check the values of each column, so that an error names it."""
    for column in schema.columns:
        if column.dtype == "str":
            _check_strings(schema.name, column, columns[column.name])
        _check_column(schema.name, column, columns[column.name])


def check_header(header: Header) -> None:
    """Raise MessageError for a header that no message may have."""
    schema, source, frame, time_ns, seq = header
    if not isinstance(source, str) or len(source) > MAX_TEXT:
        raise MessageError(f"{schema}: source is not a name")
    numbers = frame, time_ns, seq
    if type(frame) is type(time_ns) is type(seq) is int and min(numbers) >= 0 and max(numbers) < _HEADER_LIMIT:
        return
    for name, value in (("frame", frame), ("time_ns", time_ns), ("seq", seq)):
        if type(value) is not int or not 0 <= value < _HEADER_LIMIT:
            raise MessageError(f"{schema}: {name} is {str(value)[:40]}, expected a whole number from 0")


def _array_of(schema: str, column: Column, packed: Any, sizes: dict[str, int]) -> NDArray[Any]:
    """The array of a column packed as [dtype, shape, data]; sizes: see `check_shape`."""
    if not isinstance(packed, list) or len(packed) != 3:
        raise MessageError(f"{schema}.{column.name}: not [dtype, shape, data]")
    dtype, shape, data = packed
    if dtype != DTYPE_NAME[column.dtype]:
        raise MessageError(f"{schema}.{column.name}: dtype {str(dtype)[:20]}, expected {DTYPE_NAME[column.dtype]}")
    if not isinstance(shape, list) or not all(type(size) is int for size in shape):
        raise MessageError(f"{schema}.{column.name}: shape is not a list of whole numbers")
    _check_shape(schema, column, tuple(shape), sizes)
    if column.dtype == "str":
        if not isinstance(data, list) or [len(data)] != shape:
            raise MessageError(f"{schema}.{column.name}: not a list of {shape[0]} short strings")
        _check_strings(schema, column, data)
        return text(data)
    wire = WIRE_DTYPE[column.dtype]
    if not isinstance(data, bytes) or len(data) != prod(shape) * wire.itemsize:
        raise MessageError(f"{schema}.{column.name}: data do not fill the shape {shape}")
    return np.frombuffer(data, dtype=wire).reshape(shape)


def _check_shape(schema: str, column: Column, shape: tuple[int, ...], sizes: dict[str, int]) -> None:
    """Check a shape against the schema; adds the sizes of its letters to `sizes`."""
    if len(shape) == len(column.shape):
        for size, expected_size in zip(shape, column.shape, strict=True):
            if not 0 <= size <= MAX_ROWS:
                break
            if size != (sizes.setdefault(expected_size, size) if isinstance(expected_size, str) else expected_size):
                break
        else:
            return
    known = ", ".join(f"{name} = {size}" for name, size in sizes.items())
    expected = f"({', '.join(map(str, column.shape))})" + (f" with {known}" if known else "")
    raise MessageError(f"{schema}.{column.name}: shape {shape}, expected {expected}")


def _check_strings(schema: str, column: Column, strings: Sequence[object] | NDArray[Any]) -> None:
    """Check that all items are text of at most MAX_TEXT characters."""
    if not all(isinstance(item, str) and len(item) <= MAX_TEXT for item in strings):
        raise MessageError(f"{schema}.{column.name}: not a list of {len(strings)} short strings")


def _check_column(schema: str, column: Column, array: NDArray[Any]) -> None:
    """Check values: finite and plausible numbers, quaternions not zero, valid indices."""
    if column.dtype in ("float64", "float32"):
        # One pass without temporaries: the sum of squares is not finite, or too large, if any value is.
        # The mean is limited, not the sum, so that a message collated from many valid ones is valid.
        with np.errstate(invalid="ignore"):  # NaNs that signal, which are refused below
            flat = array.reshape(-1).astype(np.float64, copy=False)
        squares = np.vdot(flat, flat)
        if not squares <= MAX_SQUARES * max(len(flat), 1):
            raise MessageError(f"{schema}.{column.name}: a value is not finite or beyond {MAX_MAGNITUDE:g}")
        if column.least_length and array.size:
            rows = array.reshape(len(array), -1) if isinstance(column.shape[0], str) else flat[None]
            if np.einsum("ij,ij->i", rows, rows).min() < column.least_length**2:
                raise MessageError(f"{schema}.{column.name}: a quaternion of length 0 is not a rotation")
    elif column.dtype == "uint8" and array.size and int(array.max()) >= column.below:
        raise MessageError(f"{schema}.{column.name}: index {int(array.max())}, expected below {column.below}")


def _check_references(message: Message) -> None:
    """Check relations between columns: row numbers exist, ids are unique."""
    schema, body = message.header.schema, message.body
    if schema == "collated":
        agent, rows = body["agent"], len(body["agents"])
        if agent.size and not (agent.min() >= 0 and agent.max() < rows):
            raise MessageError(f"collated.agent: a row outside `agents`, which has {rows}")
    elif schema in ("tracks", "picture", "relayed") and len(set(body["id"].tolist())) != len(body["id"]):
        raise MessageError(f"{schema}.id: an id occurs twice")
    elif schema == "gossip":
        trust = body["trust"]
        if len(trust) and not 0.0 <= trust.min() <= trust.max() <= 1.0:
            raise MessageError("gossip.trust: a value is not from 0 to 1")


def _names_differ(schema: str, body: Any, columns: tuple[Column, ...]) -> str:
    """An error message that lists the missing and the unknown columns of a body."""
    expected = {column.name for column in columns}
    actual = set(map(str, body)) if isinstance(body, Mapping) else set()
    return f"{schema}: columns missing: {sorted(expected - actual)}, unknown: {sorted(actual - expected)[:8]}"
