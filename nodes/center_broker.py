"""The broker of a centre of centres: collates the pictures of regional centres, as a broker does the agents' tracks."""

from __future__ import annotations

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.pipelines.collation import CollatingNode
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.mesh.hosting import main
from mast_zenoh.node import Context, Received


class CenterBroker(CollatingNode):
    """Collates the pictures of the centres, one batch a frame. For its parameters see `Broker`."""

    role = "broker"
    inputs = {"clock": "clock", "pictures": "picture"}
    outputs = {"collated": "collated"}
    collated_role = "center"

    def __init__(
        self, latency_s: float = 0.0, patience: int = 0, capacity: int = 10, max_age_s: float = MAX_AGE_S
    ) -> None:
        super().__init__(latency_s, patience, capacity, max_age_s)

    def on_pictures(self, received: Received, context: Context) -> None:
        """Store the picture of a region."""
        self.collate(received, ObjectStates.from_columns(received.body), context)

    def finish(self, context: Context) -> dict[str, object]:
        """Numbers of complete and overdue batches, of late pictures, and of rejected ones."""
        return {"collation": super().finish(context)["collation"]}


if __name__ == "__main__":
    main(CenterBroker)
