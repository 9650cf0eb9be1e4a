"""The broker: the command centre's ear. Brings the tracks of all agents to one time and one frame of reference.

It learns of agents by their presence on the mesh and their first status, and forgets those that go. A batch is
emitted when everyone has spoken, or when the next frame's clock says that it is too late to wait: a dead or silent
agent stalls nobody. What an agent said last stays in the batch, moved along, until it is too old.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.geometry import states_to_world
from mast_zenoh.arrays.states import ObjectStates, concatenate, propagate
from mast_zenoh.gather import MAX_AGE_S, CollationBuffer
from mast_zenoh.messages.schemas import text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.runtime.mesh.main import main

#: In SI units; a track beyond it is of no world, and brought to another time would make the whole batch unsound.
MOST = 1e8


class Broker(Node):
    """latency_s: emit what is at least this much older than now; patience: clocks that a missing message is waited

    for beyond its own frame's; capacity: messages kept per agent; max_age_s: an agent's last word counts so long.

    Which frame a word belongs to is what its header says, and so is its time: an agent whose clock is wrong completes
    its batches all the same, and its tracks are brought from the time that it says, forward or back, to the batch's.
    A time that is off by more than `max_age_s`, either way, counts as too old.
    """

    role = "broker"
    inputs = {"clock": "clock", "tracks": "tracks", "status": "status"}
    outputs = {"collated": "collated"}

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
        self.agents: set[str] = set()
        self.gone: set[str] = set()
        self.newcomers: set[str] = set()
        self.last: dict[str, tuple[int, ObjectStates]] = {}  # their times, ns, and tracks
        self.open_frames: dict[int, int] = {}  # frames without a batch yet, and their times
        self.batches = {"complete": 0, "overdue": 0}
        self.absurd = 0

    def joined(self, node: str, role: str, context: Context) -> None:
        """An agent has come up: from now on it is waited for."""
        if role == "agent":
            self.agents.add(node)
            self.gone.discard(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """An agent has gone: it is waited for no longer. This may complete a batch."""
        self.agents.discard(node)
        self.gone.add(node)
        self.emit_complete(context)

    def on_status(self, received: Received, context: Context) -> None:
        """An agent presents itself: from the next frame on it takes part and is waited for, announced or not."""
        self.newcomers.add(received.subject)

    def on_tracks(self, received: Received, context: Context) -> None:
        """An agent's tracks: into the buffer, in the world frame."""
        if received.subject not in self.agents:
            # It is not waited for in this frame: whether its tracks come before the batch goes out would be chance.
            self.newcomers.add(received.subject)
            return
        body = received.body
        states = states_to_world(ObjectStates.from_columns(body), body["origin"], body["rotation"])
        real = real_rows(states)
        if len(real) < len(states):
            self.absurd += len(states) - len(real)
            states = states.select(real)
        self.buffer.push(received.subject, received.frame, (received.time_ns, states))
        self.emit_complete(context)

    def on_clock(self, received: Received, context: Context) -> None:
        """A new frame: older ones that have waited long enough are emitted as they are."""
        overdue = received.time_ns - self.latency_ns
        waited = sorted(f for f, t in self.open_frames.items() if f < received.frame - self.patience and t < overdue)
        for frame in waited:
            self.emit(frame, "overdue", context)
        self.agents |= self.newcomers - self.gone
        self.newcomers.clear()
        self.open_frames[received.frame] = received.time_ns
        self.emit_complete(context)

    def emit_complete(self, context: Context) -> None:
        """Emit, oldest first, what is old enough and has everyone's word."""
        for frame in sorted(self.open_frames):
            time_ns = self.open_frames[frame]
            if time_ns > context.time_ns - self.latency_ns or not self.buffer.complete(frame, self.agents):
                return
            self.emit(frame, "complete", context)

    def emit(self, frame: int, how: str, context: Context) -> None:
        """Publish the batch of a frame: every agent's newest tracks up to then, brought to its time."""
        time_ns = self.open_frames.pop(frame)
        self.last |= self.buffer.pop(frame)
        self.last = {a: (t, s) for a, (t, s) in self.last.items() if abs(time_ns - t) <= self.max_age_ns}
        self.batches[how] += 1
        names = sorted(self.last)
        parts = [propagate(self.last[name][1], (time_ns - self.last[name][0]) * 1e-9) for name in names]
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

    def finish(self, context: Context) -> dict[str, object]:
        """How many batches were complete, what came too late, and what was left out."""
        left_out = {"overflowed": self.buffer.dropped, "absurd": self.absurd}
        return {"collation": {**self.batches, "late": self.buffer.late, **left_out}}


def real_rows(states: ObjectStates) -> np.ndarray:
    """(k,) rows of the objects of which nothing is beyond MOST."""
    columns = (states.position, states.velocity, states.size, states.covariance)
    if sum([np.vdot(column, column) for column in columns]) <= MOST**2:
        return np.arange(len(states))  # mostly: none is beyond what all are together
    flat = np.concatenate([column.reshape(len(states), -1) for column in columns], axis=1)
    return (np.abs(flat).max(axis=1) <= MOST).nonzero()[0]


if __name__ == "__main__":
    main(Broker)
