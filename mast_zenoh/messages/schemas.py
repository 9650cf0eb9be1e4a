"""Message types: a table per type, with column, dtype, shape and unit.

docs/ref-messages.md is generated from this module.

A message is a header and a body of columns. In a shape, letters are sizes that must agree within one message
(`n` rows are n objects, `a` rows are a agents); numbers are fixed. Users' nodes can declare more types (`user_types`).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASSES

__all__ = ["BUILT_IN", "SCHEMAS", "Body", "Column", "Header", "Message", "Schema", "same_columns", "text"]

#: The dtypes that a column can have. `str` is text.
DTYPES = ("float64", "float32", "int64", "int32", "uint8", "str")
MAX_COLUMNS = 60  #: effects on rows keep a bit for each column
MAX_SIZE = 200_000  #: the largest size of a shape, fixed or by letter
MAX_AXES = 8

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_INDICES = 256  # of uint8
_MOST_VALUES = 1 << 59  # of eight bytes


@dataclass(frozen=True, slots=True)
class Column:
    """One column, as used by senders, receivers and the documentation.

    name:  lower-case letters, digits and _
    dtype: float64, int64, int32, uint8, or str for text
    shape: sizes; equal letters are equal sizes in one message: ("n", 3) is a row of three numbers for each of n objects
    unit, meaning: for readers; "" where there is none
    below: for indices (uint8): exclusive upper limit
    least_length: for quaternions and matrices (float64): minimum square root of the sum of squares

    Raises ValueError for anything else.
    """

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    unit: str = ""
    meaning: str = ""
    below: int = 256
    least_length: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(self.shape))
        for text in (self.unit, self.meaning):
            if not isinstance(text, str):
                raise ValueError(f"column {self.name!r}: unit and meaning: found {text!r:.40}, expected a string")
        _check_column(self.name, self.dtype, self.shape, self.below, self.least_length)


@dataclass(frozen=True, slots=True)
class Schema:
    """One message type: name, version, meaning, columns.

    A node names it in its ports: `outputs = {"gusts": GUSTS}`. Raises ValueError for an invalid name, and for two
    columns with the same name.
    """

    name: str
    version: int
    meaning: str
    columns: tuple[Column, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        _check_schema(self.name, self.version, [column.name for column in self.columns])


def _check_column(name: object, dtype: object, shape: Sequence[object], below: object, least_length: object) -> None:
    """Check one column; see `schemas.Column`."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"column {name!r}: expected a name of lower-case letters, digits and _, at most 64")
    if dtype not in DTYPES:
        raise ValueError(f"column {name!r}: dtype: found {dtype!r}, expected one of {', '.join(DTYPES)}")
    if len(shape) > MAX_AXES:
        raise ValueError(f"column {name!r}: shape: found {len(shape)} sizes, expected at most {MAX_AXES}")
    if not shape:
        raise ValueError(f"column {name!r}: shape: found (), expected a size, such as (1,) or ('n',)")
    for size in shape:
        letter = isinstance(size, str) and size.isidentifier()
        if not letter and not (type(size) is int and 1 <= size <= MAX_SIZE):
            expected = f"1 to {MAX_SIZE}, or a letter such as 'n'"
            raise ValueError(f"column {name!r}: shape: found {size!r}, expected {expected}")
    # The largest array of a shape must be possible, or a forged message would raise an error of NumPy.
    largest = prod(size if isinstance(size, int) else MAX_SIZE for size in shape)
    if largest >= _MOST_VALUES:
        raise ValueError(f"column {name!r}: shape: found {tuple(shape)}, expected fewer or smaller sizes")
    if dtype == "str" and len(shape) != 1:
        raise ValueError(f"column {name!r}: shape: found {len(shape)} sizes, expected one for text")
    if type(below) is not int or not 1 <= below <= _INDICES or (below < _INDICES and dtype != "uint8"):
        raise ValueError(f"column {name!r}: below: found {below!r}, expected 1 to {_INDICES}, for uint8 only")
    if not isinstance(least_length, (int, float)) or not 0.0 <= least_length < float("inf"):
        raise ValueError(f"column {name!r}: least_length: found {least_length!r}, expected 0 or more")
    if least_length and dtype != "float64":
        raise ValueError(f"column {name!r}: least_length: found {least_length!r}, expected 0 for {dtype}")


