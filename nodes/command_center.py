"""The command centre: clusters and fuses the agents' tracks into a picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.pipelines import Pipeline
from mast_zenoh.fusion.pipelines.command_center import FusingNode
from mast_zenoh.integrity.views import SweptView, views_of
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Received

#: Views that wait for their batches, at most; the oldest are dropped.
MAX_WAITING = 64


class CommandCenter(FusingNode):
    """Turns each batch into a picture.

    pipeline: from the agents' tracks to the picture; `CommandCenterPipeline` is the one in the paper's listing
    """

    role = "command_center"
    inputs = {"clock": "clock", "collated": "collated", "views": "views"}
    outputs = {"picture": "picture", "trust": "trust"}

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.processed: deque[int] = deque(maxlen=64)  # frames of the latest batches
        self.expects_views = False
        self.waiting: dict[int, Received] = {}  # batches without their views yet, by frame
        self.views: dict[int, Mapping[str, SweptView]] = {}  # views without their batch yet

    def start(self, context: Context) -> None:
        """Wait for views with each batch, if agents send any."""
        super().start(context)
        self.expects_views = any(source.port == "views" for source in context.subscriptions.values())

    def on_clock(self, received: Received, context: Context) -> None:
        """Process batches of the frame before whose views have not arrived; the broker applies all other deadlines."""
        for frame in sorted(self.waiting):
            self.process(self.waiting.pop(frame), context)

    def on_views(self, received: Received, context: Context) -> None:
        """Process the batch that the views belong to; without views if they are malformed."""
        try:
            views = views_of(received.body)
        except ValueError as error:
            context.reject(f"malformed: views: {error}")
            views = {}
        if (batch := self.waiting.pop(received.frame, None)) is None:
            self.views.setdefault(received.frame, views)  # a link may delay the batch
            if len(self.views) > MAX_WAITING:
                del self.views[min(self.views)]
        else:
            self.process(batch, context, views)

    def on_collated(self, received: Received, context: Context) -> None:
        """Publish one picture for each batch, about the same frame, once its views have arrived.

        A second batch of a frame is ignored.
        A pipeline never goes back in time: a batch that is older than the previous one is rejected.
        """
        if received.frame in self.processed or received.frame in self.waiting:
            return
        views = self.views.pop(received.frame, None)
        if self.expects_views and views is None:
            self.waiting[received.frame] = received
        else:
            self.process(received, context, views)

    def process(self, received: Received, context: Context, views: Mapping[str, SweptView] | None = None) -> None:
        """Publish the picture of a batch, and the trust that the pipeline has in agents and objects."""
        frame, time_ns, body = received.frame, received.time_ns, received.body
        if not self.advances(time_ns, context, "collated", "at least {}, the time of the previous batch"):
            return
        self.processed.append(frame)
        if views is not None:
            self.pipeline.look(views)
        states, agents = ObjectStates.from_columns(body), tuple(body["agents"])
        picture, support = self.pipeline.step(time_ns, states, body["agent"], agents)
        context.publish("picture", picture.columns() | {"support": support}, frame=frame, time_ns=time_ns)
        self.publish_trust(frame, time_ns, context)


if __name__ == "__main__":
    main(CommandCenter)
