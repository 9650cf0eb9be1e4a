"""Compares the objects in messages before and after an interposer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import NO_OFFSET, NO_TURN
from mast_zenoh.arrays.matching import min_cost_matching
from mast_zenoh.arrays.states import Bools, Floats, Ints, within_runs
from mast_zenoh.evaluation.effects import scans
from mast_zenoh.messages.schemas import SCHEMAS, Body, Header, Schema, text
from mast_zenoh.metrics.assignment import find
from mast_zenoh.metrics.causes import ALTERED, INSERTED, MOVED, REMOVED
from mast_zenoh.sensing.points import Points

#: Code of an unchanged object, in addition to the kinds of manipulation.
UNCHANGED = -1

#: Absolute and relative tolerance of comparisons, so that rounding is not an effect.
TOLERANCE = 1e-9
#: m; maximum distance between rows of the same object if they have no ids and differ in all columns. The gate of the
#: metrics is the same.
SAME_OBJECT_M = 2.0
#: m; likewise for rows whose appearance is not unique.
SAME_APPEARANCE_M = 30.0

#: Columns that identify a moved object without an id, and other columns that confirm it.
_APPEARANCE, _CONFIRMING = ("class_id", "size"), ("score", "covariance")


class _Columns(NamedTuple):
    """The columns of a message type: columns with a row for each object, and others.

    wide: those of the others that have a row for each object, of a size that may differ between messages
    """

    rows: tuple[str, ...]
    wide: tuple[str, ...]
    others: tuple[str, ...]


#: Dtype and shape of columns by which objects are told apart. A user's type in which they differ has no objects.
_OF_OBJECTS = {
    "position": ("float64", ("n", 3)),
    "velocity": ("float64", ("n", 3)),
    "id": ("int64", ("n",)),
    "agent": ("int64", ("n",)),
}


@lru_cache(maxsize=256)
def _columns(schema: Schema) -> _Columns:
    names = tuple(column.name for column in schema.columns)
    usual = all((c.dtype, c.shape) == _OF_OBJECTS.get(c.name, (c.dtype, c.shape)) for c in schema.columns)
    if "position" not in names or not usual:
        return _Columns((), (), names)
    # Other letters, such as the number of agents, may differ between messages.
    rows = tuple(
        column.name
        for column in schema.columns
        if column.shape[0] == "n" and column.dtype != "str" and all(isinstance(size, int) for size in column.shape[1:])
    )
    wide = tuple(column.name for column in schema.columns if column.shape[:1] == ("n",) and column.name not in rows)
    return _Columns(rows, wide, tuple(name for name in names if name not in rows))


class Rows(NamedTuple):
    """The objects of m messages of one type, concatenated.

    message: (n,) int64, message of each row;  columns: by name (n, ...)
    """

    message: Ints
    columns: dict[str, NDArray[Any]]

    @classmethod
    def of(cls, bodies: Sequence[Body], names: Sequence[str]) -> Rows:
        """The named columns of messages."""
        count = [len(body["position"]) if names else 0 for body in bodies]
        message = np.repeat(np.arange(len(bodies)), count)
        return cls(message, {name: np.concatenate([body[name] for body in bodies]) for name in names})


def _equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.shape == b.shape and not bool(np.any(_differ(a, b)))


def _differ(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Elements in which two arrays of the same shape differ by more than rounding."""
    differs = np.asarray(a != b)
    if a.dtype.kind == "f" and differs.any():
        differs &= np.abs(a - b) > TOLERANCE * np.maximum(1.0, np.abs(a))
    return differs


def _rows_differ(a: NDArray[Any], b: NDArray[Any]) -> Bools:
    """(k,) whether each of k rows differs by more than rounding."""
    return np.asarray(_differ(a, b).reshape(len(a), -1).any(axis=1)) if len(a) else np.zeros(0, bool)


def _complement(count: int, rows: Ints) -> Ints:
    """The rows 0 to count - 1 except `rows`."""
    left = np.ones(count, bool)
    left[rows] = False
    return np.flatnonzero(left)


