"""The broker: collates the tracks of all agents at one time, in the world frame.

It discovers agents by their presence on the mesh and their first status, and forgets agents that leave. A batch is
emitted when all agents have sent their tracks, or when the clock of the next frame arrives: a dead or silent agent
does not stall it. Every batch has the newest tracks of each agent, however late they arrived, predicted to the time of
the batch, until they are too old.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mast_zenoh.arrays.geometry import tracks_in_world
from mast_zenoh.fusion.input_limit import InputLimit
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.integrity.views import check_view, collated_columns
from mast_zenoh.messages.limits import RowChoice
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines.collation import Collated, Collation
from mast_zenoh.runtime.mesh.hosting import main


class Broker(Node):
    """Collates the agents' tracks, one batch a frame.

    latency_s: age at which frames are emitted; patience: number of clocks, after that of its own frame, to wait for a
    missing message; capacity: messages kept per agent; max_age_s: the greatest age of an agent's tracks in a batch
    input_limit: which tracks a batch has, if there are too many; None: FairInput, with as many as the scene needs

    The header gives the frame of a message and its time: an agent whose clock is wrong still completes its batches,
    and its tracks are predicted from the time in the header, forward or back, to the batch's time. A time that is
    off by more than `max_age_s`, either way, counts as too old.
    """

    role = "broker"
    inputs = {"clock": "clock", "tracks": "tracks", "view": "view", "status": "status"}
    outputs = {"collated": "collated", "views": "views"}
    affects = {"tracks": {"collated": 0}, "view": {"views": 0}}

    def __init__(
        self,
        latency_s: float = 0.0,
        patience: int = 0,
        capacity: int = 10,
        max_age_s: float = MAX_AGE_S,
        input_limit: InputLimit | None = None,
    ) -> None:
        self.collation = Collation(latency_s, patience, capacity, max_age_s, input_limit)

    def start(self, context: Context) -> None:
        """Collate views, too, if agents send any."""
        self.collation.with_views = any(source.port == "view" for source in context.subscriptions.values())

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
        self.emit_complete(context)

    def on_status(self, received: Received, context: Context) -> None:
        """Add the agent from the next frame onwards, whether or not its presence was announced."""
        self.collation.meet(received.subject)

    def on_tracks(self, received: Received, context: Context) -> None:
        """Store an agent's tracks, in the world frame."""
        states = tracks_in_world(received.body)
        self.collation.add(received.subject, received.frame, received.time_ns, states, received.body)
        self.emit_complete(context)

    def on_view(self, received: Received, context: Context) -> None:
        """Store what an agent's sensor covers."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"implausible: view: {error}")
            return
        self.collation.add_view(received.subject, received.frame, received.time_ns, received.body)
        self.emit_complete(context)

    def on_clock(self, received: Received, context: Context) -> None:
        """Open a new frame, and emit incomplete older ones that have waited long enough."""
        self.emit(self.collation.begin(received.frame, received.time_ns), context)
        self.emit_complete(context)

    def emit_complete(self, context: Context) -> None:
        """Emit frames that are old enough and have all agents' tracks, oldest first."""
        if batches := self.collation.complete(context.time_ns):
            self.emit(batches, context)

    def emit(self, batches: Iterable[Collated], context: Context) -> None:
        """Publish batches: every agent's newest tracks, predicted to their time, and every agent's latest view."""
        for batch in batches:
            about = {"frame": batch.frame, "time_ns": batch.time_ns}
            agents = {"agents": text(list(batch.agents)), "age_ns": batch.age_ns}
            context.publish("collated", batch.states.columns() | {"agent": batch.agent} | agents, **about)
            if self.collation.with_views:
                bodies = [body for body, _ in batch.views.values()]
                ages = np.array([age for _, age in batch.views.values()], np.int64)
                agents = {"agents": text(list(batch.views)), "age_ns": ages}
                context.publish("views", {**agents, **collated_columns(bodies)}, **about)

    def finish(self, context: Context) -> dict[str, object]:
        """Numbers of complete and overdue batches, of late messages, of rejected ones, and of tracks left out."""
        return {"collation": self.collation.counts(), "left_out": self.collation.admission.counts()}


if __name__ == "__main__":
    main(Broker)
