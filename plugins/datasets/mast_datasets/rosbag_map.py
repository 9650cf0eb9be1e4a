"""The map of a ROS 2 bag's topics to the agents and the truth of a scene: read and checked."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta

from mast_datasets.files import Coordinate, Element, Point, Size
from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.agents import SceneSensor
from mast_zenoh.scenes.detection_tables import read_text
from mast_zenoh.scenes.making.sensor_types import Lidar, ObjectCamera, Radar, Sensor
from mast_zenoh.sensing import LidarSensor

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_MAX_ENTRIES = 1000  # agents, and objects
_MAX_TEXT = 1000
_MAX_CHAIN = 20  # frames
_KINDS: Mapping[str, type[Sensor]] = {"lidar": Lidar, "camera": ObjectCamera, "radar": Radar}
_AXES = {"x": 0, "y": 1, "z": 2}
_Angle = Annotated[float, Meta(ge=-180, le=180)]  # degrees
_Id = str | Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]


class Pose(NamedTuple):
    """A pose in a frame of reference: position (3,) m, rotation (3, 3) active."""

    position: Floats
    rotation: Floats


@dataclass(frozen=True)
class Source:
    """Messages of a topic.

    place:     of the entry in the map, for messages
    chain:     of a topic with transforms: names of frames, from the child of a fixed frame down to that whose pose is
               wanted; empty: the pose of the message
    origin:    where the frame of the messages is in the world; None: as `frames` says
    offset_ns: ns, added to their times;  received: whether those are times of recording, rather than of headers
    """

    place: str
    topic: str
    chain: tuple[str, ...]
    origin: Pose | None
    offset_ns: int
    received: bool


@dataclass(frozen=True, eq=False)
class Body:
    """The box of an object whose pose is known.

    size: (3,) m, length, width, height; centre: (3,) m, its middle, in the frame of the pose
    """

    size: Floats
    class_id: int
    centre: Floats


@dataclass(frozen=True, eq=False)
class DetectionsEntry:
    """A sensor of an agent, and the topic of its detections.

    source:    None: the scene's detector generates its detections
    frame:     name of the frame of the detections, the sensor's or one of `frames`
    nearest_m: nearer detections are left out, m
    axes:      (3, 3) of -1, 0 and 1, to x forward, y left, z up from the axes of the messages; None: they have these
    size:      (3,) m, instead of that in the messages; None: theirs
    classes:   our classes by the names of the messages
    paths:     of values in messages of a type that is not known, by what they are; empty: of a type that is
    """

    source: Source | None
    frame: str
    sensor: SceneSensor
    nearest_m: float
    axes: Floats | None
    size: Floats | None
    classes: Mapping[str, str]
    paths: Mapping[str, tuple[str | int, ...]]


@dataclass(frozen=True, eq=False)
class AgentEntry:
    """An agent. pose: of an agent that never moves, or the source of its poses; body: None: it is no object"""

    name: str
    pose: Pose | Source
    body: Body | None
    sensors: tuple[DetectionsEntry, ...]

    @property
    def fixed(self) -> bool:
        """Whether it never moves."""
        return isinstance(self.pose, Pose)


@dataclass(frozen=True, eq=False)
class TruthEntry:
    """An object of the truth, or a topic with lists of objects (body None), without those of some ids.

    without: ids as the messages have them: text, a UUID in hexadecimal digits, or one of our whole numbers
    """

    name: str
    source: Source
    body: Body | None
    without: frozenset[str]


@dataclass(frozen=True, eq=False)
class BagMap:
    """A map. period_ns: of the frames; max_gap_ns: the longest time between two poses that is bridged

    bag:    path of its bag, from the folder of the map; "": it is given otherwise
    frames: pose in the world of each fixed frame; types: definition of message types, by name
    """

    place: str
    bag: str
    period_ns: int
    max_gap_ns: int
    frames: Mapping[str, Pose]
    types: Mapping[str, str]
    agents: tuple[AgentEntry, ...]
    truth: tuple[TruthEntry, ...]

    def topics(self) -> frozenset[str]:
        """All topics that it names."""
        return frozenset(source.topic for source in self.sources())

    def sources(self) -> list[Source]:
        """All sources, in order."""
        found = [agent.pose for agent in self.agents if isinstance(agent.pose, Source)]
        found += [each.source for agent in self.agents for each in agent.sensors if each.source is not None]
        return found + [entry.source for entry in self.truth]


def read_map(path: Path) -> BagMap:
    """The map in a TOML file. Raises ConfigurationError, with the file and the place in it."""
    try:
        return parse_map(tomllib.loads(read_text(path)), path)
    except (ValueError, RecursionError, SceneError) as error:
        raise ConfigurationError(
            f"{path}: not TOML: {error}" if isinstance(error, ValueError) else str(error)
        ) from None


def parse_map(content: Mapping[str, Any], path: Path) -> BagMap:
    """A map as nested dicts. path: where it is from, for messages

    Raises ConfigurationError for an entry that is missing, unknown or cannot be.
    """
    try:
        return _parsed(Element(dict(content), path))
    except SceneError as error:
        raise ConfigurationError(str(error)) from None


def _parsed(whole: Element) -> BagMap:
    _check_keys(whole, ("bag", "agents", "truth", "frames", "types", "rate_hz", "max_gap_s", "time"))
    times = _times(whole, False)
    frames = {name: _pose(each) for name, each in _entries(whole, "frames")}
    types = {name: each.text() for name, each in _entries(whole, "types")}
    agents = [_agent(name, each, times) for name, each in _entries(whole, "agents")]
    if not agents:
        whole.fail("at least one agent under `agents`, the ego first")
    truth = [_truth(name, each, times) for name, each in _entries(whole, "truth")]
    rate_hz = _number(whole, "rate_hz", 10.0, 0.01, 1000.0)
    max_gap_s = _number(whole, "max_gap_s", 0.5, 0.0, 3600.0)
    bag = whole.get("bag")
    return BagMap(
        place=str(whole.path),
        bag="" if bag is None else _short(bag),
        period_ns=round(1e9 / rate_hz),
        max_gap_ns=round(max_gap_s * 1e9),
        frames=frames,
        types=types,
        agents=tuple(agents),
        truth=tuple(truth),
    )


def _check_keys(table: Element, known: Collection[str]) -> None:
    for key, value in table.members():
        if key not in known:
            place = f"{table.path}: {value.place}"
            raise ConfigurationError(f"{place}: unknown, expected one of {', '.join(known)}{nearest(key, known)}")


def _entries(whole: Element, key: str) -> list[tuple[str, Element]]:
    table = whole.get(key)
    entries = [] if table is None else list(table.members())
    if table is not None and len(entries) > _MAX_ENTRIES:
        table.fail(f"at most {_MAX_ENTRIES} entries")
    return entries


def _agent(name: str, table: Element, received: bool) -> AgentEntry:
    if not _NAME.fullmatch(name):
        table.fail("a name of letters, digits and _, such as ego, mobile_1 or infra_1")
    _check_keys(table, ("pose", "body", "detections"))
    pose = table["pose"]
    fixed = "topic" not in pose.value if isinstance(pose.value, dict) else False
    body = table.get("body")
    if fixed and body is not None:
        body.fail("no body of an agent that never moves")
    listed = table["detections"]
    sensors = listed.elements() if isinstance(listed.value, list) else [listed]
    if not sensors:
        listed.fail("at least one sensor")
    entries = tuple(_detections(each, received) for each in sensors)
    names = [entry.sensor.name for entry in entries]
    if len(set(names)) < len(names):
        listed.fail(f"different names of sensors, found {', '.join(names)}: give each a name")
    return AgentEntry(
        name, _pose(pose) if fixed else _source(pose, received), None if body is None else _body(body, ()), entries
    )


def _truth(name: str, table: Element, received: bool) -> TruthEntry:
    if table.get("size") is None:
        _check_keys(table, (*_SOURCE, "without"))
        without = table.get("without")
        ids = frozenset() if without is None else frozenset(map(str, without.read(list[_Id])))
        return TruthEntry(name, _source(table, received, ("without",)), None, ids)
    return TruthEntry(name, _source(table, received, _BODY), _body(table, _SOURCE), frozenset())


_BODY = ("size", "class", "centre")
_SOURCE = ("topic", "child", "origin", "offset_s", "time")


def _body(table: Element, further: Collection[str]) -> Body:
    _check_keys(table, (*_BODY, *further))
    return Body(np.array(table["size"].read(Size)), CLASS_INDEX[table["class"].text(CLASSES)], _vector(table, "centre"))


def _source(table: Element, received: bool, further: Collection[str] = ()) -> Source:
    _check_keys(table, (*_SOURCE, *further))
    origin, child = table.get("origin"), table.get("child")
    return Source(
        f"{table.path}: {table.place}",
        _short(table["topic"]),
        () if child is None else _chain(child),
        None if origin is None else _pose(origin),
        round(_number(table, "offset_s", 0.0, -1e9, 1e9) * 1e9),
        _times(table, received),
    )


def _chain(child: Element) -> tuple[str, ...]:
    """The frames of a chain, that is written as a list, or as the name of the only one."""
    listed = child.elements() if isinstance(child.value, list) else [child]
    names = tuple(_short(each) for each in listed)
    if not 0 < len(set(names)) == len(names) <= _MAX_CHAIN:
        child.fail(f"1 to {_MAX_CHAIN} different frames")
    return names


def _times(table: Element, default: bool) -> bool:
    """Whether times are those of recording."""
    time = table.get("time")
    return default if time is None else time.text(("header", "received")) == "received"


def _short(element: Element) -> str:
    text = element.text()
    if not 0 < len(text) <= _MAX_TEXT:
        element.fail(f"a name of up to {_MAX_TEXT} characters")
    return text


def _number(table: Element, key: str, default: float, low: float, high: float) -> float:
    value = table.get(key)
    return default if value is None else float(value.read(Annotated[float, Meta(ge=low, le=high)]))


def _vector(table: Element, key: str) -> Floats:
    value = table.get(key)
    return np.zeros(3) if value is None else np.array(value.read(Point))


def _pose(table: Element) -> Pose:
    """A pose that is written as position, m, yaw_deg counter-clockwise, and pitch_deg down."""
    _check_keys(table, ("position", "yaw_deg", "pitch_deg"))
    yaw, pitch = (np.radians(_number(table, key, 0.0, -360.0, 360.0)) for key in ("yaw_deg", "pitch_deg"))
    return Pose(_vector(table, "position"), rotation_from_yaw_pitch(float(yaw), float(pitch)))


_SENSOR = ("name", "kind", "position", "yaw_deg", "pitch_deg", "azimuth_deg", "elevation_deg", "range_m")
_PROBABILITY = "detection_probability"
_READING = ("frame", "nearest_m", "axes", "size", "classes", "fields")
_FIELDS = ("list", "position", "orientation", "size", "score", "class")
_ORIGIN = LidarSensor(mount_position=np.zeros(3))


def _detections(table: Element, received: bool) -> DetectionsEntry:
    if table.get("topic") is None:
        _check_keys(table, (*_SENSOR, _PROBABILITY))
        return DetectionsEntry(None, "", _sensor(table), 0.0, None, None, {}, {})
    further = (*_SENSOR, _PROBABILITY, *_READING)
    source = _source(table, received, further)
    for key in ("child", "origin"):
        if (value := table.get(key)) is not None:
            value.fail(f"no {key} of detections: `frame` names their frame, and `frames` says where it is")
    axes, size, classes, fields = (table.get(key) for key in ("axes", "size", "classes", "fields"))
    named = {} if classes is None else {name: each.text(CLASSES) for name, each in classes.members()}
    paths: dict[str, tuple[str | int, ...]] = {}
    if fields is not None:
        _check_keys(fields, _FIELDS)
        paths = {name: _path(each) for name, each in fields.members()}
        for key in ("list", "position", *(() if size is not None else ("size",))):
            if key not in paths:
                fields.fail(f"a path of `{key}`" + (", or `size` beside `fields`" if key == "size" else ""))
    return DetectionsEntry(
        source,
        _short(table["frame"]),
        _sensor(table),
        _number(table, "nearest_m", 0.0, 0.0, 1e6),
        None if axes is None else _axes(axes),
        None if size is None else np.array(size.read(Size)),
        named,
        paths,
    )


def _path(element: Element) -> tuple[str | int, ...]:
    """The steps of a path such as results.0.score."""
    return tuple(int(step) if step.isdecimal() and len(step) < 7 else step for step in _short(element).split("."))


def _axes(element: Element) -> Floats:
    """A matrix from three axes, such as ["z", "-x", "-y"]: what is forward, left and up."""
    matrix = np.zeros((3, 3))
    for row, name in enumerate(element.read(tuple[str, str, str])):
        if name.removeprefix("-") not in _AXES:
            element.fail("three of x, y, z, -x, -y, -z")
        matrix[row, _AXES[name.removeprefix("-")]] = -1.0 if name.startswith("-") else 1.0
    if not np.abs(matrix).sum(axis=0).all():
        element.fail("three different axes")
    return matrix


def _sensor(table: Element) -> SceneSensor:
    """The sensor of an entry, at the agent's origin unless it says otherwise."""
    kind = table["kind"].text(tuple(_KINDS))
    name = table.get("name")
    if name is not None and not _NAME.fullmatch(name.text()):
        name.fail("a name of letters, digits and _")
    options: dict[str, Any] = {"name": None if name is None else name.text()}
    options["position"] = tuple(_vector(table, "position").tolist())
    options |= {key: _number(table, key, 0.0, -360.0, 360.0) for key in ("yaw_deg", "pitch_deg")}
    for key in ("azimuth_deg", "elevation_deg"):
        if (value := table.get(key)) is not None:
            options[key] = value.read(tuple[_Angle, _Angle])
    options |= {
        key: value.read(Coordinate) for key in ("range_m", _PROBABILITY) if (value := table.get(key)) is not None
    }
    sensor = _KINDS[kind](**options)
    try:
        return sensor.fitted(_ORIGIN)
    except ValueError as error:
        raise ConfigurationError(f"{table.path}: {table.place}: {error}") from None
