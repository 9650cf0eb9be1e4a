"""A regional centre: collates and fuses the tracks of one region.

It does for its region what a broker and a command centre do for a whole scene. Agents send their tracks to all centres;
each uses those in its region and in a margin around it, and publishes the objects of the region, with a small overlap.
So an object that crosses a border is tracked on both sides before it changes hands. A region may move with an agent: a
centre on board.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.fusion.pipelines import Pipeline
from mast_zenoh.fusion.pipelines.collation import Collated, CollatingNode
from mast_zenoh.fusion.pipelines.command_center import FusingNode
from mast_zenoh.fusion.regions import ServedArea
from mast_zenoh.gather import MAX_AGE_S, LatestBefore
from mast_zenoh.integrity.views import view_of
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Received


class Center(CollatingNode, FusingNode):
    """Turns each batch of its region's tracks into a picture of the region.

    pipeline: from the agents' tracks to the picture, as in a command centre; region: its area
    margin_m: m around the region, in which tracks are used; overlap_m: m around it, in which objects are published
    latency_s, patience, capacity, max_age_s, input_limit: of the collation, as in a broker
    """

    role = "center"
    inputs = {"clock": "clock", "tracks": "tracks", "view": "view", "status": "status", "pose": "pose"}
    outputs = {"picture": "picture", "trust": "trust"}

    def __init__(
        self,
        pipeline: Pipeline,
        region: ServedArea,
        margin_m: float = 20.0,
        overlap_m: float = 2.0,
        latency_s: float = 0.0,
        patience: int = 0,
        capacity: int = 10,
        max_age_s: float = MAX_AGE_S,
        input_limit: InputLimit | None = None,
    ) -> None:
        if not 0.0 <= overlap_m <= margin_m < float("inf"):
            raise ValueError(f"margin_m, overlap_m: found {margin_m}, {overlap_m}, expected 0 <= overlap_m <= margin_m")
        super().__init__(latency_s, patience, capacity, max_age_s, input_limit)
        self.pipeline = pipeline
        self.region = region
        self.margin_m, self.overlap_m = margin_m, overlap_m
        self.poses: LatestBefore[np.ndarray] = LatestBefore()  # positions of the agent that carries the centre

    def start(self, context: Context) -> None:
        """Refuse a region that moves with an agent without the agent's pose."""
        super().start(context)
        ports = {source.port for source in context.subscriptions.values()}
        if self.region.follows and "pose" not in ports:
            kind = type(self.region).__name__
            raise ConfigurationError(
                f"{context.name}: region: found {kind}, which follows an agent, but no wire brings `pose`: "
                "add a [[listen]] as in center_on_board.toml, or choose Rectangle"
            )

    def on_pose(self, received: Received, context: Context) -> None:
        """The pose of the agent that carries the centre: its region moves with it from the next frame on."""
        self.poses.add(context.frame, received.body["position"], received.frame)

    def on_clock(self, received: Received, context: Context) -> None:
        """Move the region, and fuse incomplete older frames that have waited long enough."""
        if (latest := self.poses.get(received.frame)) is not None:
            self.region.move_to(latest[1])
        super().on_clock(received, context)

    def emit(self, batch: Collated, context: Context) -> None:
        """Publish the picture of the region for a batch, and the trust in agents and objects."""
        if not self.advances(batch.time_ns, context, f"frame {batch.frame}"):
            return
        if self.with_views:
            views = {name: view_of(body, age_ns * 1e-9) for name, (body, age_ns) in batch.views.items()}
            self.pipeline.look(views)
        inside = self.region.contains(batch.states.position, self.margin_m)
        states, agent = batch.states.select(inside), batch.agent[inside]
        picture, support = self.pipeline.step(batch.time_ns, states, agent, batch.agents)
        own = self.region.contains(picture.position, self.overlap_m)
        columns = picture.select(own).columns() | {"support": support[own]}
        context.publish("picture", columns, frame=batch.frame, time_ns=batch.time_ns)
        self.publish_trust(batch.frame, batch.time_ns, context)


if __name__ == "__main__":
    main(Center)
