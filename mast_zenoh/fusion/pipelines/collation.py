"""Collates what many agents send about a frame: every agent's newest tracks, at one time, in the world frame.

An agent is waited for from its announcement on, until it leaves. A batch is due when all agents have sent theirs, or
when the clock of the next frame arrives: a dead or silent agent does not stall it. A batch has the newest tracks of
each agent, however late they arrived, predicted to the time of the batch, until they are too old.

Which tracks of each agent a node fuses: an input limit on messages and on the frame; counts what is left out.

What a peer hears from other agents, until the next frame.

From which agents' sensors the objects of a picture come.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.geometry import tracks_in_world
from mast_zenoh.arrays.states import Bools, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.input_limit import ClaimedObjects, InputLimit, Kept, NoInputLimit
from mast_zenoh.fusion.pipelines.command_center import is_view
from mast_zenoh.gather import MAX_AGE_S, CollationBuffer, LatestBefore, plausible
from mast_zenoh.messages.limits import RowChoice, Shortened
from mast_zenoh.messages.schemas import Body, text
from mast_zenoh.node import Context, Node, Received
from mast_zenoh.tracking.kalman import predicted


class Collated(NamedTuple):
    """A batch.

    states: n tracks of all agents at `time_ns`, world frame; agent: (n,) rows of `agents`, names, sorted
    age_ns: (a,) by which each agent's tracks were predicted
    views:  by agent: the columns of its newest view, and its age, ns; empty unless agents send views
    """

    frame: int
    time_ns: int
    states: ObjectStates
    agent: Ints
    agents: tuple[str, ...]
    age_ns: Ints
    views: Mapping[str, tuple[Body, int]]


class _Tracks(NamedTuple):
    """The tracks of an agent.

    states: n tracks at `time_ns`, world frame; beyond: number of rows that its message had besides
    """

    time_ns: int
    states: ObjectStates
    beyond: int


class CollatingNode(Node):
    """Collates the tracks, and the views if there are any, of many agents; the base of brokers and regional centres.

    latency_s: age at which frames are emitted; patience: number of clocks, after that of its own frame, to wait for a
    missing message; capacity: messages kept per agent; max_age_s: the greatest age of an agent's tracks in a batch
    input_limit: which tracks a batch has, if there are many; None: all

    A time that is off by more than `max_age_s`, either way, counts as too old. Raises ValueError for negative values.
    """

    #: role of the nodes that are waited for
    collated_role: ClassVar[str] = "agent"

    def __init__(
        self,
        latency_s: float = 0.0,
        patience: int = 0,
        capacity: int = 10,
        max_age_s: float = MAX_AGE_S,
        input_limit: InputLimit | None = None,
    ) -> None:
        check("0 or more", latency_s=latency_s, patience=patience, max_age_s=max_age_s)
        check("1 or more", capacity=capacity)
        self.with_views = False  # whether agents send views
        self.admission = Admission(input_limit)
        self.agents: set[str] = set()  # those that are waited for
        self._latency_ns = round(latency_s * 1e9)
        self._patience = patience
        self._max_age_ns = round(max_age_s * 1e9)
        self._tracks: CollationBuffer[_Tracks] = CollationBuffer(capacity)
        self._views: CollationBuffer[tuple[int, Body]] = CollationBuffer(capacity)
        self._last: dict[str, _Tracks] = {}
        self._last_views: dict[str, tuple[int, Body]] = {}
        self._gone: set[str] = set()
        self._newcomers: set[str] = set()
        self._open_frames: dict[int, int] = {}  # frames without a batch yet, and their times
        self._batches = {"complete": 0, "overdue": 0}
        self._rejected = {"absurd": 0}

    def start(self, context: Context) -> None:
        """Collate views, too, if agents send any."""
        super().start(context)
        self.with_views = any(source.port == "view" for source in context.subscriptions.values())

    def choice(self, port: str, subject: str, step: int) -> RowChoice | None:
        """Of too many rows, those that the input limit keeps."""
        return self.admission.choice(subject, step) if port == "tracks" else None

    def joined(self, node: str, role: str, context: Context) -> None:
        """Wait for an agent from now on."""
        if role == self.collated_role:
            self.agents.add(node)
            self._gone.discard(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """Stop waiting for an agent that has left, which may complete a batch."""
        self.agents.discard(node)
        self._gone.add(node)
        self.emit_complete(context)

    def on_status(self, received: Received, context: Context) -> None:
        """Wait for the agent from the next frame on, whether or not its presence was announced."""
        self._newcomers.add(received.subject)

    def on_tracks(self, received: Received, context: Context) -> None:
        """Store an agent's tracks, in the world frame."""
        self.collate(received, tracks_in_world(received.body), context)

    def collate(self, received: Received, states: ObjectStates, context: Context) -> None:
        """Store an agent's tracks, which may complete a batch. states: those of the message, world frame"""
        beyond = self.admission.note(received.subject, received.body)
        if received.subject in self.agents:
            tracks = _Tracks(received.time_ns, plausible(states, self._rejected), beyond)
            self._tracks.push(received.subject, received.frame, tracks)
        else:
            # Not expected in this frame: whether its tracks arrive before the batch is emitted would be random.
            self._newcomers.add(received.subject)
        self.emit_complete(context)

    def on_view(self, received: Received, context: Context) -> None:
        """Store what an agent's sensor covers."""
        if not is_view(received, context):
            return
        if received.subject in self.agents:
            self._views.push(received.subject, received.frame, (received.time_ns, received.body))
        else:
            self._newcomers.add(received.subject)
        self.emit_complete(context)

    def on_clock(self, received: Received, context: Context) -> None:
        """Open a new frame, and emit incomplete older ones that have waited long enough."""
        self.admission.begin(received.frame)
        first, overdue_ns = received.frame - self._patience, received.time_ns - self._latency_ns
        frames = sorted(each for each, at_ns in self._open_frames.items() if each < first and at_ns < overdue_ns)
        overdue = [self._batch(frame, "overdue") for frame in frames]
        self.agents |= self._newcomers - self._gone
        self._newcomers.clear()
        self._open_frames[received.frame] = received.time_ns
        for batch in overdue:
            self.emit(batch, context)
        self.emit_complete(context)

    def emit_complete(self, context: Context) -> None:
        """Emit frames that are old enough and have all that is waited for, oldest first."""
        for frame in sorted(self._open_frames):
            if self._open_frames[frame] > context.time_ns - self._latency_ns:
                break
            if not self._tracks.complete(frame, self.agents):
                break
            if self.with_views and not self._views.complete(frame, self.agents):
                break
            self.emit(self._batch(frame, "complete"), context)

    def emit(self, batch: Collated, context: Context) -> None:
        """Publish a batch: every agent's newest tracks, predicted to its time."""
        columns = batch.states.columns() | {"agent": batch.agent}
        agents = {"agents": text(list(batch.agents)), "age_ns": batch.age_ns}
        context.publish("collated", columns | agents, frame=batch.frame, time_ns=batch.time_ns)

    def finish(self, context: Context) -> dict[str, Any]:
        """Numbers of complete and overdue batches, of late messages, of rejected ones, and of tracks left out."""
        late = dict(sorted(self._tracks.late.items()))
        collated = {**self._batches, "late": late, "overflowed": self._tracks.dropped, **self._rejected}
        return super().finish(context) | {"collation": collated, "left_out": self.admission.counts()}

    def _batch(self, frame: int, how: str) -> Collated:
        time_ns = self._open_frames.pop(frame)
        self._batches[how] += 1
        self._last |= self._tracks.pop(frame)
        self._last = {a: last for a, last in self._last.items() if abs(time_ns - last.time_ns) <= self._max_age_ns}
        self._last_views |= self._views.pop(frame)
        self._last_views = {a: (t, v) for a, (t, v) in self._last_views.items() if abs(time_ns - t) <= self._max_age_ns}
        names = sorted(self._last)
        tracks = {name: self._last[name].states for name in names}
        objects = {name: ClaimedObjects(each.id, each.score, self._last[name].beyond) for name, each in tracks.items()}
        for name, rows in self.admission.select(objects).items():
            tracks[name] = tracks[name].select(rows)
        ages = [time_ns - self._last[name].time_ns for name in names]
        parts = [predicted(tracks[name], age * 1e-9) for name, age in zip(names, ages, strict=True)]
        agent = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        views = {name: (body, time_ns - at_ns) for name, (at_ns, body) in sorted(self._last_views.items())}
        return Collated(frame, time_ns, concatenate(parts), agent, tuple(names), np.array(ages, np.int64), views)


