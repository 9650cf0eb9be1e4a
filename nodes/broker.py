"""The broker: collates the tracks of all agents at one time, in the world frame.

It discovers agents by their presence on the mesh and their first status, and forgets agents that leave. A batch is
emitted when all agents have sent their tracks, or when the clock of the next frame arrives: a dead or silent agent
does not stall it. Every batch has the newest tracks of each agent, however late they arrived, predicted to the time of
the batch, until they are too old. Its handlers are those of `CollatingNode`.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.fusion.pipelines.collation import Collated, CollatingNode
from mast_zenoh.integrity.views import collated_columns
from mast_zenoh.mesh.hosting import main
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context


class Broker(CollatingNode):
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

    def emit(self, batch: Collated, context: Context) -> None:
        """Publish a batch: every agent's newest tracks, predicted to its time, and every agent's latest view."""
        super().emit(batch, context)
        if self.with_views:
            bodies = [body for body, _ in batch.views.values()]
            ages = np.array([age for _, age in batch.views.values()], np.int64)
            agents = {"agents": text(list(batch.views)), "age_ns": ages}
            columns = {**agents, **collated_columns(bodies)}
            context.publish("views", columns, frame=batch.frame, time_ns=batch.time_ns)


if __name__ == "__main__":
    main(Broker)
