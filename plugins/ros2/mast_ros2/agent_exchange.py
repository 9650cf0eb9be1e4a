"""What an agent sends to ROS 2 in each frame, and what it takes back as its tracks, its detections or its pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any, Literal

import numpy as np

from mast_ros2 import type_store
from mast_ros2.frame_exchange import TF, About, AnswerTopic, FrameExchange, Timing
from mast_ros2.liveliness_tokens import ros2_name, topic_prefix
from mast_ros2.object_messages import detection_array, states_of
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
from mast_zenoh.arrays.states import Detections, Floats, ObjectStates
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import Body
from mast_zenoh.outside import Outside
from mast_zenoh.sensing import to_world
from mast_zenoh.tracking.kalman import predicted

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
        tracks = _in_world(received.objects, placement)
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


def _in_world(states: ObjectStates, placement: Placement) -> ObjectStates:
    return states_to_world(states, placement.position, placement.rotation)


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