class Admission:
    """Applies an input limit; None: NoInputLimit().

    A message with more rows than can be used is cut before its rows are checked, by what was kept until two frames
    before it was sent: a message may arrive before the clock of its frame, and must not depend on that.
    """

    def __init__(self, limit: InputLimit | None = None) -> None:
        self.left_out: Counter[str] = Counter()  # number of rows, by agent
        self._limit = limit or NoInputLimit()
        self._kept: LatestBefore[Kept] = LatestBefore()

    def begin(self, frame: int) -> None:
        """Open a frame: call it first of all in each."""
        self._kept.add(frame, self._limit.kept)

    def choice(self, agent: str, step: int) -> RowChoice | None:
        """Which rows of an agent's message are used; see `Node.choice`."""
        limit = self._limit
        if limit.rows is None:
            return None
        return RowChoice(limit.rows, lambda ids, score, rows: self._cut(agent, step, ClaimedObjects(ids, score), rows))

    def _cut(self, agent: str, step: int, objects: ClaimedObjects, rows: int) -> Ints:
        latest = self._kept.get(step)
        return self._limit.cut({} if latest is None else latest[1].get(agent, {}), objects, rows)

    def note(self, agent: str, body: Body) -> int:
        """Number of rows that a message of an agent had beyond those that are used; they count as left out."""
        beyond = body.found - len(body["score"]) if type(body) is Shortened else 0
        self.left_out[agent] += beyond
        return beyond

    def select(self, objects: Mapping[str, ClaimedObjects]) -> dict[str, Ints]:
        """Rows to fuse in a frame, of each agent of which some are left out. objects: by agent"""
        selected = self._limit.select(objects)
        for name, rows in selected.items():
            self.left_out[name] += len(objects[name].ids) - len(rows)
        return selected

    def counts(self) -> dict[str, int]:
        """Number of rows that were left out, by agent."""
        return {name: count for name, count in sorted(self.left_out.items()) if count}


