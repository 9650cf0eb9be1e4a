"""Reads the mapped topics of a ROS 2 bag: poses over time, detections of sensors, and lists of true objects."""

from __future__ import annotations

import itertools
import re
from abc import ABC, abstractmethod
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Generic, NamedTuple, NoReturn, TypeVar

import numpy as np
from mast_ros2 import type_store
from mast_ros2.object_messages import id_of_text, id_of_uuid
from mast_ros2.received_objects import ReceivedObjects, received_detections, received_tracks
from mast_ros2.received_poses import POSES, slerp, stamped_poses
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.typesys.base import normalize_fieldname

from mast_datasets.rosbag import BagMap, DetectionsEntry, FramePose, PointsEntry, TopicSource, TruthEntry
from mast_datasets.rosbag_points import ScanStamp, stamp_of_scan
from mast_datasets.rosbag_storage import Bag, Decode, Fields, OwnType, known_decoder, parse_definition
from mast_datasets.traffic import MAX_BOXES
from mast_zenoh.arrays.geometry import heading, quaternion_from_rotation, rotation_from_quaternion, rotation_from_yaw
from mast_zenoh.arrays.states import Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

#: Limit on the messages of all mapped topics.
MAX_MESSAGES = 5_000_000
_MAX_REMARKS = 20  # that are told apart, of one topic
_MAX_DETECTED = 1000
_MAX_NS = 2**61
_UUID = re.compile("-?".join(f"[0-9a-fA-F]{{{count}}}" for count in (8, 4, 4, 4, 12)))
_TYPES_OF_DETECTIONS = (type_store.DETECTIONS, type_store.DETECTED_OBJECTS)
_TYPES_OF_TRUTH = (type_store.TRACKED_OBJECTS, type_store.DETECTIONS)


class PosesAt(NamedTuple):
    """Poses at n times: position (n, 3) m, rotation (n, 3, 3), and whether they are known (n,)."""

    position: Floats
    rotation: Floats
    known: Bools


class PoseTrack(NamedTuple):
    """Poses over time: times_ns (K,) ascending, position (K, 3) m and quaternion (K, 4) w x y z, world frame."""

    times_ns: Ints
    position: Floats
    quaternion: Floats

    def at(self, times_ns: Ints, max_gap_ns: int) -> PosesAt:
        """The poses at times (n,).

        Between two poses, positions are linear and rotations spherically linear. Nothing is known before the first,
        after the last, and between two that are further apart than `max_gap_ns`.
        """
        before = np.clip(np.searchsorted(self.times_ns, times_ns, side="right") - 1, 0, len(self.times_ns) - 1)
        after = np.minimum(before + 1, len(self.times_ns) - 1)
        since, span = times_ns - self.times_ns[before], self.times_ns[after] - self.times_ns[before]
        known = (since == 0) | ((since > 0) & (since <= span) & (span <= max_gap_ns))
        share = np.where(known & (since > 0), since / np.maximum(span, 1), 0.0)[:, None]
        position = (1.0 - share) * self.position[before] + share * self.position[after]
        rotation = rotation_from_quaternion(slerp(self.quaternion[before], self.quaternion[after], share))
        return PosesAt(position, rotation, np.asarray(known))


Entry = TypeVar("Entry", bound=TopicSource)


