"""Reads structures in Thrift's compact protocol, as Parquet files hold them, from bytes that may be damaged.

Source: Apache Thrift, "Thrift Compact protocol".
"""

from __future__ import annotations

import mmap
from typing import Any

#: What may be in what, at most.
_MAX_DEPTH = 8
_TRUE, _FALSE, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _LIST, _STRUCT = 1, 2, 3, (4, 5, 6), 7, 8, 9, 12


def read_struct(content: bytes | mmap.mmap, at: int, depth: int = 0) -> tuple[dict[int, Any], int]:
    """The fields of a structure by number, and where it ends. Text is bytes, a list a list, a double its eight bytes.

    Raises IndexError or ValueError if it is damaged, has a set or a map, or is too deep.
    """
    fields: dict[int, Any] = {}
    number = 0
    while head := content[at]:
        at += 1
        if head >> 4:
            number += head >> 4
        else:
            number, at = _integer(content, at)
        kind = head & 15
        if kind in (_TRUE, _FALSE):  # the type is the value
            fields[number] = kind == _TRUE
        else:
            fields[number], at = _value(content, at, kind, depth)
    return fields, at + 1


def _value(content: bytes | mmap.mmap, at: int, kind: int, depth: int) -> tuple[Any, int]:
    """A value of a kind, and where it ends."""
    if kind in _INTEGERS:
        return _integer(content, at)
    if kind in (_TRUE, _FALSE, _BYTE):
        return content[at], at + 1
    if kind == _DOUBLE:
        return content[at : at + 8], at + 8
    if kind == _BINARY:
        length, at = _varint(content, at)
        return content[at : at + length], at + length
    if depth == _MAX_DEPTH:
        raise ValueError(f"found a structure at depth {depth}")
    if kind == _STRUCT:
        return read_struct(content, at, depth + 1)
    if kind == _LIST:
        head, at = content[at], at + 1
        length, at = _varint(content, at) if head >> 4 == 15 else (head >> 4, at)
        values = []
        for _ in range(length):
            value, at = _value(content, at, head & 15, depth + 1)
            values.append(value)
        return values, at
    raise ValueError(f"found type {kind}")


def _varint(content: bytes | mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 64, 7):
        byte = content[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number of more than 64 bits")


def _integer(content: bytes | mmap.mmap, at: int) -> tuple[int, int]:
    value, at = _varint(content, at)
    return (value >> 1) ^ -(value & 1), at