#: Messages on one wire in a frame that wait for the next one, at most.
MAX_WAITING = 64


class Inbox:
    """Messages that wait for the frame after that of their arrival, in an order that is not that of arrival."""

    def __init__(self) -> None:
        # By frame of arrival, then by wire, its sender and port: only messages of one wire arrive in a fixed order.
        self._waiting: dict[int, dict[tuple[str, str], list[Received]]] = {}

    def add(self, frame: int, received: Received) -> bool:
        """Add a message that arrives in a frame; False if too many on its wire have arrived in it already."""
        wire = received.subject, received.port
        waiting = self._waiting.setdefault(frame, {}).setdefault(wire, [])
        if len(waiting) < MAX_WAITING:
            waiting.append(received)
            return True
        return False

    def take(self, frame: int) -> list[Received]:
        """Take out the messages that arrived before a frame."""
        return [
            received
            for arrived in sorted(each for each in self._waiting if each < frame)
            for _, messages in sorted(self._waiting.pop(arrived).items())
            for received in sorted(messages, key=_order)
        ]


def _order(received: Received) -> tuple[int, int, int]:
    return received.time_ns, received.frame, received.message.header.seq


class Origins:
    """The agents whose tracks have ever been in each object of a picture.

    A tracker remembers: an object keeps its origins as long as it is in the picture.
    """

    def __init__(self) -> None:
        self._names: tuple[str, ...] = ()
        self._ids = np.zeros(0, np.int64)
        self._origins = np.zeros((0, 0), np.bool_)

    def update(self, ids: Ints, members: Ints, of_members: Bools, names: Sequence[str]) -> Bools:
        """(n, a) whether each of a agents is an origin of each of n objects, after one more step.

        ids: (n,) of the picture, ascending; members: (m,) the row of its object for each track of the step, -1: none
        of_members: (m, a) origins of these tracks; names: of the a agents, sorted
        """
        origins = np.zeros((len(ids), len(names)), np.bool_)
        if len(self._ids):
            place = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
            known = self._ids[place] == ids
            columns = [names.index(name) for name in self._names if name in names]
            kept = [column for column, name in enumerate(self._names) if name in names]
            origins[np.ix_(known.nonzero()[0], columns)] = self._origins[place[known]][:, kept]
        used = members >= 0
        np.logical_or.at(origins, members[used], of_members[used])
        self._names, self._ids, self._origins = tuple(names), ids, origins
        return origins
