"""The topics of a run in ROS 2, and the messages of its frames: those of a bag, and of the bridge."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from mast_ros2 import type_store
from mast_ros2.object_markers import marker_array
from mast_ros2.object_messages import detection_array, predicted_objects, tracked_objects
from mast_ros2.pose_messages import clock, odometry, transform_message
from mast_ros2.spatial import Transform
from mast_ros2.trust_messages import diagnostic_array
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.routes import POSE, TRUST
from mast_zenoh.runs.run import Run
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
    """

    def __init__(self, run: Run, namespace: str = "/", partners: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        self.run = run
        self._partners = partners or {}
        self._sends_clock = not any(config.get("clock") for config in self._partners.values())
        names = _Names(namespace)
        self.objects: Mapping[Series, str] = {series: names.of(key) for series, key in run.topics.items()}
        self.odometry: Mapping[str, str] = {agent: names.of(f"agent/{agent}/odometry") for agent in run.agents}
        judged = any(wire.message == TRUST for _, wiring in run.files.wirings for wire in wiring.wires)
        self.topics = (
            *([Topic(CLOCK, type_store.CLOCK)] if self._sends_clock else []),
            Topic(TRANSFORMS, type_store.TF_MESSAGE),
            Topic(MOUNTS, type_store.TF_MESSAGE, transient_local=True),
            *(Topic(topic, type_store.ODOMETRY) for topic in self.odometry.values()),
            *(Topic(name + ending, kind) for name in self.objects.values() for ending, kind in _TYPES.items()),
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
