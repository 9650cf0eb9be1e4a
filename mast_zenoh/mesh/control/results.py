"""Results of nodes: nested plain values and arrays, packed as MessagePack; and what a node reports with them.

Tables that nodes hand in part by part, so that no process ever holds a long one; pure functions.

A node appends rows whenever it likes; a part leaves it when PART_ROWS rows have come together. So parts, which become
the row groups of a Parquet file, depend on the rows alone, not on when they were appended.
"""

from __future__ import annotations

import itertools
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import msgpack
import numpy as np
from msgspec import UNSET, Meta, UnsetType
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Ints
from mast_zenoh.config.resolved import NodeSpec, has_topics_outside
from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import codec
from mast_zenoh.mesh.control.failures import MAX_HANDLERS, FailureEntry
from mast_zenoh.messages.schemas import text
from mast_zenoh.run_folder.recording.churn import BACK, LOST

#: The node whose metrics and tables become those of the run; every scenario has one of this name.
EVALUATOR = "evaluator"

#: Tables that only the evaluator may return; they are written to the top of the run folder.
TABLES = ("metrics", "objects", "attacks", "targets", "driving", "driven", "trust", "trust_objects")

#: Limit of a node's result, and of a part of a table, bytes.
MAX_RESULT = 32 << 20

MAX_VALUES = 1 << 20  #: lists, maps and their items in a result; arrays count as one
MAX_TEXTS = 1 << 23  #: items of columns of text in a result of up to 32 MiB; proportionally more in a longer one
MAX_DEPTH = 32  #: levels of nested lists and maps
_MAX_EMPTY = 1 << 24  # rows and columns of an array without elements
_MAX_DIMENSIONS = 8

_DTYPE = re.compile(r"[<>|][biuf](1|2|4|8|12|16)")  # NumPy's names of numeric dtypes, and nothing else that it accepts

_ARRAY = 1
_TEXTS = 2
_PLAIN = (str, int, float, type(None), np.bool_, np.integer, np.floating, np.ndarray)


def pack(value: Any) -> bytes:
    """Pack nested dicts, lists, numbers, strings, and arrays of numbers or strings."""
    packed: bytes = msgpack.packb(value, default=encode_extension)
    return packed


