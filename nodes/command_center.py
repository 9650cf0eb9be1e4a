"""The command centre: clusters and fuses the agents' tracks into a picture."""

from __future__ import annotations

from collections import deque

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import Pipeline
from mast_zenoh.runtime.mesh.main import main


class CommandCenter(Node):
    """Turns each batch into a picture.

    pipeline: from the agents' tracks to the picture; `CommandCenterPipeline` is the one in the paper's listing
    """

    role = "command_center"
    inputs = {"clock": "clock", "collated": "collated"}
    outputs = {"picture": "picture"}

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.processed: deque[int] = deque(maxlen=64)  # frames of the latest batches
        self.newest_ns = 0  # time of the pipeline's last step

    def on_clock(self, received: Received, context: Context) -> None:
        """Do nothing: the broker applies the deadlines."""

    def on_collated(self, received: Received, context: Context) -> None:
        """Publish one picture for each batch, about the same frame.

        A second batch of a frame is ignored.
        A pipeline never goes back in time: a batch that is older than the previous one is rejected.
        """
        if received.frame in self.processed:
            return
        if received.time_ns < self.newest_ns:
            least = f"{self.newest_ns}, the time of the previous batch"
            context.reject(f"old: collated: time_ns is {received.time_ns}, expected at least {least}")
            return
        self.processed.append(received.frame)
        self.newest_ns = received.time_ns
        body = received.body
        picture, support = self.pipeline.step(
            received.time_ns, ObjectStates.from_columns(body), body["agent"], tuple(body["agents"])
        )
        context.publish(
            "picture", picture.columns() | {"support": support}, frame=received.frame, time_ns=received.time_ns
        )


if __name__ == "__main__":
    main(CommandCenter)
