"""The topics of a run in ROS 2, and the messages of its frames: those of a bag, and of the bridge.

Trust in agents and objects as a DiagnosticArray, for rqt_robot_monitor and Foxglove.

A ROS 2 bag with everything that the bridge publishes, except for the clock, which players make.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mast_ros2 import type_store
from mast_ros2.object_messages import detection_array, marker_array, predicted_objects, tracked_objects
from mast_ros2.spatial import Transform, clock, header, odometry, point_cloud, transform_message
from mast_ros2.type_store import TYPES, RosMessage
from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.integrity.base import FAULTY, STATES, SUSPENDED, TRUSTED, UNDECIDED, UNKNOWN
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import POSE, TRUST
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.scans import scanned_agents, scans_in
from mast_zenoh.show.export.columns import AXES, WORLD, cameras, colours

#: The root of all frames of reference, which RViz expects: at the run's origin, as RViz has 32 bits for a coordinate.
MAP = "map"
CLOCK, TRANSFORMS, MOUNTS, DIAGNOSTICS = "/clock", "/tf", "/tf_static", "/diagnostics"

#: Appended to the topic of the objects of a series, which itself has Detection3DArray: other types of the same objects.
MARKERS, TRACKED, PREDICTED = "/markers", "/tracked_objects", "/predicted_objects"
_TYPES = {
    "": type_store.DETECTIONS,
    MARKERS: type_store.MARKER_ARRAY,
    TRACKED: type_store.TRACKED_OBJECTS,
    PREDICTED: type_store.PREDICTED_OBJECTS,
}
_NO_COLOURS = np.zeros((0, 3), np.int64)

#: Whether messages of a topic are of use now.
Wanted = Callable[[str], bool]


class Topic(NamedTuple):
    """A topic and its type. transient_local: it has one message, which later subscribers get, too"""

    name: str
    type_name: str
    transient_local: bool = False


class RunMessages:
    """What a run is in ROS 2.

    namespace: before the topics of objects and odometry; the others have the names that ROS expects
    partners: configurations of the nodes of ROS 2 that take part in the run now, by name: they send the clock, and
        where their agents are

    topics: all of them
    objects: by series, the topic of its detections;  odometry: by agent, its topic
    points: by agent whose scans were recorded, their topic
    """

    def __init__(self, run: Run, namespace: str = "/", partners: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        self.run = run
        self._partners = partners or {}
        self._sends_clock = not any(config.get("clock") for config in self._partners.values())
        names = _Names(namespace)
        self.objects: Mapping[Series, str] = {series: names.of(key) for series, key in run.topics.items()}
        self.odometry: Mapping[str, str] = {agent: names.of(f"agent/{agent}/odometry") for agent in run.agents}
        self.points: Mapping[str, str] = {agent: names.of(f"agent/{agent}/points") for agent in scanned_agents(run)}
        scene = run.files.scene
        self._lidars = {agent.name: agent.sensors[0].name for agent in scene.agents} if scene is not None else {}
        judged = any(wire.message == TRUST for _, wiring in run.files.wirings for wire in wiring.wires)
        self.topics = (
            *([Topic(CLOCK, type_store.CLOCK)] if self._sends_clock else []),
            Topic(TRANSFORMS, type_store.TF_MESSAGE),
            Topic(MOUNTS, type_store.TF_MESSAGE, transient_local=True),
            *(Topic(topic, type_store.ODOMETRY) for topic in self.odometry.values()),
            *(Topic(name + ending, kind) for name in self.objects.values() for ending, kind in _TYPES.items()),
            *(Topic(topic, type_store.POINT_CLOUD) for topic in self.points.values()),
            *([Topic(DIAGNOSTICS, type_store.DIAGNOSTIC_ARRAY)] if judged else []),
        )

    def transient_local(self) -> Iterator[tuple[str, RosMessage]]:
        """The messages of transient-local topics: where the world and the sensors are, at any time."""
        yield MOUNTS, transform_message(self._mounts())

    def of(self, frame: Frame, wanted: Wanted = lambda topic: True) -> Iterator[tuple[str, RosMessage]]:
        """Topics and messages of a frame, the clock first.

        A series without a message in this frame has no objects in RViz, and no message in the other topics. Raises
        ValueError for a time that ROS cannot express.
        """
        time_ns = frame.time_ns
        if self._sends_clock:
            yield CLOCK, clock(time_ns)
        yield TRANSFORMS, transform_message(self._poses(frame))
        for agent, topic in self.odometry.items():
            body = frame.bodies.get(Series(agent, POSE))
            if body is not None and wanted(topic):
                yield topic, odometry(body, time_ns, WORLD, agent)
        for agent, scan in scans_in(frame).items() if self.points else ():
            if agent in self.points and wanted(self.points[agent]):
                yield self.points[agent], point_cloud(scan, time_ns, f"{agent}/{self._lidars.get(agent, 'lidar')}")
        for series, topic in self.objects.items():
            yield from self._objects(frame, series, topic, wanted)
        for series, body in frame.bodies.items():
            if series.estimator == TRUST:
                yield DIAGNOSTICS, diagnostic_array(body, time_ns, series.agent)

    def _objects(self, frame: Frame, series: Series, topic: str, wanted: Wanted) -> Iterator[tuple[str, RosMessage]]:
        states = frame.objects.get(series)
        if wanted(topic + MARKERS):
            shown, of_boxes = (
                (ObjectStates.empty(), _NO_COLOURS) if states is None else (states, colours(frame, series))
            )
            yield topic + MARKERS, marker_array(shown, of_boxes, frame.time_ns, WORLD)
        if states is None:
            return
        for ending, convert in (("", detection_array), (TRACKED, tracked_objects), (PREDICTED, predicted_objects)):
            if wanted(topic + ending):
                yield topic + ending, convert(states, frame.time_ns, WORLD)

    def _poses(self, frame: Frame) -> Iterator[Transform]:
        """Where the agents are, but for those that say it themselves."""
        for agent, pose in frame.poses.items():
            if agent in self._partners:
                continue
            yield Transform(WORLD, agent, frame.time_ns, pose.position, quaternion_from_rotation(pose.rotation))

    def _mounts(self) -> Iterator[Transform]:
        """Where the world is on the map, and sensors and optical frames of cameras on their agents."""
        yield Transform(MAP, WORLD, 0, 0.0 - self.run.origin, np.array([1.0, 0.0, 0.0, 0.0]))
        for agent, camera in cameras(self.run).items():
            optical = camera.mount_rotation @ AXES.T
            yield _mount(agent, "camera_optical", camera.mount_position, optical)
        for scene_agent in self.run.files.scene.agents if self.run.files.scene is not None else ():
            for sensor in scene_agent.sensors:
                lidar = sensor.lidar
                yield _mount(scene_agent.name, sensor.name, lidar.mount_position, lidar.mount_rotation)


def _mount(agent: str, sensor: str, position: Floats, rotation: Floats) -> Transform:
    return Transform(agent, f"{agent}/{sensor}", 0, position, quaternion_from_rotation(rotation))


class _Names:
    """Names of topics, made of key expressions in the letters that ROS allows, each only once."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace.rstrip("/")
        self._taken: set[str] = set()

    def of(self, key: str) -> str:
        chunks = [re.sub(r"[^A-Za-z0-9_]", "_", chunk) for chunk in key.split("/")]
        name = self._namespace + "".join(f"/_{chunk}" if chunk[:1].isdigit() else f"/{chunk}" for chunk in chunks)
        while name in self._taken:
            name += "_"
        self._taken.add(name)
        return name


