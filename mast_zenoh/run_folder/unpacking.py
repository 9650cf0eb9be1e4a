"""Reads tables up to a limit on their unpacked size.

Feather (Arrow IPC): a compressed buffer begins with its unpacked length, and Arrow allocates that much. So all lengths
are added up first.

Parquet: the size of a page is in its header, before its data; sizes in the footer may differ and are not used. The
number of values counts as well, because a few bytes can repeat one value a billion times.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import ipc, parquet

from mast_zenoh.run_folder.parquet_footers import MAX_LIST, Chunk, Footer, Group, read_footer
from mast_zenoh.run_folder.thrift import read_struct

#: Limit on the unpacked size of a table, bytes.
MAX_TABLE_BYTES = 400_000_000


def longest(column: Any) -> int:
    """Bytes of the longest text of a chunked column, which may be a dictionary.

    Raises ArrowInvalid if it is a column of something else, or not UTF-8.
    """
    kind = column.type
    if pyarrow.types.is_dictionary(kind):
        kind = kind.value_type
    if pyarrow.types.is_null(kind):
        return 0
    if not _is_text(kind):
        raise pyarrow.ArrowInvalid(f"found a column of {column.type}, expected text")
    texts = (chunk.dictionary if pyarrow.types.is_dictionary(column.type) else chunk for chunk in column.chunks)
    return max((_longest(part) for part in texts), default=0)


def _is_text(kind: Any) -> bool:
    types = pyarrow.types
    return bool(types.is_string(kind) or types.is_large_string(kind) or types.is_binary(kind))


def _longest(part: Any) -> int:
    """Bytes of the longest text of an array; a Python object for each text would take ten times its size."""
    part.validate(full=True)
    wide = pyarrow.types.is_large_string(part.type)
    offsets = part.buffers()[1]
    if len(part) == 0 or offsets is None:
        return 0
    ends = np.frombuffer(offsets, np.int64 if wide else np.int32, len(part) + 1, part.offset * (8 if wide else 4))
    return int(np.diff(ends).max())


def check_expanded(column: Any, max_bytes: int = MAX_TABLE_BYTES) -> int:
    """Bytes of a column of text as a NumPy array, where each row is as wide as the longest.

    Raises ArrowInvalid if they are more than `max_bytes`, or if it is no text.
    """
    size = 4 * len(column) * longest(column)
    if size > max_bytes:
        raise pyarrow.ArrowInvalid(
            f"{len(column)} rows of up to {longest(column)} characters: found {size} bytes unpacked, "
            f"expected at most {max_bytes}"
        )
    return size


_MAGIC = b"ARROW1\0\0"
_BUFFER = struct.Struct("<qq")
_LENGTH = struct.Struct("<q")

# Types and fields of messages, see Message.fbs of Arrow.
_DICTIONARY, _BATCH = 2, 3
_HEADER_TYPE, _HEADER = 1, 2
_ROWS, _BUFFERS, _COMPRESSION = 0, 2, 3
_DICTIONARY_DATA = 1


def read_feather(path: Path, max_bytes: int = MAX_TABLE_BYTES) -> pyarrow.Table:
    """Read a Feather file (version 2).

    Raises OSError if it cannot be read, ArrowException if it is broken or unpacks to more than `max_bytes`.
    """
    with _checking_names(), pyarrow.memory_map(str(path)) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise pyarrow.ArrowInvalid("not an Arrow IPC file (Feather version 2)")
        _check_messages(file, max_bytes)
        # Read as the stream that was checked: the footer could point to other places.
        file.seek(len(_MAGIC))
        with ipc.open_stream(file) as stream:
            return _validated(stream.read_all())


@contextmanager
def _checking_names() -> Iterator[None]:
    """Raise ArrowInvalid for a name that is no text."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise pyarrow.ArrowInvalid(f"found a name that is not UTF-8: {error}") from None


def _validated(table: pyarrow.Table) -> pyarrow.Table:
    """A table, if its text is UTF-8, and each number of a text that of one; otherwise raises ArrowInvalid."""
    table.validate(full=True)
    return table


def _check_messages(file: Any, max_bytes: int) -> None:
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
            size += _unpacked_message(message.metadata.to_pybytes(), message.body, columns)
        except (struct.error, TypeError, IndexError) as error:
            raise pyarrow.ArrowInvalid(f"a damaged {message.type}: {error}") from None
        _check(size, max_bytes)


def _unpacked_message(metadata: bytes, body: Any, columns: int) -> int:
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


#: Limit on the pages of a table, of all columns together.
MAX_PAGES = 200_000
#: Encodings of text whose values take no more bytes than their page: not DELTA_BYTE_ARRAY, which repeats prefixes, nor
#: DELTA_LENGTH_BYTE_ARRAY, which says itself how many there are.
_TEXT_ENCODINGS = (0, 2, 3, 8)  # PLAIN, PLAIN_DICTIONARY, RLE, RLE_DICTIONARY

#: Of these, those whose values are numbers of texts in a dictionary.
_BY_NUMBER = (2, 8)
#: Bytes that a text which may be new takes in a dictionary, besides its characters.
_TEXT_BYTES = 64

# Fields of a PageHeader, and the fields of the encoding and the number of values in the headers of its types.
_UNPACKED, _PACKED = 2, 3
_ENCODING_OF = {5: 2, 7: 2, 8: 4}  # DataPageHeader, DictionaryPageHeader, DataPageHeaderV2
_DATA_PAGES = (5, 8)
_VALUES = 1


