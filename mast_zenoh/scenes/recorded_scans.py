"""Scans that a data set recorded with real lidars: columns of a recording, beside its truth."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.messages.layout import MAX_ROWS
from mast_zenoh.sensing.points import Points

#: Limits on the points of one scan, which is one message, and of all in a recording, which is in memory.
MAX_POINTS, MAX_ALL_POINTS = MAX_ROWS, 40_000_000


@dataclass(frozen=True, eq=False)
class RecordedScans:
    """The scans of A agents in F frames.

    recorded: (A,) whether an agent's scans are here; the others' lidars are simulated
    start:    (F * A + 1,) int64: agent a in frame f has the rows start[f * A + a] to start[f * A + a + 1]
    points:   of all scans, each in the frame of its agent's first lidar at the time of the frame
    """

    recorded: Bools
    start: Ints
    points: Points

    @classmethod
    def of(cls, place: object, frames: int, agents: int, scans: Mapping[int, Iterable[Points]]) -> RecordedScans:
        """The scans of some agents, by row: one for each frame. place: of the data, for messages

        Raises SceneError for more points than a recording holds.
        """
        parts = [Points.empty()] * (frames * agents)
        total = 0
        for number, (row, of_agent) in enumerate(scans.items(), 1):
            for frame, points in zip(range(frames), of_agent, strict=True):
                parts[frame * agents + row] = points
                total += len(points)
                if total > MAX_ALL_POINTS:
                    raise SceneError(
                        f"{place}: found more than {MAX_ALL_POINTS} points up to frame {frame + 1} of {frames} of "
                        f"lidar {number} of {len(scans)}, expected at most as many: choose fewer frames"
                    )
        start = np.cumsum([0, *map(len, parts)], dtype=np.int64)
        return cls(np.isin(np.arange(agents), list(scans)), start, Points.joined(parts))

    def at(self, frame: int, agent: int) -> Points:
        """The scan of an agent, by its row, in a frame; no points where there is none."""
        index = frame * len(self.recorded) + agent
        return self.points.select(slice(int(self.start[index]), int(self.start[index + 1])))

    def select(self, frames: int, agents: Ints) -> RecordedScans:
        """Those of the first frames, and of agents by their rows."""
        parts = [self.at(frame, row) for frame, row in itertools.product(range(frames), agents.tolist())]
        start = np.cumsum([0, *map(len, parts)], dtype=np.int64)
        return RecordedScans(self.recorded[agents], start, Points.joined(parts))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays by their names in a file."""
        columns = {f"scans.{name}": values for name, values in self.points.columns().items()}
        return {"scans.recorded": self.recorded, "scans.start": self.start, **columns}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> RecordedScans:
        """What `arrays` returned."""
        points = Points.from_columns({name.removeprefix("scans."): column for name, column in arrays.items()})
        return cls(arrays["scans.recorded"], arrays["scans.start"], points)

    def problems(self, frames: int, agents: int) -> Iterator[str]:
        """What is wrong with shapes and offsets, each in a sentence."""
        count = len(self.points.position)
        expected = {"scans.recorded": (agents,), "scans.start": (frames * agents + 1,), "scans.position": (count, 3)}
        for name, array in self.arrays().items():
            if array.shape != expected.get(name, (count,)):
                yield f"{name} has shape {array.shape}, expected {expected.get(name, (count,))}"
                return
        sizes = np.diff(self.start)
        if self.start[0] != 0 or self.start[-1] != count or np.any((sizes < 0) | (sizes > MAX_POINTS)):
            yield f"scans.start: the offsets do not cover {count} points in order, with at most {MAX_POINTS} in a scan"


#: Types of the arrays in a file.
SCAN_TYPES: Mapping[str, Any] = {name: array.dtype for name, array in RecordedScans.of("", 1, 1, {}).arrays().items()}
