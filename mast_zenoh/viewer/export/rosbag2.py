"""A ROS 2 bag: Detection3DArray and MarkerArray for each estimate, and the poses of agents and cameras."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics.record import Series
from mast_zenoh.ros2 import type_store
from mast_zenoh.ros2.object_markers import marker_array
from mast_zenoh.ros2.object_messages import detection_array
from mast_zenoh.ros2.pose_messages import transform_message
from mast_zenoh.ros2.spatial import Transform
from mast_zenoh.ros2.type_store import RosMessage
from mast_zenoh.viewer.export.columns import WORLD, cameras, colours, transforms_of
from mast_zenoh.viewer.frame import Frame
from mast_zenoh.viewer.recorded import RecordedRun

#: Appended to the topic of an estimate.
MARKERS = "/markers"

_NO_COLOURS = np.zeros((0, 3), np.int64)


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
        self.cameras = cameras(run)
        self.transforms = self._connection("/tf", type_store.TF_MESSAGE)
        topics = {series: topic_of(run, series) for series in run.topics}
        self.detections = {series: self._connection(topic, type_store.DETECTIONS) for series, topic in topics.items()}
        self.markers = {
            series: self._connection(topic + MARKERS, type_store.MARKER_ARRAY) for series, topic in topics.items()
        }

    def write(self) -> None:
        """Write all frames."""
        for frame in self.run:
            self._send(self.transforms, frame, transform_message(self._transforms(frame)))
            for series in self.run.topics:
                states, of_boxes = ObjectStates.empty(), _NO_COLOURS
                if series in frame.objects:
                    states, of_boxes = frame.objects[series], colours(frame, series)
                    self._send(self.detections[series], frame, detection_array(states, frame.time_ns, WORLD))
                self._send(self.markers[series], frame, marker_array(states, of_boxes, frame.time_ns, WORLD))

    def _connection(self, topic: str, kind: str) -> Connection:
        return self.bag.add_connection(topic, kind, typestore=type_store.STORE)

    def _send(self, connection: Connection, frame: Frame, message: RosMessage) -> None:
        self.bag.write(connection, frame.time_ns, type_store.encode(message))

    def _transforms(self, frame: Frame) -> Iterator[Transform]:
        """The poses of the agents, and of their cameras in their optical frames."""
        for agent, pose in frame.poses.items():
            for parent, child, position, (x, y, z, w) in transforms_of(agent, pose, self.cameras[agent]):
                yield Transform(parent, child, frame.time_ns, position, np.array([w, x, y, z]))


def topic_of(run: RecordedRun, series: Series) -> str:
    """The topic of a series: its key expression, in the letters that ROS allows."""
    return "/" + re.sub(r"[^A-Za-z0-9_/]", "_", run.topics[series])
