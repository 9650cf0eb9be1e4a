"""The command centre: clusters and fuses the collated tracks, tracks the result, and publishes the picture."""

from __future__ import annotations

from collections import deque

from mast_zenoh.fusion import Pipeline
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.process import main
from mast_zenoh.states import ObjectStates


class CommandCenter(Node):
    """pipeline: from the agents' tracks to the picture; `CommandCenterPipeline` is that of the paper's listing."""

    role = "command_center"
    inputs = {"clock": "clock", "collated": "collated"}
    outputs = {"picture": "picture"}

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.taken: deque[int] = deque(maxlen=64)  # frames of the newest batches

    def on_clock(self, received: Received, context: Context) -> None:
        """Nothing to do: the broker judges the deadlines."""

    def on_collated(self, received: Received, context: Context) -> None:
        """One batch in, one picture out, about the same frame; a second batch of a frame is a duplicate."""
        if received.frame in self.taken:
            return
        self.taken.append(received.frame)
        body = received.body
        picture, support = self.pipeline.step(
            received.time_ns, ObjectStates.from_columns(body), body["agent"], tuple(body["agents"])
        )
        context.publish(
            "picture", picture.columns() | {"support": support}, frame=received.frame, time_ns=received.time_ns
        )


if __name__ == "__main__":
    main(CommandCenter)
