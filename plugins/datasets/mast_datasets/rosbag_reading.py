"""Reads the mapped topics of a ROS 2 bag: poses over time, detections of sensors, and lists of true objects."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from array import array
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from mast_ros2 import type_store
from mast_ros2.object_ids import id_of_text, id_of_uuid
from mast_ros2.received_objects import ReceivedObjects, received_detections, received_tracks
from mast_ros2.received_poses import POSES, stamped_poses
from numpy.typing import NDArray
from rosbags.typesys.base import normalize_fieldname

from mast_datasets.rosbag_map import BagMap, DetectionsEntry, Pose, Source, TruthEntry
from mast_datasets.rosbag_storage import Bag, Topic
from mast_datasets.rosbag_types import Decode, OwnType, known_decoder, parse_definition
from mast_datasets.traffic import MAX_BOXES
from mast_zenoh.arrays.geometry import heading, quaternion_from_rotation, rotation_from_quaternion, rotation_from_yaw
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

#: Limit on the messages of all mapped topics.
MAX_MESSAGES = 5_000_000
_MAX_REMARKS = 20  # that are told apart, of one topic
_MAX_DETECTED = 1000
_MAX_OBJECTS = 20_000  # of a topic with lists, by their ids
_MAX_NS = 2**61
_DETECTION = 18  # numbers of a detection
_UUID = re.compile("-?".join(f"[0-9a-fA-F]{{{count}}}" for count in (8, 4, 4, 4, 12)))
_TYPES_OF_DETECTIONS = (type_store.DETECTIONS, type_store.DETECTED_OBJECTS)
_TYPES_OF_TRUTH = (type_store.TRACKED_OBJECTS, type_store.DETECTIONS)


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses over time: times_ns (K,) ascending, position (K, 3) m and quaternion (K, 4) w x y z, world frame."""

    times_ns: Ints
    position: Floats
    quaternion: Floats

    def at(self, times_ns: Ints, max_gap_ns: int) -> tuple[Floats, Floats, Bools]:
        """Position (n, 3), rotation (n, 3, 3) at times (n,), and whether they are known (n,).

        Between two poses, positions are linear and rotations spherically linear. Nothing is known before the first,
        after the last, and between two that are further apart than `max_gap_ns`.
        """
        before = np.clip(np.searchsorted(self.times_ns, times_ns, side="right") - 1, 0, len(self.times_ns) - 1)
        after = np.minimum(before + 1, len(self.times_ns) - 1)
        since, span = times_ns - self.times_ns[before], self.times_ns[after] - self.times_ns[before]
        known = (since == 0) | ((since > 0) & (since <= span) & (span <= max_gap_ns))
        share = np.where(known & (since > 0), since / np.maximum(span, 1), 0.0)[:, None]
        position = (1.0 - share) * self.position[before] + share * self.position[after]
        rotation = rotation_from_quaternion(_slerp(self.quaternion[before], self.quaternion[after], share))
        return position, rotation, np.asarray(known)


