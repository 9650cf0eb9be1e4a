"""Compares two recordings, and describes the first difference by field, with units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import BUILT_IN, Column, Message
from mast_zenoh.run_folder.recording.reader import Recorded, read


@dataclass
class Difference:
    """The result of a comparison. Two recordings are equal if `first` is None.

    equal:          number of equal messages
    first:          the first message that differs, as (A's, B's); None on a side where it is missing
    differing:      number of messages that are in both and differ, by wire
    only_a, only_b: number of messages that are missing in the other recording, by wire
    """

    equal: int = 0
    first: tuple[Recorded | None, Recorded | None] | None = None
    differing: Counter[str] = field(default_factory=Counter)
    only_a: Counter[str] = field(default_factory=Counter)
    only_b: Counter[str] = field(default_factory=Counter)


def compare(
    a: Path,
    b: Path,
    *,
    wires: Collection[str] = ("*",),
    ignore: Collection[str] = (),
    taps: bool = False,
    before: int | None = None,
) -> Difference:
    """Compare two recordings, ordered by (time, frame, wire, publisher, sequence number).

    wires, ignore: globs of wires to compare, and of those to leave out
    taps: compare tap legs too, which only runs of equal rewrites share
    before: only frames before this one
    Raises RunFolderError if one cannot be read, or if there is nothing to compare.
    """
    difference = Difference()
    for left, right in _paired(*(_selected(path, wires, ignore, taps, before) for path in (a, b))):
        if left and right:
            if left.payload == right.payload:
                difference.equal += 1
                continue
            difference.differing[left.wire] += 1
        elif left:
            difference.only_a[left.wire] += 1
        elif right:
            difference.only_b[right.wire] += 1
        if difference.first is None:
            difference.first = left, right
    if difference.first is None and not difference.equal:
        raise RunFolderError(f"{a}, {b}: no messages to compare")
    return difference


def _selected(
    path: Path, wires: Collection[str], ignore: Collection[str], taps: bool, before: int | None
) -> Iterator[Recorded]:
    for message in read(path):
        if (before is not None and message.frame >= before) or (message.tap and not taps):
            continue
        if _matches(message.wire, wires) and not _matches(message.wire, ignore):
            yield message


def _matches(wire: str, globs: Collection[str]) -> bool:
    return any(fnmatchcase(wire, glob) for glob in globs)


def _paired(a: Iterator[Recorded], b: Iterator[Recorded]) -> Iterator[tuple[Recorded | None, Recorded | None]]:
    """Pairs of messages with the same place in the order; None if a side has none."""
    left, right = next(a, None), next(b, None)
    while left or right:
        if right is None or (left and left.order < right.order):
            yield left, None
            left = next(a, None)
        elif left is None or right.order < left.order:
            yield None, right
            right = next(b, None)
        else:
            yield left, right
            left, right = next(a, None), next(b, None)


_WIRES_SHOWN = 12
_HEADER_UNITS = {"time_ns": " ns"}


def explain(difference: Difference) -> Iterator[str]:
    """Lines that describe how recordings A and B differ, or state that they are equal."""
    if difference.first is None:
        yield f"equal: {difference.equal} messages"
        return
    left, right = difference.first
    yield f"first difference: {_place(left or right)}"
    if left and right:
        yield from (f"  {line}" for line in _fields(left, right))
    else:
        yield f"  only in {'A' if left else 'B'}: {_content(left or right)}"
    for predicate, wires in (
        ("differ", difference.differing),
        ("are only in A", difference.only_a),
        ("are only in B", difference.only_b),
    ):
        yield from _totals(predicate, wires)
    yield f"{difference.equal} messages are equal"


def _place(message: Recorded | None) -> str:
    assert message is not None
    frame = "malformed" if message.malformed else f"frame {message.frame}"
    return f"{frame}, {message.key}, publisher {message.publisher}, sequence {message.seq}"


def _content(message: Recorded | None) -> str:
    """The content of a message in one line."""
    decoded = _decoded(message) if message else None
    if message is None or decoded is None:
        return f"{len(message.payload) if message else 0} bytes that are not a valid message"
    shapes = ", ".join(f"{name} {tuple(column.shape)}" for name, column in decoded.body.items())
    return f"{message.message} of {decoded.header.time_ns} ns: {shapes or 'no columns'}"


def _totals(predicate: str, wires: Counter[str]) -> Iterator[str]:
    if wires:
        counts = [f"{wire} {count}" for wire, count in sorted(wires.items())[:_WIRES_SHOWN]]
        more = f" and {len(wires) - _WIRES_SHOWN} more wires" if len(wires) > _WIRES_SHOWN else ""
        yield f"{sum(wires.values())} messages {predicate}: {', '.join(counts)}{more}"


def _decoded(message: Recorded) -> Message | None:
    """The decoded message, or None if it is invalid."""
    try:
        return codec.decode(message.payload, message.type)
    except MessageError:
        return None


def _fields(left: Recorded, right: Recorded) -> Iterator[str]:
    """The differing header fields and columns of two messages, or else their bytes."""
    a, b = _decoded(left), _decoded(right)
    explained = False
    if a and b:
        for name in ("source", "frame", "time_ns", "seq"):
            in_a, in_b = getattr(a.header, name), getattr(b.header, name)
            if in_a != in_b:
                explained = True
                yield f"{name}: A {in_a}{_HEADER_UNITS.get(name, '')}, B {in_b}{_HEADER_UNITS.get(name, '')}"
        columns = {column.name: column for column in (left.schema or BUILT_IN[left.message]).columns}
        if left.schema != right.schema:  # a user-defined type, changed between the runs
            others = (right.schema or BUILT_IN[right.message]).columns
            columns = {name: column for name, column in columns.items() if column in others}
            explained = True
            yield f"the message type {left.message!r} differs: A {_definition(left)}, B {_definition(right)}"
        for column in columns.values():
            for line in _column(column, a.body[column.name], b.body[column.name]):
                explained = True
                yield line
    else:
        for name, message in (("A", a), ("B", b)):
            if message is None:
                yield f"{name} is not a valid message"
    if not explained:
        yield _bytes(left.payload, right.payload)


def _definition(message: Recorded) -> str:
    """The version and the columns of a message's type."""
    schema = message.schema or BUILT_IN[message.message]
    columns = (f"{each.name} {each.dtype} ({', '.join(map(str, each.shape))})" for each in schema.columns)
    return f"version {schema.version} ({', '.join(columns)})"


