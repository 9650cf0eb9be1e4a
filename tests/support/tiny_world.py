"""A tiny world that plays in milliseconds, and a bench for single nodes."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import CLASS_INDEX, Detections, ObjectStates
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.scenes.agents import SceneAgent
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording, truth_states
from mast_zenoh.sensing import Camera, LidarSensor, sensor_pose, to_sensor
from mast_zenoh.streams import stream
from mast_zenoh.wiring.model import Wiring

PERIOD_NS = 100_000_000
STILL = np.array([1.0, 0.0, 0.0, 0.0])

#: Position and velocity at time 0 of the ego, a car, a truck and a pedestrian.
_START = np.array([[-10.0, 0.0, 0.8], [12.0, 4.0, 0.8], [6.0, -9.0, 1.6], [-6.0, 8.0, 0.9]])
_VELOCITY = np.array([[8.0, 0.0, 0.0], [-6.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, -1.0, 0.0]])
_SIZE = np.array([[4.5, 1.8, 1.6], [4.5, 1.8, 1.6], [8.0, 2.5, 3.2], [0.6, 0.6, 1.8]])
_CLASS = np.array([CLASS_INDEX[name] for name in ("car", "car", "truck", "pedestrian")], np.uint8)
_YAW = np.arctan2(_VELOCITY[:, 1], _VELOCITY[:, 0])


class TinyScene(Scene):
    """Four objects including the ego, and poles; everything is detected to 10 cm."""

    def __init__(self, *, n_infrastructure: int = 2) -> None:
        self.n_infrastructure = n_infrastructure

    def record(self, seed: int, frames: int | None) -> Recording:
        """12 frames of the tiny world."""
        count = 12 if frames is None else frames
        agents = [SceneAgent("ego", "mobile", 0, LidarSensor(), Camera())]
        for i in range(self.n_infrastructure):
            agents.append(SceneAgent(f"infra_{i + 1}", "static", -1, LidarSensor.infrastructure(), Camera()))
        times = np.arange(count) * PERIOD_NS
        truth = _START + _VELOCITY * (times * 1e-9)[:, None, None]
        position, rotation = np.zeros((count, len(agents), 3)), np.zeros((count, len(agents), 3, 3))
        velocity = np.zeros((count, len(agents), 3))
        position[:, 0], rotation[:, 0], velocity[:, 0] = truth[:, 0], rotation_from_yaw(0.0), _VELOCITY[0]
        for i in range(1, len(agents)):
            bearing = 1.0 + 2.1 * i
            position[:, i] = 30.0 * np.cos(bearing), 30.0 * np.sin(bearing), 15.0
            rotation[:, i] = rotation_from_yaw_pitch(bearing + np.pi, np.radians(30.0))
        parts = [
            _detected(seed, frame, agent, truth[frame], position[frame, i], rotation[frame, i])
            for frame in range(count)
            for i, agent in enumerate(agents)
        ]
        columns = [np.concatenate(column) for column in zip(*(p.columns().values() for p in parts), strict=True)]
        n = len(_START)
        return Recording(
            name="tiny",
            agents=tuple(agents),
            period_ns=PERIOD_NS,
            times_ns=times,
            truth=truth_states(
                {
                    "id": np.tile(np.arange(n), count),
                    "position": truth.reshape(-1, 3),
                    "velocity": np.tile(_VELOCITY, (count, 1)),
                    "size": np.tile(_SIZE, (count, 1)),
                    "yaw": np.tile(_YAW, count),
                    "class_id": np.tile(_CLASS, count),
                }
            ),
            truth_start=np.arange(count + 1) * n,
            points=np.full((count * n, len(agents)), 50, np.int32),
            agent_position=position,
            agent_rotation=rotation,
            agent_velocity=velocity,
            detections=Detections(*columns),
            detection_start=np.cumsum([0, *map(len, parts)]),
            detection_truth_id=np.zeros(sum(map(len, parts)), np.int64),
            buildings=(),
            building_height=np.zeros(0),
        )


def _detected(
    seed: int, frame: int, agent: SceneAgent, objects: np.ndarray, position: np.ndarray, rotation: np.ndarray
) -> Detections:
    rows = np.arange(len(objects)) != agent.object_id
    noise = stream(seed, "tiny", agent.name, frame).normal(0.0, 0.1, (len(objects), 3))
    world = Detections(
        position=(objects + noise)[rows],
        size=_SIZE[rows],
        yaw=_YAW[rows],
        score=np.full(rows.sum(), 0.9),
        class_id=_CLASS[rows],
        covariance=np.tile(np.eye(3) * 0.01, (rows.sum(), 1, 1)),
    )
    mount = agent.sensor.mount_position, agent.sensor.mount_rotation
    return to_sensor(world, *sensor_pose(position, rotation, *mount))


def tiny(
    name: str = "baseline",
    *settings: str,
    infrastructure: int = 2,
    frames: int = 12,
    seed: int = 0,
    edit: Callable[[dict[str, Any]], None] | None = None,
    record: bool = False,
    acting: bool = False,
) -> Resolved:
    """A shipped scenario in the tiny world, changed by `edit` if given. acting: poles get the picture, too"""
    acts = ["agents.infra_*.acts=true"] if acting else []
    path, content = scenario.load(name, [f"n_infrastructure={infrastructure}", *acts, *settings])
    content["scene"] = dict(type="TinyScene", n_infrastructure=infrastructure)
    if edit:
        edit(content)
    return scenario.resolve(path, content, frames=frames, seed=seed, record=record)


class Run:
    """All messages and results of a run in one process, by key in order."""

    def __init__(self, resolved: Resolved, *, shuffle: int | None = None, encode: bool = True) -> None:
        self.messages: dict[str, list[bytes]] = defaultdict(list)

        def tap(message: Any) -> None:
            payload = message.payload
            self.messages[message.key].append(payload if isinstance(payload, bytes) else codec.encode(payload))

        process = InProcess(resolved, shuffle=shuffle, encode=encode, tap=tap)
        outcome = process.run()
        outcome.pop("")
        self.results = outcome
        self.packed = results.pack(outcome)
        self.failures = {name: dict(host.failures) for name, host in process.hosts.items() if host.failures}
        self.rejected = {name: dict(host.rejected) for name, host in process.hosts.items() if host.rejected}
        self.nodes = {name: host.node for name, host in process.hosts.items()}

    def decoded(self, key: str, schema: str) -> list[Message]:
        """All messages of a key."""
        return [codec.decode(payload, schema) for payload in self.messages[key]]


class Bench:
    """One node of a scenario by itself; the test plays all other nodes.

    link: to programs outside the run, for a node that has one
    said: all messages published so far, as (key, message); outbox: those not yet checked by the test
    """

    def __init__(self, resolved: Resolved, name: str, *, encode: bool = True, link: Any = None, **config: Any) -> None:
        wiring = Wiring.from_json(resolved.wiring)
        self.encode = encode
        self.ports = wiring.ports(name)
        spec = resolved.nodes[name]
        self.node = build_node(replace(spec, config={**spec.config, **config}), name)
        self.outbox: list[Outgoing] = []
        self.host = Host(
            name, self.node, self.ports, resolved.seed, encode=encode, emit=self.outbox.append, wiring=wiring
        )
        if link is not None:
            self.node.outside_topics(self.host)
            self.host.link = link
        self.host.start({other: spec.role for other, spec in resolved.nodes.items() if other != name})
        self.said: list[tuple[str, Message]] = []
        self.payloads: list[bytes] = []
        self._seq: dict[str, int] = defaultdict(int)

    def key(self, port: str, subject: str | None = None) -> str:
        """The key of an input port of the node."""
        (key,) = (
            key for key, hears in self.ports.inputs.items() if hears.port == port and subject in (None, hears.subject)
        )
        return key

    def message(self, key: str, body: dict[str, Any], frame: int, **header: Any) -> Message:
        """The next message of the node's peer on a key."""
        hears = self.ports.inputs[key]
        fields = dict(source=hears.source, frame=frame, time_ns=frame * PERIOD_NS, seq=self._seq[key]) | header
        self._seq[key] += 1
        return codec.conform(Header(hears.message, **fields), body)

    def deliver(self, key: str, message: Message, *, step: int | None = None) -> list[tuple[str, Message]]:
        """Deliver a message; returns the messages that the node publishes at once."""
        payload = codec.encode(message) if self.encode else message
        self.host.deliver(key, payload, message.header.frame if step is None else step)
        return self._collect()

    def send(self, port: str, body: dict[str, Any], frame: int, *, subject: str | None = None, step: int | None = None):
        """Make and deliver a message by port."""
        key = self.key(port, subject)
        return self.deliver(key, self.message(key, body, frame), step=step)

    def hear(self, key: str, body: dict[str, Any], frame: int, *, step: int | None = None, **header: Any) -> None:
        """Make and deliver a message by key, for nodes that hear every key."""
        self.deliver(key, self.message(key, body, frame, **header), step=step)

    def clock(self, frame: int) -> list[tuple[str, Message]]:
        """Begin a frame."""
        return self.send("clock", {}, frame)

    def play(self, frame: int, **bodies: dict[str, Any]) -> list[tuple[str, Message]]:
        """Begin a frame, then send a message to each of these ports in order."""
        published = self.clock(frame)
        for port, body in bodies.items():
            published += self.send(port, body, frame)
        return published

    def heard(self, key: str) -> list[Message]:
        """All messages that the node has published on a key."""
        return [message for said, message in self.said if said == key]

    def left(self, name: str, role: str) -> list[tuple[str, Message]]:
        """Announce that another node has left."""
        self.host.left(name, role)
        return self._collect()

    def _collect(self) -> list[tuple[str, Message]]:
        fresh = []
        for out in self.outbox:
            schema = next(schema for key, schema in self._schemas() if key == out.key)
            payload = out.payload if isinstance(out.payload, bytes) else codec.encode(out.payload)
            self.payloads.append(payload)
            fresh.append((out.key, codec.decode(payload, schema)))
        self.outbox.clear()
        self.said += fresh
        return fresh

    def _schemas(self) -> Iterator[tuple[str, str]]:
        for (port, _), key in self.ports.outputs.items():
            yield key, self.node.outputs.get(port) or self.ports.types[port]


