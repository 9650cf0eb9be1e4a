"""Recorded messages, decoded, and the states of objects in them as tables by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import CLASSES, ObjectStates
from mast_zenoh.messagelog.reader import read
from mast_zenoh.messages import codec

Columns = dict[str, NDArray[Any]]

#: Units of the columns of tables; the others have none.
UNITS = {
    **dict.fromkeys(("x", "y", "z", "l", "w", "h"), "m"),
    **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
    "yaw": "rad",
    "time_s": "s",
}


@dataclass(frozen=True, slots=True)
class WireMessage:
    """A message as it was sent on a wire.

    wire:      key expression without the run's prefix: `agent/ego/tracks`
    tap:       it was sent on a hidden leg of the wire, before an interposer
    type:      of the message: a section of docs/messages.md, or one that a node of the scenario declares
    publisher: name of the node that made it
    frame:     that it is about;  time_s: s since the scene began;  seq: its number on the wire
    columns:   read-only arrays by name, with the shapes and units of docs/messages.md
    """

    wire: str
    tap: bool
    type: str
    publisher: str
    frame: int
    time_s: float
    seq: int
    columns: Mapping[str, NDArray[Any]]

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.columns[column]

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in self.columns.items())
        leg = " (tap)" if self.tap else ""
        return f"<{self.type} on {self.wire}{leg}, frame {self.frame}, from {self.publisher}: {shapes or 'no columns'}>"


def messages(path: Path, pattern: str = "*", *, taps: bool = False) -> Iterator[WireMessage]:
    """The messages of a run folder or recording on the wires that match, by frame, wire, publisher and number.

    pattern: a glob as of `mast diff --ignore`: `*` stands for any text
    taps:    include the hidden legs of intercepted wires
    Malformed messages, which every subscriber drops, are left out. Raises RunFolderError where nothing was recorded.
    """
    for recorded in read(path):
        if recorded.malformed or (recorded.tap and not taps) or not fnmatchcase(recorded.wire, pattern):
            continue
        header, body = codec.decode_lazily(recorded.payload, recorded.type)
        of_wire = recorded.wire, recorded.tap, recorded.message, recorded.publisher
        yield WireMessage(*of_wire, header.frame, header.time_ns * 1e-9, header.seq, body)


def table_of(path: Path, wire: str, rows: Callable[[WireMessage], Columns]) -> pyarrow.Table:
    """What `rows` makes of each message on a wire, one below the other, behind `frame` and `time_s`.

    A copy of a message that a link has duplicated is left out.
    """
    parts: list[Columns] = []
    last: dict[str, int] = {}
    for message in messages(path, wire):
        if message.seq <= last.get(message.publisher, -1):
            continue
        last[message.publisher] = message.seq
        columns = rows(message)
        count = len(next(iter(columns.values())))
        of_frame = {"frame": np.full(count, message.frame), "time_s": np.full(count, message.time_s)}
        parts.append(of_frame | columns)
    names = list(parts[0]) if parts else ["frame", "time_s"]
    arrays = {name: np.concatenate([part[name] for part in parts]) if parts else np.zeros(0) for name in names}
    fields = []
    for name, array in arrays.items():
        kind = pyarrow.string() if array.dtype == object else pyarrow.from_numpy_dtype(array.dtype)
        fields.append(pyarrow.field(name, kind, metadata={"unit": UNITS[name]} if name in UNITS else None))
    return pyarrow.table([pyarrow.array(array) for array in arrays.values()], schema=pyarrow.schema(fields))


def states(message: WireMessage) -> Columns:
    """The objects of `tracks` or of a `picture` in the world frame."""
    objects = ObjectStates.from_columns(message.columns)
    if "origin" in message.columns:
        objects = states_to_world(objects, message["origin"], message["rotation"])
    support = {"support": message["support"]} if "support" in message.columns else {}
    return _boxes(objects.columns()) | {"score": objects.score} | support


def truth(message: WireMessage) -> Columns:
    """The objects of the scene; `points` are the lidar returns at the agent that has the most."""
    points = message["points"]
    most = points.max(axis=1) if points.shape[1] else np.zeros(len(points), np.int32)
    return _boxes(message.columns) | {"points": most}


def detections(message: WireMessage) -> Columns:
    """The detections of a sensor, in its own frame."""
    return _boxes(message.columns) | {"score": message["score"]}


def pose(message: WireMessage) -> Columns:
    """Where an agent says it is, a row for each frame; the quaternion is that of its rotation into the world."""
    values = np.concatenate([message["position"], message["rotation"], message["velocity"]])[None]
    return dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz"), values.T, strict=True))


def _boxes(columns: Mapping[str, NDArray[Any]]) -> Columns:
    """Columns of boxes with one value a row: position, velocity and size by axis, the class as text."""
    classes = np.array(CLASSES, dtype=object)[columns["class_id"]]
    result: Columns = {"id": columns["id"]} if "id" in columns else {}
    result["class"] = classes
    for name, axes in (("position", "x y z"), ("velocity", "vx vy vz"), ("size", "l w h")):
        if name in columns:
            result |= {axis: columns[name][:, index] for index, axis in enumerate(axes.split())}
    return result | {"yaw": columns["yaw"]}
