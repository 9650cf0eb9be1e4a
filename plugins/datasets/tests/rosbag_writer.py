"""Writes ROS 2 bags: a recording with its map of topics, and messages of any types."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mast_ros2 import type_store
from mast_ros2.object_messages import tracked_objects
from mast_ros2.spatial import Transform, header, poses, transform_message, upper_left
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_zenoh.arrays.geometry import heading, quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.arrays.states import CLASSES, Detections
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import sensor_pose

START_NS = 1_700_000_000_000_000_000
STORAGES = {
    "sqlite3": (StoragePlugin.SQLITE3, None),
    "mcap": (StoragePlugin.MCAP, None),
    "mcap, zstd chunks": (StoragePlugin.MCAP, CompressionMode.STORAGE),
    "sqlite3, zstd messages": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "sqlite3, zstd file": (StoragePlugin.SQLITE3, CompressionMode.FILE),
}
TYPES = type_store.TYPES
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"


class Sent(NamedTuple):
    """A message of a topic: its type is that of the message. received_ns: ns after the start"""

    topic: str
    received_ns: int
    message: Any


def write_bag(
    folder: Path, messages: Iterable[Sent], storage: str = "sqlite3", definitions: Mapping[str, str] | None = None
) -> Path:
    """Write a bag in a new folder. definitions: of types that are not known"""
    plugin, mode = STORAGES[storage]
    store = get_typestore(Stores.EMPTY)
    store.fielddefs, store.types = dict(type_store.STORE.fielddefs), dict(type_store.STORE.types)
    for name, text in (definitions or {}).items():
        store.register(get_types_from_msg(text, name))
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, received_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            payload = store.serialize_cdr(message, message.__msgtype__, little_endian=True)
            writer.write(connections[topic], START_NS + received_ns, payload)
    return folder


def pose_stamped(time_ns: int, frame: str, position: Any, rotation: Any = None) -> Any:
    """A PoseStamped at ns after the start. position: (3,) m; rotation: (3, 3)"""
    return TYPES[POSE_STAMPED](header(START_NS + time_ns, frame), pose(position, rotation))


def pose(position: Any, rotation: Any = None) -> Any:
    w, x, y, z = quaternion_from_rotation(np.eye(3) if rotation is None else np.asarray(rotation))
    return poses(np.asarray(position, float)[None], np.array([[x, y, z, w]]))[0]


def odometry(time_ns: int, frame: str, position: Any, rotation: Any = None) -> Any:
    """An Odometry at ns after the start, without a velocity."""
    zero = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = TYPES["geometry_msgs/msg/TwistWithCovariance"](TYPES["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
    placed = TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(position, rotation), np.zeros(36))
    return TYPES[type_store.ODOMETRY](header(START_NS + time_ns, frame), "base_link", placed, twist)


def transforms(time_ns: int, frame: str, children: Mapping[str, tuple[Any, Any]]) -> Any:
    """A TFMessage at ns after the start. children: positions and rotations by name"""
    return transform_message(
        Transform(frame, child, START_NS + time_ns, np.asarray(position, float), quaternion_from_rotation(rotation))
        for child, (position, rotation) in children.items()
    )


def detection_array(
    time_ns: int, frame: str, found: Detections, rotations: Sequence[Any] | None = None, ids: Sequence[str] = ()
) -> Any:
    """A Detection3DArray at ns after the start. rotations: (3, 3) of each box; None: about z alone"""
    detections = []
    for row in range(len(found)):
        turn = rotation_from_yaw(float(found.yaw[row])) if rotations is None else rotations[row]
        place = pose(found.position[row], turn)
        hypothesis = TYPES["vision_msgs/msg/ObjectHypothesis"](CLASSES[found.class_id[row]], float(found.score[row]))
        covariance = upper_left(found.covariance[row : row + 1])[0]
        placed = TYPES["geometry_msgs/msg/PoseWithCovariance"](place, covariance)
        result = TYPES["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis, placed)
        size = TYPES["geometry_msgs/msg/Vector3"](*found.size[row].tolist())
        box = TYPES["vision_msgs/msg/BoundingBox3D"](place, size)
        head = header(START_NS + time_ns, frame)
        detections.append(TYPES["vision_msgs/msg/Detection3D"](head, [result], box, ids[row] if len(ids) else ""))
    return TYPES[type_store.DETECTIONS](header(START_NS + time_ns, frame), detections)


def write_recording(folder: Path, source: Recording, storage: str = "sqlite3", *, detections: bool = False) -> Path:
    """Write a recording as a bag with its map, topics.toml.

    Mobile agents are on /tf, with poses when a sensor measured and at the times of frames. The truth without the agents
    is on /objects. detections: of the agents are in the bag, too; otherwise the scene's detector makes them.
    """
    lines = [f"rate_hz = {1e9 / source.period_ns:.9f}", "[frames]", "map = {}"]
    messages: list[Sent] = []
    own = [agent.object_id for agent in source.agents if agent.object_id >= 0]
    for row, agent in enumerate(source.agents):
        lines.append(f"[agents.{agent.name}]")
        if agent.kind == "static":
            position, rotation = source.agent_position[0, row], source.agent_rotation[0, row]
            pitch = np.degrees(-np.arcsin(rotation[2, 0]))
            turn = f"yaw_deg = {np.degrees(heading(rotation))}, pitch_deg = {pitch}"
            lines.append(f"pose = {{ position = {position.tolist()}, {turn} }}")
        else:
            lines.append(f'pose = {{ topic = "/tf", child = "{agent.name}" }}')
            first = np.flatnonzero(source.truth.id == agent.object_id)[0]
            size, kind = source.truth.size[first], CLASSES[source.truth.class_id[first]]
            centre = source.agent_rotation[0, row].T @ (source.truth.position[first] - source.agent_position[0, row])
            lines.append(f'body = {{ size = {size.tolist()}, class = "{kind}", centre = {centre.tolist()} }}')
        for number, sensor in enumerate(agent.sensors):
            lidar = sensor.lidar
            pitch = np.degrees(-np.arcsin(lidar.mount_rotation[2, 0]))
            lines += [
                f"[[agents.{agent.name}.detections]]",
                f'name = "{sensor.name}"',
                f'kind = "{sensor.kind}"',
                f"position = {lidar.mount_position.tolist()}",
                f"yaw_deg = {np.degrees(heading(lidar.mount_rotation))}",
                f"pitch_deg = {pitch}",
                f"azimuth_deg = [{lidar.azimuth_min_deg}, {lidar.azimuth_max_deg}]",
                f"elevation_deg = [{lidar.elevation_min_deg}, {lidar.elevation_max_deg}]",
                f"range_m = {lidar.max_range_m}",
            ]
            if detections:
                topic = f"/{agent.name}/{sensor.name}"
                lines += [f'topic = "{topic}"', f'frame = "{agent.name}/{sensor.name}"']
                messages += _measurements(source, row, number, topic)
    messages += _poses(source)
    lines += ["[truth.others]", 'topic = "/objects"', f"without = {own}"]
    for frame, time_ns in enumerate(source.times_ns.tolist()):
        objects = tracked_objects(source.truth_at(frame), START_NS + time_ns, "map")
        messages.append(Sent("/objects", time_ns, objects))
    write_bag(folder, sorted(messages, key=lambda message: message.received_ns), storage)
    (folder / "topics.toml").write_text("\n".join(lines) + "\n")
    return folder


def _poses(source: Recording) -> list[Sent]:
    """The poses of the mobile agents at the times of frames and of measurements."""
    mobile = [row for row, agent in enumerate(source.agents) if agent.kind == "mobile"]
    sent = []
    for frame, time_ns in enumerate(source.times_ns.tolist()):
        poses = zip(source.agent_position[frame], source.agent_rotation[frame], strict=True)
        children = {
            agent.name: pose for agent, pose in zip(source.agents, poses, strict=True) if agent.kind == "mobile"
        }
        sent.append(Sent("/tf", time_ns, transforms(time_ns, "map", children)))
        for row in mobile:
            for sensor in range(len(source.agents[row].sensors)):
                age = source.age_ns_at(frame, row, sensor)
                if age > 0 and source.measurements is not None:
                    column = source.column(row, sensor)
                    then = source.measurements.position[frame, column], source.measurements.rotation[frame, column]
                    message = transforms(time_ns - age, "map", {source.agents[row].name: then})
                    sent.append(Sent("/tf", time_ns - age, message))
    return sent


def _measurements(source: Recording, agent: int, sensor: int, topic: str) -> list[Sent]:
    """The detections of a sensor, in its frame, whose boxes stand upright in the world."""
    sent = []
    lidar = source.agents[agent].sensors[sensor].lidar
    for frame, time_ns in enumerate(source.times_ns.tolist()):
        age = source.age_ns_at(frame, agent, sensor)
        if age < 0:
            continue
        pose_then = source.agent_position[frame, agent], source.agent_rotation[frame, agent]
        if source.measurements is not None:
            column = source.column(agent, sensor)
            pose_then = source.measurements.position[frame, column], source.measurements.rotation[frame, column]
        _, rotation = sensor_pose(*pose_then, lidar.mount_position, lidar.mount_rotation)
        found = source.detections_at(frame, agent, sensor)
        turns = [rotation.T @ rotation_from_yaw(float(yaw + heading(rotation))) for yaw in found.yaw]
        message = detection_array(time_ns - age, topic.removeprefix("/"), found, turns)
        sent.append(Sent(topic, time_ns - age, message))
    return sent
