"""The broker: collates the tracks of all agents at one time, in the world frame.

It discovers agents by their presence on the mesh and their first status, and forgets agents that leave. A batch is
emitted when all agents have sent their tracks, or when the clock of the next frame arrives: a dead or silent agent
does not stall it. Every batch has the newest tracks of each agent, however late they arrived, predicted to the time of
the batch, until they are too old.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.gather import MAX_AGE_S, CollationBuffer, plausible_rows
from mast_zenoh.integrity.views import check_view, collated_columns
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.mesh.hosting import main
from mast_zenoh.tracking.kalman import predicted


class Broker(Node):
    """Collates the agents' tracks, one batch a frame.

    latency_s: age at which frames are emitted; patience: number of clocks, after that of its own frame, to wait for a
    missing message; capacity: messages kept per agent; max_age_s: the greatest age of an agent's tracks in a batch

    The header gives the frame of a message and its time: an agent whose clock is wrong still completes its batches,
    and its tracks are predicted from the time in the header, forward or back, to the batch's time. A time that is
    off by more than `max_age_s`, either way, counts as too old.
    """

    role = "broker"
    inputs = {"clock": "clock", "tracks": "tracks", "view": "view", "status": "status"}
    outputs = {"collated": "collated", "views": "views"}

    def __init__(
        self, latency_s: float = 0.0, patience: int = 0, capacity: int = 10, max_age_s: float = MAX_AGE_S
    ) -> None:
        for name, value, least in (
            ("latency_s", latency_s, 0),
            ("patience", patience, 0),
            ("capacity", capacity, 1),
            ("max_age_s", max_age_s, 0),
        ):
            if value < least:
                raise ValueError(f"{name}: found {value}, expected {least} or more")
        self.latency_ns = round(latency_s * 1e9)
        self.patience = patience
        self.max_age_ns = round(max_age_s * 1e9)
        self.buffer: CollationBuffer[tuple[int, ObjectStates]] = CollationBuffer(capacity)
        self.views: CollationBuffer[tuple[int, Body]] | None = None  # None: agents send none
        self.last_views: dict[str, tuple[int, Body]] = {}  # their times, ns, and views
        self.agents: set[str] = set()
        self.gone: set[str] = set()
        self.newcomers: set[str] = set()
        self.last: dict[str, tuple[int, ObjectStates]] = {}  # their times, ns, and tracks
        self.open_frames: dict[int, int] = {}  # frames without a batch yet, and their times
        self.batches = {"complete": 0, "overdue": 0}
        self.absurd = 0

    def start(self, context: Context) -> None:
        """Collate views, too, if agents send any."""
        if any(source.port == "view" for source in context.subscriptions.values()):
            self.views = CollationBuffer(self.buffer.capacity)

    def joined(self, node: str, role: str, context: Context) -> None:
        """Wait for an agent from now on."""
        if role == "agent":
            self.agents.add(node)
            self.gone.discard(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """Stop waiting for an agent that has left, which may complete a batch."""
        self.agents.discard(node)
        self.gone.add(node)
        self.emit_complete(context)

    def on_status(self, received: Received, context: Context) -> None:
        """Add the agent from the next frame onwards, whether or not its presence was announced."""
        self.newcomers.add(received.subject)

    def on_tracks(self, received: Received, context: Context) -> None:
        """Store an agent's tracks in the buffer, in the world frame."""
        if received.subject not in self.agents:
            # Not expected in this frame: whether its tracks arrive before the batch is emitted would be random.
            self.newcomers.add(received.subject)
            return
        body = received.body
        states = states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])
        plausible = plausible_rows(states)
        if len(plausible) < len(states):
            self.absurd += len(states) - len(plausible)
            states = states.select(plausible)
        self.buffer.push(received.subject, received.frame, (received.time_ns, states))
        self.emit_complete(context)

    def on_view(self, received: Received, context: Context) -> None:
        """Store what an agent's sensor covers."""
        try:
            check_view(received.body)
        except ValueError as error:
            context.reject(f"implausible: view: {error}")
            return
        if self.views is None or received.subject not in self.agents:
            self.newcomers.add(received.subject)
            return
        self.views.push(received.subject, received.frame, (received.time_ns, received.body))
        self.emit_complete(context)

    def on_clock(self, received: Received, context: Context) -> None:
        """Open a new frame, and emit incomplete older ones that have waited long enough."""
        overdue = received.time_ns - self.latency_ns
        overdue_frames = sorted(
            f for f, t in self.open_frames.items() if f < received.frame - self.patience and t < overdue
        )
        for frame in overdue_frames:
            self.emit(frame, "overdue", context)
        self.agents |= self.newcomers - self.gone
        self.newcomers.clear()
        self.open_frames[received.frame] = received.time_ns
        self.emit_complete(context)

    def emit_complete(self, context: Context) -> None:
        """Emit frames that are old enough and have all agents' tracks, oldest first."""
        for frame in sorted(self.open_frames):
            time_ns = self.open_frames[frame]
            if time_ns > context.time_ns - self.latency_ns or not self.complete(frame):
                return
            self.emit(frame, "complete", context)

    def complete(self, frame: int) -> bool:
        """Whether all agents have sent all they send for a frame."""
        buffers = [self.buffer] if self.views is None else [self.buffer, self.views]
        return all(buffer.complete(frame, self.agents) for buffer in buffers)

    def emit(self, frame: int, how: str, context: Context) -> None:
        """Publish a frame's batch: every agent's newest tracks, predicted to its time."""
        time_ns = self.open_frames.pop(frame)
        self.last |= self.buffer.pop(frame)
        self.last = {a: (t, s) for a, (t, s) in self.last.items() if abs(time_ns - t) <= self.max_age_ns}
        self.batches[how] += 1
        names = sorted(self.last)
        parts = [predicted(self.last[name][1], (time_ns - self.last[name][0]) * 1e-9) for name in names]
        context.publish(
            "collated",
            concatenate(parts).columns()
            | {
                "agent": np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
                "agents": text(names),
                "age_ns": np.array([time_ns - self.last[name][0] for name in names], np.int64),
            },
            frame=frame,
            time_ns=time_ns,
        )
        if self.views is not None:
            self.emit_views(self.views.pop(frame), frame, time_ns, context)

    def emit_views(self, arrived: dict[str, tuple[int, Body]], frame: int, time_ns: int, context: Context) -> None:
        """Publish every agent's latest view, unless it is too old."""
        self.last_views |= arrived
        self.last_views = {a: (t, v) for a, (t, v) in self.last_views.items() if abs(time_ns - t) <= self.max_age_ns}
        names = sorted(self.last_views)
        ages = np.array([time_ns - self.last_views[name][0] for name in names], np.int64)
        columns = collated_columns([self.last_views[name][1] for name in names])
        context.publish("views", {"agents": text(names), "age_ns": ages, **columns}, frame=frame, time_ns=time_ns)

    def finish(self, context: Context) -> dict[str, object]:
        """Numbers of complete and overdue batches, of late messages, and of rejected ones."""
        rejected = {"overflowed": self.buffer.dropped, "absurd": self.absurd}
        return {"collation": {**self.batches, "late": dict(sorted(self.buffer.late.items())), **rejected}}


if __name__ == "__main__":
    main(Broker)
