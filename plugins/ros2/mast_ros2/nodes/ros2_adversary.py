"""An adversary on a wire that is a node of ROS 2; see docs/how-to-ros2.md#nodes-of-ros-2-in-a-run.

It sends what it intercepts, and forwards what comes back with the frame's stamp, under the original header: keys,
numbers and untouched rows stay as they are. In lock-step the message waits for that, up to a limit; in real time until
the next frame begins. Without an answer it is forwarded unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

from mast_ros2.frame_exchange import Timing
from mast_ros2.mesh import Connection
from mast_ros2.node_exchanges import WIRE_TYPES, AdversaryExchange
from mast_ros2.participant import joined

from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Node, OutsideTopics, Received

#: Messages that wait for their answer in real time, at most.
MAX_WAITING = 256


class Ros2Adversary(Node):
    """Has a node of ROS 2 manipulate detections, tracks or pictures.

    agent: the compromised agent, whose wires it is on, or several of them
    ros2: router and domain, see `Connection`; None: rmw_zenoh's own
    wait_s, start_s, skew_s, stamps: see `Ros2Agent`
    """

    role = "adversary"
    inputs = {"clock": "clock"}
    forwards = tuple(WIRE_TYPES)

    def __init__(
        self,
        agent: str | tuple[str, ...],
        ros2: Mapping[str, Any] | None = None,
        wait_s: float = 1.0,
        start_s: float = 10.0,
        skew_s: float = 0.1,
        stamps: Literal["scene", "wall"] = "scene",
    ) -> None:
        self.connection = Connection.of(ros2 or {}, "ros2")
        timing = Timing(wait_s, skew_s, stamps, start_s)
        self.make_exchange = lambda name, wires: AdversaryExchange(name, timing, wires)
        self.exchange = self.make_exchange("adversary", {})
        self.waiting: dict[tuple[int, str], Received] = {}  # by frame, and topic of the answer

    def outside_topics(self, context: Context) -> OutsideTopics:
        """The topics of what comes back, one for each wire."""
        inputs = [wire for wire in context.subscriptions.values() if wire.port != "clock"]
        wires = {(wire.port, wire.subject): wire.message for wire in inputs}
        self.exchange = self.make_exchange(context.name, dict(sorted(wires.items())))
        return OutsideTopics(partial(joined, self.connection), self.exchange.topics)

    def start(self, context: Context) -> None:
        """Wait for the node of ROS 2."""
        if not self.exchange.join(context.outside):
            context.log.warning("no node of ROS 2 publishes on all topics that end with /out: going on without")

    def on_clock(self, received: Received, context: Context) -> None:
        """Begin a frame; in real time, forward what has no answer: more delay could be noticed."""
        if not context.outside.waits:
            self.settle(context)
            self.give_up(context)
        self.exchange.begin(received.frame, received.time_ns)

    def on_message(self, received: Received, context: Context) -> None:
        """Send a message in transit to ROS 2; in lock-step, wait for the answer."""
        wire = (received.port, received.subject)
        if len(self.waiting) >= MAX_WAITING or not self.exchange.send(
            context.outside, received.frame, wire, received.body
        ):
            context.relay(f"{received.port}_out", received)
            return
        self.waiting[received.frame, self.exchange.topic(wire, "out")] = received
        self.settle(context, received.frame)
        if context.outside.waits:
            self.give_up(context)

    def arrived(self, context: Context) -> None:
        """In real time, forward answers as they arrive."""
        self.settle(context)

    def settle(self, context: Context, frame: int = -1) -> None:
        """Forward the answers that have arrived; frame: whose answers are waited for in lock-step"""
        for topic, about, columns in self.exchange.collect(context.outside, frame):
            received = self.waiting.pop((about.frame, topic), None)
            if received is not None:
                context.relay(f"{received.port}_out", received, columns)

    def give_up(self, context: Context) -> None:
        """Forward what has no answer as it is."""
        for received in self.waiting.values():
            context.relay(f"{received.port}_out", received)
        self.waiting.clear()

    def finish(self, context: Context) -> dict[str, Any]:
        """How often an answer was waited for, and missing."""
        return {"outside": self.exchange.results(context.outside)}


if __name__ == "__main__":
    main(Ros2Adversary)
