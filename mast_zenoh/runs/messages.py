"""Decodes recorded messages, and turns their object states into tables by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import CLASSES, ObjectStates
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.run_folder.recording.reader import Recorded, read

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
    tap:       whether it was sent on a hidden leg of the wire, before an interposer
    type:      message type, a section of docs/ref-messages.md, or one that a node of the scenario declares
    publisher: name of the node that published it
    frame:     frame number;  time_s: s since the scene began;  seq: its number on the wire
    body:      read-only columns by name, as in `Received.body`, with the shapes and units of docs/ref-messages.md
    """

    wire: str
    tap: bool
    type: str
    publisher: str
    frame: int
    time_s: float
    seq: int
    body: Mapping[str, NDArray[Any]]

    @property
    def columns(self) -> Mapping[str, NDArray[Any]]:
        """The body, by its former name."""
        return self.body

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.body[column]

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in self.body.items())
        leg = " (tap)" if self.tap else ""
        return f"<{self.type} on {self.wire}{leg}, frame {self.frame}, from {self.publisher}: {shapes or 'no columns'}>"


def messages(path: Path, pattern: str = "*", *, taps: bool = False) -> Iterator[WireMessage]:
    """The messages of a run folder or recording on matching wires.

    Sorted by time, frame, wire, publisher and number.

    pattern: a glob as in `mast diff --ignore`: `*` matches any text
    taps:    include the hidden legs of intercepted wires
    Malformed messages, which every subscriber drops, are left out. Raises RunFolderError if nothing was recorded.
    """
    for recorded in read(path):
        if not recorded.malformed and (taps or not recorded.tap) and fnmatchcase(recorded.wire, pattern):
            yield _decoded(recorded)


def _decoded(recorded: Recorded) -> WireMessage:
    header, body = codec.decode_lazily(recorded.payload, recorded.type)
    of_wire = recorded.wire, recorded.tap, recorded.message, recorded.publisher
    return WireMessage(*of_wire, header.frame, header.time_ns * 1e-9, header.seq, body)


def table_of(path: Path, wire: str, rows: Callable[[Body], Columns]) -> pyarrow.Table:
    """As `tables_of`, of one wire."""
    return tables_of(path, [wire], rows)[wire]


def tables_of(path: Path, wires: Iterable[str], rows: Callable[[Body], Columns]) -> dict[str, pyarrow.Table]:
    """By wire, a table of the rows that `rows` makes of the columns of each message on it.

    The columns `frame` and `time_s` come first. Copies of a message that a link duplicated are left out.
    The recording is read once. Raises RunFolderError if there is none.
    """
    parts: dict[str, list[tuple[int, float, Columns]]] = {wire: [] for wire in wires}
    last: dict[tuple[str, str], int] = {}
    for recorded in read(path, lambda channel: channel.get("wire") in parts):
        if recorded.malformed or recorded.tap:
            continue
        message, sender = _decoded(recorded), (recorded.wire, recorded.publisher)
        if message.seq > last.get(sender, -1):
            last[sender] = message.seq
            parts[message.wire].append((message.frame, message.time_s, rows(message.body)))
    return {wire: table(of_wire) for wire, of_wire in parts.items()}


def table(frames: Iterable[tuple[int, float, Columns]]) -> pyarrow.Table:
    """Join the columns of frames, after the columns `frame` and `time_s`.

    frames: frame number, s since the scene began, columns
    """
    parts: list[Columns] = []
    for frame, time_s, columns in frames:
        count = len(next(iter(columns.values())))
        parts.append({"frame": np.full(count, frame), "time_s": np.full(count, time_s)} | columns)
    names = list(parts[0]) if parts else ["frame", "time_s"]
    arrays = {name: np.concatenate([part[name] for part in parts]) if parts else np.zeros(0) for name in names}
    fields = []
    for name, array in arrays.items():
        kind = pyarrow.string() if array.dtype == object else pyarrow.from_numpy_dtype(array.dtype)
        fields.append(pyarrow.field(name, kind, metadata={"unit": UNITS[name]} if name in UNITS else None))
    return pyarrow.table([pyarrow.array(array) for array in arrays.values()], schema=pyarrow.schema(fields))


def states(columns: Body) -> Columns:
    """The objects of `tracks` or of a `picture` in the world frame."""
    objects = ObjectStates.from_columns(columns)
    if "origin" in columns:
        objects = states_to_world(objects, columns["origin"], columns["rotation"])
    support = {"support": columns["support"]} if "support" in columns else {}
    return _boxes(objects.columns()) | {"score": objects.score} | support


def truth(columns: Body) -> Columns:
    """The objects of the scene; points: the most lidar returns at any agent."""
    points = columns["points"]
    max_points = points.max(axis=1) if points.shape[1] else np.zeros(len(points), np.int32)
    return _boxes(columns) | {"points": max_points}


def detections(columns: Body) -> Columns:
    """The detections of a sensor, in its own frame."""
    return _boxes(columns) | {"score": columns["score"]}


def pose(columns: Body) -> Columns:
    """The pose that an agent reports, with the quaternion from agent to world frame."""
    values = np.concatenate([columns["position"], columns["rotation"], columns["velocity"]])[None]
    return dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz"), values.T, strict=True))


def _boxes(columns: Body) -> Columns:
    """Columns of boxes, with vectors split by axis and the class as text."""
    classes = np.array(CLASSES, dtype=object)[columns["class_id"]]
    result: Columns = {"id": columns["id"]} if "id" in columns else {}
    result["class"] = classes
    for name, axes in (("position", "x y z"), ("velocity", "vx vy vz"), ("size", "l w h")):
        if name in columns:
            result |= {axis: columns[name][:, index] for index, axis in enumerate(axes.split())}
    return result | {"yaw": columns["yaw"]}
