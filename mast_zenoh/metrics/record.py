"""Truth, every agent's tracks and the picture, collected during a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.estimates import PICTURE_ON_ARRIVAL, PICTURE_RECEIVED


class Series(NamedTuple):
    """One estimate over time.

    agent: its name, empty for a shared estimate; estimator: its name
    """

    agent: str
    estimator: str


@dataclass(frozen=True, slots=True)
class TruthTable:
    """n rows of truth in f frames with a agents.

    boxes:          n boxes, group = row of the frame
    velocity:       (n, 3) m/s, world frame
    points:         (n, a) int32, lidar points of each agent on the object
    agent_position: (f, a, 3) m
    agent_object:   (f, a) int64, id of the agent's own object, -1: none
    """

    boxes: Boxes
    velocity: Floats
    points: Ints
    agent_position: Floats
    agent_object: Ints

    @property
    def seen(self) -> Ints:
        """(n,) largest number of lidar points of any agent on the object."""
        return np.asarray(self.points.max(axis=1, initial=0))


@dataclass(frozen=True, slots=True)
class TrackTable:
    """n rows of tracks of some series in f frames.

    boxes: group = series · f + row of the frame;  velocity: (n, 3) m/s, world frame;  score: (n,)
    spread: (n, 6), see `Snapshot`
    """

    boxes: Boxes
    velocity: Floats
    score: Floats
    spread: Floats


class Snapshot(NamedTuple):
    """The columns of one message's objects that metrics use.

    id (n,) int64, position (n, 3) m, size (n, 3) m, yaw (n,) rad, velocity (n, 3) m/s, score (n,); world frame
    spread (n, 6): covariances of the horizontal position, xx, xy, yy m^2, and of the velocity, the same in (m/s)^2
    """

    id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    velocity: Floats
    score: Floats
    spread: Floats

    @classmethod
    def of(cls, states: ObjectStates, *, views: bool = False) -> Snapshot:
        """The snapshot of states.

        views: copy their columns, which are views of larger arrays
        """
        columns = _snapshot_columns(states)
        spread = states.covariance.reshape(len(states), 81).take(_SPREAD, 1)
        return cls(*[*(column.copy() for column in columns), spread] if views else [*columns, spread])


_snapshot_columns = attrgetter(*Snapshot._fields[:-1])
#: Of the 81 numbers of a covariance: x x, x y, y y, vx vx, vx vy, vy vy.
_SPREAD = np.array([0, 1, 10, 60, 61, 70])
_EMPTY = Snapshot.of(ObjectStates.empty())


class Record:
    """Collects a run frame by frame, and forgets frames that are not needed any more.

    The first of several messages about a frame in a series counts.
    agents: names, in the order of the columns of `points` and `agent_position`
    picture_ages_ns: by agent and frame, ns, age of the picture for its mission estimate: one of an earlier frame
    begin: the first frame that is kept
    latest: number of frames after its own, at most, in which an estimate was sent that counts
    """

    def __init__(self, agents: Sequence[str]) -> None:
        self.agents = tuple(agents)
        self._truth: dict[int, tuple[Snapshot, Ints, Floats, Ints]] = {}
        self._tracks: dict[Series, dict[int, Snapshot]] = {}
        self._arrivals: dict[str, list[tuple[int, int, int, Snapshot]]] = {}  # by agent: step, frame, ns, picture
        self.picture_ages_ns: dict[str, dict[int, int]] = {}
        self.begin, self.latest = 0, np.iinfo(np.int64).max

    def forget(self, before: int) -> None:
        """Forget the frames before this one; what arrives about them later is left out."""
        self.begin = before
        self._truth = {frame: truth for frame, truth in self._truth.items() if frame >= before}
        for series, messages in self._tracks.items():
            self._tracks[series] = {frame: objects for frame, objects in messages.items() if frame >= before}
        for arrivals in self._arrivals.values():
            past = sorted((arrival for arrival in arrivals if arrival[0] < before), key=lambda arrival: arrival[:2])
            newest = [max(past, key=lambda arrival: arrival[1])] if past else []
            arrivals[:] = newest + [arrival for arrival in arrivals if arrival[0] >= before]

    def add_truth(
        self, frame: int, objects: ObjectStates, points: Ints, agent_position: Floats, agent_object: Ints
    ) -> None:
        """Truth of one frame, world frame.

        points: (n, a) lidar points of each object at each agent; agent_position: (a, 3) m; agent_object: (a,) ids of
        the agents' own objects, -1: none. Raises ValueError for shapes that do not fit the agents.
        """
        a = len(self.agents)
        for name, array, expected in (
            ("points", points, (len(objects), a)),
            ("agent_position", agent_position, (a, 3)),
            ("agent_object", agent_object, (a,)),
        ):
            if array.shape != expected:
                raise ValueError(f"truth of frame {frame}, {name}: found shape {array.shape}, expected {expected}")
        if frame < self.begin:
            return
        boxes = Snapshot.of(objects, views=True)
        self._truth[frame] = (boxes, points.copy(), agent_position.copy(), agent_object.copy())

    def expect(self, series: Sequence[Series]) -> None:
        """Declare estimates that are part of the run, even without messages."""
        for each in series:
            self._tracks.setdefault(each, {})
            if each.estimator == PICTURE_RECEIVED:
                self._arrivals.setdefault(each.agent, [])

    def add(
        self, frame: int, series: Sequence[Series], objects: Snapshot, step: int | None = None, time_ns: int = 0
    ) -> None:
        """Add an estimate of a frame that belongs to one or several series.

        step: frame of the run in which it was sent, None: `frame`
        time_ns: ns, of its header
        Raises ValueError for an unknown agent.
        """
        for each in series:
            if each.agent and each.agent not in self.agents:
                raise ValueError(f"frame {frame}: found agent {each.agent!r}, expected one of {self.agents}")
            if frame >= self.begin and (step is None or step - frame <= self.latest):
                self._tracks.setdefault(each, {}).setdefault(frame, objects)
            if each.estimator == PICTURE_RECEIVED:
                arrival = frame if step is None else step, frame, time_ns, objects
                self._arrivals.setdefault(each.agent, []).append(arrival)

    def hold_pictures(self, max_age_ns: Mapping[str, int], times_ns: Mapping[int, int]) -> None:
        """Compute the series PICTURE_ON_ARRIVAL from the received pictures, and `picture_ages_ns`.

        In each frame it has the received picture about the latest frame. Pictures older than `max_age_ns` of the agent,
        or from the future, are not used. times_ns: of the frames
        """
        frames = self.frames().tolist()
        for agent, arrivals in self._arrivals.items():
            waiting = deque(
                sorted(arrivals, key=lambda arrival: arrival[:2])
            )  # stable: the first of equals stays first
            newest: tuple[int, int, Snapshot] | None = None
            held = self._tracks.setdefault(Series(agent, PICTURE_ON_ARRIVAL), {})
            ages, most_ns = self.picture_ages_ns.setdefault(agent, {}), max_age_ns[agent]
            for now in frames:
                now_ns = times_ns.get(now, 0)
                if newest is not None and 0 <= now_ns - newest[1] <= most_ns:
                    ages[now] = now_ns - newest[1]
                while waiting and waiting[0][0] <= now:
                    _, about, time_ns, snapshot = waiting.popleft()
                    if newest is None or about > newest[0]:
                        newest = about, time_ns, snapshot
                if newest is not None and 0 <= now_ns - newest[1] <= most_ns:
                    held[now] = newest[2]

    def frames(self) -> Ints:
        """The frames with truth (f,) int64, ascending."""
        return np.array(sorted(self._truth), np.int64)

    def series(self) -> list[Series]:
        """All series, in the order of the agents, then by estimator name."""
        place = {name: k for k, name in enumerate(("", *self.agents))}
        return sorted(self._tracks, key=lambda series: (place[series.agent], series.estimator))

    def truth(self, frames: Ints) -> TruthTable:
        """The truth of (f,) frames."""
        a = len(self.agents)
        parts = [self._truth[int(frame)] for frame in frames]
        boxes, velocity, *_ = _concatenate([part[0] for part in parts])
        return TruthTable(
            boxes=boxes,
            velocity=velocity,
            points=np.concatenate([np.zeros((0, a), np.int32), *(part[1] for part in parts)]),
            agent_position=np.array([part[2] for part in parts]).reshape(len(parts), a, 3),
            agent_object=np.array([part[3] for part in parts], np.int64).reshape(len(parts), a),
        )

    def same(self, one: Series, other: Series, frames: Ints) -> bool:
        """Whether two series have the same messages in all of (f,) frames."""
        messages, other_messages = self._tracks[one], self._tracks[other]
        return all(messages.get(frame) is other_messages.get(frame) for frame in frames.tolist())

    def tracks(self, series: Sequence[Series], frames: Ints) -> TrackTable:
        """The tracks of some series in (f,) frames; no rows for frames without a message."""
        numbers = frames.tolist()
        parts = [messages.get(frame, _EMPTY) for messages in map(self._tracks.__getitem__, series) for frame in numbers]
        return TrackTable(*_concatenate(parts))


def _concatenate(parts: list[Snapshot]) -> tuple[Boxes, Floats, Floats, Floats]:
    """The boxes of all parts, group = number of the part; their velocities, scores and spreads."""
    group = np.repeat(np.arange(len(parts), dtype=np.int64), [len(part.id) for part in parts])
    *columns, velocity, score, spread = (np.concatenate(column) for column in zip(_EMPTY, *parts, strict=True))
    return Boxes(group, *columns), velocity, score, spread
