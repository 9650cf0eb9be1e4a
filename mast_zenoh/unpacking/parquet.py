"""Reads Parquet tables up to a limit on their unpacked size.

The size of a page is in its header, before its data; sizes in the footer may differ and are not used. The number of
values counts as well, because a few bytes can repeat one value a billion times.
"""

from __future__ import annotations

import mmap
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet

from mast_zenoh.unpacking.text import MAX_TABLE_BYTES, longest

#: Limit on the pages of a table, of all columns together.
MAX_PAGES = 200_000
#: Limit on the lists in a footer: of row groups, and of columns.
_MAX_LIST = 100_000

#: Encodings of text whose values take no more bytes than their page: all but DELTA_BYTE_ARRAY, which repeats prefixes.
_TEXT_ENCODINGS = (0, 2, 3, 6, 8)  # PLAIN, PLAIN_DICTIONARY, RLE, DELTA_LENGTH_BYTE_ARRAY, RLE_DICTIONARY

#: Of these, those whose values are numbers of texts in a dictionary.
_BY_NUMBER = (2, 8)
#: Bytes that a text which may be new takes in a dictionary, besides its characters.
_TEXT_BYTES = 64

# Fields of a PageHeader, and the fields of the encoding and the number of values in the headers of its types.
_UNPACKED, _PACKED = 2, 3
_ENCODING_OF = {5: 2, 7: 2, 8: 4}  # DataPageHeader, DictionaryPageHeader, DataPageHeaderV2
_DATA_PAGES = (5, 8)
_VALUES = 1


def read(path: Path, columns: Collection[str] | None = None, max_bytes: int = MAX_TABLE_BYTES) -> pyarrow.Table:
    """Read a Parquet file, or only some columns of it.

    Raises OSError if it cannot be read, ArrowException if it is broken, has columns of lists, or unpacks to more than
    `max_bytes`.
    """
    try:
        return _read(path, columns, max_bytes)
    except UnicodeDecodeError as error:
        raise pyarrow.ArrowInvalid(f"found a name that is not UTF-8: {error}") from None


def _read(path: Path, columns: Collection[str] | None, max_bytes: int) -> pyarrow.Table:
    with parquet.ParquetFile(path, thrift_container_size_limit=_MAX_LIST) as file:
        wanted = [
            index
            for index in range(len(file.schema))
            if columns is None or file.schema.column(index).path.partition(".")[0] in columns
        ]
        size = _unpacked_size(path, file, wanted, max_bytes)
        schema = file.schema_arrow
        repeating = {file.schema.column(index).path for index in wanted} if file.metadata.num_rows else set()
        texts = sorted(name for name in repeating if name in schema.names and _is_text(schema, name))
        if not texts:
            return file.read(columns=None if columns is None else list(columns))
    # As a dictionary, a text that repeats is in memory once. It is expanded only when the size is known.
    with parquet.ParquetFile(path, thrift_container_size_limit=_MAX_LIST, read_dictionary=texts) as file:
        table = file.read(columns=None if columns is None else list(columns))
    for name in texts:
        column, kind = table[name], schema.field(name).type
        size += len(column) * longest(column)
        _check(size, max_bytes)
        if column.type != kind:
            table = table.set_column(table.column_names.index(name), schema.field(name), column.cast(kind))
    return table


def _is_text(schema: Any, name: str) -> bool:
    kind = schema.field(name).type
    return bool(pyarrow.types.is_string(kind) or pyarrow.types.is_binary(kind) or pyarrow.types.is_large_string(kind))


def _check(size: int, max_bytes: int) -> None:
    if size > max_bytes:
        raise pyarrow.ArrowInvalid(f"found {size} bytes unpacked or more, expected at most {max_bytes}")


def _unpacked_size(path: Path, file: Any, wanted: list[int], max_bytes: int) -> int:
    """Bytes of some columns when they are read, text as dictionaries. Raises ArrowInvalid above `max_bytes`."""
    size = pages = 0
    with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for index in wanted:
            column = file.schema.column(index)
            if column.max_repetition_level:
                raise pyarrow.ArrowInvalid(f"column {column.path}: found lists, expected one value in each row")
            is_text = column.physical_type == "BYTE_ARRAY"
            width = max(8, column.length)
            for group in range(file.metadata.num_row_groups):
                chunk = file.metadata.row_group(group).column(index)
                values = 0
                for header in _pages(content, chunk):
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
                size += width * max(values, chunk.num_values, file.metadata.row_group(group).num_rows)
                _check(size, max_bytes)
    return size


def _pages(content: mmap.mmap, chunk: Any) -> Iterator[dict[int, Any]]:
    """The headers of the pages of a column in a row group."""
    at = chunk.data_page_offset
    if at <= 0:  # of a row group without rows
        return
    if chunk.has_dictionary_page and chunk.dictionary_page_offset is not None and 0 < chunk.dictionary_page_offset < at:
        at = chunk.dictionary_page_offset
    end = at + chunk.total_compressed_size
    if not 0 <= at <= end <= len(content):
        raise pyarrow.ArrowInvalid(f"column {chunk.path_in_schema}: not within the file's {len(content)} bytes")
    while at < end:
        try:
            header, at = _struct(content, at, 0)
            unpacked, packed = header[_UNPACKED], header[_PACKED]
            if not all(type(header.get(kind, {})) is dict for kind in _ENCODING_OF):
                raise ValueError("its header has no fields")
            values = [header.get(kind, {}).get(_VALUES, 0) for kind in _DATA_PAGES]
            if not all(type(number) is int and number >= 0 for number in (unpacked, packed, *values)):
                raise ValueError(f"found {unpacked!r} bytes, packed {packed!r}, with {values} values")
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise pyarrow.ArrowInvalid(f"column {chunk.path_in_schema}: a damaged page: {error!r}") from None
        yield header
        at += packed


def _struct(content: mmap.mmap, at: int, depth: int) -> tuple[dict[int, Any], int]:
    """The fields of a structure in Thrift's compact protocol, and where it ends. Of text, the length."""
    fields: dict[int, Any] = {}
    number = 0
    while head := content[at]:
        at += 1
        if head >> 4:
            number += head >> 4
        else:
            number, at = _integer(content, at)
        kind = head & 15
        if kind in (1, 2):  # the type is the value
            fields[number] = kind == 1
        elif kind == 3:
            fields[number], at = content[at], at + 1
        elif kind in (4, 5, 6):
            fields[number], at = _integer(content, at)
        elif kind == 8:
            length, at = _varint(content, at)
            fields[number], at = length, at + length
        elif kind == 12 and depth < 4:
            fields[number], at = _struct(content, at, depth + 1)
        else:
            raise ValueError(f"field {number} has type {kind}")
    return fields, at + 1


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 64, 7):
        byte = content[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number of more than 64 bits")


def _integer(content: mmap.mmap, at: int) -> tuple[int, int]:
    value, at = _varint(content, at)
    return (value >> 1) ^ -(value & 1), at
