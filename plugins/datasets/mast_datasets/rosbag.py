"""ROS 2 bags as scenes: poses, truth and detections of the topics that a map names; the map is checked here."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct, field

from mast_datasets.files import Coordinate, Element, Point, Size
from mast_datasets.traffic import ABOVE_0, DataSetScene
from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.agents import SceneSensor
from mast_zenoh.scenes.making.sensor_types import Lidar, ObjectCamera, Radar, Sensor
from mast_zenoh.scenes.own_detections import read_text
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import LidarSensor

_MAX_ENTRIES = 1000  # agents, and objects
_KINDS: Mapping[str, type[Sensor]] = {"lidar": Lidar, "camera": ObjectCamera, "radar": Radar}
_ORIGIN = LidarSensor(mount_position=np.zeros(3))
_Name = Annotated[str, Meta(pattern="^[A-Za-z][A-Za-z0-9_]{0,63}$")]
_Angle = Annotated[float, Meta(ge=-180, le=180)]  # degrees
_Turn = Annotated[float, Meta(ge=-360, le=360)]  # degrees
_Text = Annotated[str, Meta(min_length=1, max_length=1000)]
_Time = Literal["header", "received"]
_Class = Literal["unknown", "car", "truck", "bus", "motorcycle", "bicycle", "pedestrian"]
_Axis = Literal["x", "y", "z", "-x", "-y", "-z"]


class _MapEntry(Struct, forbid_unknown_fields=True, eq=False, dict=True):
    """An entry of a map."""


class FramePose(_MapEntry):
    """A pose in a frame of reference: m, and degrees counter-clockwise and down."""

    position: Point = (0.0, 0.0, 0.0)
    yaw_deg: _Turn = 0.0
    pitch_deg: _Turn = 0.0

    @cached_property
    def origin(self) -> Floats:
        """(3,) m."""
        return np.array(self.position)

    @cached_property
    def rotation(self) -> Floats:
        """(3, 3) active."""
        return rotation_from_yaw_pitch(float(np.radians(self.yaw_deg)), float(np.radians(self.pitch_deg)))


class TopicSource(_MapEntry):
    """Messages of a topic.

    child:    of a topic with transforms: names of frames, from the child of a fixed frame down to that whose pose is
              wanted; without one the pose of the message
    origin:   where the frame of the messages is in the world; None: as `frames` says
    offset_s: s, added to their times;  time: which these are; None: as the map says
    """

    topic: Annotated[str, Meta(max_length=1000)] = ""
    child: _Text | Annotated[list[_Text], Meta(max_length=20)] = []
    origin: FramePose | None = None
    offset_s: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
    time: _Time | None = None

    def __post_init__(self) -> None:
        if len(set(self.chain)) != len(self.chain):
            raise ValueError("child: expected different frames")

    @property
    def chain(self) -> list[str]:
        """The frames of `child`."""
        return [self.child] if isinstance(self.child, str) else self.child


class PoseEntry(TopicSource):
    """The poses of an agent: a source, or without a topic the pose of one that never moves."""

    position: Point = (0.0, 0.0, 0.0)
    yaw_deg: _Turn = 0.0
    pitch_deg: _Turn = 0.0


class Body(_MapEntry):
    """The box of an object whose pose is known: size m, class, and its middle m in the frame of the pose."""

    size: Size
    kind: _Class = field(name="class")
    centre: Point = (0.0, 0.0, 0.0)


class TruthEntry(TopicSource):
    """An object of the truth, with the parts of its `Body`, or a topic with lists of objects, without some ids.

    without: ids as the messages have them: text, a UUID in hexadecimal digits, or one of our whole numbers
    """

    size: Size | None = None
    kind: _Class | None = field(name="class", default=None)
    centre: Point = (0.0, 0.0, 0.0)
    without: list[str | Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]] = []

    @property
    def body(self) -> Body | None:
        """None for a list of objects."""
        return None if self.size is None else Body(size=self.size, kind=self.kind or "unknown", centre=self.centre)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.topic or (self.size is None) != (self.kind is None):
            raise ValueError("expected a topic; an object with a pose needs `size` and `class`, a list neither")


class Paths(_MapEntry):
    """Paths of values in messages of a type that is not known: of the list, and of others in its elements."""

    list: _Text
    position: _Text
    orientation: _Text | None = None
    size: _Text | None = None
    score: _Text | None = None
    kind: _Text | None = field(name="class", default=None)

    @cached_property
    def steps(self) -> dict[str, tuple[str | int, ...]]:
        """The steps of each path, such as results.0.score."""
        given = {name: getattr(self, name) for name in self.__struct_fields__ if getattr(self, name) is not None}
        return {
            name: tuple(int(step) if re.fullmatch("[0-9]{1,6}", step) else step for step in path.split("."))
            for name, path in given.items()
        }


class PointsEntry(TopicSource, kw_only=True):
    """The points of a lidar, in its frame.

    frame: of the messages;  most_intensity: in the messages, of a surface that reflects all light to the lidar
    """

    frame: _Text
    most_intensity: Annotated[float, Meta(gt=0, le=1e9)] = 255.0

    def __post_init__(self) -> None:
        if not self.topic or self.child or self.origin is not None:
            raise ValueError("points: expected a topic, no child and no origin: they are in the frame of the lidar")


class DetectionsEntry(PoseEntry, kw_only=True):
    """A sensor of an agent, its mount, and the topic of its detections; without one, the detector makes them.

    frame:     name of the frame of the detections, the sensor's or one of `frames`
    nearest_m: nearer detections are left out, m
    axes:      what is x forward, y left and z up in the messages
    size:      m, instead of that in the messages
    classes:   our classes by the names of the messages
    points:    of a lidar, the topic with its points
    """

    frame: Annotated[str, Meta(max_length=1000)] = ""
    kind: Literal["lidar", "camera", "radar"]
    name: _Name | None = None
    azimuth_deg: tuple[_Angle, _Angle] | None = None
    elevation_deg: tuple[_Angle, _Angle] | None = None
    range_m: Coordinate | None = None
    detection_probability: Coordinate | None = None
    nearest_m: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    axes: tuple[_Axis, _Axis, _Axis] | None = None
    size: Size | None = None
    classes: dict[str, _Class] = {}
    fields: Paths | None = None
    points: PointsEntry | None = None

    @cached_property
    def sensor(self) -> SceneSensor:
        """The sensor. Raises ValueError if it cannot be."""
        names = ("name", "position", "yaw_deg", "pitch_deg", "azimuth_deg", "elevation_deg", "range_m")
        options = {name: getattr(self, name) for name in (*names, "detection_probability")}
        return _KINDS[self.kind](**options).fitted(_ORIGIN)

    @cached_property
    def matrix(self) -> Floats | None:
        """(3, 3) of -1, 0 and 1, to our axes from those of the messages; None: they have these."""
        signs = ((axis[-1], -1.0 if axis[0] == "-" else 1.0) for axis in self.axes or ())
        return np.array([[sign * (name == axis) for name in "xyz"] for axis, sign in signs]) if self.axes else None

    def __post_init__(self) -> None:
        _ = self.sensor
        if self.topic and not self.frame:
            raise ValueError("frame is missing, expected that of the messages")
        if self.child or self.origin is not None:
            raise ValueError("no child and no origin of detections: `frame` is theirs, `frames` says where it is")
        if self.matrix is not None and not self.matrix.any(axis=0).all():
            raise ValueError("axes: expected three different axes")
        if self.fields is not None and self.fields.size is None and self.size is None:
            raise ValueError("fields: expected a path of `size`, or `size` beside `fields`")


class AgentEntry(_MapEntry, kw_only=True):
    """An agent. body: None: it is no object"""

    pose: PoseEntry
    body: Body | None = None
    detections: DetectionsEntry | list[DetectionsEntry]

    @property
    def sensors(self) -> list[DetectionsEntry]:
        """Its sensors, with the topics of their detections."""
        return self.detections if isinstance(self.detections, list) else [self.detections]

    @property
    def fixed(self) -> bool:
        """Whether it never moves."""
        return not self.pose.topic

    def __post_init__(self) -> None:
        names = [entry.sensor.name for entry in self.sensors]
        if not 0 < len(set(names)) == len(names):
            raise ValueError(f"detections: expected different names of sensors, found {', '.join(names) or 'none'}")
        for row, entry in enumerate(self.sensors):
            if entry.points is not None and (row or entry.kind != "lidar" or entry.topic):
                raise ValueError("points: expected them of the first sensor, a lidar without a topic of detections")
        if self.fixed and self.body is not None:
            raise ValueError("expected no body of an agent that never moves")


class BagMap(_MapEntry, kw_only=True):
    """A map. bag: path of its bag, from the folder of the map; types: definition of message types, by name"""

    bag: Annotated[str, Meta(max_length=1000)] = ""
    rate_hz: Annotated[float, Meta(ge=0.01, le=1000)] = 10.0
    max_gap_s: Annotated[float, Meta(ge=0, le=3600)] = 0.5
    time: _Time = "header"
    types: dict[str, str] = {}
    frames: Annotated[dict[str, Any], Meta(max_length=_MAX_ENTRIES)] = {}
    agents: Annotated[dict[_Name, Any], Meta(min_length=1, max_length=_MAX_ENTRIES)]
    truth: Annotated[dict[str, Any], Meta(max_length=_MAX_ENTRIES)] = {}

    @property
    def period_ns(self) -> int:
        """ns, between two frames."""
        return round(1e9 / self.rate_hz)

    @property
    def max_gap_ns(self) -> int:
        """ns, the longest time between two poses that is bridged."""
        return round(self.max_gap_s * 1e9)

    def sources(self) -> dict[TopicSource, str]:
        """All sources of the agents and of the truth, and their places in the map."""
        found: dict[TopicSource, str] = {}
        for name, agent in self.agents.items():
            found[agent.pose] = f"agents.{name}.pose"
            found |= dict.fromkeys(agent.sensors, f"agents.{name}.detections")
            scans = [sensor.points for sensor in agent.sensors if sensor.points is not None]
            found |= dict.fromkeys(scans, f"agents.{name}.detections.points")
        found |= {entry: f"truth.{name}" for name, entry in self.truth.items()}
        return {source: place for source, place in found.items() if source.topic}


def read_map(path: Path) -> BagMap:
    """The map in a TOML file. Raises ConfigurationError, with the file and the place in it."""
    try:
        return parse_map(tomllib.loads(read_text(path)), path)
    except (ValueError, RecursionError, SceneError) as error:
        reason = f"{path}: not TOML: {error}" if isinstance(error, ValueError) else str(error)
        raise ConfigurationError(reason) from None


def parse_map(content: Mapping[str, Any], path: Path) -> BagMap:
    """A map as nested dicts. path: where it is from, for messages

    Raises ConfigurationError for an entry that is missing, unknown or cannot be.
    """
    try:
        whole: BagMap = Element(dict(content), path).read(BagMap)
        for key, kind in (("frames", FramePose), ("agents", AgentEntry), ("truth", TruthEntry)):
            for name, entry in getattr(whole, key).items():
                getattr(whole, key)[name] = Element(entry, path, f"$.{key}.{name}").read(kind)
    except SceneError as error:
        raise ConfigurationError(str(error)) from None
    return whole


#: What files of the two storages end with.
SUFFIXES = (".db3", ".mcap")


@dataclass(kw_only=True, eq=False)
class RosBag(DataSetScene):
    """A ROS 2 bag, in the storage SQLite3 or MCAP, with a map of its topics; see docs/how-to-data-sets.md#ros-2-bags.

    path:             a folder with metadata.yaml, a file, or a map that names its bag
    topics:           the map, or the TOML file that holds it; None: topics.toml in the folder, or the TOML file beside
                      the bag's file that has its name
    start_s:          s from the first time at which all agents have a pose to the first frame
    duration_s:       s from the first frame to the last; None: as long as all agents have a pose
    n_infrastructure: agents that never move to use, besides the first agent, the first ones; None: all
    n_mobile:         other agents to use, besides the first agent, the first ones; None: all
    detector:         the model that generates the detections of sensors for which the map has no topic
    max_unpacked_mb:  limit on the files unpacked from a bag that is compressed file by file, 10^6 bytes
    """

    short_name = "rosbag"
    files = tuple(("metadata.yaml", f"*{suffix}") for suffix in (*SUFFIXES, ".zstd"))

    topics: str | dict[str, Any] | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    max_unpacked_mb: float = 4000.0

    def __post_init__(self) -> None:
        self.check(start_s=(0.0, math.inf), duration_s=ABOVE_0, max_unpacked_mb=ABOVE_0)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or (path.is_file() and path.suffix in SUFFIXES)

    def inputs(self) -> Sequence[Path]:
        """The bag, and the file of the map."""
        bag, file = self._files()
        return (bag,) if file is None else (bag, file)

    def record(self, seed: int, frames: int | None) -> Recording:
        try:
            from mast_datasets import rosbag_reading, rosbag_recording, rosbag_storage
        except ModuleNotFoundError as error:
            if (missing := (error.name or "").partition(".")[0]) not in ("mast_ros2", "rosbags", "apsw", "lz4"):
                raise
            raise ConfigurationError(
                f"{self.path}: {missing} is not installed, expected pip install 'mast-zenoh[ros2]'"
            ) from None
        path, file = self._files()
        with rosbag_storage.open_bag(path, self.max_unpacked_mb) as bag:
            place = file or Path(f"{type(self).__name__}.topics")
            if file is None and not isinstance(self.topics, Mapping):
                raise ConfigurationError(
                    f"{self.path}: found no map of its topics, expected {self._usual_map}, or `topics` "
                    f"(docs/how-to-data-sets.md#ros-2-bags); the bag has {bag.listed_topics()}"
                )
            bag_map = parse_map(self.topics, place) if isinstance(self.topics, Mapping) else read_map(place)
            readers = rosbag_reading.read_topics(bag, bag_map, place)
        scene = rosbag_recording.BagScene(self, path, bag_map, readers)
        recording = scene.recording(seed, frames)
        if not scene.has_points:
            return recording
        with rosbag_storage.open_bag(path, self.max_unpacked_mb) as bag:  # again, now that its frames are known
            return scene.with_points(recording, bag)

    def _files(self) -> tuple[Path, Path | None]:
        """The bag, and the file with the map; None: the map is given, or there is none."""
        if self.root.suffix == ".toml":
            if self.topics is not None:
                raise ConfigurationError(f"{self.path}: topics are given, expected None: the path is that of a map")
            bag = read_map(self.root).bag
            if not bag:
                raise ConfigurationError(f"{self.path}: bag is missing, expected the path of the bag of this map")
            return self.root.parent / bag, self.root
        if isinstance(self.topics, str):
            return self.root, Path(self.topics)
        return self.root, self._usual_map if self.topics is None and self._usual_map.is_file() else None

    @property
    def _usual_map(self) -> Path:
        return self.root / "topics.toml" if self.root.is_dir() else self.root.with_suffix(".toml")
