"""An adversary between two ROS 2 nodes: on the way of a topic, outside any run.

Keys of foreign nodes are not ours to rewrite. So the publisher is started with its topic remapped to `TOPIC/before`,
and what it says there is published on TOPIC, as the adversary wants it.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from inspect import signature
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from mast_ros2 import type_store
from mast_ros2.altered_objects import ALTERABLE, altered
from mast_ros2.attachments import MessageAttachment
from mast_ros2.liveliness_tokens import check_topic
from mast_ros2.mesh import Connection
from mast_ros2.participant import Participant
from mast_ros2.received_objects import ReceivedObjects, received_tracks
from mast_ros2.received_poses import ReceivedPose, received_pose
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import loading
from mast_zenoh.config.resolved import build_node
from mast_zenoh.config.settings import nested
from mast_zenoh.errors import ConfigurationError, MessageError, nearest
from mast_zenoh.launch.live_interception import node_of, ports_of
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body, Header, Message
from mast_zenoh.node import Node
from mast_zenoh.scenario.nodes import node_spec
from mast_zenoh.wiring.model import Input, Ports

#: Appended to a topic: where its publisher is remapped to.
BEFORE = "/before"

_WIRE = "tracks"  # what all these messages are to an interposer
#: Messages that wait for the node, at most, and s between two looks whether to stop.
_MOST_WAITING, _LOOK_S = 256, 0.1
#: Messages that a node may keep back; of more, the oldest are not published.
_MOST_KEPT = 200
#: Odometry messages that are kept, the newest: 5 s of 200 Hz; s, by which one may be older or newer than the objects.
_MOST_POSES, MOST_POSE_AGE_S = 1000, 0.5
#: ns, the longest time between two messages that is none of a jump of the clock.
_LONGEST_STEP_NS = 10 * 10**9
#: s, for messages that wait when the interception ends.
_REST_S = 2.0
_WORLD = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
_STILL = {"position": np.zeros(3), "rotation": _WORLD["rotation"], "velocity": np.zeros(3)}


class ObjectsInterposer:
    """Passes messages of objects through a node of this testbed, without I/O.

    node: an interposer with ports for tracks, such as an adversary;  source: its file and class, for errors
    agent: the subject of its messages;  name: of the node;  seed: of its draws

    Each message is a frame of its own. Times are those of the messages' stamps, from 0 at the first one; where stamps
    jump, back or by more than 10 s, the time stands still for one message.

    messages, changed: number of messages that the node has got, and that were published with a difference
    takes_poses: whether the node takes the agent's pose, such as an adversary does
    placed: number of messages with which it got one from odometry
    jumps: number of jumps of the stamps
    """

    def __init__(self, node: Node, agent: str, *, source: str, name: str, seed: int) -> None:
        port, out = ports_of(type(node), _WIRE, _WIRE, None, None, source, "the topic")
        by_key = {_WIRE: Input(port, agent, _WIRE, agent)}
        by_key |= {
            other: Input(other, agent, other, "simulator") for other in ("clock", "pose") if other in node.inputs
        }
        self._agent = agent
        self._published: list[Message] = []
        ports = Ports(by_key, {(out, agent): _WIRE}, types={out: _WIRE})
        self._host = Host(name, node, ports, seed, encode=False, emit=self._on_message)
        self._host.start({})
        self.takes_poses = "pose" in self._host.subscriptions
        self._poses: deque[ReceivedPose] | None = None
        self._kept: dict[int, tuple[str, bytes, ReceivedObjects[ObjectStates]]] = {}  # by frame: type and bytes
        self._stamp_ns: int | None = None  # of the newest message
        self._time_ns = 0
        self.messages = self.changed = self.placed = self.jumps = 0

    @property
    def failed(self) -> str:
        """The first error of the node's handlers; "": none."""
        return next((f"{failure.where}: {failure.exception}" for failure in self._host.failures.values()), "")

    def follow_poses(self) -> None:
        """Place the agent by `add_pose` from now on; until then it is at the origin of its objects' frame."""
        self._poses = deque(maxlen=_MOST_POSES)

    def add_pose(self, pose: ReceivedPose) -> None:
        """Take a pose of the agent: it counts for objects in its frame of reference, MOST_POSE_AGE_S around it."""
        if self._poses is not None:
            self._poses.append(pose)

    def through(self, message: RosMessage) -> list[RosMessage]:
        """What is published when a message has arrived: it, as the node wants it; nothing; or older ones as well.

        A message on which the node fails is passed on as it is. Raises MessageError for one that cannot be read, or for
        which a pose of the agent is needed and missing.
        """
        received = received_tracks(message)
        self._advance(received.time_ns)
        pose = self._pose_for(received)
        frame = self.messages
        self.messages += 1
        failures = self._failures()
        self._deliver("clock", "simulator", frame, {})
        self._deliver("pose", "simulator", frame, pose)
        self._deliver(_WIRE, self._agent, frame, received.objects.columns() | _WORLD)
        published, self._published = self._published, []
        results, is_out = [], False
        for each in published:
            if each.header.frame == frame:
                results.append(self._result(message, received, each))
                is_out = True
            elif each.header.frame in self._kept:
                kind, payload, earlier = self._kept.pop(each.header.frame)
                results.append(self._result(type_store.decode(kind, payload), earlier, each))
        if is_out:
            return results
        if self._failures() > failures:
            return [*results, message]
        self._kept[frame] = message.__msgtype__, type_store.encode(message), received  # bytes take a tenth of the room
        if len(self._kept) > _MOST_KEPT:
            del self._kept[min(self._kept)]
        return results

    def _advance(self, stamp_ns: int) -> None:
        """Go on with the time by the difference of two stamps."""
        step_ns = 0 if self._stamp_ns is None else stamp_ns - self._stamp_ns
        self._stamp_ns = stamp_ns
        if 0 <= step_ns <= _LONGEST_STEP_NS:
            self._time_ns += step_ns
        else:
            self.jumps += 1

    def _pose_for(self, received: ReceivedObjects[ObjectStates]) -> Body:
        """The agent's pose that is nearest in time to objects; raises MessageError if there is none that counts."""
        if self._poses is None or not self.takes_poses:
            return _STILL
        if not self._poses:
            raise MessageError("no odometry: none has arrived yet")
        poses = [pose for pose in self._poses if pose.frame_id == received.frame_id]
        if not poses:
            frames = f"it is in {self._poses[-1].frame_id!r:.80}, the objects are in {received.frame_id!r:.80}"
            raise MessageError(f"odometry in another frame of reference: {frames}")
        nearest_pose = min(poses, key=lambda pose: abs(pose.time_ns - received.time_ns))
        age_s = (received.time_ns - nearest_pose.time_ns) * 1e-9
        if abs(age_s) > MOST_POSE_AGE_S:
            found = f"{abs(age_s):.3g} s {'older' if age_s > 0 else 'newer'} than the objects"
            raise MessageError(f"odometry of another time: {found}, expected at most {MOST_POSE_AGE_S:g} s")
        self.placed += 1
        return nearest_pose.columns

    def _failures(self) -> int:
        return sum(failure.count for failure in self._host.failures.values())

    def _deliver(self, key: str, source: str, frame: int, body: Body) -> None:
        if key in self._host.subscriptions:
            self._host.deliver(key, codec.conform(Header(key, source, frame, self._time_ns, frame), body), frame)

    def _on_message(self, out: Outgoing) -> None:
        if out.key == _WIRE and isinstance(out.payload, Message):
            self._published.append(out.payload)

    def _result(self, message: RosMessage, received: ReceivedObjects[ObjectStates], published: Message) -> RosMessage:
        """A message with what the node has made of its objects."""
        wanted = ObjectStates.from_columns(published.body)
        self.changed += not _equal(wanted, received.objects)
        return altered(message, received, wanted)


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


