"""Collates what many agents send about a frame: every agent's newest tracks, at one time, in the world frame.

An agent is waited for from its announcement on, until it leaves. A batch is due when all agents have sent theirs, or
when the clock of the next frame arrives: a dead or silent agent does not stall it. A batch has the newest tracks of
each agent, however late they arrived, predicted to the time of the batch, until they are too old.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates, concatenate
from mast_zenoh.fusion.input_limit import ClaimedObjects, InputLimit
from mast_zenoh.gather import MAX_AGE_S, CollationBuffer, plausible_rows
from mast_zenoh.messages.schemas import Body
from mast_zenoh.pipelines.admission import Admission
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


class Collation:
    """Collects the tracks, and the views if there are any, of the agents of one centre.

    latency_s: age at which frames are emitted; patience: number of clocks, after that of its own frame, to wait for a
    missing message; capacity: messages kept per agent; max_age_s: the greatest age of an agent's tracks in a batch
    input_limit: which tracks a batch has, if there are many; None: all
    agents: those that are waited for; with_views: whether agents send views

    A time that is off by more than `max_age_s`, either way, counts as too old. Raises ValueError for negative values.
    """

    def __init__(
        self,
        latency_s: float = 0.0,
        patience: int = 0,
        capacity: int = 10,
        max_age_s: float = MAX_AGE_S,
        input_limit: InputLimit | None = None,
    ) -> None:
        for name, value, least in (
            ("latency_s", latency_s, 0),
            ("patience", patience, 0),
            ("capacity", capacity, 1),
            ("max_age_s", max_age_s, 0),
        ):
            if value < least:
                raise ValueError(f"{name}: found {value}, expected {least} or more")
        self.with_views = False
        self.admission = Admission(input_limit)
        self.agents: set[str] = set()
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
        self._absurd = 0

    def join(self, agent: str) -> None:
        """Wait for an agent from now on."""
        self.agents.add(agent)
        self._gone.discard(agent)

    def leave(self, agent: str) -> None:
        """Stop waiting for an agent; may make batches due."""
        self.agents.discard(agent)
        self._gone.add(agent)

    def meet(self, agent: str) -> None:
        """Wait for an agent from the next frame on, whether or not its presence was announced."""
        self._newcomers.add(agent)

    def add(self, agent: str, frame: int, time_ns: int, states: ObjectStates, body: Body) -> None:
        """Add an agent's tracks, world frame; may make batches due. body: columns of the message"""
        beyond = self.admission.note(agent, body)
        if agent not in self.agents:
            # Not expected in this frame: whether its tracks arrive before the batch is emitted would be random.
            self.meet(agent)
            return
        plausible = plausible_rows(states)
        if len(plausible) < len(states):
            self._absurd += len(states) - len(plausible)
            states = states.select(plausible)
        self._tracks.push(agent, frame, _Tracks(time_ns, states, beyond))

    def add_view(self, agent: str, frame: int, time_ns: int, body: Body) -> None:
        """Add the columns of what an agent's sensor covers; may make batches due."""
        if agent not in self.agents:
            self.meet(agent)
            return
        self._views.push(agent, frame, (time_ns, body))

    def begin(self, frame: int, time_ns: int) -> list[Collated]:
        """Open a new frame; returns the batches of older ones that have waited long enough."""
        self.admission.begin(frame)
        overdue = time_ns - self._latency_ns
        frames = sorted(f for f, t in self._open_frames.items() if f < frame - self._patience and t < overdue)
        batches = [self._batch(each, "overdue") for each in frames]
        self.agents |= self._newcomers - self._gone
        self._newcomers.clear()
        self._open_frames[frame] = time_ns
        return batches

    def complete(self, now_ns: int) -> list[Collated]:
        """The batches of frames that are old enough and have all agents' tracks, oldest first. now_ns: time, ns"""
        batches = []
        for frame in sorted(self._open_frames):
            if self._open_frames[frame] > now_ns - self._latency_ns or not self._tracks.complete(frame, self.agents):
                break
            if self.with_views and not self._views.complete(frame, self.agents):
                break
            batches.append(self._batch(frame, "complete"))
        return batches

    def counts(self) -> dict[str, Any]:
        """Numbers of complete and overdue batches, of late messages, and of rejected ones."""
        rejected = {"overflowed": self._tracks.dropped, "absurd": self._absurd}
        return {**self._batches, "late": dict(sorted(self._tracks.late.items())), **rejected}

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