#: Levels of DiagnosticStatus.
OK, WARN, ERROR = 0, 1, 2

#: An agent about which nothing is known is no reason to warn.
_LEVELS = {UNKNOWN: OK, TRUSTED: OK, FAULTY: WARN, UNDECIDED: WARN, SUSPENDED: ERROR}
#: Columns of numbers about agents, and their units.
_NUMBERS = {"mean": "", "log_odds": "", "fault_turn": " rad", "fault_delay": " s", "fault_loss": ""}

_Status, _KeyValue = TYPES["diagnostic_msgs/msg/DiagnosticStatus"], TYPES["diagnostic_msgs/msg/KeyValue"]


def diagnostic_array(trust: Body, time_ns: int, source: str) -> RosMessage:
    """A DiagnosticArray of the columns of a `trust` message: a status for each agent, and one for all objects.

    source: name of the node that judges; statuses are named `source: agent`, and `source: objects`

    Raises ValueError for a time that ROS cannot express.
    """
    agents = [_agent(trust, row, source) for row in range(len(trust["agents"]))]
    return TYPES[type_store.DIAGNOSTIC_ARRAY](header(time_ns, ""), [*agents, _objects(trust, source)])


def _agent(trust: Body, row: int, source: str) -> RosMessage:
    state, reason, name = (trust[column][row] for column in ("state", "reason", "agents"))
    offset = " ".join(f"{value:.6g}" for value in trust["fault_offset"][row].tolist())
    values = {column: f"{trust[column][row]:.6g}{unit}" for column, unit in _NUMBERS.items()}
    message = STATES[state] + (f": {reason}" if reason else "")
    return _status(_LEVELS[int(state)], f"{source}: {name}", message, name, values | {"fault_offset": f"{offset} m"})


def _objects(trust: Body, source: str) -> RosMessage:
    """A warning if objects are withheld, with their ids."""
    withheld = trust["id"][trust["withheld"] == 1].tolist()
    values = {
        "objects": str(len(trust["id"])),
        "contradicted": str(int((trust["contradicting"] > 0).sum())),
        "withheld": " ".join(map(str, withheld)),
    }
    message = f"{len(withheld)} of {len(trust['id'])} objects withheld"
    return _status(WARN if withheld else OK, f"{source}: objects", message, "", values)


def _status(level: int, name: str, message: str, hardware_id: str, values: dict[str, str]) -> RosMessage:
    return _Status(level, name, message, hardware_id, [_KeyValue(key, value) for key, value in values.items()])


_NEVER = QosTime(2147483647, 4294967295)
#: Of topics whose message those get that subscribe late.
_TRANSIENT_LOCAL_PROFILE = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NEVER,
    _NEVER,
    QosLiveliness.AUTOMATIC,
    _NEVER,
    False,
)


def write(run: Run, path: Path) -> None:
    """Write a bag as MCAP, compressed by zstd in chunks, in the folder `path`.

    Times are those of the scene, from 0.
    """
    bag = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    messages = RunMessages(run)
    with bag:
        connections = {
            topic.name: bag.add_connection(
                topic.name,
                topic.type_name,
                typestore=type_store.STORE,
                offered_qos_profiles=[_TRANSIENT_LOCAL_PROFILE] if topic.transient_local else [],
            )
            for topic in messages.topics
            if topic.name != CLOCK
        }

        def send(topic: str, message: RosMessage, time_ns: int) -> None:
            if topic in connections:
                bag.write(connections[topic], time_ns, type_store.encode(message))

        for number, frame in enumerate(frames_of(run)):
            for topic, message in messages.transient_local() if number == 0 else ():
                send(topic, message, frame.time_ns)
            for topic, message in messages.of(frame):
                send(topic, message, frame.time_ns)
