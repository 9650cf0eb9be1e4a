"""What an evaluator collects while a run goes on: truth, every agent's tracks, the picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.boxes import Boxes

#: What an agent believes from its own sensors alone, as it computed it, and as the broker received it.
LOCAL, RECEIVED = "local", "received"
#: The command centre's picture: as it was computed, by the frame that it is about, which all agents share; as an agent
#: received it; and the newest one that the agent held in each frame, which may be about an earlier frame.
PICTURE, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL = "picture", "picture_received", "picture_on_arrival"
#: What an agent believes from its own sensors and the picture together.
MISSION = "mission"
#: In the order in which an estimate is made from those before it.
ESTIMATORS = (LOCAL, RECEIVED, PICTURE, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL, MISSION)


def place_of(estimator: str) -> int:
    """Where an estimator stands among ESTIMATORS; others come last."""
    return ESTIMATORS.index(estimator) if estimator in ESTIMATORS else len(ESTIMATORS)


class Series(NamedTuple):
    """One estimate over time: an agent's name, empty for what all agents share, and the estimator's name."""

    agent: str
    estimator: str


@dataclass(frozen=True, slots=True)
class TruthTable:
    """n rows of truth in f frames with a agents.

    boxes:          n boxes, group = row of the frame
    velocity:       (n, 3) m/s, world frame
    points:         (n, a) int32, lidar points of each agent on the object
    agent_position: (f, a, 3) m
    agent_object:   (f, a) int64, id of the object that the agent is, -1: none
    """

    boxes: Boxes
    velocity: Floats
    points: Ints
    agent_position: Floats
    agent_object: Ints

    @property
    def seen(self) -> Ints:
        """(n,) the most lidar points that any agent has on the object."""
        return np.asarray(self.points.max(axis=1, initial=0))


@dataclass(frozen=True, slots=True)
class TrackTable:
    """n rows of tracks of some series in f frames.

    boxes: group = series · f + row of the frame;  velocity: (n, 3) m/s, world frame;  score: (n,)
    """

    boxes: Boxes
    velocity: Floats
    score: Floats


class Snapshot(NamedTuple):
    """What metrics need of the objects of one message.

    id (n,) int64, position (n, 3) m, size (n, 3) m, yaw (n,) rad, velocity (n, 3) m/s, score (n,); world frame
    """

    id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    velocity: Floats
    score: Floats

    @classmethod
    def of(cls, states: ObjectStates, *, views: bool = False) -> Snapshot:
        """The snapshot of states; views: their columns are views of something larger, which is not to be kept alive."""
        columns = _columns_kept(states)
        return cls(*([column.copy() for column in columns] if views else columns))


_columns_kept = attrgetter(*Snapshot._fields)
_NOTHING = Snapshot.of(ObjectStates.empty())


class Record:
    """Collects a run frame by frame. Of several messages about one frame in one series the first counts, as it does
    for the nodes that receive them.

    agents: names, in the order of the columns of `points` and `agent_position`
    """

    def __init__(self, agents: Sequence[str]) -> None:
        self.agents = tuple(agents)
        self._truth: dict[int, tuple[Snapshot, Ints, Floats, Ints]] = {}
        self._tracks: dict[Series, dict[int, Snapshot]] = {}
        self._arrivals: dict[str, list[tuple[int, int, int, Snapshot]]] = {}  # by agent: step, frame, ns, picture

    def add_truth(
        self, frame: int, objects: ObjectStates, points: Ints, agent_position: Floats, agent_object: Ints
    ) -> None:
        """Truth of one frame, world frame.

        points: (n, a) lidar points of each object at each agent; agent_position: (a, 3) m; agent_object: (a,) ids of
        the objects that the agents are, -1: none. Raises ValueError for shapes that do not fit the agents.
        """
        a = len(self.agents)
        for name, array, expected in (
            ("points", points, (len(objects), a)),
            ("agent_position", agent_position, (a, 3)),
            ("agent_object", agent_object, (a,)),
        ):
            if array.shape != expected:
                raise ValueError(f"truth of frame {frame}, {name}: found shape {array.shape}, expected {expected}")
        boxes = Snapshot.of(objects, views=True)
        self._truth[frame] = (boxes, points.copy(), agent_position.copy(), agent_object.copy())

    def expect(self, series: Sequence[Series]) -> None:
        """These estimates are part of the run, whether or not a message of them ever comes."""
        for each in series:
            self._tracks.setdefault(each, {})
            if each.estimator == PICTURE_RECEIVED:
                self._arrivals.setdefault(each.agent, [])

    def add(
        self, frame: int, series: Sequence[Series], objects: Snapshot, step: int | None = None, time_ns: int = 0
    ) -> None:
        """An estimate of a frame, which belongs to several series: it is scored only once.

        step: frame of the run in which it was sent, None: the one that it is about
        time_ns: ns, of its header
        Raises ValueError for an unknown agent.
        """
        for each in series:
            if each.agent and each.agent not in self.agents:
                raise ValueError(f"frame {frame}: found agent {each.agent!r}, expected one of {self.agents}")
            self._tracks.setdefault(each, {}).setdefault(frame, objects)
            if each.estimator == PICTURE_RECEIVED:
                arrival = frame if step is None else step, frame, time_ns, objects
                self._arrivals.setdefault(each.agent, []).append(arrival)

    def hold_pictures(self, most_ns: Mapping[str, int], times_ns: Mapping[int, int]) -> None:
        """Make the series PICTURE_ON_ARRIVAL from the pictures received: in each frame the one about the latest frame
        that has arrived, unless its time is more than `most_ns` of the agent ago, or is yet to come.

        times_ns: of the frames
        """
        frames = self.frames().tolist()
        for agent, arrivals in self._arrivals.items():
            waiting = deque(sorted(arrivals, key=lambda arrival: arrival[:2]))  # of equals the first stays first
            newest: tuple[int, int, Snapshot] | None = None
            held = self._tracks.setdefault(Series(agent, PICTURE_ON_ARRIVAL), {})
            for now in frames:
                while waiting and waiting[0][0] <= now:
                    _, about, time_ns, snapshot = waiting.popleft()
                    if newest is None or about > newest[0]:
                        newest = about, time_ns, snapshot
                if newest is not None and 0 <= times_ns.get(now, 0) - newest[1] <= most_ns[agent]:
                    held[now] = newest[2]

    def frames(self) -> Ints:
        """(f,) int64, ascending: the frames of which the truth is known."""
        return np.array(sorted(self._truth), np.int64)

    def series(self) -> list[Series]:
        """The series of which anything is known, in the order of the agents, then by the estimator's name."""
        place = {name: k for k, name in enumerate(("", *self.agents))}
        return sorted(self._tracks, key=lambda series: (place[series.agent], series.estimator))

    def truth(self, frames: Ints) -> TruthTable:
        """The truth of (f,) frames."""
        a = len(self.agents)
        parts = [self._truth[int(frame)] for frame in frames]
        boxes, velocity, _ = _joined([part[0] for part in parts])
        return TruthTable(
            boxes=boxes,
            velocity=velocity,
            points=np.concatenate([np.zeros((0, a), np.int32), *(part[1] for part in parts)]),
            agent_position=np.array([part[2] for part in parts]).reshape(len(parts), a, 3),
            agent_object=np.array([part[3] for part in parts], np.int64).reshape(len(parts), a),
        )

    def same(self, one: Series, other: Series, frames: Ints) -> bool:
        """Whether two series are the same messages in all of (f,) frames."""
        mine, others = self._tracks[one], self._tracks[other]
        return all(mine.get(frame) is others.get(frame) for frame in frames.tolist())

    def tracks(self, series: Sequence[Series], frames: Ints) -> TrackTable:
        """The tracks of some series in (f,) frames; none where there was no message."""
        numbers = frames.tolist()
        parts = [mine.get(frame, _NOTHING) for mine in map(self._tracks.__getitem__, series) for frame in numbers]
        return TrackTable(*_joined(parts))


def _joined(parts: list[Snapshot]) -> tuple[Boxes, Floats, Floats]:
    """The boxes of all parts, group = number of the part; their velocities and scores."""
    group = np.repeat(np.arange(len(parts), dtype=np.int64), [len(part.id) for part in parts])
    *columns, velocity, score = (np.concatenate(column) for column in zip(_NOTHING, *parts, strict=True))
    return Boxes(group, *columns), velocity, score
