"""Limits on the rows of a message: what the sensors of a scene can see.

Rows beyond are dropped before they cost anything.

One node that sends 20,000 objects would otherwise slow every node that compares, fuses or scores them. The rows that
are kept do not depend on their order: those with the highest scores, then the lowest ids, then the lowest positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.messages.schemas import SCHEMAS, Body

#: Rows beyond twice what is there: the least limit.
_MARGIN = 16

#: Limits by message type, of the scenario that is used (`user_types.use`); none for types that are not in it.
LIMITS: dict[str, int] = {}


class Shortened(dict[str, Any]):
    """The columns of a message without the rows beyond its limit; `found` is how many rows it had."""

    found: int


#: Limit of overheard messages of the type `tracks`: an agent's mission estimate has its tracks and the picture.
OVERHEARD = "overheard"

#: By limit, the latest message with too many rows, and what is left: in one process, all subscribers get the same one.
_latest: dict[str, tuple[Body, Shortened]] = {}


def use(limits: Mapping[str, int]) -> None:
    """Use these limits from now on, and no others."""
    LIMITS.clear()
    LIMITS.update(limits)
    _latest.clear()


def limits_for(detections: NDArray[np.int64], objects: int, per_agent: int | None = None) -> dict[str, int]:
    """Limits for a scene: twice what is there, and some more, so that honest nodes never reach them.

    detections: (F, A) of each agent in each frame; objects: most of a frame
    per_agent:  a limit on the rows of an agent's messages, instead of one from its detections
    """
    rows = per_agent or _MARGIN + 2 * int(detections.max(initial=0))
    picture = _MARGIN + 2 * max(objects, int(detections.sum(axis=1).max(initial=0)))
    picture = max(rows, picture)
    limits = {"detections": rows, "tracks": rows, "collated": detections.shape[1] * rows, "picture": picture}
    return limits | {OVERHEARD: rows + picture}


def excess(body: Shortened) -> str:
    """Why rows of a message were dropped."""
    rows = len(body["score"])
    return f"rows: found {body.found} rows, expected at most {rows}: only those with the highest scores are used"


def shortened(schema: str, columns: Body, limit_of: str) -> Body:
    """The columns without the rows beyond the limit of their type; the same object if there are none.

    limit_of: which of LIMITS
    """
    limit = LIMITS.get(limit_of)
    if limit is None or len(columns["score"]) <= limit:
        return columns
    if limit_of in _latest and _latest[limit_of][0] is columns:
        return _latest[limit_of][1]
    score, position = columns["score"], columns["position"]
    ids = [columns["id"]] if "id" in columns else []
    rows = _lowest([-score, *ids, *position.T], limit)
    per_row = {column.name for column in SCHEMAS[schema].columns if column.shape[:1] == ("n",)}
    result = Shortened()
    for name, values in columns.items():
        result[name] = values[rows] if name in per_row else values
        result[name].setflags(write=False)
    result.found = len(score)
    _latest[limit_of] = columns, result
    return result


def _lowest(keys: Sequence[NDArray[Any]], count: int) -> NDArray[np.int64]:
    """The `count` lowest rows by the first key, then by the next, ascending; in linear time."""
    candidates, kept = np.arange(len(keys[0])), []
    for key in keys:
        values = key[candidates]
        cutoff = np.partition(values, count - 1)[count - 1]
        below = candidates[values < cutoff]
        kept.append(below)
        count -= len(below)
        candidates = candidates[values == cutoff]
        if len(candidates) <= count:
            break
    return np.sort(np.concatenate([*kept, candidates[:count]]))
