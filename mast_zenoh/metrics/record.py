"""What an evaluator collects while a run goes on: truth, every agent's tracks, the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mast_zenoh.metrics.boxes import Boxes
from mast_zenoh.states import Floats, Ints, ObjectStates

#: The estimator that all agents share: the command centre's picture.
PICTURE = "picture"


class Series(NamedTuple):
    """Who estimates: an agent's name, empty for what all agents share, and the estimator's name."""

    agent: str
    estimator: str


@dataclass(frozen=True, slots=True)
class TruthTable:
    """n rows of truth in f frames with a agents.

    boxes:          n boxes, group = row of the frame
    points:         (n, a) int32, lidar points of each agent on the object
    agent_position: (f, a, 3) m
    agent_object:   (f, a) int64, id of the object that the agent is, -1: none
    """

    boxes: Boxes
    points: Ints
    agent_position: Floats
    agent_object: Ints

    @property
    def seen(self) -> Ints:
        """(n,) the most lidar points that any agent has on the object."""
        return np.asarray(self.points.max(axis=1, initial=0))


@dataclass(frozen=True, slots=True)
class TrackTable:
    """n rows of tracks: boxes with group = row of the frame, and score (n,)."""

    boxes: Boxes
    score: Floats


class _Snapshot(NamedTuple):
    """What metrics need of the objects of one message: copies, for the arrays of a message keep all of it alive."""

    id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats

    @classmethod
    def of(cls, states: ObjectStates) -> _Snapshot:
        return cls(*[column.copy() for column in _columns_kept(states)])


_columns_kept = attrgetter(*_Snapshot._fields)
_NOTHING = _Snapshot.of(ObjectStates.empty())


class Record:
    """Collects a run frame by frame; a second message for the same frame and series replaces the first.

    agents: names, in the order of the columns of `points` and `agent_position`
    """

    def __init__(self, agents: Sequence[str]) -> None:
        self.agents = tuple(agents)
        self._truth: dict[int, tuple[_Snapshot, Ints, Floats, Ints]] = {}
        self._tracks: dict[Series, dict[int, _Snapshot]] = {}

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
        self._truth[frame] = (_Snapshot.of(objects), points.copy(), agent_position.copy(), agent_object.copy())

    def add_tracks(self, frame: int, agent: str, estimator: str, states: ObjectStates) -> None:
        """What an agent's estimator believes in one frame, world frame. Raises ValueError for an unknown agent."""
        if agent not in self.agents:
            raise ValueError(f"tracks of frame {frame}: found agent {agent!r}, expected one of {self.agents}")
        self._add(frame, Series(agent, estimator), states)

    def add_picture(self, frame: int, states: ObjectStates) -> None:
        """The command centre's picture of one frame, world frame; every agent is scored on it."""
        self._add(frame, Series("", PICTURE), states)

    def _add(self, frame: int, series: Series, states: ObjectStates) -> None:
        self._tracks.setdefault(series, {})[frame] = _Snapshot.of(states)

    def frames(self) -> Ints:
        """(f,) int64, ascending: the frames of which the truth is known."""
        return np.array(sorted(self._truth), np.int64)

    def series(self) -> list[Series]:
        """Who has estimated anything, in the order of the agents, then by the estimator's name."""
        place = {name: k for k, name in enumerate(("", *self.agents))}
        return sorted(self._tracks, key=lambda series: (place[series.agent], series.estimator))

    def truth(self, frames: Ints) -> TruthTable:
        """The truth of (f,) frames."""
        a = len(self.agents)
        parts = [self._truth[int(frame)] for frame in frames]
        return TruthTable(
            boxes=_joined([part[0] for part in parts])[0],
            points=np.concatenate([np.zeros((0, a), np.int32), *(part[1] for part in parts)]),
            agent_position=np.array([part[2] for part in parts]).reshape(len(parts), a, 3),
            agent_object=np.array([part[3] for part in parts], np.int64).reshape(len(parts), a),
        )

    def tracks(self, series: Series, frames: Ints) -> TrackTable:
        """The tracks of one series in (f,) frames; none where there was no message."""
        mine = self._tracks[series]
        parts = [mine.get(int(frame), _NOTHING) for frame in frames]
        return TrackTable(*_joined(parts))


def _joined(parts: list[_Snapshot]) -> tuple[Boxes, Floats]:
    """The boxes of all parts, group = number of the part; and their scores."""
    group = np.repeat(np.arange(len(parts), dtype=np.int64), [len(part.id) for part in parts])
    *columns, score = (np.concatenate(column) for column in zip(_NOTHING, *parts, strict=True))
    return Boxes(group, *columns), score
