"""A ROS 2 bag: Detection3DArray and MarkerArray for each estimate, and the poses of agents and cameras."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.record import Series
from mast_zenoh.viewer.export.columns import WORLD, cameras, class_names, colours, quaternions, transforms_of
from mast_zenoh.viewer.frame import Frame
from mast_zenoh.viewer.recorded import RecordedRun

#: Appended to the topic of an estimate.
MARKERS = "/markers"

#: The messages of vision_msgs 4, which ROS 2 has since Humble, that a Detection3DArray consists of.
VISION_MSGS = {
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
_DETECTIONS, _MARKER_ARRAY = "vision_msgs/msg/Detection3DArray", "visualization_msgs/msg/MarkerArray"
_TF = "tf2_msgs/msg/TFMessage"
_CUBE, _ADD, _DELETE_ALL = 1, 0, 3


def write(run: RecordedRun, path: Path) -> None:
    """Write a bag as MCAP, compressed by zstd in chunks, in the folder `path`.

    Times are those of the scene, from 0.
    """
    bag = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        _Bag(run, bag).write()


class _Bag:
    """Writes the messages of a run to a bag."""

    def __init__(self, run: RecordedRun, bag: Writer) -> None:
        self.run, self.bag = run, bag
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in VISION_MSGS.items():
            self.store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
        self.types: Any = self.store.types
        self.cameras = cameras(run)
        self.transforms = self._connection("/tf", _TF)
        self.detections = {series: self._connection(topic_of(run, series), _DETECTIONS) for series in run.topics}
        self.markers = {
            series: self._connection(topic_of(run, series) + MARKERS, _MARKER_ARRAY) for series in run.topics
        }

    def write(self) -> None:
        """Write all frames."""
        for frame in self.run:
            self._send(self.transforms, frame, self.types[_TF](self._transforms(frame)))
            header = self._header(frame)
            for series in self.run.topics:
                markers = [self._nothing(header)]
                if series in frame.objects:
                    states = frame.objects[series]
                    array = self.types[_DETECTIONS](header, self._detections(header, states))
                    self._send(self.detections[series], frame, array)
                    markers += self._markers(header, states, colours(frame, series))
                self._send(self.markers[series], frame, self.types[_MARKER_ARRAY](markers))

    def _connection(self, topic: str, kind: str) -> Connection:
        return self.bag.add_connection(topic, kind, typestore=self.store)

    def _send(self, connection: Connection, frame: Frame, message: Any) -> None:
        self.bag.write(connection, frame.time_ns, self.store.serialize_cdr(message, connection.msgtype))

    def _header(self, frame: Frame, frame_id: str = WORLD) -> Any:
        time = self._new("builtin_interfaces/msg/Time", *divmod(frame.time_ns, 10**9))
        return self._new("std_msgs/msg/Header", time, frame_id)

    def _new(self, kind: str, *values: Any) -> Any:
        return self.types[kind](*values)

    def _vector(self, values: Floats, kind: str = "Vector3") -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", *values.tolist())

    def _transforms(self, frame: Frame) -> list[Any]:
        """The poses of the agents, and of their cameras in their optical frames."""
        result = []
        for agent, pose in frame.poses.items():
            for parent, child, position, turn in transforms_of(agent, pose, self.cameras[agent]):
                transform = self._new(
                    "geometry_msgs/msg/Transform", self._vector(position), self._vector(turn, "Quaternion")
                )
                header = self._header(frame, parent)
                result.append(self._new("geometry_msgs/msg/TransformStamped", header, child, transform))
        return result

    def _detections(self, header: Any, states: ObjectStates) -> list[Any]:
        """A detection for each object: id, class, score, box, and the covariance of its position."""
        result = []
        turns, kinds = quaternions(states.yaw), class_names(states)
        for k, number in enumerate(states.id.tolist()):
            pose = self._pose(states.position[k], turns[k])
            covariance = np.zeros((6, 6))
            covariance[:3, :3] = states.covariance[k, :3, :3]
            with_covariance = self._new("geometry_msgs/msg/PoseWithCovariance", pose, covariance.ravel())
            hypothesis = self._new("vision_msgs/msg/ObjectHypothesis", kinds[k], float(states.score[k]))
            both = self._new("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis, with_covariance)
            box = self._new("vision_msgs/msg/BoundingBox3D", pose, self._vector(states.size[k]))
            result.append(self._new("vision_msgs/msg/Detection3D", header, [both], box, str(number)))
        return result

    def _nothing(self, header: Any) -> Any:
        """A marker that removes those of the frame before."""
        return self._marker(
            header, 0, _DELETE_ALL, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)
        )

    def _markers(self, header: Any, states: ObjectStates, colour: Ints) -> list[Any]:
        """A box for each object."""
        turns = quaternions(states.yaw)
        return [
            self._marker(header, number, _ADD, states.position[k], turns[k], states.size[k], colour[k] / 255)
            for k, number in enumerate(states.id.tolist())
        ]

    def _marker(
        self,
        header: Any,
        number: int,
        action: int,
        position: Floats,
        turn: Floats,
        size: Floats,
        colour: Floats,
    ) -> Any:
        red, green, blue = (float(value) for value in colour)
        return self._new(
            "visualization_msgs/msg/Marker",
            header,
            "",
            number % 2**31,  # ROS has 32 bits for it
            _CUBE,
            action,
            self._pose(position, turn),
            self._vector(size),
            self._new("std_msgs/msg/ColorRGBA", red, green, blue, 0.6),
            self._new("builtin_interfaces/msg/Duration", 0, 0),
            False,
            [],
            [],
            "",
            self._new("sensor_msgs/msg/CompressedImage", header, "", np.zeros(0, np.uint8)),
            [],
            "",
            "",
            self._new("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8)),
            False,
        )

    def _pose(self, position: Floats, turn: Floats) -> Any:
        return self._new("geometry_msgs/msg/Pose", self._vector(position, "Point"), self._vector(turn, "Quaternion"))


def topic_of(run: RecordedRun, series: Series) -> str:
    """The topic of a series: its key expression, in the letters that ROS allows."""
    return "/" + re.sub(r"[^A-Za-z0-9_/]", "_", run.topics[series])
