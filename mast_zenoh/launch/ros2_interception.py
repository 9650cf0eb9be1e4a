"""An adversary between two ROS 2 nodes: on the way of a topic, outside any run.

Keys of foreign nodes are not ours to rewrite. So the publisher is started with its topic remapped to `TOPIC/before`,
and what it says there is published on TOPIC, as the adversary wants it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from inspect import signature
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import loading
from mast_zenoh.config.resolved import build_node
from mast_zenoh.config.settings import nested
from mast_zenoh.errors import ConfigurationError, HandlerFailed, MessageError, nearest
from mast_zenoh.launch.live_interception import node_of, port_of
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Node
from mast_zenoh.ros2 import type_store
from mast_zenoh.ros2.altered_objects import ALTERABLE, altered
from mast_zenoh.ros2.attachments import Attachment
from mast_zenoh.ros2.connection import Connection
from mast_zenoh.ros2.names import check_topic
from mast_zenoh.ros2.received_objects import Received, received_tracks
from mast_zenoh.ros2.received_poses import received_pose
from mast_zenoh.ros2.type_store import RosMessage
from mast_zenoh.runtime.host import Host, Outgoing
from mast_zenoh.runtime.mesh.ros2_participant import Participant
from mast_zenoh.scenario.nodes import node_spec
from mast_zenoh.wiring.model import Input, Ports

#: Appended to a topic: where its publisher is remapped to.
BEFORE = "/before"

_WIRE = "tracks"  # what all these messages are to an interposer
#: Messages that wait for the node, at most, and s between two looks whether to stop.
_MOST_WAITING, _LOOK_S = 256, 0.1
#: Messages that a node may keep back; of more, the oldest are not published.
_MOST_KEPT = 1000
_WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
_STILL = {"position": np.zeros(3), "rotation": _WORLD["rotation"], "velocity": np.zeros(3)}


class ObjectsInterposer:
    """Passes messages of objects through a node of this testbed, without I/O.

    node: an interposer with ports for tracks, such as an adversary;  source: its file and class, for errors
    agent: the subject of its messages;  name: of the node;  seed: of its draws

    Each message is a frame of its own. Times are those of the messages' stamps, from 0 at the first one.
    messages, changed: number of messages that were received, and that were published with a difference
    """

    def __init__(self, node: Node, agent: str, *, source: str, name: str, seed: int) -> None:
        inputs = {port: message for port, message in node.inputs.items() if port not in node.listening}
        port = port_of(inputs, _WIRE, None, source, "input", "the topic")
        out = port_of(node.outputs, _WIRE, None, source, "output", "the topic")
        by_key = {_WIRE: Input(port, agent, _WIRE, agent)}
        by_key |= {other: Input(other, agent, other, "simulator") for other in ("clock", "pose") if other in inputs}
        self._agent = agent
        self._published: list[Message] = []
        self._host = Host(name, node, Ports(by_key, {(out, agent): _WIRE}), seed, encode=False, emit=self._on_message)
        self._host.start({})
        self._pose: Body = _STILL
        self._kept: dict[int, tuple[RosMessage, Received[ObjectStates]]] = {}
        self._first_ns: int | None = None
        self.messages = self.changed = 0

    @property
    def failed(self) -> str:
        """The first error of the node's handlers; "": none."""
        return next((f"{failure.where}: {failure.exception}" for failure in self._host.failures.values()), "")

    def set_pose(self, pose: Body) -> None:
        """Set where the agent is in the messages' frame of reference, columns of `pose`."""
        self._pose = pose

    def through(self, message: RosMessage) -> list[RosMessage]:
        """What is published when a message has arrived: it, as the node wants it; nothing; or older ones as well.

        A message on which the node fails is passed on as it is. Raises MessageError for one that cannot be read.
        """
        received = received_tracks(message)
        if self._first_ns is None:
            self._first_ns = received.time_ns
        frame, time_ns = self.messages, max(0, received.time_ns - self._first_ns)
        self.messages += 1
        self._kept[frame] = message, received
        while len(self._kept) > _MOST_KEPT:
            del self._kept[min(self._kept)]
        failures = self._failures()
        self._deliver("clock", "simulator", frame, time_ns, {})
        self._deliver("pose", "simulator", frame, time_ns, self._pose)
        self._deliver(_WIRE, self._agent, frame, time_ns, received.objects.columns() | _WORLD)
        published, self._published = self._published, []
        results = [result for each in published if (result := self._result(each)) is not None]
        if self._failures() > failures and frame not in (each.header.frame for each in published):
            del self._kept[frame]
            results.append(message)
        return results

    def _failures(self) -> int:
        return sum(failure.count for failure in self._host.failures.values())

    def _deliver(self, key: str, source: str, frame: int, time_ns: int, body: Body) -> None:
        if key in self._host.subscriptions:
            self._host.deliver(key, codec.conform(Header(key, source, frame, time_ns, frame), body), frame)

    def _on_message(self, out: Outgoing) -> None:
        if out.key == _WIRE and isinstance(out.payload, Message):
            self._published.append(out.payload)

    def _result(self, published: Message) -> RosMessage | None:
        """A message with what the node has made of its objects; None: it is kept no longer."""
        if published.header.frame not in self._kept:
            return None
        message, received = self._kept[published.header.frame]
        wanted = ObjectStates.from_columns(published.body)
        result = altered(message, received, wanted)
        self.changed += not _equal(wanted, received.objects)
        return result