def _column(column: Column, a: NDArray[Any], b: NDArray[Any]) -> Iterator[str]:
    """The first differing value of a column, and the number of them.

    Values are compared as bits: -0.0 is not 0.0.
    """
    if a.shape[1:] != b.shape[1:]:
        yield f"{column.name}: A has the shape {a.shape}, B {b.shape}"
        return
    if a.shape != b.shape:
        yield f"{column.name}: A {_shape(a)}, B {_shape(b)}"
    rows = min(len(a), len(b))
    a, b = a[:rows], b[:rows]
    differs = a != b if column.dtype == "str" else a.view(f"V{a.itemsize}") != b.view(f"V{b.itemsize}")
    places = np.argwhere(differs)
    if not len(places):
        return
    first = tuple(int(index) for index in places[0])
    unit = f" {column.unit}" if column.unit else ""
    extent = f"; {len(places)} of {a.size} values differ"
    if column.dtype in ("float64", "float32", "int64", "int32") and len(places) > 1:
        largest = np.max(np.abs(a[differs].astype(float) - b[differs].astype(float)))
        extent += f", by at most {largest:.3g}{unit}"
    yield f"{column.name}{_where(column, first)}: A {a[first]}{unit}, B {b[first]}{unit}{extent}"


def _shape(array: NDArray[Any]) -> str:
    return f"has {len(array)} rows" if array.ndim else "has no rows"


def _where(column: Column, index: tuple[int, ...]) -> str:
    """A place in a column: its row if rows are objects, and its index in the row."""
    if isinstance(column.shape[0], str):
        suffix = f"[{', '.join(map(str, index[1:]))}]" if index[1:] else ""
        return f" row {index[0]}{suffix}"
    return f"[{', '.join(map(str, index))}]"


def _bytes(a: bytes, b: bytes) -> str:
    offset = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    bytes_a, bytes_b = (payload[offset : offset + 8].hex(" ") or "ends" for payload in (a, b))
    return f"byte {offset}: A {bytes_a}, B {bytes_b}; lengths {len(a)}, {len(b)}"