def _slerp(first: Floats, second: Floats, share: Floats) -> Floats:
    """Quaternions (n, 4) at shares (n, 1) of the way between two, the short way."""
    cosine = np.sum(first * second, axis=1, keepdims=True)
    second = np.where(cosine < 0.0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    near = angle < 1e-4  # there, both ways are the same, and the sine is 0
    sine = np.where(near, 1.0, np.sin(angle))
    weights = [np.where(near, part, np.sin(part * angle) / sine) for part in (1.0 - share, share)]
    return np.asarray(weights[0] * first + weights[1] * second)


class TopicReader(ABC):
    """Collects what one entry of the map wants of the messages of its topic.

    count: messages;  remarks: what was left out or changed, in words, and how often
    changes: whether it changes the messages that it reads
    """

    changes = False

    def __init__(self, source: Source, frames: Mapping[str, Pose]) -> None:
        self.source = source
        self.count = 0
        self.remarks: Counter[str] = Counter()
        self._frames = frames
        self._frame_id = ""

    @abstractmethod
    def decoder(self, place: str, topic: Topic, types: Mapping[str, Any]) -> Decode:
        """How the messages of the topic are decoded. place: of the bag; types: those that the map defines

        Raises ConfigurationError for a type that is of no use here.
        """

    def add(self, message: Any, received_ns: int) -> None:
        """Read a message. Raises ConfigurationError if it is in a frame that the map does not name."""
        self.count += 1
        try:
            self._read(message, received_ns)
        except MessageError as error:
            self._leave_out(str(error))

    @property
    @abstractmethod
    def used(self) -> int:
        """How many poses, detections messages or objects have been read."""

    @abstractmethod
    def _read(self, message: Any, received_ns: int) -> None:
        """Read a message. Raises MessageError if it cannot be used."""

    def _leave_out(self, reason: str, number: int = 1) -> None:
        self._remark(f"left out: {reason:.160}", number)

    def _remark(self, remark: str, number: int) -> None:
        known = remark in self.remarks or len(self.remarks) < _MAX_REMARKS
        self.remarks[remark if known else "left out for other reasons"] += number

    def _count_unclassified(self, number: int) -> None:
        if number:
            self._remark("a class that none of ours is, now unknown", number)

    def _time(self, header_ns: int, received_ns: int) -> int:
        """The time, ns, that counts. Raises MessageError for one whose differences from others overflow."""
        time_ns = (received_ns if self.source.received else header_ns) + self.source.offset_ns
        if abs(time_ns) > _MAX_NS:
            raise MessageError(f"a time further than {_MAX_NS} ns from 1970")
        return time_ns

    def _check_type(self, topic: Topic, known: Sequence[str], hint: str = "") -> None:
        if topic.type not in known:
            raise ConfigurationError(
                f"{self.source.place}: {topic.name} is of the type {topic.type!r:.120}, "
                f"expected {', '.join(known)}{nearest(topic.type, known)}{hint}"
            )

    def _check_frame(self, frame_id: str) -> None:
        """Raise ConfigurationError unless all messages are in one frame, which is in the world as the map says."""
        if frame_id == self._frame_id:
            return
        if self._frame_id:
            expected = f"{self._frame_id!r} as in the messages before"
            raise ConfigurationError(
                f"{self.source.place}: {self.source.topic}: found the frame {frame_id!r:.80}, expected {expected}"
            )
        if self.source.origin is None and frame_id not in self._frames:
            known = ", ".join(self._frames) or "none"
            raise ConfigurationError(
                f"{self.source.place}: {self.source.topic} is in the frame {frame_id!r:.80}, expected one of `frames` "
                f"of the map ({known}), or `origin`, where it is in the world{nearest(frame_id, self._frames)}"
            )
        self._frame_id = frame_id

    def _origin(self) -> Pose:
        origin = self.source.origin
        return self._frames[self._frame_id] if origin is None else origin


class PoseReader(TopicReader):
    """The poses of an agent or an object."""

    def __init__(self, source: Source, frames: Mapping[str, Pose]) -> None:
        super().__init__(source, frames)
        self._links = {child: _Link(array("q"), array("d")) for child in source.chain or ("",)}
        self._parents = dict(zip(source.chain[1:], source.chain, strict=False))

    def decoder(self, place: str, topic: Topic, types: Mapping[str, Any]) -> Decode:
        self._check_type(topic, POSES)
        has_children = topic.type in POSES[1:2] + POSES[4:]
        if has_children != bool(self.source.chain):
            expected = "`child`, the frame whose pose is wanted" if has_children else "no `child`"
            raise ConfigurationError(
                f"{self.source.place}: {topic.name} is of the type {topic.type}, expected {expected}"
            )
        return known_decoder(place, topic)

    @property
    def used(self) -> int:
        return min(len(link.times) for link in self._links.values())

    def _read(self, message: Any, received_ns: int) -> None:
        received = stamped_poses(message)
        for reason, number in received.dropped.items():
            self._leave_out(reason, number)
        for each in received.transforms:
            child = each.child if self.source.chain else ""
            link = self._links.get(child)
            if link is None:
                continue
            expected = self._parents.get(child)
            if expected is None:
                self._check_frame(each.parent)
            elif each.parent != expected:
                raise ConfigurationError(
                    f"{self.source.place}.child: {self.source.topic}: {child!r} is in the frame {each.parent!r:.80}, "
                    f"expected {expected!r}"
                )
            link.times.append(self._time(each.time_ns, received_ns))
            link.values.extend((*each.position.tolist(), *each.rotation.tolist()))

    def track(self, max_gap_ns: int) -> PoseTrack:
        """All poses in the world, at the times of the last frame of a chain; of several at one time, the first.

        max_gap_ns: of the other frames of a chain, the longest time between two poses that is bridged
        """
        *above, last = (self._track_of(link) for link in self._links.values())
        times, position, rotation = last.times_ns, last.position, rotation_from_quaternion(last.quaternion)
        known = np.ones(len(times), bool)
        for track in reversed(above):
            origin, turn, is_known = track.at(times, max_gap_ns)
            position, rotation = origin + (turn @ position[:, :, None])[:, :, 0], turn @ rotation
            known &= is_known
        if not known.all():
            self._leave_out("a pose without one of a frame above it in the chain", int((~known).sum()))
            if not known.any():
                raise SceneError(f"{self.source.place}: {self.source.topic}: found no time with all frames of `child`")
        world = self._origin()
        position, rotation = position[known] @ world.rotation.T + world.position, world.rotation @ rotation[known]
        return PoseTrack(times[known], position, quaternion_from_rotation(rotation))

    def _track_of(self, link: _Link) -> PoseTrack:
        times, first = np.unique(np.frombuffer(link.times, np.int64), return_index=True)
        if len(first) < len(link.times):
            self._leave_out("a pose at the time of another one", len(link.times) - len(first))
        values = np.frombuffer(link.values, np.float64).reshape(-1, 7)[first]
        return PoseTrack(times, values[:, :3], values[:, 3:])


class _Link(NamedTuple):
    """Poses of a frame in the one above it: ns of each, and x y z w x y z of each."""

    times: array[int]
    values: array[float]


@dataclass(frozen=True, eq=False)
class Measured:
    """The measurements of a sensor.

    times_ns:   (K,) ns, ascending
    first:      (K,) row of the first detection of each, and count: (K,) how many it has
    detections: of all measurements
    fixed:      pose in the world of the fixed frame that they are in; None: they are in the sensor's
    """

    times_ns: Ints
    first: Ints
    count: Ints
    detections: Detections
    fixed: Pose | None

    def detections_of(self, measurement: int) -> Detections:
        """The detections of a measurement; views, not copies."""
        first = int(self.first[measurement])
        return self.detections.select(slice(first, first + int(self.count[measurement])))


class DetectionReader(TopicReader):
    """The detections of a sensor."""

    changes = True

    def __init__(self, entry: DetectionsEntry, source: Source, frames: Mapping[str, Pose]) -> None:
        super().__init__(source, frames)
        self._entry = entry
        self._times, self._counts, self._values = array("q"), array("q"), array("d")
        self._fixed = frames.get(entry.frame)

    def decoder(self, place: str, topic: Topic, types: Mapping[str, Any]) -> Decode:
        if self._entry.paths:
            own = OwnType(place, topic, types)
            try:
                element = own.element_of(self._entry.paths["list"])
                for name, path in self._entry.paths.items():
                    if name != "list":
                        own.check_path(element, path)
            except ValueError as error:
                raise ConfigurationError(f"{self.source.place}.fields: {topic.name}: {error}") from None
            return own.decode
        self._check_type(topic, _TYPES_OF_DETECTIONS, "; `fields` reads other types")
        if topic.type == type_store.DETECTED_OBJECTS:
            for name, given in (
                ("axes", self._entry.axes is not None),
                ("size", self._entry.size is not None),
                ("classes", bool(self._entry.classes)),
            ):
                if given:
                    raise ConfigurationError(f"{self.source.place}: {topic.type} has no use for `{name}`")
        return known_decoder(place, topic)

    @property
    def used(self) -> int:
        return len(self._times)

    def _read(self, message: Any, received_ns: int) -> None:
        entry = self._entry
        if entry.paths:
            message = self._converted(message)
        if message.__msgtype__ == type_store.DETECTIONS:
            _change(message, entry)
        received = received_detections(message)
        if received.frame_id != entry.frame:
            raise ConfigurationError(
                f"{self.source.place}.frame: {self.source.topic} is in the frame {received.frame_id!r:.80}, "
                f"expected {entry.frame!r}"
            )
        for reason, number in received.dropped.items():
            self._leave_out(reason, number)
        self._count_unclassified(received.unclassified)
        found = received.objects
        near = np.linalg.norm(found.position, axis=1) < entry.nearest_m
        if near.any():
            self._leave_out(f"nearer than nearest_m, {entry.nearest_m:g} m", int(near.sum()))
            found = found.select(np.flatnonzero(~near))
        if len(self._values) > MAX_BOXES * _DETECTION:
            raise SceneError(f"{self.source.topic}: found more than {MAX_BOXES} detections, expected at most as many")
        self._times.append(self._time(received.time_ns, received_ns))
        self._counts.append(len(found))
        for columns in zip(*(getattr(found, name) for name in DETECTION_COLUMNS), strict=True):
            self._values.extend(np.hstack([np.ravel(column) for column in columns]).tolist())

    def _converted(self, message: Any) -> Any:
        """A Detection3DArray of a message of another type."""
        paths = self._entry.paths
        listed = _value(message, paths["list"])
        if not isinstance(listed, list):
            raise MessageError(f"{'.'.join(map(str, paths['list']))} is no list")
        if len(listed) > _MAX_DETECTED:
            raise MessageError(f"found {len(listed)} detections, expected at most {_MAX_DETECTED}")
        s, ns, frame_id = (
            _value(message, ("header", *path)) for path in (("stamp", "sec"), ("stamp", "nanosec"), ("frame_id",))
        )
        if not isinstance(s, int) or not isinstance(ns, int) or not isinstance(frame_id, str):
            raise MessageError("header: found another type, expected std_msgs/msg/Header")
        header = _TYPE["std_msgs/msg/Header"](_TYPE["builtin_interfaces/msg/Time"](s, ns), frame_id)
        detections = []
        for each in listed:
            try:
                detections.append(self._detection(each, paths))
            except MessageError as error:
                self._leave_out(str(error))
        return _TYPE[type_store.DETECTIONS](header, detections)

    def _detection(self, each: Any, paths: Mapping[str, tuple[str | int, ...]]) -> Any:
        x, y, z = _numbers(_value(each, paths["position"]), "xyz")
        turn = _numbers(_value(each, paths["orientation"]), "xyzw") if "orientation" in paths else (0.0, 0.0, 0.0, 1.0)
        size = _numbers(_value(each, paths["size"]), "xyz") if "size" in paths else (1.0, 1.0, 1.0)
        results = []
        if "score" in paths or "class" in paths:
            try:
                score = float(_value(each, paths["score"])) if "score" in paths else 1.0
                name = str(_value(each, paths["class"])) if "class" in paths else "unknown"
                results = [_result(name, score)]
            except (TypeError, ValueError):
                raise MessageError("score: no number") from None
            except MessageError:
                results = []  # of an empty list of hypotheses
        centre = _TYPE["geometry_msgs/msg/Pose"](
            _TYPE["geometry_msgs/msg/Point"](x, y, z), _TYPE["geometry_msgs/msg/Quaternion"](*turn)
        )
        box = _TYPE["vision_msgs/msg/BoundingBox3D"](centre, _TYPE["geometry_msgs/msg/Vector3"](*size))
        header = _TYPE["std_msgs/msg/Header"](_TYPE["builtin_interfaces/msg/Time"](0, 0), "")
        return _TYPE["vision_msgs/msg/Detection3D"](header, results, box, "")

    def measured(self) -> Measured:
        """All measurements, by time."""
        times, count = np.frombuffer(self._times, np.int64), np.frombuffer(self._counts, np.int64)
        order, first = np.argsort(times, kind="stable"), np.cumsum(count) - count
        values = np.frombuffer(self._values, np.float64).reshape(-1, _DETECTION)
        position, size, yaw, score, class_id, covariance = np.split(values, [3, 6, 7, 8, 9], axis=1)
        detections = Detections(
            position, size, yaw[:, 0], score[:, 0], class_id[:, 0].astype(np.uint8), covariance.reshape(-1, 3, 3)
        )
        return Measured(times[order], first[order], count[order], detections, self._fixed)


_TYPE: Mapping[str, Callable[..., Any]] = type_store.TYPES


def _result(name: str, score: float) -> Any:
    pose = _TYPE["geometry_msgs/msg/Pose"](
        _TYPE["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), _TYPE["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    with_covariance = _TYPE["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    hypothesis = _TYPE["vision_msgs/msg/ObjectHypothesis"](name, score)
    return _TYPE["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis, with_covariance)


def _value(whole: Any, path: Sequence[str | int]) -> Any:
    """The value at a path in nested messages and lists. Raises MessageError if there is none."""
    for step in path:
        try:
            whole = whole[step] if isinstance(step, int) else getattr(whole, normalize_fieldname(step))
        except (AttributeError, IndexError, TypeError):
            raise MessageError(f"{'.'.join(map(str, path))}: found no {step}") from None
    return whole


def _numbers(whole: Any, names: str) -> list[float]:
    """The values of x, y, z and so on, or those of a list as long."""
    values = [_value(whole, (name,)) for name in names] if hasattr(whole, "__msgtype__") else whole
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != len(names):
        raise MessageError(f"found no {', '.join(names)}")
    return numbers


def _change(message: Any, entry: DetectionsEntry) -> None:
    """Give the detections of a Detection3DArray our axes, the size that the map says, and our classes."""
    for each in message.detections:
        for result in each.results:
            name = result.hypothesis.class_id
            result.hypothesis.class_id = entry.classes.get(name, name)
        box = each.bbox
        if entry.axes is not None:
            point, size, turn = box.center.position, box.size, box.center.orientation
            turn.x, turn.y, turn.z, turn.w = 0.0, 0.0, 0.0, 1.0
            with np.errstate(all="ignore"):  # values may be anything
                point.x, point.y, point.z = (entry.axes @ (point.x, point.y, point.z)).tolist()
                size.x, size.y, size.z = (np.abs(entry.axes) @ (size.x, size.y, size.z)).tolist()
                for result in each.results:
                    covariance = result.pose.covariance.reshape(6, 6).copy()
                    covariance[:3, :3] = entry.axes @ covariance[:3, :3] @ entry.axes.T
                    result.pose.covariance = covariance.ravel()
        if entry.size is not None:
            box.size.x, box.size.y, box.size.z = entry.size.tolist()


@dataclass(frozen=True, eq=False)
class TrueObject:
    """An object of a list: its poses, and at each of their times size (K, 3) m and class (K,)."""

    poses: PoseTrack
    size: Floats
    class_id: NDArray[np.uint8]


class ObjectReader(TopicReader):
    """The objects of a topic with lists of the truth."""

    def __init__(self, entry: TruthEntry, frames: Mapping[str, Pose]) -> None:
        super().__init__(entry.source, frames)
        self._without_names, self._without = entry.without, frozenset[int]()
        self._ids, self._times, self._values = array("q"), array("q"), array("d")

    def decoder(self, place: str, topic: Topic, types: Mapping[str, Any]) -> Decode:
        hint = "; an object with a pose needs `size` and `class`" if topic.type in POSES else ""
        self._check_type(topic, _TYPES_OF_TRUTH, hint)
        if self.source.chain:
            raise ConfigurationError(f"{self.source.place}: {topic.type} has no use for `child`")
        is_uuid = _UUID.fullmatch if topic.type == type_store.TRACKED_OBJECTS else lambda _: None
        self._without = frozenset(
            id_of_uuid(bytes.fromhex(name.replace("-", ""))) if is_uuid(name) else id_of_text(name)
            for name in self._without_names
        )
        return known_decoder(place, topic)

    @property
    def used(self) -> int:
        return len(self._ids)

    def _read(self, message: Any, received_ns: int) -> None:
        received: ReceivedObjects[ObjectStates] | ReceivedObjects[Detections]
        if message.__msgtype__ == type_store.TRACKED_OBJECTS:
            tracks = received = received_tracks(message)
            ids = tracks.objects.id
        else:
            received = received_detections(message)
            texts = [message.detections[row].id for row in received.rows.tolist()]
            if "" in texts:
                raise MessageError("a detection has no id: without ids, no object can be followed over time")
            ids = np.array([id_of_text(text) for text in texts], np.int64)
        for reason, number in received.dropped.items():
            self._leave_out(reason, number)
        self._count_unclassified(received.unclassified)
        found = received.objects
        self._check_frame(received.frame_id)
        time = self._time(received.time_ns, received_ns)
        origin = self._origin()
        position = found.position @ origin.rotation.T + origin.position
        yaw = found.yaw + float(heading(origin.rotation))
        for row, number in enumerate(ids.tolist()):
            if number in self._without:
                continue
            self._ids.append(number)
            self._times.append(time)
            values = (*position[row].tolist(), yaw[row], *found.size[row].tolist(), float(found.class_id[row]))
            self._values.extend(values)
        if len(self._ids) > MAX_BOXES:
            raise SceneError(f"{self.source.topic}: found more than {MAX_BOXES} objects, expected at most as many")

    def objects(self) -> list[TrueObject]:
        """All objects, by their ids."""
        ids, times = np.frombuffer(self._ids, np.int64), np.frombuffer(self._times, np.int64)
        values = np.frombuffer(self._values, np.float64).reshape(-1, 8)
        order = np.lexsort((times, ids))
        repeated = np.zeros(len(order), bool)
        repeated[1:] = (np.diff(ids[order]) == 0) & (np.diff(times[order]) == 0)
        if repeated.any():
            self._leave_out("an object at the time of another one with its id", int(repeated.sum()))
            order = order[~repeated]
        objects = len(np.unique(ids))
        if objects > _MAX_OBJECTS:
            raise SceneError(f"{self.source.topic}: found {objects} objects, expected at most {_MAX_OBJECTS}")
        found = []
        for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(order) else []:
            rotation = np.stack([rotation_from_yaw(yaw) for yaw in values[rows, 3].tolist()])
            poses = PoseTrack(times[rows], values[rows, :3], quaternion_from_rotation(rotation))
            found.append(TrueObject(poses, values[rows, 4:7], values[rows, 7].astype(np.uint8)))
        return found


def read_topics(bag: Bag, bag_map: BagMap) -> dict[str, TopicReader]:
    """Read all mapped topics once; the readers by the place of their source in the map.

    Raises ConfigurationError for a topic that the bag does not have or whose type is of no use, and SceneError with the
    file for messages that cannot be decoded, and for a topic without any that can be used.
    """
    readers: dict[str, TopicReader] = {}
    for agent in bag_map.agents:
        if isinstance(agent.pose, Source):
            readers[agent.pose.place] = PoseReader(agent.pose, bag_map.frames)
        for entry in agent.sensors:
            if entry.source is not None:
                readers[entry.source.place] = DetectionReader(entry, entry.source, bag_map.frames)
    for truth in bag_map.truth:
        is_list = truth.body is None
        readers[truth.source.place] = (
            ObjectReader(truth, bag_map.frames) if is_list else PoseReader(truth.source, bag_map.frames)
        )
    try:
        types = {name: parse_definition(name, text) for name, text in bag_map.types.items()}
    except ValueError as error:
        raise ConfigurationError(f"{bag_map.place}: types: {error}") from None
    wanted = bag_map.topics()
    of_topic: dict[str, list[tuple[Decode, list[TopicReader]]]] = {}
    last: dict[str, Topic] = {}
    for number, (topic, received_ns, payload) in enumerate(bag.messages(wanted)):
        if last.get(topic.name) != topic:
            if topic.name in last and last[topic.name].type != topic.type:
                raise SceneError(
                    f"{bag.path}: {topic.name} has messages of {last[topic.name].type!r} and {topic.type!r}"
                )
            own = [reader for reader in readers.values() if reader.source.topic == topic.name]
            decoders = [reader.decoder(str(bag.path), topic, types) for reader in own]
            # Readers of detections change messages; all others share one, for many agents may be on /tf.
            alone = [(decode, [reader]) for decode, reader in zip(decoders, own, strict=True) if reader.changes]
            sharing = [reader for reader in own if not reader.changes]
            of_topic[topic.name] = alone + ([(decoders[own.index(sharing[0])], sharing)] if sharing else [])
            last[topic.name] = topic
        if number >= MAX_MESSAGES:
            raise SceneError(f"{bag.path}: found more than {MAX_MESSAGES} messages of mapped topics")
        for decode, of_decoder in of_topic[topic.name]:
            try:
                message = decode(payload)
            except MessageError as error:
                raise SceneError(
                    f"{bag.path}: {topic.name}: message {of_decoder[0].count}, received at {received_ns} ns, "
                    f"cannot be read: {error}"
                ) from None
            for reader in of_decoder:
                reader.add(message, received_ns)
    for reader in readers.values():
        _check_used(bag, reader)
    return readers


def _check_used(bag: Bag, reader: TopicReader) -> None:
    """Raise ConfigurationError if the topic is not in the bag, and SceneError if nothing in it can be used."""
    source = reader.source
    if not reader.count:
        topics = bag.topics()
        if source.topic in topics:
            raise SceneError(f"{bag.path}: {source.topic} has no messages ({source.place})")
        raise ConfigurationError(
            f"{source.place}: no topic {source.topic!r} in {bag.path}{nearest(source.topic, topics)}; the bag has "
            f"{bag.listed_topics()}"
        )
    if not reader.used:
        child = f"none for each of {', '.join(source.chain)}" if source.chain else "none that can be used"
        reasons = "; ".join(f"{remark}: {number}" for remark, number in reader.remarks.most_common(3))
        raise SceneError(
            f"{bag.path}: {source.topic}: found {reader.count} messages, {child} ({source.place})"
            + (f"; {reasons}" if reasons else "")
        )
