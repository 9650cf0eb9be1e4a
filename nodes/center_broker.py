"""The broker of a centre of centres: collates the pictures of regional centres, as a broker does the agents' tracks."""

from __future__ import annotations

from collections.abc import Iterable

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.pipelines.collation import Collated, Collation
from mast_zenoh.runtime.mesh.hosting import main


class CenterBroker(Node):
    """Collates the pictures of the centres, one batch a frame. For its parameters see `Broker`."""

    role = "broker"
    inputs = {"clock": "clock", "pictures": "picture"}
    outputs = {"collated": "collated"}

    def __init__(
        self, latency_s: float = 0.0, patience: int = 0, capacity: int = 10, max_age_s: float = MAX_AGE_S
    ) -> None:
        self.collation = Collation(latency_s, patience, capacity, max_age_s)

    def joined(self, node: str, role: str, context: Context) -> None:
        """Wait for a centre from now on."""
        if role == "center":
            self.collation.join(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """Stop waiting for a centre that has left, which may complete a batch."""
        self.collation.leave(node)
        self.emit(self.collation.complete(context.time_ns), context)

    def on_pictures(self, received: Received, context: Context) -> None:
        """Store the picture of a region."""
        states = ObjectStates.from_columns(received.body)
        self.collation.add(received.subject, received.frame, received.time_ns, states, received.body)
        self.emit(self.collation.complete(context.time_ns), context)

    def on_clock(self, received: Received, context: Context) -> None:
        """Open a new frame, and emit incomplete older ones that have waited long enough."""
        self.emit(self.collation.begin(received.frame, received.time_ns), context)
        self.emit(self.collation.complete(context.time_ns), context)

    def emit(self, batches: Iterable[Collated], context: Context) -> None:
        """Publish batches: the objects of all regions, predicted to their time."""
        for batch in batches:
            columns = batch.states.columns() | {"agent": batch.agent}
            agents = {"agents": text(list(batch.agents)), "age_ns": batch.age_ns}
            context.publish("collated", columns | agents, frame=batch.frame, time_ns=batch.time_ns)

    def finish(self, context: Context) -> dict[str, object]:
        """Numbers of complete and overdue batches, of late pictures, and of rejected ones."""
        return {"collation": self.collation.counts()}


if __name__ == "__main__":
    main(CenterBroker)