def _check_schema(name: object, version: object, columns: Collection[str]) -> None:
    """Check a message type; columns: the names of its columns."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"message type {name!r}: expected a name of lower-case letters, digits and _, at most 64")
    if type(version) is not int or not 1 <= version < 1 << 31:
        raise ValueError(f"message type {name!r}: version: found {version!r}, expected a whole number from 1")
    if len(columns) > MAX_COLUMNS:
        raise ValueError(f"message type {name!r}: {len(columns)} columns, expected at most {MAX_COLUMNS}")
    twice = sorted({column for column in columns if list(columns).count(column) > 1})
    if twice:
        raise ValueError(f"message type {name!r}: column {twice[0]!r} occurs twice, expected different names")


#: A message body: column name to array. Columns of text are arrays of dtype object holding str.
Body = Mapping[str, NDArray[Any]]


class Header(NamedTuple):
    """The header of every message.

    schema:  name of the message type
    source:  name of the node that published it (an interposer leaves it unchanged)
    frame:   index of the scene's frame that the message is about
    time_ns: int, ns, time of that frame in the scene; of `detections`, when the sensor measured
    seq:     number of the message among those of one publisher on one wire, from 0
    """

    schema: str
    source: str
    frame: int
    time_ns: int
    seq: int


class Message(NamedTuple):
    """One message: header and columns. The arrays that a node receives are read-only."""

    header: Header
    body: Body


def same_columns(one: Body, other: Body) -> bool:
    """Whether two bodies of one message type are bit-identical."""
    return all(
        column.shape == other[name].shape and column.tobytes() == other[name].tobytes() for name, column in one.items()
    )


def _states(prefix: str = "", size: str = "n", *, filtered: bool = True) -> tuple[Column, ...]:
    """Columns of object states; filtered: with covariance and score."""
    columns = [
        Column("id", "int64", (size,), "", "identity, unique within one producer"),
        Column("position", "float64", (size, 3), "m", "centre of the box"),
        Column("velocity", "float64", (size, 3), "m/s", ""),
        Column("size", "float64", (size, 3), "m", "length, width, height"),
        Column("yaw", "float64", (size,), "rad", "heading of the length axis, counter-clockwise from x"),
        Column("covariance", "float64", (size, 9, 9), "m, m/s", "of [x y z l w h vx vy vz]"),
        Column("score", "float64", (size,), "", "evidence that the object exists, 0 to 1, for ranking"),
        Column("class_id", "uint8", (size,), "", "index into mast_zenoh.arrays.states.CLASSES", below=len(CLASSES)),
    ]
    return tuple(
        replace(column, name=prefix + column.name)
        for column in columns
        if filtered or column.name not in ("covariance", "score")
    )


_ROTATION: dict[str, Any] = {"least_length": 1e-3}  # receivers normalise it


def _view(*size: str) -> tuple[Column, ...]:
    """Columns of the field of view of one sensor, or of `size` sensors."""
    return (
        Column("position", "float64", (*size, 3), "m", "of the sensor, world frame"),
        Column("rotation", "float64", (*size, 4), "", "active quaternion w x y z, sensor to world", **_ROTATION),
        Column("azimuth", "float64", (*size, 2), "rad", "field of view (from, to), in the sensor frame"),
        Column("elevation", "float64", (*size, 2), "rad", "field of view (from, to), in the sensor frame"),
        Column("max_range", "float64", size or (1,), "m", "range of the sensor"),
    )


_FRAME_OF_REFERENCE = (
    Column("origin", "float64", (3,), "m", "of the columns' frame of reference, in the world frame"),
    Column("rotation", "float64", (4,), "", "active quaternion w x y z, frame of reference to world", **_ROTATION),
)

#: Columns of the built-in message types, by name, version and meaning.
_BUILT_IN: Mapping[tuple[str, int, str], tuple[Column, ...]] = {
    ("clock", 1, "a frame begins"): (),
    ("truth", 1, "all objects of the scene, world frame; for the evaluator only"): (
        *_states(filtered=False),
        Column("points", "int32", ("n", "a"), "", "lidar returns of the object at each agent"),
        Column("agents", "str", ("a",), "", "names of the agents"),
        Column("agent_position", "float64", ("a", 3), "m", "position of each agent"),
        Column("agent_object", "int64", ("a",), "", "id of the agent's own object; -1: none"),
    ),
    ("pose", 1, "an agent's own pose, as it reports it, world frame"): (
        Column("position", "float64", (3,), "m", ""),
        Column("rotation", "float64", (4,), "", "active quaternion w x y z, agent to world", **_ROTATION),
        Column("velocity", "float64", (3,), "m/s", ""),
    ),
    ("detections", 1, "what an agent's sensor detected at `time_ns`, sensor frame at that time"): (
        Column("position", "float64", ("n", 3), "m", "centre of the box"),
        Column("size", "float64", ("n", 3), "m", "length, width, height"),
        Column("yaw", "float64", ("n",), "rad", "heading about the world's vertical axis, minus the sensor's"),
        Column("score", "float64", ("n",), "", "confidence, 0 to 1"),
        Column("class_id", "uint8", ("n",), "", "index into mast_zenoh.arrays.states.CLASSES", below=len(CLASSES)),
        Column("covariance", "float64", ("n", 3, 3), "m²", "of the position; all zero: not given"),
        Column("mount_position", "float64", (3,), "m", "of the sensor at `time_ns`, in the agent's frame now"),
        Column("mount_rotation", "float64", (4,), "", "active quaternion w x y z, sensor to agent", **_ROTATION),
    ),
    ("points", 1, "the returns of one scan of an agent's lidar at `time_ns`, in the lidar's frame at that time"): (
        Column("position", "float32", ("n", 3), "m", "without the lidar's own motion during the scan"),
        Column("intensity", "float32", ("n",), "", "0 to 1, of a surface that reflects all light to the lidar"),
        Column("time_s", "float32", ("n",), "s", "of the firing, from `time_ns`; 0: not known"),
        Column("channel", "uint8", ("n",), "", "of the beam, from the lowest up"),
        Column("mount_position", "float64", (3,), "m", "of the lidar at `time_ns`, in the agent's frame now"),
        Column("mount_rotation", "float64", (4,), "", "active quaternion w x y z, lidar to agent", **_ROTATION),
        Column(
            "level_rotation",
            "float64",
            (4,),
            "",
            "active quaternion w x y z, lidar to axes with z up, and x where the lidar faces",
            **_ROTATION,
        ),
    ),
    ("route", 1, "what a car's map and the traffic lights tell its driver, world frame"): (
        Column("position", "float64", ("k", 2), "m", "points in the middle of its lane, from the car on"),
        Column("speed", "float64", ("k",), "m/s", "greatest speed at each point"),
        Column("stop", "float64", ("m",), "m", "from the car's front to where it must stop; no rows: nowhere"),
        Column("size", "float64", (2,), "m", "length and width of the car"),
    ),
    ("command", 1, "what a driver wants of its car until the next frame"): (
        Column("acceleration", "float64", (1,), "m/s²", "along the car; negative: it brakes"),
        Column("curvature", "float64", (1,), "1/m", "of the way of its middle, positive to the left"),
    ),
    ("tracks", 1, "an agent's confirmed tracks"): (*_states(), *_FRAME_OF_REFERENCE),
    ("relayed", 1, "objects of an agent's picture, for other agents, world frame"): (
        *_states(),
        Column("agents", "str", ("a",), "", "names of agents, sorted"),
        Column("origin", "uint8", ("n", "a"), "", "1: the agent's tracks are in the object", below=2),
    ),
    ("gossip", 1, "an agent's own trust in agents, for other agents"): (
        Column("agents", "str", ("a",), "", "names of the agents, sorted"),
        Column("trust", "float64", ("a",), "", "trust in each agent, 0 to 1"),
    ),
    (
        "reception",
        2,
        "what a station did not receive of what was sent in the frame before, and the load of the channel",
    ): (
        Column("lost", "str", ("m",), "", "the stations whose tracks were lost, sorted"),
        Column("lost_awareness", "str", ("k",), "", "the same of messages about themselves"),
        Column("busy_ratio", "float64", (1,), "", "channel busy ratio, 0 to 1"),
        Column("sent", "int64", (1,), "", "number of the station's own messages, 0 to 2"),
        Column("airtime_ns", "int64", (1,), "ns", "of the station's own messages; 0: it sent none"),
    ),
    ("status", 1, "an agent's type and counts"): (
        Column("mobile", "uint8", (1,), "", "1: mobile, 0: stationary"),
        Column("detections", "int64", (1,), "", "number of detections processed in this frame"),
        Column("tracks", "int64", (1,), "", "number of tracks sent in this frame"),
    ),
    ("collated", 1, "the tracks of all agents at one time, world frame"): (
        *_states(),
        Column("agent", "int64", ("n",), "", "row of `agents` that the track came from"),
        Column("agents", "str", ("a",), "", "names of the agents whose tracks are in the batch"),
        Column("age_ns", "int64", ("a",), "ns", "interval over which each agent's tracks were propagated"),
    ),
    ("picture", 1, "the common picture, or that of a region or of a peer: fused, labelled objects, world frame"): (
        *_states(),
        Column("support", "int64", ("n",), "", "agents whose tracks were fused in this frame"),
    ),
    ("attack_report", 1, "what an adversary changed, world frame; for the evaluator only"): (
        Column("action", "uint8", ("n",), "", "index into mast_zenoh.attacks.ACTIONS", below=5),
        Column("target", "int64", ("n",), "", "number of the target, assigned by the adversary; -1: a pose, a view"),
        Column("before_position", "float64", ("n", 3), "m", "zero where an object was inserted"),
        Column("after_position", "float64", ("n", 3), "m", "zero where an object was removed"),
        Column("velocity", "float64", ("n", 3), "m/s", "of the object afterwards, or before its removal"),
    ),
    ("link_report", 1, "what a link did to messages in the previous step; for the evaluator only"): (
        Column("port", "uint8", ("n",), "", "index into mast_zenoh.links.WIRES; 9: another type", below=10),
        Column("frame", "int64", ("n",), "", "frame of the message"),
        Column("seq", "int64", ("n",), "", "sequence number of the message"),
        Column("fate", "uint8", ("n",), "", "index into mast_zenoh.links.FATES", below=6),
        Column("rule", "int64", ("n",), "", "index of the responsible rule, among those of its wire"),
        Column("delay_s", "float64", ("n",), "s", "by which it is late; 0 where it was dropped"),
    ),
    ("observation", 3, "what an adversary sees on its wire, for its coordinator, world frame"): (
        *_states(),
        Column("agent_position", "float64", (3,), "m", "of the compromised agent"),
        Column("agent_rotation", "float64", (4,), "", "active quaternion w x y z, agent to world", **_ROTATION),
        Column("agent_velocity", "float64", (3,), "m/s", "of the agent"),
        Column("sensor_position", "float64", (3,), "m", "of its sensor"),
        Column("sensor_rotation", "float64", (3, 3), "", "active, sensor to world", **_ROTATION),
        Column("azimuth", "float64", (2,), "rad", "its sensor's field of view (from, to), in the sensor frame"),
        Column("elevation", "float64", (2,), "rad", "its sensor's field of view (from, to), in the sensor frame"),
        Column("max_range", "float64", (1,), "m", "range of its sensor"),
    ),
    ("sweep", 1, "free distance in each direction from an agent's sensor"): (
        Column("free", "float64", ("m", "k"), "m", "by elevation band and azimuth sector; no rows: unknown"),
    ),
    ("view", 1, "what an agent's sensor covers"): (
        *_view(),
        Column("free", "float64", ("m", "k"), "m", "free distance in each direction; no rows: unknown"),
    ),
    ("views", 1, "what the sensors of all agents cover"): (
        Column("agents", "str", ("a",), "", "names of the agents, sorted"),
        Column("age_ns", "int64", ("a",), "ns", "of each agent's view"),
        *_view("a"),
        Column("grid", "int64", ("a", 2), "", "numbers of bands and sectors; 0, 0: unknown"),
        Column("free", "float64", ("k",), "m", "free distance in each direction: band by band, agent by agent"),
    ),
    ("trust", 1, "a command centre's or a peer's assessment of agents and objects"): (
        Column("agents", "str", ("a",), "", "names of the agents, sorted"),
        Column("mean", "float64", ("a",), "", "trust in each agent, 0 to 1"),
        Column("log_odds", "float64", ("a",), "", "log-odds that it is honest, on the stage's own scale"),
        Column("state", "uint8", ("a",), "", "index into mast_zenoh.integrity.STATES", below=5),
        Column("reason", "str", ("a",), "", "of its state; empty if there is none"),
        Column("fault_offset", "float64", ("a", 2), "m", "estimated error of its tracks' position, x and y"),
        Column("fault_turn", "float64", ("a",), "rad", "estimated error of its heading"),
        Column("fault_delay", "float64", ("a",), "s", "by which its tracks are late"),
        Column("fault_loss", "float64", ("a",), "", "share of the frames in which nothing arrived from it"),
        Column("id", "int64", ("n",), "", "of each object that the centre tracks, withheld ones too"),
        Column("position", "float64", ("n", 3), "m", ""),
        Column("size", "float64", ("n", 3), "m", "length, width, height"),
        Column("yaw", "float64", ("n",), "rad", ""),
        Column("trust", "float64", ("n",), "", "trust in the object, 0 to 1"),
        Column("expected", "int64", ("n",), "", "agents that the stage expects to see it"),
        Column("confirming", "int64", ("n",), "", "agents that report it"),
        Column("contradicting", "int64", ("n",), "", "agents that contradict it, as the stage defines it"),
        Column("withheld", "uint8", ("n",), "", "1: not in the picture", below=2),
    ),
    ("directive", 1, "what a coordinator wants its adversaries to do, world frame"): (
        *_states("add_", "n", filtered=False),
        *_states("remove_", "m", filtered=False),
        *_states("move_", "k", filtered=False),
        Column("move_offset", "float64", ("k", 3), "m", "displacement of each object"),
    ),
}

#: The built-in message types by name.
BUILT_IN: Mapping[str, Schema] = {of[0]: Schema(*of, columns) for of, columns in _BUILT_IN.items()}

#: All schemas that the codec knows: built-in ones, and the types that the scenario's nodes declare (`user_types.use`).
SCHEMAS: dict[str, Schema] = dict(BUILT_IN)


def text(values: list[str]) -> NDArray[Any]:
    """A column of text."""
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
