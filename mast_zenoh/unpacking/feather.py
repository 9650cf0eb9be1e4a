"""Reads Feather files (Arrow IPC) up to a limit on their unpacked size.

A compressed buffer begins with its unpacked length, and Arrow allocates that much. So all lengths are added up first.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import ipc

from mast_zenoh.unpacking.text import MAX_TABLE_BYTES

_MAGIC = b"ARROW1\0\0"
_BUFFER = struct.Struct("<qq")
_LENGTH = struct.Struct("<q")

# Types and fields of messages, see Message.fbs of Arrow.
_DICTIONARY, _BATCH = 2, 3
_HEADER_TYPE, _HEADER = 1, 2
_ROWS, _BUFFERS, _COMPRESSION = 0, 2, 3
_DICTIONARY_DATA = 1


def read(path: Path, max_bytes: int = MAX_TABLE_BYTES) -> pyarrow.Table:
    """Read a Feather file (version 2).

    Raises OSError if it cannot be read, ArrowException if it is broken or unpacks to more than `max_bytes`.
    """
    with pyarrow.memory_map(str(path)) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise pyarrow.ArrowInvalid("not an Arrow IPC file (Feather version 2)")
        _check_size(file, max_bytes)
        # Read as the stream that was checked: the footer could point to other places.
        file.seek(len(_MAGIC))
        with ipc.open_stream(file) as stream:
            return stream.read_all()


def _check_size(file: Any, max_bytes: int) -> None:
    """Raise ArrowInvalid if the messages unpack to more than `max_bytes`."""
    size, messages = 0, ipc.MessageReader.open_stream(file)
    columns = 0
    while True:
        try:
            message = messages.read_next_message()
        except StopIteration:
            return
        if message.type == "schema":
            columns = len(ipc.read_schema(message))
            continue
        try:
            size += _unpacked_size(message.metadata.to_pybytes(), message.body, columns)
        except (struct.error, TypeError, IndexError) as error:
            raise pyarrow.ArrowInvalid(f"a damaged {message.type}: {error}") from None
        if size > max_bytes:
            raise pyarrow.ArrowInvalid(f"found {size} bytes unpacked or more, expected at most {max_bytes}")


def _unpacked_size(metadata: bytes, body: Any, columns: int) -> int:
    """Bytes of the buffers of a message when they are unpacked, and at least 8 for each value."""
    root = _unsigned(metadata, 0)
    kind = metadata[_field(metadata, root, _HEADER_TYPE) or 0]
    batch = _target(metadata, root, _HEADER)
    if kind == _DICTIONARY:
        batch = _target(metadata, batch, _DICTIONARY_DATA)
    elif kind != _BATCH:
        raise pyarrow.ArrowInvalid(f"found a message of type {kind}, expected tables only")
    rows_at, packed = _field(metadata, batch, _ROWS), _field(metadata, batch, _COMPRESSION) is not None
    rows = _LENGTH.unpack_from(metadata, rows_at)[0] if rows_at else 0
    buffers = _target(metadata, batch, _BUFFERS)
    total = 0
    for index in range(_unsigned(metadata, buffers)):
        offset, length = _BUFFER.unpack_from(metadata, buffers + 4 + index * _BUFFER.size)
        unpacked = length
        if packed and length:
            (claim,) = _LENGTH.unpack(body[offset : offset + _LENGTH.size].to_pybytes())
            unpacked = length if claim == -1 else claim  # -1: stored as it is
        if offset < 0 or length < 0 or unpacked < 0:
            raise pyarrow.ArrowInvalid(f"found a buffer of {length} bytes at {offset}, {unpacked} unpacked")
        total += unpacked
    return max(total, 8 * columns * rows)


def _field(data: bytes, table: int, index: int) -> int | None:
    """Where a field of a flatbuffer's table is; None: it is absent."""
    vtable = table - struct.unpack_from("<i", data, table)[0]
    (size,) = struct.unpack_from("<H", data, vtable)
    place = 4 + 2 * index
    offset = struct.unpack_from("<H", data, vtable + place)[0] if place < size else 0
    return table + offset if offset else None


def _target(data: bytes, table: int, index: int) -> int:
    """Where the table or vector is to which a field points. Raises TypeError if the field is absent."""
    field = _field(data, table, index)
    if field is None:
        raise TypeError(f"field {index} is absent")
    return field + _unsigned(data, field)


def _unsigned(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])
