"""docs/ref-messages.md: every message type."""

from __future__ import annotations

from collections.abc import Iterator

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.messages.schemas import SCHEMAS, Column
from reference import page, table

_INTRODUCTION = f"""\
Look up here what each message contains, and which messages a node refuses. Your nodes can declare
[message types of their own](how-to-write-a-part.md#a-message-type).

A message is a MessagePack map: a header (`schema`, `version`, `source`, `frame`, `time_ns`, `seq`) and a
`body` that maps each column to `[dtype, shape, data]`, the data being raw little-endian bytes in C order.
In a shape, `n`, `m` and `k` are numbers of objects and `a` is a number of agents. Equal letters in one
message are equal numbers. `time_ns` is nanoseconds since the scene began: the time of the frame, and in
`detections` [the time of the measurement](how-to-sensors.md#how-times-flow).

Coordinate frames are right-handed: x forward (world: east), y left (north), z up. Quaternions are
(w, x, y, z) of the active rotation into the world.

Classes, by `class_id`: {", ".join(f"{i} {name}" for i, name in enumerate(CLASSES))}.

A subscriber refuses, counts and drops a message if

- it is truncated, oversized, or of another schema or version,
- it has a missing or an additional column, another dtype or another shape,
- a number is not finite or implausibly large, or a class is out of range,
- in tracks and pictures, an id occurs twice.

A covariance may be any finite matrix. Filters and fusion make it usable."""


def messages_page() -> str:
    """Every message type with its columns, dtypes, shapes and units."""
    return page("Messages", "mast_zenoh/messages/schemas.py", _INTRODUCTION, _sections())


def _sections() -> Iterator[str]:
    for schema in SCHEMAS.values():
        meaning = f"{schema.meaning[0].upper()}{schema.meaning[1:]}."
        columns = table(("column", "dtype", "shape", "unit", "meaning"), map(_row, schema.columns))
        yield f"## `{schema.name}` (version {schema.version})\n\n{meaning}\n"
        yield columns or "It has no columns, only a header.\n"


def _row(column: Column) -> tuple[str, ...]:
    shape = "(" + ", ".join(map(str, column.shape)) + ("," if len(column.shape) == 1 else "") + ")"
    return f"`{column.name}`", str(column.dtype), shape, column.unit, column.meaning