def _identical(a: Rows, b: Rows, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Pairs of bitwise equal rows of the same message, in any order."""
    at = find(_position_keys(b), _position_keys(a))
    j = np.flatnonzero(at >= 0)
    i = at[j]
    same = np.ones(len(i), bool)
    for name in names:
        equal = a.columns[name][i] == b.columns[name][j]
        same &= equal.reshape(len(i), -1).all(axis=1) if len(i) else same
    if same.all() and len(np.unique(i)) == len(i):
        return i, j  # the usual case: no two objects of a message have the same position
    waiting: dict[tuple[int, bytes], list[int]] = {}
    for row, key in enumerate(_bytes(a, names)):
        waiting.setdefault(key, []).append(row)
    pairs = [(rows.pop(0), row) for row, key in enumerate(_bytes(b, names)) if (rows := waiting.get(key))]
    rows_array = np.array(pairs, np.int64).reshape(-1, 2)
    return rows_array[:, 0], rows_array[:, 1]


def _position_keys(rows: Rows) -> tuple[Ints, ...]:
    """Message and position of every row, the latter as bits."""
    bits = np.ascontiguousarray(rows.columns["position"]).view(np.int64)
    return rows.message, bits[:, 0], bits[:, 1], bits[:, 2]


def _bytes(rows: Rows, names: tuple[str, ...]) -> list[tuple[int, bytes]]:
    """The message and the bytes of all columns of every row."""
    n = len(rows.message)
    parts = [np.ascontiguousarray(rows.columns[name]).reshape(n, -1).view(np.uint8) for name in names] if n else []
    whole = np.concatenate(parts, axis=1) if parts else np.zeros((0, 1), np.uint8)
    return [(message, row.tobytes()) for message, row in zip(rows.message.tolist(), whole, strict=True)]


def _changed(a: Rows, b: Rows, left: Ints, right: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Pairs of differing rows of the same object.

    left, right: candidate rows of `a` and of `b`
    """
    if not len(left) or not len(right):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    if "id" not in names:
        return _by_appearance(a, b, left, right, names)
    # Rows that differ only in their ids are the same object; otherwise the id decides. In a batch of several agents'
    # tracks, an id belongs to an agent.
    identity = tuple(name for name in ("agent", "id") if name in names)
    content = tuple(name for name in names if name not in identity)
    match = find(
        tuple(column[right] for column in _position_keys(b)), tuple(column[left] for column in _position_keys(a))
    )
    q = np.flatnonzero(match >= 0)
    p = match[q]
    same = np.ones(len(q), bool)
    for name in content:
        same &= ~_rows_differ(a.columns[name][left[p]], b.columns[name][right[q]])
    p, q = left[p[same]], right[q[same]]
    left, right = left[~np.isin(left, p)], right[~np.isin(right, q)]
    left_ids, right_ids = ((side.message, *(side.columns[name] for name in identity)) for side in (a, b))
    match = find(tuple(column[right] for column in right_ids), tuple(column[left] for column in left_ids))
    hit = np.flatnonzero(match >= 0)
    return np.concatenate([p, left[match[hit]]]), np.concatenate([q, right[hit]])


def _by_appearance(a: Rows, b: Rows, left: Ints, right: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Match rows by appearance, then by distance.

    Each time with the least total distance.
    """
    i, j = _pairs(a.message[left], b.message[right])
    i, j = left[i], right[j]
    offset = a.columns["position"][i] - b.columns["position"][j]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    alike = np.ones(len(i), bool)
    for name in (name for name in _APPEARANCE if name in names):
        alike &= ~_rows_differ(a.columns[name][i], b.columns[name][j])
    exactly = alike.copy()
    alike_rows = np.flatnonzero(alike)
    for name in (name for name in _CONFIRMING if name in names):
        exactly[alike_rows] &= ~_rows_differ(a.columns[name][i[alike_rows]], b.columns[name][j[alike_rows]])
    selected: list[Ints] = []
    for candidates in (exactly, alike, distance <= SAME_OBJECT_M):
        taken = np.concatenate([np.zeros(0, np.int64), *selected])
        free = np.flatnonzero(candidates & ~np.isin(i, i[taken]) & ~np.isin(j, j[taken]))
        if candidates is not exactly and candidates is not alike:
            selected.append(free[_least_distance(i[free], j[free], distance[free])])
            break
        unique = (np.bincount(i[free])[i[free]] == 1) & (np.bincount(j[free])[j[free]] == 1) if len(free) else free > 0
        free = free[unique | (distance[free] <= SAME_APPEARANCE_M)]
        selected.append(free[_least_distance(i[free], j[free], distance[free])])
    rows = np.concatenate(selected)
    return i[rows], j[rows]


def _pairs(a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """All pairs of rows of the same message; a, b: messages of the rows, ascending."""
    first, last = np.searchsorted(b, a, side="left"), np.searchsorted(b, a, side="right")
    count = last - first
    i = np.repeat(np.arange(len(a)), count)
    return i, within_runs(count) + np.repeat(first, count)


def _least_distance(i: Ints, j: Ints, distance: Floats) -> Bools:
    """The matching with the most pairs and, among these, the least total distance.

    (k,) bool
    """
    if not len(i):
        return np.zeros(0, bool)
    offset = float(distance.max()) * (len(np.unique(i)) + 1) + 1.0
    return min_cost_matching(np.ascontiguousarray(i), np.ascontiguousarray(j), distance - offset)


def _effects(a: Rows, b: Rows, p: Ints, q: Ints, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """The effect on each pair of rows, and the changed columns as bits."""
    columns, moved = np.zeros(len(p), np.int64), np.zeros(len(p), bool)
    for bit, name in enumerate(names):
        differs = _rows_differ(a.columns[name][p], b.columns[name][q])
        columns |= differs.astype(np.int64) << bit
        if name == "position":
            moved = differs
    return np.where(moved, MOVED, np.where(columns != 0, ALTERED, UNCHANGED)), columns


#: Columns with the frame of reference of all positions: in the world or in the agent's frame.
_REFERENCES = (("origin", "rotation"), ("mount_position", "mount_rotation"))
_WORLD = np.concatenate([NO_OFFSET, NO_TURN])


class ChangedMessage(NamedTuple):
    """A changed message.

    seq: its number; step: the frame in which it was received; before, after: its bodies
    """

    frame: int
    seq: int
    step: int
    before: Body
    after: Body


class ObjectChanges(NamedTuple):
    """Effects on k objects in messages of one passage.

    frame, seq, step: (k,) of the message, and the frame of the run in which the interposer received it
    effect:   (k,) index into KINDS; UNCHANGED: the object moves with the frame of reference of its message
    columns:  (k,) object, names of the columns that were changed, separated by spaces
    id:       (k,) of the object in the message, -1: messages of this type have no ids
    before, after: (k, 3) m, the object's position in the received and in the sent message; NaN: absent
    velocity: (k, 3) m/s, as sent, or as received for a removed object; NaN: messages have none
    references: (2, k, 7) frames of reference of `before`, and of `after` and `velocity`: origin m, active quaternion
              w x y z
    of_agent: whether these are relative to the agent (the mount of a sensor) instead of the world
    whole:    (k,) bool, the whole message was withheld, delayed, forged or reframed
    frames_late: (k,) delay of the message in frames
    points:   (k,) of a lidar that make the object; 0: messages have none
    """

    frame: Ints
    seq: Ints
    step: Ints
    effect: Ints
    columns: np.ndarray
    id: Ints
    before: Floats
    after: Floats
    velocity: Floats
    references: Floats
    of_agent: bool
    whole: Bools
    frames_late: Ints
    points: Ints

    def since(self, step: int) -> ObjectChanges:
        """The effects on messages that the interposer received in this frame of the run or later."""
        kept = self.step >= step
        by_row = {name: getattr(self, name)[kept] for name in self._fields if name not in ("references", "of_agent")}
        return self._replace(references=self.references[:, kept], **by_row)


def changed_objects(
    message: str, messages: Sequence[ChangedMessage]
) -> tuple[ObjectChanges, tuple[tuple[str, ...], ...]]:
    """Changed objects in valid messages of one type, and the names of the other changed columns of each message.

    Rows are the same object if they are equal; otherwise if they have the same id. Without ids, they must have the same
    appearance (size and class, preferably also score and covariance) or be at most SAME_OBJECT_M apart; among several
    matchings, the one with the least total distance is chosen. Remaining rows were removed or inserted. The order of
    the rows does not matter. If the frame of reference of a message was changed, all its objects count.
    """
    if message == scans.POINTS:
        return changed_scans(messages)
    bodies = [item.before for item in messages], [item.after for item in messages]
    names, wide, message_columns = _columns(SCHEMAS[message])
    others = tuple(
        tuple(
            name
            for name in message_columns
            if not _equal(a[name], b[name]) and (name not in wide or len(a[name]) == len(b[name]))
        )
        for a, b in zip(*bodies, strict=True)
    )
    sides, rows, effect, columns = _compared(*bodies, names)
    of_before, of_after = (np.append(side.message, -1) for side in sides)
    message_row = np.where(rows[0] >= 0, of_before[rows[0]], of_after[rows[1]])
    stated = {name for pair in _REFERENCES if _has(bodies[0][0], pair) for name in pair}
    reframed = np.array([not stated.isdisjoint(other) for other in others], bool)
    chosen = ((effect != UNCHANGED) | reframed[message_row]).nonzero()[0]
    rows, effect, columns, message_row = rows[:, chosen], effect[chosen], columns[chosen], message_row[chosen]
    positions, velocity = np.full((2, len(chosen), 3), np.nan), np.full((len(chosen), 3), np.nan)
    ids = np.full(len(chosen), -1, np.int64)
    for position, side, row in zip(positions, sides, rows, strict=True):
        present = np.flatnonzero(row >= 0)
        for name, column in (("position", position), ("velocity", velocity)):
            column[present] = side.columns[name][row[present]] if name in side.columns else np.nan
        unset = present[ids[present] < 0]  # the id as received takes precedence
        ids[unset] = side.columns["id"][row[unset]] if "id" in side.columns else -1
    return ObjectChanges(
        **_times(messages, message_row),
        effect=effect,
        columns=_bit_names(columns, names),
        id=ids,
        before=positions[0],
        after=positions[1],
        velocity=velocity,
        references=np.stack([np.stack([_reference(body) for body in side])[message_row] for side in bodies]),
        of_agent=_of_agent(bodies[0][0]),
        whole=effect == UNCHANGED,
        frames_late=np.zeros(len(chosen), np.int64),
        points=np.zeros(len(chosen), np.int64),
    ), others


def _times(messages: Sequence[ChangedMessage], row: Ints) -> dict[str, Ints]:
    """Frame, number and step of messages by row (k,)."""
    return {name: np.array([getattr(item, name) for item in messages])[row] for name in ("frame", "seq", "step")}


def changed_scans(messages: Sequence[ChangedMessage]) -> tuple[ObjectChanges, tuple[tuple[str, ...], ...]]:
    """As `changed_objects`, of scans: the objects that their points have lost or gained."""
    changes = [
        (row, effect, position, points)
        for row, item in enumerate(messages)
        for effect, objects in zip((REMOVED, INSERTED), scans.compared(item.before, item.after), strict=True)
        for position, points in objects
    ]
    row, effect, points = (np.array([each[k] for each in changes], np.int64) for k in (0, 1, 3))
    position = np.array([each[2] for each in changes]).reshape(-1, 3)
    gained = (effect == INSERTED)[:, None]
    reference = np.stack([np.stack([_reference(item.before), _reference(item.after)]) for item in messages], axis=1)
    return ObjectChanges(
        **_times(messages, row),
        effect=effect,
        columns=text([""] * len(changes)),
        id=np.full(len(changes), -1, np.int64),
        before=np.where(gained, np.nan, position),
        after=np.where(gained, position, np.nan),
        velocity=np.full((len(changes), 3), np.nan),
        references=reference[:, row],
        of_agent=True,
        whole=np.zeros(len(changes), bool),
        frames_late=np.zeros(len(changes), np.int64),
        points=points,
    ), tuple(
        tuple(name for name, column in item.before.items() if not _equal(column, item.after[name])) for item in messages
    )


def _compared(
    before: Sequence[Body], after: Sequence[Body], names: tuple[str, ...]
) -> tuple[tuple[Rows, Rows], Ints, Ints, Ints]:
    """The objects of m messages on both sides, and of k objects their rows (2, k) there, -1: none.

    Also the effect (k,) on each, an index into KINDS or UNCHANGED, and its changed columns (k,), as bits of `names`.
    """
    a, b = Rows.of(before, names), Rows.of(after, names)
    if not names:
        none = np.zeros(0, np.int64)
        return (a, b), np.zeros((2, 0), np.int64), none, none
    i, j = _identical(a, b, names)
    left, right = _complement(len(a.message), i), _complement(len(b.message), j)
    p, q = _changed(a, b, left, right, names)
    effect, columns = _effects(a, b, p, q, names)
    removed, inserted = left[~np.isin(left, p)], right[~np.isin(right, q)]
    counts = [len(i), len(p), len(removed), len(inserted)]
    rows = np.stack(
        [
            np.concatenate([i, p, removed, np.full(counts[3], -1)]),
            np.concatenate([j, q, np.full(counts[2], -1), inserted]),
        ]
    )
    effects = np.repeat([UNCHANGED, UNCHANGED, REMOVED, INSERTED], counts)
    bits = np.zeros(len(effects), np.int64)
    pairs = slice(counts[0], counts[0] + counts[1])
    effects[pairs], bits[pairs] = effect, columns
    return (a, b), rows, effects, bits


def whole_message(
    message: str, header: Header, step: int, body: Body, *, received: bool, frames_late: int = 0
) -> ObjectChanges:
    """All objects of a message that was not sent on in time (`received`), or not received.

    They are as of a message that is compared with the same one without objects.
    """
    rows = _columns(SCHEMAS[message]).rows or (tuple(Points.empty().columns()) if message == scans.POINTS else ())
    emptied = {name: column[:0] if name in rows else column for name, column in body.items()}
    before, after = (body, emptied) if received else (emptied, body)
    changes, _ = changed_objects(message, [ChangedMessage(header.frame, header.seq, step, before, after)])
    n = len(changes.frame)
    return changes._replace(whole=np.ones(n, bool), frames_late=np.full(n, frames_late, np.int64))


def _reference(body: Body) -> Floats:
    for pair in _REFERENCES:
        if _has(body, pair):
            return np.concatenate([body[name] for name in pair])
    return _WORLD


def _of_agent(body: Body) -> bool:
    return _has(body, _REFERENCES[1])


def _has(body: Body, reference: tuple[str, str]) -> bool:
    """Whether a message states its coordinate frame.

    A user's message type may have only one of these columns, or other shapes.
    """
    origin, rotation = reference
    return origin in body and rotation in body and body[origin].shape == (3,) and body[rotation].shape == (4,)


def _bit_names(bits: Ints, names: tuple[str, ...]) -> np.ndarray:
    """(k,) object: the names of the set bits."""
    masks, index = np.unique(bits, return_inverse=True)
    strings = [" ".join(name for bit, name in enumerate(names) if mask >> bit & 1) for mask in masks.tolist()]
    return text(strings)[index.reshape(-1)]