def _equal(first: ObjectStates, second: ObjectStates) -> bool:
    """Whether two sets of objects are the same, in this order."""
    columns, others = first.columns(), second.columns()
    return all(np.array_equal(column, others[name]) for name, column in columns.items())


def interposer_of(file: str, topic: str, settings: list[str], seed: int) -> ObjectsInterposer:
    """An interposer from what `--with` names.

    file: of a node; or an attack, by name, FILE.py or FILE.py:CLASS;  settings: its parameters, `key=value`

    Raises NodeFileError for its file or ports, ConfigurationError for its parameters.
    """
    path, config = node_of(file, nested(settings))
    cls = loading.node_class(path, config.get("type"))
    name, agent = path.stem, topic.strip("/").partition("/")[0]
    if "agent" in signature(cls).parameters:
        config.setdefault("agent", agent)
    agent = str(config.get("agent", agent))
    spec = node_spec(path, name, cls.role, config | {"file": str(path)})
    node = build_node(spec, name, str(path))
    return ObjectsInterposer(node, agent, source=f"{path}: {cls.__name__}", name=name, seed=seed)


def launch_fragment(topic: str) -> str:
    """A launch file of ROS 2 that starts another one with the topic remapped, so that its nodes publish before it."""
    before = topic + BEFORE
    return f"""<launch>
  <!-- ros2 launch THIS_FILE file:=LAUNCH_FILE: the nodes of LAUNCH_FILE, which must be those that publish
       {topic}, publish {before} instead. Those that subscribe to {topic} are started without it. -->
  <arg name="file"/>
  <group>
    <set_remap from={quoteattr(topic)} to={quoteattr(before)}/>
    <include file="$(var file)"/>
  </group>
</launch>
"""


def check_interception(topic: str, type_name: str) -> None:
    """Raise ConfigurationError for a topic or a type between whose nodes nothing can be put."""
    try:
        check_topic(topic + BEFORE)
    except ValueError as error:
        raise ConfigurationError(f"--ros2: {error}") from None
    if type_name not in ALTERABLE:
        raise ConfigurationError(f"--type: found {type_name!r:.120}{nearest(type_name, ALTERABLE)}")


def intercept_topic(
    connection: Connection,
    topic: str,
    type_name: str,
    interposer: ObjectsInterposer,
    stop: threading.Event,
    *,
    odometry: str = "",
    ready: Callable[[], None] = lambda: None,
    warn: Callable[[str], None] = lambda sentence: None,
) -> dict[str, Any]:
    """Publish on a topic what arrives before it, as an interposer wants it, until `stop` is set or Ctrl-C.

    type_name: of ALTERABLE;  odometry: a topic with the agent's pose, in the frame of reference of the objects; "": it
    is at the origin, as for objects in the vehicle's own frame
    ready: called when it is between them;  warn: called once, when the node fails for the first time

    Returns messages, changed, published, and refused by reason. Raises NotRunning without a router, HandlerFailed at
    the end if the node has failed.
    """
    arrived: queue.Queue[RosMessage] = queue.Queue(_MOST_WAITING)
    with Participant(connection, "mast_interposer") as participant:
        publisher = participant.publisher(topic, type_name)

        def keep(message: RosMessage, _: Attachment) -> None:
            try:
                arrived.put_nowait(message)
            except queue.Full:
                raise MessageError(f"overtaken: more than {_MOST_WAITING} messages wait for the node") from None

        def pass_on(message: RosMessage) -> None:
            if message.__msgtype__ == type_store.ODOMETRY:
                interposer.set_pose(received_pose(message).columns)
                return
            has_failed = interposer.failed
            try:
                results = interposer.through(message)
            except MessageError:
                publisher.publish(message)  # what cannot be read cannot be attacked
                raise
            for each in results:
                publisher.publish(each)
            if interposer.failed and not has_failed:
                warn(f"{interposer.failed}: what the node fails on is passed on as it is")

        if odometry:
            participant.subscribe(odometry, type_store.ODOMETRY, keep)
        participant.subscribe(topic + BEFORE, type_name, keep)
        ready()
        with suppress(KeyboardInterrupt):
            while not stop.is_set():
                try:
                    pass_on(arrived.get(timeout=_LOOK_S))
                except queue.Empty:
                    continue
                except MessageError as error:
                    participant.refuse(topic + BEFORE, str(error))
        counts = {"messages": interposer.messages, "changed": interposer.changed, "published": publisher.sent}
    if interposer.failed:
        raise HandlerFailed(f"{interposer.failed}: it was on {topic}, and what it failed on was passed on as it was")
    return counts | {"refused": dict(participant.refused)}