def unpack(payload: bytes) -> Any:
    """Unpack what `pack` packed; raises MessageError for anything else or too much."""
    count = codec.at_most(MAX_VALUES, "a result, not counting arrays and columns of text")
    remaining_texts = [max(MAX_TEXTS, len(payload) // 4)]
    try:
        return msgpack.unpackb(
            payload,
            ext_hook=lambda code, data: _decode(code, data, remaining_texts),
            object_hook=count,
            list_hook=count,
            strict_map_key=False,
            max_array_len=MAX_VALUES,
            max_map_len=MAX_VALUES,
        )
    except MessageError:
        raise
    except Exception as error:  # of several types, of msgpack and NumPy
        raise MessageError(f"a result: not as it was packed: {type(error).__name__}: {str(error)[:100]}") from None


_Reason = Annotated[str, Meta(max_length=200, pattern=codec.ONE_LINE)]
_Times = dict[codec.Whole, codec.Whole]
_PER_KEY = Meta(max_length=4096)  # keys of a run


class _Churn(codec.ControlMessage, frozen=True):
    frame: codec.Whole
    node: Annotated[str, Meta(max_length=256)]
    what: Literal[LOST, BACK]  # type: ignore[valid-type]


class _ClockOffset(codec.ControlMessage, frozen=True):
    offset_ms: Annotated[float, Meta(ge=-1e12, le=1e12)]
    round_trip_ms: Annotated[float, Meta(ge=-1e12, le=1e12)]


class _Report(codec.ControlMessage, frozen=True, kw_only=True):
    """What a node hands in at its end, as runtime.protocol.node makes it."""

    results: Any
    rejected: Annotated[dict[codec.Line, codec.Whole], _PER_KEY]
    first_rejected: Annotated[dict[codec.Line, tuple[codec.FrameOrNone, _Reason]], _PER_KEY]
    foreign: Annotated[dict[codec.Line, codec.Whole], _PER_KEY]
    invalid: Annotated[dict[codec.Line, tuple[codec.Positive, _Reason]], _PER_KEY]
    unsigned: codec.Whole
    process: codec.Id
    failures: Annotated[list[FailureEntry], Meta(max_length=MAX_HANDLERS)]
    last_frame: codec.FrameOrNone
    cpu_s: codec.Finite
    arrived_ns: Annotated[dict[str, _Times], _PER_KEY]
    unaccepted: Annotated[list[codec.Line], _PER_KEY] | UnsetType = UNSET
    versions: codec.Versions | UnsetType = UNSET
    clock: _ClockOffset | UnsetType = UNSET


class _DriverReport(_Report, frozen=True, kw_only=True):
    frames: codec.Whole
    wall_s: codec.Finite
    stop_reason: codec.Text
    sent_ns: _Times
    churn: list[_Churn]


def decode_result(payload: bytes, node: str, *, drives: bool) -> dict[str, Any]:
    """Decode what a node hands in at its end; raises MessageError.

    drives: whether the node drives the scene: only that one has stop_reason, frames, wall_s, sent_ns, churn
    """
    codec.fits(payload, "result", MAX_RESULT)
    result: dict[str, Any] = unpack(payload)
    report: _Report = codec.converted(result, _DriverReport if drives else _Report, "result")
    try:
        checked(report.results)
    except TypeError as error:
        raise MessageError(f"result: {error}") from None
    receives = {"epoch", "stop", f"leave/{node}", f"drain/{node}", codec.OTHERS}
    if not drives and (unexpected := report.invalid.keys() - receives):
        raise MessageError(f"result: invalid: found {min(unexpected)!r:.60}, which {node} does not receive")
    return result


#: A part of a table is a list of four, a result a map: the first byte tells.
_PART = b"\x94"


def is_part(payload: bytes) -> bool:
    """Whether a node hands in a part of a table, and not its result."""
    return payload.startswith(_PART)


def encode_part(process: str, part: TablePart) -> bytes:
    """Encode a part of a table of a node's process."""
    return pack([process, *part])


def decode_part(payload: bytes) -> tuple[str, TablePart]:
    """A node's process, and a part of one of its tables; raises MessageError."""
    codec.fits(payload, "result", MAX_RESULT)
    kind = tuple[codec.Id, Annotated[str, Meta(max_length=64)], codec.Whole, dict[Any, Any]]
    process, table, number, columns = codec.converted(unpack(payload), kind, "result")
    return process, TablePart(table, number, checked_columns(table, columns))


def checked(value: Any) -> dict[str, Any]:
    """The result of a node's `finish`, {} for None; raises TypeError if not packable."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise TypeError(f"finish returned a {type(value).__name__}, expected a dict")
    _check(value, None)
    count = sum(_json_size(part) for name, part in value.items() if name != "tables")
    if count > MAX_VALUES:
        raise TypeError(f"results: found arrays of {count} items, expected at most {MAX_VALUES} outside tables")
    return value


def collations(results: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]) -> list[dict[str, Any]]:
    """The counts that brokers returned as `collation`, with `late` by agent.

    Other values are dropped: a user's own broker may return anything.
    """
    brokers = [result for name, result in results.items() if name in nodes and nodes[name].role == "broker"]
    returned = [result["collation"] for result in brokers if isinstance(result.get("collation"), Mapping)]
    return [counts_of(collation) | {"late": counts_of(collation.get("late"))} for collation in returned]


def late(collations: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Number of messages by agent that missed their batch, from the brokers' counts."""
    counts = [collation["late"] for collation in collations]
    return {agent: sum(count.get(agent, 0) for count in counts) for agent in sorted(set().union(*counts))}


def left_out(results: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    """Number of tracks by agent that input limits left out: of the node that left out most."""
    counts = [counts_of(result.get("left_out")) for result in results.values()]
    return {agent: max(count.get(agent, 0) for count in counts) for agent in sorted(set().union(*counts))}


def outside(results: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]) -> dict[str, dict[str, Any]]:
    """What nodes that exchange messages with programs outside the run counted, by node, see `OutsideTally`.

    A node that handed in no counts, because it was lost, has none: {}.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, spec in nodes.items():
        if has_topics_outside(spec):
            told = results.get(name, {}).get("outside")
            if not isinstance(told, Mapping):
                found[name] = {}
                continue
            names = ("asked", "answered", "late", "unanswered", "interrupted", "unclassified")
            counts: dict[str, Any] = dict.fromkeys(names, 0)
            counts |= {key: n for key, n in counts_of(told).items() if key in (*names, "predicted")}
            parts = ("publishers", "refused", "left_out")
            found[name] = {**counts, "waits": told.get("waits") is True, **{p: counts_of(told.get(p)) for p in parts}}
            found[name]["absent"] = _texts(told.get("absent"))
    return found


def counts_of(value: object) -> dict[str, int]:
    """The valid counts in a node's return value: printable names, integers from 0."""
    if not isinstance(value, Mapping):
        return {}
    return {str(name): n for name, n in value.items() if type(n) is int and n >= 0 and str(name).isprintable()}


def _texts(value: object) -> dict[str, str]:
    """The valid texts in a node's return value: printable, 300 characters at most."""
    items = [(str(name), text) for name, text in value.items()] if isinstance(value, Mapping) else []
    return {name: text[:300] for name, text in items if isinstance(text, str) and (name + text).isprintable()}


#: The place of a value: the place of its container, and its key or index in that; None at the top.
_Place = tuple[Any, Any] | None


def _check(value: Any, place: _Place, depth: int = 0) -> None:
    if depth > MAX_DEPTH:
        raise TypeError(f"{_path_text(place)}: found more than {MAX_DEPTH} nested dicts and lists")
    if isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, (str, int, float)) or (isinstance(key, float) and not math.isfinite(key)):
                raise TypeError(f"{_path_text(place)}: found the key {key!r:.80}, expected a string or a finite number")
            _check(item, (place, key), depth + 1)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            _check(item, (place, index), depth + 1)
    elif not isinstance(value, _PLAIN):
        raise TypeError(f"{_path_text(place)}: found a {type(value).__name__}, expected plain values and arrays")
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 64:
        raise TypeError(f"{_path_text(place)}: found {value}, expected a number of at most 64 bits")
    elif isinstance(value, np.ndarray) and value.dtype.kind not in "biufOU":
        raise TypeError(f"{_path_text(place)}: found an array of {value.dtype}, expected numbers or text")
    elif isinstance(value, np.ndarray) and value.dtype.kind in "OU" and value.ndim != 1:
        raise TypeError(f"{_path_text(place)}: found {value.ndim}-dimensional text, expected one column")


def _path_text(place: _Place) -> str:
    """The place of a value as text, shortened: results.metrics.mean."""
    parts: list[str] = []
    while place is not None:
        place, part = place
        parts.append(f"{part!s:.80}")
    return ".".join(["results", *reversed(parts)])[:200]


def _json_size(value: Any) -> int:
    """Number of lists and items that the arrays in a value would have as plain JSON."""
    if isinstance(value, dict):
        return sum(map(_json_size, value.values()))
    if isinstance(value, (list, tuple)):
        return sum(map(_json_size, value))
    return sum(itertools.accumulate(value.shape, operator.mul)) if isinstance(value, np.ndarray) else 0


def encode_extension(value: Any) -> Any:
    """Encode an array or a NumPy scalar: the `default` of msgpack; raises TypeError."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "OU":
            return msgpack.ExtType(_TEXTS, msgpack.packb([str(item) for item in value]))
        array = np.ascontiguousarray(value)
        return msgpack.ExtType(_ARRAY, msgpack.packb([array.dtype.str, list(array.shape), array.tobytes()]))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a result holds a {type(value).__name__}, expected plain values and arrays")


def _decode(code: int, data: bytes, strings: list[int]) -> Any:
    """Decode a column of text or an array; strings: the remaining number of strings."""
    if code == _TEXTS:
        items = _flat(data, strings[0])
        if not {*map(type, items)} <= {str}:
            raise MessageError("a result: found a column of text that holds something else")
        strings[0] -= len(items)
        return text(items)
    if code != _ARRAY:
        raise MessageError(f"a result: found extension {code}, expected an array")
    dtype, shape, raw = _flat(data, 3, inner=1)
    if type(dtype) is not str or not _DTYPE.fullmatch(dtype):
        raise MessageError(f"a result: found an array of {dtype!r:.40}, expected numbers")
    if type(shape) is not list or len(shape) > _MAX_DIMENSIONS or any(type(n) is not int or n < 0 for n in shape):
        raise MessageError("a result: found an array without a shape")
    if math.prod(n for n in shape if n) > max(_MAX_EMPTY, len(raw)):
        raise MessageError(f"a result: found an array of {len(raw)} bytes whose shape is larger")
    return np.frombuffer(raw, dtype=dtype).reshape(shape)


def _flat(data: bytes, limit: int, inner: int = 0) -> list[Any]:
    """A list of at most `limit` values; at most `inner` of them are lists, none a map."""
    remaining = 1 + inner

    def counted(container: Any) -> Any:
        nonlocal remaining
        remaining -= 1
        if remaining < 0 or type(container) is not list:
            raise MessageError("a result: found an array or a column of text that holds something else")
        return container

    max_length = max(limit, _MAX_DIMENSIONS)
    values = msgpack.unpackb(
        data, list_hook=counted, object_hook=counted, max_array_len=max_length, max_map_len=0, max_ext_len=0
    )
    if type(values) is not list:
        raise MessageError("a result: found an array or a column of text that is not a list")
    return values


#: Rows and bytes of a part, at most; characters of text count as four bytes. A row has at most as many bytes.
PART_ROWS, PART_BYTES = 1 << 16, 16 << 20

MAX_TABLES = 100  #: that one node may hand in
MAX_COLUMNS = 1000  #: of one table

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
EXPECTED_NAME = "expected a name of at most 64 letters, digits, dots, hyphens and underscores that begins with no dot"

#: Columns by name, equally long: numbers, or text as Python objects.
Columns = dict[str, NDArray[Any]]


class TablePart(NamedTuple):
    """Rows of a table, which follow those of earlier parts.

    number: of the part among all that a process hands in, from 0
    """

    table: str
    number: int
    columns: Columns


def is_table_name(name: object) -> bool:
    """Whether a table, or a node's folder, can have this name."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def checked_columns(table: object, columns: object) -> Columns:
    """The columns of a table as arrays; raises MessageError if it is none, or has no valid name."""
    if not is_table_name(table):
        raise MessageError(f"table {table!r:.80}: {EXPECTED_NAME}")
    if not isinstance(columns, Mapping):
        raise MessageError(f"table {table}: found a {type(columns).__name__}, expected a dict of columns")
    if not 0 < len(columns) <= MAX_COLUMNS:
        raise MessageError(f"table {table}: found {len(columns)} columns, expected 1 to {MAX_COLUMNS}")
    arrays = {name: _column(table, name, values) for name, values in columns.items()}
    if len({len(array) for array in arrays.values()}) > 1:
        lengths = ", ".join(f"{name} {len(array)}" for name, array in arrays.items())
        raise MessageError(f"table {table}: columns of different lengths: {lengths:.200}")
    return arrays


def _column(table: object, name: object, values: Any) -> NDArray[Any]:
    """A column as an array; text as objects, which are as long as they are, not all as long as the longest."""
    if not isinstance(name, str):
        raise MessageError(f"table {table}: found the column {name!r:.80}, expected a name")
    try:
        texts = isinstance(values, (list, tuple)) and any(isinstance(value, str) for value in values)
        array = np.fromiter(values, object, len(values)) if texts else np.asarray(values)
    except (TypeError, ValueError) as error:
        raise MessageError(f"table {table}: column {name:.80}: {error}") from None
    if array.ndim != 1 or array.dtype.kind not in "biufOU":
        found = f"{array.ndim} dimensions of {array.dtype}"
        raise MessageError(f"table {table}: column {name:.80}: found {found}, expected one of numbers or text")
    if array.dtype.kind not in "OU":
        return array
    items = array.tolist()  # a list is read faster than an array of objects
    return np.fromiter(items if set(map(type, items)) <= {str} else map(str, items), object, len(items))


class _WaitingRows:
    """The rows of a table that wait for their part.

    kinds: type of each column, of its first rows; {} before;  begun: whether a part has been cut off
    """

    def __init__(self) -> None:
        self.kinds: dict[str, str] = {}
        self.begun = False
        self.count = self._bytes = 0
        self._pieces: list[Columns] = []
        self._sizes: list[Ints] = []  # of the rows of each piece, bytes

    def add(self, columns: Columns) -> None:
        """Add rows; raises MessageError if their columns differ from those before."""
        kinds = {name: array.dtype.str if array.dtype.kind != "O" else "text" for name, array in columns.items()}
        sizes = _row_bytes(columns)
        count = len(sizes)
        if sizes.max(initial=0) > PART_BYTES:
            most = int(sizes.argmax())
            raise MessageError(f"found {sizes[most]} bytes in row {most}, expected at most {PART_BYTES}")
        if self.kinds and count and list(kinds.items()) != list(self.kinds.items()):
            raise MessageError(f"found columns {kinds}, expected those of the rows before: {self.kinds}")
        if not self.kinds:
            self._pieces.clear()  # without rows, whose types say nothing
            self._sizes.clear()
        if count or not self.kinds:  # numbers are copied: the node may use its arrays again
            self._pieces.append(
                {name: array.copy() if kinds[name] != "text" else array for name, array in columns.items()}
            )
            self._sizes.append(sizes)
        if count:
            self.kinds = kinds
        self.count += count
        self._bytes += int(sizes.sum())

    @property
    def is_full(self) -> bool:
        """Whether there are enough rows for a part."""
        return self.count >= PART_ROWS or self._bytes >= PART_BYTES

    def joined(self) -> Columns:
        """All rows."""
        return {name: np.concatenate([piece[name] for piece in self._pieces]) for name in self._pieces[0]}

    def cut(self, *, everything: bool) -> Iterator[Columns]:
        """Cut off parts, each as long as it may be; the rest waits, unless `everything` is wanted."""
        columns, sizes, start, count = self.joined(), np.concatenate(self._sizes), 0, self.count
        until = np.cumsum(sizes)
        while start < count or (everything and not self.begun):
            most = PART_BYTES + int(until[start - 1] if start else 0)
            end = min(start + PART_ROWS, int(np.searchsorted(until, most, side="right")))
            if end == count < start + PART_ROWS and not everything:
                break
            yield {name: array[start:end] for name, array in columns.items()}
            self.begun, start = True, end
        rest = {name: array[start:].copy() for name, array in columns.items()}
        self._pieces, self._sizes, self.count = [rest], [sizes[start:]], count - start
        self._bytes = int(sizes[start:].sum())


class PartedTables:
    """The tables of one process of a node, cut into parts.

    hand_in: takes each part; None: the rows stay here until `close`
    """

    def __init__(self) -> None:
        self.hand_in: Callable[[TablePart], None] | None = None
        self._number = 0
        self._tables: dict[str, _WaitingRows] = {}

    def append(self, table: str, columns: Mapping[str, Any]) -> None:
        """Append rows to a table; raises MessageError for an invalid table, or for other columns than before."""
        arrays = checked_columns(table, columns)
        if table not in self._tables and len(self._tables) >= MAX_TABLES:
            raise MessageError(f"table {table}: found more than {MAX_TABLES} tables, expected at most as many")
        rows = self._tables.setdefault(table, _WaitingRows())
        try:
            rows.add(arrays)
        except MessageError as error:
            raise MessageError(f"table {table}: {error}") from None
        if rows.is_full:
            self._hand_in(table, everything=False)

    def close(self, results: dict[str, Any]) -> dict[str, Any]:
        """Hand in the rest, and the tables in a node's results; returns the results with the others.

        An invalid table is replaced by a sentence that says why. Without `hand_in`, all tables are in the results.
        """
        tables = results.get("tables", {})
        if not isinstance(tables, Mapping):
            return results
        kept: dict[Any, Any] = {}
        for table, columns in tables.items():
            try:
                self.append(table, columns)
            except MessageError as error:
                kept[table] = str(error)
        for table, rows in self._tables.items():
            if self.hand_in is None:
                kept.setdefault(table, rows.joined())
            else:
                self._hand_in(table, everything=True)
        rest = {key: value for key, value in results.items() if key != "tables"}
        return {**rest, "tables": kept} if kept else rest

    def _hand_in(self, table: str, *, everything: bool) -> None:
        if self.hand_in is not None:
            for columns in self._tables[table].cut(everything=everything):
                self.hand_in(TablePart(table, self._number, columns))
                self._number += 1


def _row_bytes(columns: Columns) -> Ints:
    """Bytes of each row (n,), at most: each character of text has up to four, and its length another five."""
    sizes = np.zeros(len(next(iter(columns.values()))), np.int64)
    for array in columns.values():
        text = array.dtype == object
        sizes += 5 + 4 * np.fromiter(map(len, array.tolist()), np.int64, len(array)) if text else array.itemsize
    return sizes
