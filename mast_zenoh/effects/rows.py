"""What happened to the objects of messages: their rows before an interposer, compared with those behind it. Pure, and
for many messages at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.matching import cheapest
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.messages.schemas import SCHEMAS, Body
from mast_zenoh.metrics.lookup import find
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, MOVED, REMOVED

#: Beside the kinds of manipulation: nothing happened to the object.
UNCHANGED = -1

#: Numbers that differ by less than this, absolutely or relatively, are equal: rounding is no effect.
TOLERANCE = 1e-9
#: m; a row without an identity that changed in every respect is the same object if it reappears this near: the gate
#: within which the metrics, too, take a track for an object.
SAME_OBJECT_M = 2.0
#: m; a row whose appearance other rows share is the same object if it reappears this near.
SAME_APPEARANCE_M = 30.0

#: Columns by which an object without an id is recognised when it has been moved, and further ones that make it sure.
_ROUGHLY, _EXACTLY = ("class_id", "size"), ("score", "covariance")


class _Columns(NamedTuple):
    """The columns of one message type: those with a row for each object, and all others."""

    rows: tuple[str, ...]
    rest: tuple[str, ...]


def _columns(name: str) -> _Columns:
    columns = SCHEMAS[name].columns
    if not any(column.name == "position" and column.shape == ("n", 3) for column in columns):
        return _Columns((), tuple(column.name for column in columns))
    rows = tuple(column.name for column in columns if column.shape[:1] == ("n",))
    return _Columns(rows, tuple(column.name for column in columns if column.name not in rows))


_COLUMNS = {name: _columns(name) for name in SCHEMAS}


def has_objects(message: str) -> bool:
    """Whether messages of a type have a row with a position for each object."""
    return bool(_COLUMNS[message].rows)


class Rows(NamedTuple):
    """The objects of m messages of one type, one message after the other.

    message: (n,) int64, which message each row is of;  columns: by name (n, ...)
    """

    message: Ints
    columns: dict[str, NDArray[Any]]

    @classmethod
    def of(cls, bodies: Sequence[Body], names: Sequence[str]) -> Rows:
        """Some columns of messages."""
        count = [len(body["position"]) for body in bodies]
        message = np.repeat(np.arange(len(bodies)), count)
        return cls(message, {name: np.concatenate([body[name] for body in bodies]) for name in names})


@dataclass(frozen=True, slots=True)
class Changes:
    """How the bodies of m messages of one type differ, before and behind an interposer; k objects.

    sides:   the objects before, and those behind
    before, after: (k,) int64, rows of the one and of the other that are about one object; -1: there is none
    effect:  (k,) index into KINDS; UNCHANGED: the row is as it was
    columns: (k,) the columns of the row that differ, as bits in the order of `names`
    names:   the columns with a row for each object
    others:  of each message the names of the other columns that differ, such as the frame of reference of its rows
    """

    sides: tuple[Rows, Rows]
    before: Ints
    after: Ints
    effect: Ints
    columns: Ints
    names: tuple[str, ...]
    others: tuple[tuple[str, ...], ...]

    @property
    def message(self) -> Ints:
        """(k,) which message each change is of."""
        of_before, of_after = (np.append(side.message, -1) for side in self.sides)
        return np.where(self.before >= 0, of_before[self.before], of_after[self.after])


def compare(message: str, before: Sequence[Body], after: Sequence[Body]) -> Changes:
    """How m bodies `after` differ from m bodies `before`, all sound and of one message type.

    Rows are about one object when they are equal; else when they have the same id, or, if messages of this type have
    no ids, look alike (size and class, better score and covariance too) or are at most SAME_OBJECT_M apart; of several
    choices that one of which the sum of the distances is least. What is left was removed or inserted. The order of the
    rows does not matter.
    """
    names, rest = _COLUMNS[message]
    others = tuple(
        tuple(name for name in rest if not _equal(a[name], b[name])) for a, b in zip(before, after, strict=True)
    )
    none = np.zeros(0, np.int64)
    if not names:
        empty = Rows(none, {})
        return Changes((empty, empty), none, none, none, none, names, others)
    a, b = Rows.of(before, names), Rows.of(after, names)
    i, j = _identical(a, b, names)
    left, right = _without(len(a.message), i), _without(len(b.message), j)
    p, q = _changed(a, b, left, right, names)
    effect, columns = _effects(a, b, p, q, names)
    removed, inserted = left[~np.isin(left, p)], right[~np.isin(right, q)]
    counts = [len(i), len(p), len(removed), len(inserted)]
    return Changes(
        sides=(a, b),
        before=np.concatenate([i, p, removed, np.full(counts[3], -1)]),
        after=np.concatenate([j, q, np.full(counts[2], -1), inserted]),
        effect=np.concatenate(
            [np.full(counts[0], UNCHANGED), effect, np.full(counts[2], REMOVED), np.full(counts[3], INSERTED)]
        ),
        columns=np.concatenate([np.zeros(counts[0], np.int64), columns, np.zeros(counts[2] + counts[3], np.int64)]),
        names=names,
        others=others,
    )


def _equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.shape == b.shape and not bool(np.any(_differ(a, b)))


def _differ(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Where two arrays of one shape differ by more than rounding."""
    differs = np.asarray(a != b)
    if a.dtype.kind == "f" and differs.any():
        differs &= np.abs(a - b) > TOLERANCE * np.maximum(1.0, np.abs(a))
    return differs


