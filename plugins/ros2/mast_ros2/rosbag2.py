"""A ROS 2 bag with everything that the bridge publishes, except for the clock, which players make."""

from __future__ import annotations

from pathlib import Path

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mast_ros2 import type_store
from mast_ros2.run_messages import CLOCK, RunMessages
from mast_ros2.type_store import RosMessage
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.run import Run

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
