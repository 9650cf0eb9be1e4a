"""What each kind of node of a run sends to ROS 2 in a frame, and what it takes back: an agent, a centre, an adversary.

Of a message in transit, a row that comes back with the values that were sent keeps its bytes, although ROS cannot
express all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mast_ros2 import type_store
from mast_ros2.frame_exchange import TF, About, AnswerTopic, FrameExchange, Timing
from mast_ros2.liveliness_tokens import ros2_name, topic_prefix
from mast_ros2.object_messages import detection_array, states_of, tracked_objects
from mast_ros2.received_objects import MOST_SPEED, TOO_FAST, ReceivedObjects, received_detections, received_tracks
from mast_ros2.received_poses import (
    POSES,
    FrameTransforms,
    Placement,
    ReceivedPose,
    composed,
    received_pose,
    stamped_poses,
)
from mast_ros2.spatial import Transform, odometry, transform_message
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.messages.schemas import Body
from mast_zenoh.outside import Outside
from mast_zenoh.sensing import to_world
from mast_zenoh.tracking.kalman import predicted

# -- the agent ---------------------------------------------------------------------------------------------------------

#: s, the age of a track's position up to which a velocity is taken from it and the newest one.
_VELOCITY_AGE_S = 1.0

Objects = Literal["tracks", "detections"]

#: Types of messages that can be tracks, detections, and a pose.
TRACK_TYPES = type_store.TRACKED_OBJECTS, type_store.DETECTIONS
DETECTION_TYPES = type_store.DETECTIONS, type_store.DETECTED_OBJECTS
POSE_TYPES = tuple(kind for kind in POSES if kind != type_store.TF_MESSAGE)


class AgentExchange(FrameExchange):
    """The exchange of one agent.

    name:    of its node;  agent_frame, world: names of its frame of reference and of the world's
    objects: whether tracks or detections are received, as a message of `object_type`
    pose_type: of the messages with its pose; "": it has that of the scene
    clock_topic: of the clock that it sends; "": none

    Topics are below /mast/NAME: odometry and detections are sent; `objects_topic` and `pose_topic` are received.

    Raises ValueError for unknown types, and for names that ROS does not allow.
    """

    def __init__(
        self,
        name: str,
        timing: Timing,
        *,
        objects: Objects,
        object_type: str,
        pose_type: str,
        world: str,
        clock_topic: str,
    ) -> None:
        prefix = topic_prefix(name)
        self.agent_frame, self.world = ros2_name(name), world
        self.odometry_topic, self.detections_topic = f"{prefix}/odometry", f"{prefix}/detections"
        self.objects_topic, self.pose_topic = f"{prefix}/received_{objects}", f"{prefix}/received_pose"
        self._velocities = Velocities()
        known = TRACK_TYPES if objects == "tracks" else DETECTION_TYPES
        read: Callable[[Any], ReceivedObjects[Any]] = received_tracks if objects == "tracks" else received_detections
        use = self._use_tracks if objects == "tracks" else self._use_detections
        answers = [AnswerTopic(self.objects_topic, _of("message", object_type, known), read, use)]
        self.has_pose = bool(pose_type)
        if pose_type:
            read_pose = received_pose if pose_type == "Odometry" else _received_place
            answers.append(AnswerTopic(self.pose_topic, _of("pose", pose_type, POSE_TYPES), read_pose, self._use_pose))
        self.questions = [topic.name for topic in answers]
        # An agent that is placed from outside has no frame of which the run says where it is.
        transforms = FrameTransforms(world, () if pose_type else (self.agent_frame,))
        super().__init__(answers, transforms, timing, clock_topic=clock_topic)

    def join(self, outside: Outside) -> bool:
        """Make the topics known, and wait for a node that answers; False if there is none."""
        outside.announce(self.odometry_topic, type_store.ODOMETRY)
        outside.announce(self.detections_topic, type_store.DETECTIONS)
        outside.announce(TF, type_store.TF_MESSAGE)
        return self.start(outside, [self.detections_topic, self.odometry_topic])

    def send(self, outside: Outside, frame: int, time_ns: int, pose: Body | None, detections: Detections) -> None:
        """Ask about a frame, and send it.

        pose: columns of a `pose` message, None: unknown;  detections: in the world
        """
        self.open_frame(outside, frame, time_ns, self.questions)
        if pose is not None:
            outside.send(self.odometry_topic, odometry(pose, time_ns, self.world, self.agent_frame))
            placed = Transform(self.world, self.agent_frame, time_ns, pose["position"], pose["rotation"])
            if not self.has_pose:
                outside.send(TF, transform_message([placed]))
                self.transforms.place_own(self.agent_frame, time_ns, Placement(placed.position, placed.rotation))
        outside.send(self.detections_topic, detection_array(states_of(detections), time_ns, self.world))

    def _use_tracks(self, received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> ObjectStates:
        tracks = states_to_world(received.objects, placement.position, placement.rotation)
        if self._topics[self.objects_topic].type_name == type_store.DETECTIONS:
            tracks = self._velocities.added(tracks, about.time_ns + about.skew_ns, self._period_ns() / 2e9)
            plausible = np.linalg.norm(tracks.velocity, axis=1) <= MOST_SPEED
            self.leave_out(TOO_FAST, int(np.count_nonzero(~plausible)))
            tracks = tracks.select(plausible)
        return predicted(tracks, -about.skew_ns * 1e-9)

    def _use_detections(
        self, received: ReceivedObjects[Detections], about: About, placement: Placement
    ) -> tuple[int, Detections]:
        """The time of the measurement, ns, and what was detected, world frame."""
        if about.late:
            raise MessageError("late: detections of an earlier frame, without which it was tracked")
        rotation = rotation_from_quaternion(placement.rotation)
        return about.time_ns + about.skew_ns, to_world(received.objects, placement.position, rotation)

    def _use_pose(self, received: ReceivedPose, about: About, placement: Placement) -> Placement:
        columns = received.columns
        pose = composed(placement, Placement(columns["position"], columns["rotation"]))
        velocity = rotation_from_quaternion(placement.rotation) @ columns["velocity"]
        return pose._replace(position=pose.position - velocity * about.skew_ns * 1e-9)


class Velocities:
    """Velocities of tracks that have none, from their positions in the message before."""

    def __init__(self) -> None:
        self._time_ns: int | None = None  # of what is known
        self._known: dict[int, tuple[Floats, Floats]] = {}  # positions and velocities by id

    def added(self, tracks: ObjectStates, time_ns: int, least_s: float) -> ObjectStates:
        """Tracks with the velocities of those that were known less than a second ago; the others have 0.

        least_s: s, time between messages below which velocities stay as they were: rounding would be all there is
        """
        elapsed_s = math.inf if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        velocity = np.zeros((len(tracks), 3))
        for row, (number, position) in enumerate(zip(tracks.id.tolist(), tracks.position, strict=True)):
            if number in self._known and abs(elapsed_s) <= _VELOCITY_AGE_S:
                before, known = self._known[number]
                velocity[row] = (position - before) / elapsed_s if elapsed_s > least_s else known
        if elapsed_s > least_s:
            self._time_ns = time_ns
            rows = zip(tracks.id.tolist(), tracks.position, velocity, strict=True)
            self._known = {number: (position, known) for number, position, known in rows}
        return tracks.with_(velocity=velocity)


def _received_place(message: RosMessage) -> ReceivedPose:
    """A pose without a velocity; raises MessageError for one that cannot be used."""
    placed = stamped_poses(message)
    if not placed.transforms:
        raise MessageError(f"pose: {next(iter(placed.dropped), 'none')}")
    (transform,) = placed.transforms
    columns = {"position": transform.position, "rotation": transform.rotation, "velocity": np.zeros(3)}
    return ReceivedPose(transform.parent, transform.child, transform.time_ns, columns)


def _of(parameter: str, name: str, types: Collection[str]) -> str:
    """The type of a name in scenarios, which is the last part of it."""
    named = {kind.rpartition("/")[2]: kind for kind in types}
    if name not in named:
        raise ValueError(f"{parameter}: found {name!r}, expected one of {', '.join(named)}")
    return named[name]


# -- the command centre ------------------------------------------------------------------------------------------------

#: m, on the ground, within which an agent's track supports an object of the picture.
SUPPORT_M = 2.0
#: Agents to which topics belong, at most.
MOST_AGENTS = 256


class CenterExchange(FrameExchange):
    """The exchange of one command centre.

    name: of its node; world: name of the world's frame; clock_topic: of the clock that it sends; "": none

    In each frame it sends one message for each agent, /mast/NAME/AGENT/tracks, in the order of their names; an empty
    one for an agent of which nothing is known. The picture is received as TrackedObjects on `picture_topic`.
    """

    def __init__(self, name: str, timing: Timing, *, world: str, clock_topic: str) -> None:
        self._prefix, self._world = topic_prefix(name), world
        self.picture_topic = f"{self._prefix}/received_picture"
        self._agents: dict[str, str] = {}  # topics by agent
        answer = AnswerTopic(self.picture_topic, type_store.TRACKED_OBJECTS, received_tracks, self._use)
        super().__init__([answer], FrameTransforms(world), timing, clock_topic=clock_topic)

    def join(self, outside: Outside, agents: Collection[str]) -> bool:
        """Make the topics known, and wait for a node that answers; False if there is none.

        Raises ConfigurationError for too many agents.
        """
        if len(agents) > MOST_AGENTS:
            raise ConfigurationError(f"agents: found {len(agents)}, expected at most {MOST_AGENTS} with ROS 2")
        for agent in sorted(agents):
            self._add(outside, agent)
        return self.start(outside, list(self._agents.values()))

    def send(self, outside: Outside, frame: int, time_ns: int, tracks: Mapping[str, ObjectStates]) -> None:
        """Ask about a frame, and send the tracks of each agent, world frame; agents that are too many are counted."""
        self.open_frame(outside, frame, time_ns, [self.picture_topic])
        for agent in sorted(tracks.keys() - self._agents.keys()):
            self._add(outside, agent)
        for agent, topic in sorted(self._agents.items()):
            states = tracks.get(agent, ObjectStates.empty())
            outside.send(topic, tracked_objects(states, time_ns, self._world))
        hidden = tracks.keys() - self._agents.keys()
        self.leave_out(f"agent: beyond {MOST_AGENTS}", sum(len(tracks[agent]) for agent in hidden))

    def _add(self, outside: Outside, agent: str) -> None:
        if len(self._agents) < MOST_AGENTS:
            self._agents[agent] = f"{self._prefix}/{ros2_name(agent)}/tracks"
            outside.announce(self._agents[agent], type_store.TRACKED_OBJECTS)

    def _use(self, received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> ObjectStates:
        states = states_to_world(received.objects, placement.position, placement.rotation)
        return predicted(states, -about.skew_ns * 1e-9)


def supports(picture: ObjectStates, tracks: ObjectStates, agent: Ints) -> Ints:
    """(n,) number of agents that have a track within SUPPORT_M of each object. agent: (m,) of each track"""
    offset = picture.position[:, None, :2] - tracks.position[None, :, :2]
    near = np.einsum("nmi,nmi->nm", offset, offset) <= SUPPORT_M**2
    rows = [near[:, agent == number].any(axis=1) for number in np.unique(agent)]
    return np.sum(rows, axis=0, dtype=np.int64) if rows else np.zeros(len(picture), np.int64)


# -- the adversary -----------------------------------------------------------------------------------------------------

Columns = dict[str, NDArray[Any]]

#: The type of the messages about each type of wire.
WIRE_TYPES: Mapping[str, str] = {
    "detections": type_store.DETECTIONS,
    "tracks": type_store.TRACKED_OBJECTS,
    "picture": type_store.TRACKED_OBJECTS,
}
#: Frame of reference that all messages are in: that of the wire, whatever it is.
FRAME = "intercepted"


@dataclass(frozen=True, slots=True)
class _InTransit:
    """A message in transit.

    type: of the message;  body: its columns
    expressed: its objects as they come back if nobody changes them, those that ROS can express
    """

    type: str
    body: Body
    expressed: ObjectStates

    def forged(self, returned: ObjectStates) -> Columns | None:
        """The columns to forward when these objects come back; None: the message as it was.

        An object with an id that was sent is that object: what is equal to what was sent keeps its bytes. Objects that
        ROS cannot express stay as they are, and no other one gets their ids.
        """
        ids = np.arange(len(self.body["score"])) if self.type == "detections" else self.body["id"]
        row_of_id = {number: row for row, number in enumerate(ids.tolist())}
        sent = {number: row for row, number in enumerate(self.expressed.id.tolist())}
        hidden_ids = row_of_id.keys() - sent.keys()
        hidden = sorted(row_of_id[number] for number in hidden_ids)
        returned = returned.select(np.array([number not in hidden_ids for number in returned.id.tolist()], bool))
        known = np.array([row for row, number in enumerate(returned.id.tolist()) if number in sent], int)
        sent_rows = [sent[number] for number in returned.id[known].tolist()]
        rows = np.array([row_of_id[number] for number in returned.id[known].tolist()], int)
        columns, untouched = {}, len(known) == len(returned) and sent_rows == [*range(len(self.expressed))]
        expressed = _columns(self.type, self.expressed)
        for name, values in _columns(self.type, returned).items():
            equal = values[known] == expressed[name][sent_rows]
            equal = equal.all(axis=tuple(range(1, equal.ndim)))
            untouched = untouched and bool(equal.all())
            column = values.astype(self.body[name].dtype)
            column[known[equal]] = self.body[name][rows[equal]]
            columns[name] = np.concatenate([column, self.body[name][hidden]])
        if untouched:
            return None
        if "support" in self.body:
            support = self.body["support"]
            usual = int(np.median(support)) if len(support) else 1
            own = np.full(len(returned), usual, np.int64)
            own[known] = support[rows]
            columns["support"] = np.concatenate([own, support[hidden]])
        return columns | {name: column for name, column in self.body.items() if name not in columns}


class AdversaryExchange(FrameExchange):
    """The exchange of one adversary.

    name: of its node;  wires: by (port, subject) of each, such as ("tracks", "infra_1"), the type of its messages

    What is in transit is sent on /mast/NAME/SUBJECT/PORT/in, and what comes back is received on .../out, both in the
    frame of reference of the wire, which is called `intercepted`. The wire of the picture has no subject.
    """

    def __init__(self, name: str, timing: Timing, wires: Mapping[tuple[str, str], str]) -> None:
        self._messages = wires
        self._types = {wire: WIRE_TYPES[message] for wire, message in wires.items()}
        self._sent: dict[tuple[str, int], _InTransit] = {}  # by topic of the answer, and frame
        self._prefix = topic_prefix(name)
        answers = [
            AnswerTopic(self.topic(wire, "out"), kind, received_tracks, self._use(self.topic(wire, "out")))
            for wire, kind in self._types.items()
        ]
        super().__init__(answers, FrameTransforms(FRAME), timing, listens_to_tf=False)

    def topic(self, wire: tuple[str, str], side: str) -> str:
        """The topic of a wire; side: in or out"""
        port, subject = wire
        return "/".join(part for part in (self._prefix, *map(ros2_name, subject.split("/")), port, side) if part)

    def join(self, outside: Outside) -> bool:
        """Make the topics known, and wait for a node that answers; False if there is none."""
        for wire, kind in self._types.items():
            outside.announce(self.topic(wire, "in"), kind)
        return self.start(outside, [self.topic(wire, "in") for wire in self._types])

    def send(self, outside: Outside, frame: int, wire: tuple[str, str], body: Body) -> bool:
        """Send a message in transit, and ask about it.

        False: it cannot be sent, because its frame is too old or was sent already, because ROS cannot express it, or
        because its wire was not there at the start.
        """
        topic, time_ns = self.topic(wire, "out"), self._times.get(frame)
        if time_ns is None or (topic, frame) in self._sent or wire not in self._types:
            return False
        try:
            message = _message(self._messages[wire], body, time_ns)
            expressed = received_tracks(type_store.decode(message.__msgtype__, type_store.encode(message))).objects
        except (MessageError, ValueError) as error:
            self.refuse(MessageError(f"not sent: {error}"))
            return False
        self._sent[topic, frame] = _InTransit(self._messages[wire], body, expressed)
        for old in [key for key in self._sent if key[1] not in self._times]:
            del self._sent[old]
        self.ask(outside, frame, [topic])
        outside.send(self.topic(wire, "in"), message)
        return True

    def _use(self, topic: str) -> Callable[[ReceivedObjects[ObjectStates], About, Placement], Columns | None]:
        def use(received: ReceivedObjects[ObjectStates], about: About, placement: Placement) -> Columns | None:
            if about.late:
                raise MessageError("late: the message has been forwarded as it was")
            return self._sent[topic, about.frame].forged(predicted(received.objects, -about.skew_ns * 1e-9))

        return use


def _message(kind: str, body: Body, time_ns: int) -> RosMessage:
    if kind == "detections":
        return detection_array(states_of(Detections.from_columns(body)), time_ns, FRAME)
    return tracked_objects(ObjectStates.from_columns(body), time_ns, FRAME)


def _columns(kind: str, states: ObjectStates) -> Columns:
    """The columns of objects in a message of a type, by name."""
    columns = states.columns()
    if kind != "detections":
        return columns
    return {name: columns[name] for name in DETECTION_COLUMNS} | {"covariance": states.covariance[:, :3, :3]}
