"""Limits of a run's messages: on their rows, by what its sensors can see, and on their frames and times.

Rows beyond are dropped before they cost anything.

One node that sends 20,000 objects would otherwise slow every node that compares, fuses or scores them. The rows that
are kept do not depend on their order, unless there are very many: those with the highest scores, then the lowest ids,
then the lowest positions. A node that fuses chooses them itself, so that a flood does not displace what was there
before (`fusion.input_limit`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import lowest_rows
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import BUILT_IN, SCHEMAS, Body, Column, Header

#: Rows beyond twice what is there: the least limit.
_MARGIN = 16

#: Of a message with more than this many times the rows of its limit, only the first ones are looked at. It is used only
#: if it is encoded as ours are: any other has to be unpacked, which takes longer than all else.
_LOOKED_AT = 50
#: Shortened messages that are remembered: of as many sources as may send too many rows in one frame.
_REMEMBERED = 64
#: Bytes of a message besides its rows: its header, names, and columns of fixed size.
_OTHER_BYTES = 8192


class Shortened(dict[str, Any]):
    """The columns of a message without the rows beyond its limit; `found` is how many rows it had."""

    found: int


class RowChoice(NamedTuple):
    """How a receiver chooses the rows of a message that has too many.

    rows: that it uses of a message, at most
    best: those rows, ascending, of the ids (n,) and scores (n,) of a message, and their number; values are unchecked
    """

    rows: int
    best: Callable[[NDArray[np.int64], NDArray[np.float64], int], NDArray[np.int64]]


#: Limit of messages of the type `tracks` that agents do not send as their tracks: an agent's mission estimate has its
#: tracks and the picture.
OVERHEARD = "overheard"


def limits_for(detections: NDArray[np.int64], objects: int, per_agent: int | None = None) -> dict[str, int]:
    """Limits for a scene: twice what is there, and some more, so that honest nodes never reach them.

    detections: (F, A) of each agent in each frame; objects: most of a frame
    per_agent:  a limit on the rows of an agent's messages, instead of one from its detections
    """
    rows = per_agent or _MARGIN + 2 * int(detections.max(initial=0))
    picture = _MARGIN + 2 * max(objects, _most_at_once(detections))
    picture = max(rows, picture)
    limits = {"detections": rows, "tracks": rows, "collated": detections.shape[1] * rows, "picture": picture}
    return limits | {"relayed": picture, OVERHEARD: rows + picture}


def fused_rows(detections: NDArray[np.int64]) -> int:
    """Rows of all agents that a fusion uses in a frame, at most: what they detect, half of it, and some more.

    Trackers go on with objects that were not detected, and peers keep what they have heard: of junctions with up to
    twelve agents, they had 1.15 times the most detections.
    Less than the sum of what their messages may have, so that a flood of one is no slower than a busy frame.
    detections: (F, A) of each agent in each frame
    """
    return _MARGIN + _most_at_once(detections) * 3 // 2


def _most_at_once(detections: NDArray[np.int64]) -> int:
    return int(detections.sum(axis=1).max(initial=0))


def excess(body: Shortened) -> str:
    """Why rows of a message were dropped."""
    return f"rows: found {body.found} rows, expected at most {len(body['score'])}: the others are not used"


class RowLimits:
    """Limits of one run on the rows of messages.

    rows: by message type, and `OVERHEARD`; types that are not in it have none
    """

    def __init__(self, rows: Mapping[str, int]) -> None:
        self.rows = dict(rows)
        #: Bytes of a message, by its type, beyond which it has too many rows; not for types of variable size.
        self._longest: dict[str, int] = {}
        #: The latest messages with too many rows, and what is left: in one process, all receivers get the same ones.
        self._latest: deque[tuple[str, Body, Shortened]] = deque(maxlen=_REMEMBERED)
        for name in self.rows.keys() & BUILT_IN.keys():
            columns = BUILT_IN[name].columns
            if all(column.dtype != "str" and {*column.shape} <= {"n", *range(10)} for column in columns):
                rows_unpacked = max(_LOOKED_AT * self.rows[name], self.rows.get(OVERHEARD, 0))
                self._longest[name] = _OTHER_BYTES + rows_unpacked * sum(map(_row_bytes, columns))

    def check_length(self, schema: str, length: int) -> None:
        """Raise MessageError for a message so long that to unpack it costs too much, if it is not as encoded here."""
        longest = self._longest.get(schema)
        if longest is not None and length > longest:
            raise MessageError(
                f"rows: {schema}: {length} bytes in another order than expected, at most {longest} allowed: "
                "the message is not used"
            )

    def shortened(self, schema: str, columns: Body, limit_of: str, choice: RowChoice | None = None) -> Body:
        """The columns without the rows beyond the limit of their type; the same object if there are none.

        limit_of: which of `rows`; choice: of the receiver, None: the rows with the highest scores
        """
        limit = self.rows.get(limit_of)
        if choice is not None and limit is not None:
            limit = min(limit, choice.rows)
        found = len(columns["score"]) if limit is not None else 0
        if limit is None or found <= limit:
            return columns
        most = _LOOKED_AT * limit
        if choice is not None:
            return _with_rows(schema, columns, choice.best(columns["id"][:most], columns["score"][:most], limit))
        for limited_by, message, kept in self._latest:
            if message is columns and limited_by == limit_of:
                return kept
        ids = [columns["id"][:most]] if "id" in columns else []
        keys = [-columns["score"][:most], *ids, *columns["position"][:most].T]
        result = _with_rows(schema, columns, lowest_rows(keys, limit))
        self._latest.append((limit_of, columns, result))
        return result


#: For messages that are read without a run, such as those of recordings.
NO_LIMITS = RowLimits({})


def _with_rows(schema: str, columns: Body, rows: NDArray[np.int64]) -> Shortened:
    """The columns of a message with these rows alone."""
    per_row = {column.name for column in SCHEMAS[schema].columns if _per_row(column)}
    result = Shortened()
    for name, values in columns.items():
        result[name] = values[rows] if name in per_row else values.view()
        result[name].setflags(write=False)
    result.found = len(columns["score"])
    return result


def _per_row(column: Column) -> bool:
    return column.shape[:1] == ("n",)


def _row_bytes(column: Column) -> int:
    shape: tuple[Any, ...] = column.shape[1:]  # numbers
    return int(np.dtype(column.dtype).itemsize * prod(shape)) if _per_row(column) else 0


#: s, tolerance for times where no node declares that it changes them (`Node.restamps_s`): small shifts by an adversary
#: must take effect; messages that are off by more are useless to every shipped node.
LEEWAY_S = 1.0


class Timespan(NamedTuple):
    """The frames of a run and their times.

    frames:    number of frames
    period_ns: ns, from one frame to the next
    leeway_ns: ns, tolerance for the time in a header: clock faults, uneven frames, LEEWAY_S
    """

    frames: int
    period_ns: int
    leeway_ns: int

    def refusal(self, header: Header, step: int) -> str:
        """The reason why a message cannot belong to the run, or "".

        step: the current frame of the run, -1 if unknown

        A message is about a frame of the run that has begun. Its time is between the times of its frame and of `step`.
        Both may be off by the leeway.
        """
        _, _, frame, time_ns, _ = header
        frames, period_ns, leeway_ns = self
        if frame <= step < frames and time_ns == frame * period_ns:
            return ""  # nearly all are
        latest = frames - 1 if step < 0 else min(step, frames - 1)
        if (frame - latest) * period_ns > leeway_ns:
            expected = f"at most {latest + leeway_ns // period_ns}"
            return f"frame: {header.schema}: frame is {frame}, expected {expected}"
        earliest_ns, latest_ns = frame * period_ns - leeway_ns, max(frame, step) * period_ns + leeway_ns
        if not earliest_ns <= time_ns <= latest_ns:
            expected = f"{max(0, earliest_ns)} to {latest_ns} of frame {frame}"
            return f"time: {header.schema}: time_ns is {time_ns}, expected {expected}"
        return ""
