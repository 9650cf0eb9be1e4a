"""A regional centre: collates and fuses the tracks of one region.

It does for its region what a broker and a command centre do for a whole scene. Agents send their tracks to all centres;
each uses those in its region and in a margin around it, and publishes the objects of the region, with a small overlap.
So an object that crosses a border is tracked on both sides before it changes hands. A region may move with an agent: a
centre on board.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import tracks_in_world
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.fusion.regions import Region
from mast_zenoh.gather import MAX_AGE_S, LatestBefore
from mast_zenoh.integrity.views import check_view, view_of
from mast_zenoh.messages.limits import RowChoice
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines import Pipeline, trust_body
from mast_zenoh.pipelines.collation import Collated, Collation
from mast_zenoh.runtime.mesh.hosting import main


class Center(Node):
    """Turns each batch of its region's tracks into a picture of the region.

    pipeline: from the agents' tracks to the picture, as in a command centre; region: its area
    margin_m: m around the region, in which tracks are used; overlap_m: m around it, in which objects are published
    latency_s, patience, capacity, max_age_s, input_limit: of the collation, as in a broker
    """

    role = "center"
    inputs = {"clock": "clock", "tracks": "tracks", "view": "view", "status": "status", "pose": "pose"}
    outputs = {"picture": "picture", "trust": "trust"}
    fuses = ("picture", "trust")

    def __init__(
        self,
        pipeline: Pipeline,
        region: Region,
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
        self.pipeline = pipeline
        self.region = region
        self.margin_m, self.overlap_m = margin_m, overlap_m
        self.collation = Collation(latency_s, patience, capacity, max_age_s, input_limit)
        self.poses: LatestBefore[np.ndarray] = LatestBefore()  # positions of the agent that carries the centre
        self.newest_ns = 0

    def start(self, context: Context) -> None:
        """Collate views, too, if agents send any."""
        self.pipeline.bind(context.seed, context.name)
        ports = {source.port for source in context.subscriptions.values()}
        self.collation.with_views = "view" in ports
        if self.region.follows and "pose" not in ports:
            kind = type(self.region).__name__
            raise ConfigurationError(
                f"{context.name}: region: found {kind}, which follows an agent, but no wire brings `pose`: "
                "add a [[listen]] as in center_on_board.toml, or choose Rectangle"
            )

    def choice(self, port: str, subject: str, step: int) -> RowChoice | None:
        """Of too many rows, those that the input limit keeps."""
        return self.collation.admission.choice(subject, step) if port == "tracks" else None

    def joined(self, node: str, role: str, context: Context) -> None:
        """Wait for an agent from now on."""
        if role == "agent":
            self.collation.join(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """Stop waiting for an agent that has left, which may complete a batch."""
        self.collation.leave(node)
        self.fuse(self.collation.complete(context.time_ns), context)

    def on_status(self, received: Received, context: Context) -> None:
        """Add the agent from the next frame onwards, whether or not its presence was announced."""
        self.collation.meet(received.subject)

    def on_pose(self, received: Received, context: Context) -> None:
        """The pose of the agent that carries the centre: its region moves with it from the next frame on."""
        self.poses.add(context.frame, received.body["position"], received.frame)

    def on_tracks(self, received: Received, context: Context) -> None:
        """Store an agent's tracks, in the world frame."""
        states = tracks_in_world(received.body)
        self.collation.add(received.subject, received.frame, received.time_ns, states, received.body)
        self.fuse(self.collation.complete(context.time_ns), context)

    def on_view(self, received: Received, context: Context) -> None:
        """Store what an agent's sensor covers."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"implausible: view: {error}")
            return
        self.collation.add_view(received.subject, received.frame, received.time_ns, received.body)
        self.fuse(self.collation.complete(context.time_ns), context)

    def on_clock(self, received: Received, context: Context) -> None:
        """Open a new frame, and fuse incomplete older ones that have waited long enough."""
        if (latest := self.poses.get(received.frame)) is not None:
            self.region.move_to(latest[1])
        self.fuse(self.collation.begin(received.frame, received.time_ns), context)
        self.fuse(self.collation.complete(context.time_ns), context)

    def fuse(self, batches: Iterable[Collated], context: Context) -> None:
        """Publish the picture of the region for each batch, and the trust in agents and objects."""
        for batch in batches:
            if batch.time_ns < self.newest_ns:
                context.reject(f"old: frame {batch.frame}: time_ns is {batch.time_ns}, expected {self.newest_ns}")
                continue
            self.newest_ns = batch.time_ns
            about = {"frame": batch.frame, "time_ns": batch.time_ns}
            if self.collation.with_views:
                views = {name: view_of(body, age_ns * 1e-9) for name, (body, age_ns) in batch.views.items()}
                self.pipeline.look(views)
            inside = self.region.contains(batch.states.position, self.margin_m)
            states, agent = batch.states.select(inside), batch.agent[inside]
            picture, support = self.pipeline.step(batch.time_ns, states, agent, batch.agents)
            own = self.region.contains(picture.position, self.overlap_m)
            columns = picture.select(own).columns() | {"support": support[own]}
            context.publish("picture", columns, **about)
            if self.pipeline.trust is not None:
                context.publish("trust", trust_body(self.pipeline.trust), **about)

    def finish(self, context: Context) -> dict[str, Any]:
        """The counts of the collation, tracks left out by agent, and what the pipeline counted."""
        collated = {"collation": self.collation.counts(), "left_out": self.collation.admission.counts()}
        return self.pipeline.results() | collated


if __name__ == "__main__":
    main(Center)