def read_parquet(path: Path, columns: Collection[str] | None = None, max_bytes: int = MAX_TABLE_BYTES) -> pyarrow.Table:
    """Read a Parquet file, or only some columns of it.

    Raises OSError if it cannot be read, ArrowException if it is broken, has columns of lists, or unpacks to more than
    `max_bytes`.
    """
    with _checking_names():
        return _validated(_read_bounded(path, columns, max_bytes, read_footer(path)))


def read_row_group(path: Path, group: int, columns: Collection[str], footer: Footer) -> pyarrow.Table:
    """Read some columns of a row group; raises as `read_parquet` does."""
    with _checking_names():
        return _validated(_read_bounded(path, columns, MAX_TABLE_BYTES, footer, [group]))


def _read_bounded(
    path: Path,
    columns: Collection[str] | None,
    max_bytes: int,
    footer: Footer,
    groups: Sequence[int] | None = None,
) -> pyarrow.Table:
    """Read some columns of some row groups; None: all."""
    with parquet.ParquetFile(path, metadata=footer.metadata, thrift_container_size_limit=MAX_LIST) as file:
        wanted = [
            index
            for index in range(len(file.schema))
            if columns is None or file.schema.column(index).path.partition(".")[0] in columns
        ]
        groups = range(len(footer.groups)) if groups is None else groups
        size = _unpacked_size(path, file.schema, wanted, [footer.groups[group] for group in groups], max_bytes)
        schema = file.schema_arrow
        repeating = {file.schema.column(index).path for index in wanted} if file.metadata.num_rows else set()
        texts = sorted(name for name in repeating if name in schema.names and _is_text(schema.field(name).type))
        if not texts:
            return file.read_row_groups(groups, columns=None if columns is None else list(columns))
    # As a dictionary, a text that repeats is in memory once. It is expanded only when the size is known.
    limit = {"thrift_container_size_limit": MAX_LIST}
    with parquet.ParquetFile(path, metadata=footer.metadata, read_dictionary=texts, **limit) as file:
        table = file.read_row_groups(groups, columns=None if columns is None else list(columns))
    for name in texts:
        column, kind = table[name], schema.field(name).type
        size += len(column) * longest(column)
        _check(size, max_bytes)
        if column.type != kind:
            table = table.set_column(table.column_names.index(name), schema.field(name), column.cast(kind))
    return table


def _check(size: int, max_bytes: int) -> None:
    if size > max_bytes:
        raise pyarrow.ArrowInvalid(f"found {size} bytes unpacked or more, expected at most {max_bytes}")


def _unpacked_size(path: Path, schema: Any, wanted: list[int], groups: Sequence[Group], max_bytes: int) -> int:
    """Bytes of some columns and row groups when they are read, text as dictionaries.

    Raises ArrowInvalid above `max_bytes`.
    """
    size = pages = 0
    with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for index in wanted:
            column = schema.column(index)
            if column.max_repetition_level:
                raise pyarrow.ArrowInvalid(f"column {column.path}: found lists, expected one value in each row")
            is_text = column.physical_type == "BYTE_ARRAY"
            width = max(8, column.length)
            for group in groups:
                chunk, values = group.chunks[index], 0
                for header in _pages(content, column.path, chunk):
                    pages += 1
                    size += header[_UNPACKED]
                    _check(size, max_bytes)
                    if pages > MAX_PAGES:
                        raise pyarrow.ArrowInvalid(f"found more than {MAX_PAGES} pages, expected at most as many")
                    for kind, encoding in _ENCODING_OF.items():
                        page = header.get(kind, {})
                        if page and is_text and page.get(encoding, 0) not in _TEXT_ENCODINGS:
                            raise pyarrow.ArrowInvalid(
                                f"column {column.path}: found encoding {page[encoding]}, which may expand without "
                                "limit, expected plain text or a dictionary"
                            )
                        values += page.get(_VALUES, 0) if kind in _DATA_PAGES else 0
                        if is_text and page and page.get(encoding) not in _BY_NUMBER:
                            size += _TEXT_BYTES * page.get(_VALUES, 0)
                size += width * max(values, chunk.n_values, group.n_rows)
                _check(size, max_bytes)
    return size


def _pages(content: mmap.mmap, column: str, chunk: Chunk) -> Iterator[dict[int, Any]]:
    """The headers of the pages of a column in a row group."""
    at = chunk.first_byte
    if at <= 0:  # of a row group without rows
        return
    end = at + chunk.n_bytes
    if not 0 <= at <= end <= len(content):
        raise pyarrow.ArrowInvalid(f"column {column}: not within the file's {len(content)} bytes")
    while at < end:
        try:
            header, at = read_struct(content, at)
            unpacked, packed = header[_UNPACKED], header[_PACKED]
            if not all(type(header.get(kind, {})) is dict for kind in _ENCODING_OF):
                raise ValueError("its header has no fields")
            values = [header.get(kind, {}).get(_VALUES, 0) for kind in _DATA_PAGES]
            if not all(type(number) is int and number >= 0 for number in (unpacked, packed, *values)):
                raise ValueError(f"found {unpacked!r} bytes, packed {packed!r}, with {values} values")
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise pyarrow.ArrowInvalid(f"column {column}: a damaged page: {error!r}") from None
        yield header
        at += packed