def check_interception(topic: str, type_name: str, odometry: str = "") -> None:
    """Raise ConfigurationError for topics or a type between whose nodes nothing can be put."""
    for option, name in (("--ros2", topic + BEFORE), ("--odometry", odometry)):
        try:
            if name:
                check_topic(name)
        except ValueError as error:
            raise ConfigurationError(f"{option}: {error}") from None
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
    ready: called when it is between them;  warn: called with what makes it ineffective, each sentence once

    Messages that cannot be read, or whose agent has no pose although `odometry` is named, are passed on unchanged.

    Returns `messages`, `changed`, `published`; by reason, `unattacked` (passed on unchanged) and `refused` (lost); and
    `failed`, the first error of the node. Raises NotRunning without a router.
    """
    arrived: queue.Queue[tuple[str, bytes]] = queue.Queue(_MOST_WAITING)
    unattacked: Counter[str] = Counter()
    number = 0  # of messages of objects
    if odometry:
        interposer.follow_poses()
    with Participant(connection, "mast_interposer") as participant:
        publisher = participant.publisher(topic, type_name)

        def keep(kind: str) -> Callable[[bytes, MessageAttachment], None]:
            def put(payload: bytes, _: MessageAttachment) -> None:
                try:
                    arrived.put_nowait((kind, payload))
                except queue.Full:
                    raise MessageError(f"overtaken: more than {_MOST_WAITING} messages wait for the node") from None

            return put

        def pass_on(kind: str, payload: bytes) -> None:
            if kind == type_store.ODOMETRY:
                interposer.add_pose(received_pose(type_store.decode(kind, payload)))
                return
            nonlocal number
            number += 1
            has_failed, before = interposer.failed, interposer.messages
            try:
                message = type_store.decode(kind, payload)
                results = interposer.through(message)
            except MessageError as error:
                publisher.publish_bytes(payload)
                what = str(error).partition(":")[0]
                reason = f"cannot be read as {kind}" if what == kind else what
                unattacked[reason] += 1
                if unattacked[reason] == 1:
                    warn(f"a message was passed on unchanged, more are only counted: {error}")
                return
            for each in results:
                publisher.publish(each)
            if not odometry and interposer.takes_poses and not before:
                frame = f"{message.header.frame_id!r:.80}"
                warn(f"no --odometry: to the node, the publisher is at the origin of {frame}, the frame of its objects")
            if interposer.failed and not has_failed:
                warn(f"{interposer.failed}: what the node fails on is passed on as it is")

        if odometry:
            participant.subscribe_bytes(odometry, type_store.ODOMETRY, keep(type_store.ODOMETRY))
        participant.subscribe_bytes(topic + BEFORE, type_name, keep(type_name))
        ready()
        warned = cache(warn)  # each sentence once
        with suppress(KeyboardInterrupt):
            while not stop.is_set():
                _watch(participant, topic, warned)
                _pass_on_next(arrived, pass_on, participant, odometry)
        deadline = time.monotonic() + _REST_S
        for _ in range(arrived.qsize()):
            if time.monotonic() < deadline:
                _pass_on_next(arrived, pass_on, participant, odometry)
        for _ in range(arrived.qsize()):
            participant.refuse(topic + BEFORE, "interrupted: the node had no time for it")
        counts = {"messages": number, "changed": interposer.changed, "published": publisher.sent}
    if interposer.jumps:
        warn(f"{topic}: the stamps have jumped {interposer.jumps} times: the attack's time stood still there")
    if not number:
        warn(f"nothing has arrived on {topic}{BEFORE}: nothing was attacked")
    if odometry and not interposer.placed:
        reason = "" if interposer.takes_poses else ": the node takes no poses"
        warn(f"{odometry}: no odometry was used{reason}")
    by_reason = {"unattacked": dict(unattacked), "refused": dict(participant.refused)}
    return counts | by_reason | {"failed": interposer.failed}


def _watch(participant: Participant, topic: str, warn: Callable[[str], None]) -> None:
    """Warn of what makes an interception ineffective."""
    for other in participant.publishers_of(topic)[:1]:
        name = f"{other.node.namespace.rstrip('/')}/{other.node.name}"
        warn(f"{name} publishes on {topic} itself: what it says is not attacked; start it with the topic remapped")
    if not participant.router:
        warn("there is no link to the router: meanwhile messages are lost")


def _pass_on_next(
    arrived: queue.Queue[tuple[str, bytes]],
    pass_on: Callable[[str, bytes], None],
    participant: Participant,
    odometry: str,
) -> None:
    """Pass the next message on, if there is one soon; count odometry that cannot be read."""
    try:
        pass_on(*arrived.get(timeout=_LOOK_S))
    except queue.Empty:
        pass
    except MessageError as error:
        participant.refuse(odometry, f"odometry that cannot be read: {error}")