class TopicReader(ABC, Generic[Entry]):
    """Collects what one entry of the map wants of the messages of its topic.

    source: the entry;  place: of it in the map, for messages
    count: messages;  remarks: what was left out or changed, in words, and how often
    """

    def __init__(self, source: Entry, place: str, bag_map: BagMap) -> None:
        self.source, self.place = source, place
        self.count = 0
        self.remarks: Counter[str] = Counter()
        self._frames: Mapping[str, FramePose] = bag_map.frames
        self._is_received = (source.time or bag_map.time) == "received"
        self._offset_ns = round(source.offset_s * 1e9)
        self._frame_id = ""

    @abstractmethod
    def decoder(self, bag: str, connection: Connection, types: Fields) -> Decode:
        """How the messages of the topic are decoded. types: those that the map defines

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

    def _fail(self, reason: str, part: str = "") -> NoReturn:
        raise ConfigurationError(f"{self.place}{part}: {self.source.topic}: {reason}")

    def _leave_out(self, reason: str, number: int = 1) -> None:
        self._remark(f"left out: {reason:.160}", number)

    def _remark(self, remark: str, number: int) -> None:
        known = remark in self.remarks or len(self.remarks) < _MAX_REMARKS
        self.remarks[remark if known else "left out for other reasons"] += number

    def _count_left_out(self, received: Any) -> None:
        """Count what cannot be used of a message, and classes that are not ours."""
        for reason, number in received.dropped.items():
            self._leave_out(reason, number)
        if getattr(received, "unclassified", 0):
            self._remark("a class that none of ours is, now unknown", received.unclassified)

    def _time(self, header_ns: int, received_ns: int) -> int:
        """The time, ns, that counts. Raises MessageError for one whose differences from others overflow."""
        time_ns = (received_ns if self._is_received else header_ns) + self._offset_ns
        if abs(time_ns) > _MAX_NS:
            raise MessageError(f"a time further than {_MAX_NS} ns from 1970")
        return time_ns

    def _check_type(self, connection: Connection, known: Sequence[str], hint: str = "") -> None:
        found = connection.msgtype
        if found not in known:
            self._fail(f"the type is {found!r:.120}, expected {', '.join(known)}{nearest(found, known)}{hint}")

    def _check_frame(self, frame_id: str) -> None:
        """Raise ConfigurationError unless all messages are in one frame, which is in the world as the map says."""
        if frame_id == self._frame_id:
            return
        if self._frame_id:
            self._fail(f"found the frame {frame_id!r:.80}, expected {self._frame_id!r} as in the messages before")
        if self.source.origin is None and frame_id not in self._frames:
            known = ", ".join(self._frames) or "none"
            self._fail(
                f"is in the frame {frame_id!r:.80}, expected one of `frames` of the map ({known}), or `origin`, where "
                f"it is in the world{nearest(frame_id, self._frames)}"
            )
        self._frame_id = frame_id

    def _origin(self) -> FramePose:
        return self.source.origin or self._frames[self._frame_id]


class PoseReader(TopicReader[TopicSource]):
    """The poses of an agent or an object."""

    def __init__(self, source: TopicSource, place: str, bag_map: BagMap) -> None:
        super().__init__(source, place, bag_map)
        #: Poses of each frame in the one above it: ns of each, and x y z w x y z of each.
        self._links = {child: (array("q"), array("d")) for child in source.chain or ("",)}
        self._parents = dict(zip(source.chain[1:], source.chain, strict=False))

    def decoder(self, bag: str, connection: Connection, types: Fields) -> Decode:
        self._check_type(connection, POSES)
        has_children = connection.msgtype in POSES[1:2] + POSES[4:]
        if has_children != bool(self.source.chain):
            expected = "`child`, the frame whose pose is wanted" if has_children else "no `child`"
            self._fail(f"the type is {connection.msgtype}, expected {expected}")
        return known_decoder(bag, connection)

    @property
    def used(self) -> int:
        return min(len(times) for times, _ in self._links.values())

    def _read(self, message: Any, received_ns: int) -> None:
        received = stamped_poses(message)
        self._count_left_out(received)
        for each in received.transforms:
            child = each.child if self.source.chain else ""
            if child not in self._links:
                continue
            times, values = self._links[child]
            expected = self._parents.get(child)
            if expected is None:
                self._check_frame(each.parent)
            elif each.parent != expected:
                self._fail(f"{child!r} is in the frame {each.parent!r:.80}, expected {expected!r}", ".child")
            times.append(self._time(each.time_ns, received_ns))
            values.extend((*each.position.tolist(), *each.rotation.tolist()))

    def track(self, max_gap_ns: int) -> PoseTrack:
        """All poses in the world, at the times of the last frame of a chain; of several at one time, the first.

        max_gap_ns: of the other frames of a chain, the longest time between two poses that is bridged
        """
        *above, last = (self._track_of(*link) for link in self._links.values())
        times, position, rotation = last.times_ns, last.position, rotation_from_quaternion(last.quaternion)
        known = np.ones(len(times), bool)
        for track in reversed(above):
            origin, turn, is_known = track.at(times, max_gap_ns)
            position, rotation = origin + (turn @ position[:, :, None])[:, :, 0], turn @ rotation
            known &= is_known
        if not known.all():
            self._leave_out("a pose without one of a frame above it in the chain", int((~known).sum()))
            if not known.any():
                raise SceneError(f"{self.place}: {self.source.topic}: found no time with all frames of `child`")
        world = self._origin()
        position, rotation = position[known] @ world.rotation.T + world.origin, world.rotation @ rotation[known]
        return PoseTrack(times[known], position, quaternion_from_rotation(rotation))

    def _track_of(self, listed: array[int], values: array[float]) -> PoseTrack:
        times, first = np.unique(np.frombuffer(listed, np.int64), return_index=True)
        if len(first) < len(listed):
            self._leave_out("a pose at the time of another one", len(listed) - len(first))
        poses = np.frombuffer(values, np.float64).reshape(-1, 7)[first]
        return PoseTrack(times, poses[:, :3], poses[:, 3:])


class SensorMeasurements(NamedTuple):
    """The measurements of a sensor.

    times_ns:   (K,) ns, ascending
    rows:       (K,) rows of the detections of each
    detections: of all measurements
    fixed:      pose in the world of the fixed frame that they are in; None: they are in the sensor's
    """

    times_ns: Ints
    rows: Sequence[slice]
    detections: Detections
    fixed: FramePose | None


class DetectionReader(TopicReader[DetectionsEntry]):
    """The detections of a sensor."""

    def __init__(self, source: DetectionsEntry, place: str, bag_map: BagMap) -> None:
        super().__init__(source, place, bag_map)
        self._paths = source.fields.steps if source.fields else {}
        self._times, self._found, self._total = array("q"), list[Detections](), 0

    def decoder(self, bag: str, connection: Connection, types: Fields) -> Decode:
        if self._paths:
            own = OwnType(bag, connection, types)
            try:
                own.check_paths(self._paths)
            except ValueError as error:
                self._fail(str(error), ".fields")
            return own.decode
        self._check_type(connection, _TYPES_OF_DETECTIONS, "; `fields` reads other types")
        for name in ("axes", "size", "classes") if connection.msgtype == type_store.DETECTED_OBJECTS else ():
            if getattr(self.source, name):
                self._fail(f"{connection.msgtype} has no use for `{name}`")
        return known_decoder(bag, connection)

    @property
    def used(self) -> int:
        return len(self._times)

    def _read(self, message: Any, received_ns: int) -> None:
        if self._paths:
            message = self._converted(message)
        if message.__msgtype__ == type_store.DETECTIONS:
            _change(message, self.source)
        received = received_detections(message)
        if received.frame_id != self.source.frame:
            self._fail(f"is in the frame {received.frame_id!r:.80}, expected {self.source.frame!r}", ".frame")
        self._count_left_out(received)
        found = received.objects
        near = np.linalg.norm(found.position, axis=1) < self.source.nearest_m
        if near.any():
            self._leave_out(f"nearer than nearest_m, {self.source.nearest_m:g} m", int(near.sum()))
            found = found.select(np.flatnonzero(~near))
        self._times.append(self._time(received.time_ns, received_ns))
        self._found.append(found)
        self._total += len(found)
        if self._total > MAX_BOXES:
            raise SceneError(f"{self.source.topic}: found more than {MAX_BOXES} detections, expected at most as many")

    def _converted(self, message: Any) -> Any:
        """What has the fields of a Detection3DArray, of a message of another type."""
        listed = _value(message, self._paths["list"])
        if not isinstance(listed, list) or len(listed) > _MAX_DETECTED:
            raise MessageError(f"list: found no list of at most {_MAX_DETECTED} detections")
        header, detections = _value(message, ("header",)), []
        for step, kind in (("stamp.sec", int), ("stamp.nanosec", int), ("frame_id", str)):
            if not isinstance(_value(header, step.split(".")), kind):
                raise MessageError("header: found another type, expected std_msgs/msg/Header")
        for each in listed:
            try:
                detections.append(self._detection(each))
            except MessageError as error:
                self._leave_out(str(error))
        return SimpleNamespace(__msgtype__=type_store.DETECTIONS, header=header, detections=detections)

    def _detection(self, each: Any) -> SimpleNamespace:
        found = {
            name: _numbers(_value(each, self._paths[name]) if name in self._paths else usual, axes)
            for name, axes, usual in _PARTS
        }
        results = []
        try:
            usual: dict[str, Any] = {"score": 1.0, "kind": "unknown"}
            score, kind = (_value(each, self._paths[n]) if n in self._paths else usual[n] for n in usual)
            hypothesis = SimpleNamespace(class_id=str(kind), score=float(score))
            results = [SimpleNamespace(hypothesis=hypothesis, pose=SimpleNamespace(covariance=np.zeros(36)))]
        except (TypeError, ValueError):
            raise MessageError("score: no number") from None
        except MessageError:  # of an empty list of hypotheses
            pass
        centre = SimpleNamespace(position=found["position"], orientation=found["orientation"])
        return SimpleNamespace(results=results, bbox=SimpleNamespace(center=centre, size=found["size"]), id="")

    def measured(self) -> SensorMeasurements:
        """All measurements, by time."""
        times = np.frombuffer(self._times, np.int64)
        order = np.argsort(times, kind="stable")
        detections = Detections.joined([Detections.empty(), *(self._found[row] for row in order.tolist())])
        ends = np.cumsum([0, *(len(self._found[row]) for row in order.tolist())]).tolist()
        rows = [slice(first, end) for first, end in itertools.pairwise(ends)]
        return SensorMeasurements(times[order], rows, detections, self._frames.get(self.source.frame))


#: Parts of a detection, names of their numbers, and the usual ones.
_PARTS = (
    ("position", "xyz", ()),
    ("orientation", "xyzw", (0.0, 0.0, 0.0, 1.0)),
    ("size", "xyz", (1.0, 1.0, 1.0)),
)


def _value(whole: Any, path: Sequence[str | int]) -> Any:
    """The value at a path in nested messages and lists. Raises MessageError if there is none."""
    for step in path:
        try:
            whole = whole[step] if isinstance(step, int) else getattr(whole, normalize_fieldname(step))
        except (AttributeError, IndexError, TypeError):
            raise MessageError(f"{'.'.join(map(str, path))}: found no {step}") from None
    return whole


def _numbers(whole: Any, names: str) -> SimpleNamespace:
    """The values of x, y, z and so on, or those of a list as long."""
    try:
        values = [_value(whole, (name,)) for name in names] if hasattr(whole, "__msgtype__") else whole
        return SimpleNamespace(**dict(zip(names, map(float, values), strict=True)))
    except (TypeError, ValueError):
        raise MessageError(f"found no {', '.join(names)}") from None


def _change(message: Any, entry: DetectionsEntry) -> None:
    """Give the detections of a Detection3DArray our axes, the size that the map says, and our classes."""
    axes = entry.matrix
    for each in message.detections:
        box, point, size, turn = each.bbox, each.bbox.center.position, each.bbox.size, each.bbox.center.orientation
        for result in each.results:
            name = result.hypothesis.class_id
            result.hypothesis.class_id = entry.classes.get(name, name)
        if axes is not None:
            turn.x, turn.y, turn.z, turn.w = 0.0, 0.0, 0.0, 1.0
            with np.errstate(all="ignore"):  # values may be anything
                point.x, point.y, point.z = (axes @ (point.x, point.y, point.z)).tolist()
                size.x, size.y, size.z = (np.abs(axes) @ (size.x, size.y, size.z)).tolist()
                for result in each.results:
                    covariance = result.pose.covariance.reshape(6, 6).copy()
                    covariance[:3, :3] = axes @ covariance[:3, :3] @ axes.T
                    result.pose.covariance = covariance.ravel()
        if entry.size is not None:
            box.size.x, box.size.y, box.size.z = entry.size


class TrueObject(NamedTuple):
    """An object of a list: its poses, and at each of their times size (K, 3) m and class (K,)."""

    poses: PoseTrack
    size: Floats
    class_id: NDArray[np.uint8]


class ObjectReader(TopicReader[TruthEntry]):
    """The objects of a topic with lists of the truth."""

    def __init__(self, source: TruthEntry, place: str, bag_map: BagMap) -> None:
        super().__init__(source, place, bag_map)
        self._without: set[int] = set()
        self._ids, self._times, self._values = array("q"), array("q"), array("d")

    def decoder(self, bag: str, connection: Connection, types: Fields) -> Decode:
        hint = "; an object with a pose needs `size` and `class`" if connection.msgtype in POSES else ""
        self._check_type(connection, _TYPES_OF_TRUTH, hint)
        for name in map(str, self.source.without):
            is_uuid = connection.msgtype == type_store.TRACKED_OBJECTS and _UUID.fullmatch(name)
            self._without.add(id_of_uuid(bytes.fromhex(name.replace("-", ""))) if is_uuid else id_of_text(name))
        return known_decoder(bag, connection)

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
        self._count_left_out(received)
        found = received.objects
        self._check_frame(received.frame_id)
        time, origin = self._time(received.time_ns, received_ns), self._origin()
        position = found.position @ origin.rotation.T + origin.origin
        yaw = found.yaw + float(heading(origin.rotation))
        for row, number in enumerate(ids.tolist()):
            if number not in self._without:
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
        _, order = np.unique(np.stack([ids, times], axis=1), axis=0, return_index=True)  # by id, then by time
        if len(order) < len(ids):
            self._leave_out("an object at the time of another one with its id", len(ids) - len(order))
        found = []
        for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1) if len(order) else []:
            rotation = np.stack([rotation_from_yaw(yaw) for yaw in values[rows, 3].tolist()])
            poses = PoseTrack(times[rows], values[rows, :3], quaternion_from_rotation(rotation))
            found.append(TrueObject(poses, values[rows, 4:7], values[rows, 7].astype(np.uint8)))
        return found


class ScanReader(TopicReader[PointsEntry]):
    """When the scans of a lidar were: of their messages, only the headers are read."""

    def __init__(self, source: PointsEntry, place: str, bag_map: BagMap) -> None:
        super().__init__(source, place, bag_map)
        self._times = array("q")

    def decoder(self, bag: str, connection: Connection, types: Fields) -> Decode:
        self._check_type(connection, (type_store.POINT_CLOUD,))
        known_decoder(bag, connection)
        return stamp_of_scan

    @property
    def used(self) -> int:
        return len(self._times)

    def _read(self, message: ScanStamp, received_ns: int) -> None:
        if message.frame_id != self.source.frame:
            self._fail(f"is in the frame {message.frame_id!r:.80}, expected {self.source.frame!r}", ".frame")
        self._times.append(self._time(message.time_ns, received_ns))

    def times_ns(self) -> Ints:
        """(K,) ns, of each message, in the order of the bag."""
        return np.frombuffer(self._times, np.int64)


def _reader(source: TopicSource, place: str, bag_map: BagMap) -> TopicReader[Any]:
    if isinstance(source, PointsEntry):
        return ScanReader(source, place, bag_map)
    if isinstance(source, DetectionsEntry):
        return DetectionReader(source, place, bag_map)
    if isinstance(source, TruthEntry) and source.body is None:
        return ObjectReader(source, place, bag_map)
    return PoseReader(source, place, bag_map)


def read_topics(bag: Bag, bag_map: BagMap, path: Path) -> dict[TopicSource, TopicReader[Any]]:
    """Read all mapped topics once; the readers by their sources in the map. path: of the map

    Raises ConfigurationError for a topic that the bag does not have or whose type is of no use, and SceneError with the
    file for messages that cannot be decoded, and for a topic without any that can be used.
    """
    readers = {source: _reader(source, f"{path}: {place}", bag_map) for source, place in bag_map.sources().items()}
    types: Fields = {}
    try:
        for name, text in bag_map.types.items():
            types |= parse_definition(name, text)
    except ValueError as error:
        raise ConfigurationError(f"{path}: types: {error}") from None
    of_topic: dict[tuple[str, Any], list[tuple[TopicReader[Any], Decode]]] = {}
    for number, (connection, received_ns, payload) in enumerate(bag.messages({each.topic for each in readers})):
        key = connection.topic, (connection.msgtype, connection.msgdef, connection.digest)
        if key not in of_topic:
            there = [reader for reader in readers.values() if reader.source.topic == connection.topic]
            of_topic[key] = [(reader, reader.decoder(str(bag.path), connection, types)) for reader in there]
        if number >= MAX_MESSAGES:
            raise SceneError(f"{bag.path}: found more than {MAX_MESSAGES} messages of mapped topics")
        for reader, decode in of_topic[key]:
            try:
                message = decode(payload)
            except MessageError as error:
                place = f"{bag.path}: {connection.topic}: message {reader.count}, received at {received_ns} ns"
                raise SceneError(f"{place}, cannot be read: {error}") from None
            reader.add(message, received_ns)
    for reader in readers.values():
        _check_used(bag, reader)
    return readers


def _check_used(bag: Bag, reader: TopicReader[Any]) -> None:
    """Raise ConfigurationError if the topic is not in the bag, and SceneError if nothing in it can be used."""
    topic, chain = reader.source.topic, reader.source.chain
    if not reader.count and topic in (topics := bag.topics()):
        raise SceneError(f"{bag.path}: {topic} has no messages ({reader.place})")
    if not reader.count:
        where = f"{bag.path}{nearest(topic, topics)}; the bag has {bag.listed_topics()}"
        raise ConfigurationError(f"{reader.place}: no topic {topic!r} in {where}")
    if not reader.used:
        child = f"none for each of {', '.join(chain)}" if chain else "none that can be used"
        reasons = "".join(f"; {remark}: {number}" for remark, number in reader.remarks.most_common(3))
        raise SceneError(f"{bag.path}: {topic}: found {reader.count} messages, {child} ({reader.place}){reasons}")
