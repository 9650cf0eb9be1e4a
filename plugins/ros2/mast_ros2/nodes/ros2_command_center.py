"""A command centre whose fusion, or whose defence, is a node of ROS 2; see docs/how-to-ros2.md#nodes-of-ros-2-in-a-run.

In each frame it sends the tracks that each agent reported, and publishes what comes back with the frame's stamp as the
picture. In lock-step the frame waits for that, up to a limit. The picture of a frame without an answer is the last one,
predicted at constant velocity until it is too old, then an empty one: there is always one a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import numpy as np
from mast_ros2.frame_exchange import Timing
from mast_ros2.mesh import Connection
from mast_ros2.node_exchanges import CenterExchange, supports
from mast_ros2.participant import joined

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.mesh.hosting import main
from mast_zenoh.metrics.estimates import LOCAL
from mast_zenoh.node import Context, Node, OutsideTopics, Received
from mast_zenoh.tracking.kalman import predicted

#: Frames that wait for their answer, at most.
MAX_OPEN = 64


class Ros2CommandCenter(Node):
    """Sends each batch to ROS 2, and publishes the picture from there. It has no trust of its own.

    ros2: router and domain, see `Connection`; None: rmw_zenoh's own
    picture_age_s: s, the age up to which the last picture stands in for one that has not arrived
    wait_s, start_s, skew_s, stamps, world, clock: see `Ros2Agent`
    """

    role = "command_center"
    inputs = {"clock": "clock", "collated": "collated"}
    outputs = {"picture": "picture"}

    def __init__(
        self,
        ros2: Mapping[str, Any] | None = None,
        picture_age_s: float = 0.5,
        wait_s: float = 1.0,
        start_s: float = 10.0,
        skew_s: float = 0.1,
        stamps: Literal["scene", "wall"] = "scene",
        world: str = "map",
        clock: str = "/clock",
    ) -> None:
        if picture_age_s < 0.0:
            raise ValueError(f"picture_age_s: found {picture_age_s}, expected 0 or more")
        self.connection = Connection.of(ros2 or {}, "ros2")
        timing = Timing(wait_s, skew_s, stamps, start_s)
        self.make_exchange = lambda name: CenterExchange(name, timing, world=world, clock_topic=clock)
        self.exchange = self.make_exchange("command_center")
        self.picture_age_ns = round(picture_age_s * 1e9)
        self.newest = -1  # frame of the newest batch
        self.open: dict[int, Received] = {}  # batches without their picture
        self.last: tuple[int, ObjectStates] | None = None  # the newest picture from ROS 2, and its time
        self.predicted = 0

    def outside_topics(self, context: Context) -> OutsideTopics:
        """The topics of the picture, and of frames of reference."""
        self.exchange = self.make_exchange(context.name)
        return OutsideTopics(partial(joined, self.connection), self.exchange.topics)

    def start(self, context: Context) -> None:
        """Wait for the node of ROS 2."""
        agents = {wire.subject for wire in context.wiring.wires if wire.traits.estimate == LOCAL}
        if not self.exchange.join(context.outside, agents):
            context.log.warning("no node of ROS 2 publishes on %s: going on without", self.exchange.picture_topic)

    def on_clock(self, received: Received, context: Context) -> None:
        """In real time, go on without the pictures that have not arrived."""
        if not context.outside.waits:
            self.settle(context)
            self.give_up(context)

    def on_collated(self, received: Received, context: Context) -> None:
        """Send a batch to ROS 2, if it is newer than the ones before; in lock-step, wait for the picture."""
        if received.frame <= self.newest:
            context.reject(f"old: collated: frame {received.frame}, expected one after {self.newest}")
            return
        self.newest = received.frame
        body = received.body
        states, agent = ObjectStates.from_columns(body), body["agent"]
        tracks = {name: states.select(agent == row) for row, name in enumerate(body["agents"])}
        self.exchange.send(context.outside, received.frame, received.time_ns, tracks)
        self.open[received.frame] = received
        self.settle(context, received.frame)
        if context.outside.waits or len(self.open) > MAX_OPEN:
            self.give_up(context)

    def arrived(self, context: Context) -> None:
        """In real time, publish pictures as they arrive."""
        self.settle(context)

    def settle(self, context: Context, frame: int = -1) -> None:
        """Publish the pictures that have arrived; frame: whose picture is waited for in lock-step"""
        for _, about, picture in self.exchange.collect(context.outside, frame):
            if self.last is None or about.time_ns > self.last[0]:
                self.last = about.time_ns, picture
            if about.frame in self.open:
                self.publish(self.open.pop(about.frame), picture, context)

    def give_up(self, context: Context) -> None:
        """Publish a picture for each batch that has none, from the last one."""
        for frame in sorted(self.open):
            received = self.open.pop(frame)
            time_ns, picture = self.last or (received.time_ns, ObjectStates.empty())
            if not 0 <= received.time_ns - time_ns <= self.picture_age_ns:
                picture = ObjectStates.empty()
            self.predicted += len(picture) > 0
            self.publish(received, predicted(picture, (received.time_ns - time_ns) * 1e-9), context)

    def publish(self, received: Received, picture: ObjectStates, context: Context) -> None:
        """Publish the picture of a batch; an object's support is the number of agents with a track close to it."""
        body = received.body
        support = supports(picture, ObjectStates.from_columns(body), np.asarray(body["agent"]))
        columns = picture.columns() | {"support": support}
        context.publish("picture", columns, frame=received.frame, time_ns=received.time_ns)

    def finish(self, context: Context) -> dict[str, Any]:
        """How often an answer was waited for, and missing, and how many pictures were predicted instead."""
        return {"outside": {**self.exchange.results(context.outside), "predicted": self.predicted}}


if __name__ == "__main__":
    main(Ros2CommandCenter)