def _rows_differ(a: NDArray[Any], b: NDArray[Any]) -> Bools:
    """(k,) which of k rows differ by more than rounding."""
    return np.asarray(_differ(a, b).reshape(len(a), -1).any(axis=1)) if len(a) else np.zeros(0, bool)


def _without(count: int, rows: Ints) -> Ints:
    """The rows 0 to count - 1 that are not among `rows`."""
    left = np.ones(count, bool)
    left[rows] = False
    return np.flatnonzero(left)


def _identical(a: Rows, b: Rows, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Pairs of rows of one message that are equal to the last bit, wherever they stand."""
    at = find(_place(b), _place(a))
    j = np.flatnonzero(at >= 0)
    i = at[j]
    same = np.ones(len(i), bool)
    for name in names:
        equal = a.columns[name][i] == b.columns[name][j]
        same &= equal.reshape(len(i), -1).all(axis=1) if len(i) else same
    if same.all() and len(np.unique(i)) == len(i):
        return i, j  # mostly: no two objects of a message are at one place
    waiting: dict[tuple[int, bytes], list[int]] = {}
    for row, key in enumerate(_bytes(a, names)):
        waiting.setdefault(key, []).append(row)
    pairs = [(rows.pop(0), row) for row, key in enumerate(_bytes(b, names)) if (rows := waiting.get(key))]
    both = np.array(pairs, np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _place(rows: Rows) -> tuple[Ints, ...]:
    """Message and position of every row, the latter as its bits."""
    bits = np.ascontiguousarray(rows.columns["position"]).view(np.int64)
    return rows.message, bits[:, 0], bits[:, 1], bits[:, 2]


def _bytes(rows: Rows, names: tuple[str, ...]) -> list[tuple[int, bytes]]:
    """Every row with its message, all its columns one after the other."""
    n = len(rows.message)
    parts = [np.ascontiguousarray(rows.columns[name]).reshape(n, -1).view(np.uint8) for name in names] if n else []
    whole = np.concatenate(parts, axis=1) if parts else np.zeros((0, 1), np.uint8)
    return [(message, row.tobytes()) for message, row in zip(rows.message.tolist(), whole, strict=True)]


def _changed(a: Rows, b: Rows, left: Ints, right: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Pairs among the rows `left` of the one and `right` of the other that are about one object, though they differ."""
    if not len(left) or not len(right):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    if "id" not in names:
        return _by_appearance(a, b, left, right, names)
    # A row that has nothing but another id is the same object; only then does the id decide. In a batch of several
    # agents' tracks an id is one of its agent's.
    identity = tuple(name for name in ("agent", "id") if name in names)
    content = tuple(name for name in names if name not in identity)
    at = find(tuple(column[right] for column in _place(b)), tuple(column[left] for column in _place(a)))
    q = np.flatnonzero(at >= 0)
    p = at[q]
    same = np.ones(len(q), bool)
    for name in content:
        same &= ~_rows_differ(a.columns[name][left[p]], b.columns[name][right[q]])
    p, q = left[p[same]], right[q[same]]
    left, right = left[~np.isin(left, p)], right[~np.isin(right, q)]
    mine, others = ((side.message, *(side.columns[name] for name in identity)) for side in (a, b))
    at = find(tuple(column[right] for column in others), tuple(column[left] for column in mine))
    hit = np.flatnonzero(at >= 0)
    return np.concatenate([p, left[at[hit]]]), np.concatenate([q, right[hit]])


def _by_appearance(a: Rows, b: Rows, left: Ints, right: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Rows that look alike, then rows that are near each other; the least sum of distances each time."""
    i, j = _pairs(a.message[left], b.message[right])
    i, j = left[i], right[j]
    offset = a.columns["position"][i] - b.columns["position"][j]
    apart = np.hypot(offset[:, 0], offset[:, 1])
    alike = np.ones(len(i), bool)
    for name in (name for name in _ROUGHLY if name in names):
        alike &= ~_rows_differ(a.columns[name][i], b.columns[name][j])
    exactly = alike.copy()
    some = np.flatnonzero(alike)
    for name in (name for name in _EXACTLY if name in names):
        exactly[some] &= ~_rows_differ(a.columns[name][i[some]], b.columns[name][j[some]])
    chosen: list[Ints] = []
    for possible in (exactly, alike, apart <= SAME_OBJECT_M):
        taken = np.concatenate([np.zeros(0, np.int64), *chosen])
        free = np.flatnonzero(possible & ~np.isin(i, i[taken]) & ~np.isin(j, j[taken]))
        if possible is not exactly and possible is not alike:
            chosen.append(free[_least(i[free], j[free], apart[free])])
            break
        unique = (np.bincount(i[free])[i[free]] == 1) & (np.bincount(j[free])[j[free]] == 1) if len(free) else free > 0
        free = free[unique | (apart[free] <= SAME_APPEARANCE_M)]
        chosen.append(free[_least(i[free], j[free], apart[free])])
    rows = np.concatenate(chosen)
    return i[rows], j[rows]


def _pairs(a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """All pairs of rows of one message; a, b: ascending messages of the rows."""
    first, last = np.searchsorted(b, a, side="left"), np.searchsorted(b, a, side="right")
    count = last - first
    i = np.repeat(np.arange(len(a)), count)
    return i, np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)


def _least(i: Ints, j: Ints, apart: Floats) -> Bools:
    """(k,) bool: as many of the pairs as can be and, of these choices, the one with the least sum of distances."""
    if not len(i):
        return np.zeros(0, bool)
    much = float(apart.max()) * (len(np.unique(i)) + 1) + 1.0
    return cheapest(np.ascontiguousarray(i), np.ascontiguousarray(j), apart - much)


def _effects(a: Rows, b: Rows, p: Ints, q: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Of pairs of rows: what happened to the object, and which columns differ, as bits."""
    columns, moved = np.zeros(len(p), np.int64), np.zeros(len(p), bool)
    for bit, name in enumerate(names):
        differs = _rows_differ(a.columns[name][p], b.columns[name][q])
        columns |= differs.astype(np.int64) << bit
        if name == "position":
            moved = differs
    return np.where(moved, MOVED, np.where(columns != 0, ALTERED, UNCHANGED)), columns
