"""An agent whose perception is a node of ROS 2, or whose pose comes from there; see docs/how-to-ros2.md.

In each frame it sends the scene's clock, its pose and its detections to ROS 2. What comes back with the frame's stamp
are its tracks, or detections that its own pipeline tracks. In lock-step the frame waits for that, up to a limit.

A frame without an answer is that of an agent that is late: its tracks are sent as soon as they arrive, about the frame
that they are about. With detections, nothing was detected in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import numpy as np
from agent import Agent, Measurement, Perceived, sensor_in_world
from mast_ros2.frame_exchange import Timing
from mast_ros2.mesh import Connection
from mast_ros2.node_exchanges import AgentExchange
from mast_ros2.participant import joined

from mast_zenoh.arrays.geometry import states_to_local
from mast_zenoh.arrays.states import Detections
from mast_zenoh.fusion.pipelines import Pose
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, OutsideTopics, Received
from mast_zenoh.sensing import to_sensor

#: Frames without their answer that are kept.
MAX_OPEN = 64


class Ros2Agent(Agent):
    """An agent with a node of ROS 2 in it.

    others: the parameters of `Agent`
    ros2: router and domain, see `Connection`; None: rmw_zenoh's own
    receives: what comes from ROS 2: its tracks, or detections for its own pipeline
    message: type of these, TrackedObjects or Detection3DArray with ids; of detections, Detection3DArray or
        DetectedObjects; "": the first one
    pose: type of its pose from ROS 2, Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped; "": that of
        the scene
    wait_s: how long a frame waits in lock-step, s; start_s: how long the run waits for the node before its first frame
    skew_s: greatest distance of a stamp from the time of a frame, s
    stamps: the clock of stamps: the scene's, as on /clock, or the wall clock
    world: name of the world's frame; clock: topic of the clock that it sends, "": none
    """

    def __init__(
        self,
        ros2: Mapping[str, Any] | None = None,
        receives: Literal["tracks", "detections"] = "tracks",
        message: str = "",
        pose: str = "",
        wait_s: float = 1.0,
        start_s: float = 10.0,
        skew_s: float = 0.1,
        stamps: Literal["scene", "wall"] = "scene",
        world: str = "map",
        clock: str = "/clock",
        **others: Any,
    ) -> None:
        super().__init__(**others)
        self.connection = Connection.of(ros2 or {}, "ros2")
        timing = Timing(wait_s, skew_s, stamps, start_s)
        default = "TrackedObjects" if receives == "tracks" else "Detection3DArray"
        options = {"objects": receives, "object_type": message or default, "pose_type": pose}
        options |= {"world": world, "clock_topic": clock}
        self.receives = receives
        self.make_exchange = lambda name: AgentExchange(name, timing, **options)
        self.exchange = self.make_exchange("agent")  # raises errors at once
        self.velocity = np.zeros(3)
        self.open: dict[int, Perceived] = {}  # frames without their answer
        self.answers: dict[int, dict[str, Any]] = {}  # what has been answered about them, by topic
        self.newest = -1  # frame of the newest mission estimate

    def outside_topics(self, context: Context) -> OutsideTopics:
        """The topics of its tracks or detections, its pose, and frames of reference."""
        self.exchange = self.make_exchange(context.name)
        return OutsideTopics(partial(joined, self.connection), self.exchange.topics)

    def start(self, context: Context) -> None:
        """Wait for the node of ROS 2."""
        super().start(context)
        if not self.exchange.join(context.outside):
            topics = ", ".join(self.exchange.questions)
            context.log.warning("no node of ROS 2 publishes on all of %s: going on without", topics)

    def on_clock(self, received: Received, context: Context) -> None:
        """In real time, go on without the answers that have not arrived; then begin the frame."""
        if not context.outside.waits:
            self.settle(context)
            for frame in sorted(self.open):
                self.give_up(frame, context)
        super().on_clock(received, context)

    def on_pose(self, received: Received, context: Context) -> None:
        """The agent's pose in the scene."""
        self.velocity = received.body["velocity"]
        super().on_pose(received, context)

    def arrived(self, context: Context) -> None:
        """In real time, use answers as they arrive."""
        self.settle(context)

    def estimate(self, perceived: Perceived, context: Context) -> None:
        """Send a frame to ROS 2; in lock-step, wait for the answer."""
        frame, time_ns, pose, *_ = perceived
        body = {"position": pose.position, "rotation": pose.quaternion, "velocity": self.velocity}
        self.exchange.send(context.outside, frame, time_ns, body, perceived.detections())
        self.open[frame] = perceived
        for old in sorted(self.open)[:-MAX_OPEN]:
            del self.open[old]
            self.answers.pop(old, None)
        self.settle(context, frame)
        if context.outside.waits:
            self.give_up(frame, context)

    def settle(self, context: Context, frame: int = -1) -> None:
        """Use the answers that have arrived; frame: whose answers are waited for in lock-step"""
        for topic, about, content in self.exchange.collect(context.outside, frame):
            if about.frame in self.open:
                answers = self.answers.setdefault(about.frame, {})
                answers[topic] = content
                if len(answers) == len(self.exchange.questions):
                    self.publish(about.frame, context)

    def give_up(self, frame: int, context: Context) -> None:
        """Go on without an answer; only tracks can still be sent later."""
        answered = self.exchange.objects_topic in self.answers.get(frame, ())
        if frame in self.open and (answered or self.receives == "detections"):
            self.publish(frame, context)

    def publish(self, frame: int, context: Context) -> None:
        """Publish the estimates of a frame; of one that is older than the newest, only the tracks."""
        perceived, answers = self.open.pop(frame), self.answers.pop(frame, {})
        if (place := answers.get(self.exchange.pose_topic)) is not None:
            self.last = Pose(place.position, place.rotation)
            perceived = perceived._replace(pose=self.last)
        objects = answers.get(self.exchange.objects_topic)
        if self.receives == "tracks":
            tracks = states_to_local(objects, *self.pipeline.reference(perceived.pose))
        else:
            perceived = perceived._replace(measured=[self.measurement(perceived, objects)])
            tracks = self.track(perceived)
        self.publish_tracks(perceived, tracks, context)
        if frame > self.newest:
            self.newest = frame
            self.publish_mission(perceived, tracks, context)

    def measurement(self, perceived: Perceived, answer: tuple[int, Detections] | None) -> Measurement:
        """Detections in the world and their time, None: nothing at the frame's time, as its first sensor's.

        A tracker never goes back in time.
        """
        mount = perceived.mount
        if answer is None:
            return Measurement(max(perceived.time_ns, self.tracks_ns), 0, Detections.empty(), mount)
        time_ns, detections = answer
        own = to_sensor(detections, *sensor_in_world(perceived.pose, mount))
        return Measurement(max(time_ns, self.tracks_ns), 0, own, mount)

    def finish(self, context: Context) -> dict[str, Any]:
        """How often an answer was waited for, and missing; what its own tracker tells."""
        own = super().finish(context) if self.receives == "detections" else {}
        return {"outside": self.exchange.results(context.outside), **own}


if __name__ == "__main__":
    main(Ros2Agent)