def pose(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> dict[str, np.ndarray]:
    """Columns of a pose on the ground."""
    return {
        "position": np.array([x, y, 0.0]),
        "rotation": quaternion_from_rotation(rotation_from_yaw(yaw)),
        "velocity": np.zeros(3),
    }


def detections(*places: tuple[float, float]) -> dict[str, np.ndarray]:
    """Columns of detections of cars at (x, y) in the sensor's and agent's frame."""
    n = len(places)
    detected = Detections(
        position=np.array([(x, y, 0.8) for x, y in places]).reshape(n, 3),
        size=np.tile(_SIZE[1], (n, 1)),
        yaw=np.zeros(n),
        score=np.full(n, 0.9),
        class_id=np.full(n, CLASS_INDEX["car"], np.uint8),
        covariance=np.tile(np.eye(3) * 0.01, (n, 1, 1)),
    )
    return detected.columns() | {"mount_position": np.zeros(3), "mount_rotation": STILL}


def states(*places: tuple[float, float], velocity: tuple[float, float] = (0.0, 0.0)) -> ObjectStates:
    """Cars at (x, y), ids from 0."""
    n = len(places)
    return ObjectStates.of(
        np.array([(x, y, 0.8) for x, y in places]).reshape(n, 3),
        velocity=np.tile([*velocity, 0.0], (n, 1)),
        size=np.tile(_SIZE[1], (n, 1)),
        covariance=np.tile(np.eye(9) * 0.1, (n, 1, 1)),
        score=np.full(n, 0.9),
        class_id=np.full(n, CLASS_INDEX["car"], np.uint8),
    )


def tracks(*places: tuple[float, float], **more: Any) -> dict[str, np.ndarray]:
    """Columns of tracks in the world frame."""
    return states(*places, **more).columns() | {"origin": np.zeros(3), "rotation": STILL}


def picture(*places: tuple[float, float], **more: Any) -> dict[str, np.ndarray]:
    """Columns of a picture."""
    return states(*places, **more).columns() | {"support": np.ones(len(places), np.int64)}
