"""One estimate of one agent over the frames of a run, as users' metrics get it and as it is kept until then. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.causes import CauseLabels, cause_names
from mast_zenoh.metrics.scores import OUTCOMES, Scores, Texts


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate of one agent over f frames: n boxes of truth objects and tracks.

    agent, estimator: their names;  frames: (f,) int64;  period_s: s, frame period
    scored:   (f,) bool, the frames that count in summaries
    frame:    (n,) int64, row of `frames`
    is_track: (n,) bool, a track instead of a truth object
    outcome:  (n,) str, "matched", "missed", "false" or "unevaluated"
    id, match_id: (n,) int64, of the box and of its match, -1: none
    position: (n, 3) m and size (n, 3) m, world frame;  yaw: (n,) rad;  score: (n,), NaN for truth objects
    range_m:  (n,) m, from the agent, in the bird's-eye view
    cause:    (n,) str, of false tracks and missed objects, one of CAUSES
    """

    agent: str
    estimator: str
    frames: Ints
    period_s: float
    scored: Bools
    frame: Ints
    is_track: Bools
    outcome: Texts
    id: Ints
    match_id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    range_m: Floats
    cause: Texts

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray):  # all metrics get the same arrays
                value = value.view()
                value.flags.writeable = False
                object.__setattr__(self, each.name, value)

    def count(self, boxes: Bools) -> Floats:
        """Number (f,) of boxes selected by a mask (n,) in each frame."""
        return np.bincount(self.frame[boxes], minlength=len(self.frames)).astype(np.float64)


class EstimateColumns(NamedTuple):
    """One estimate of one agent over f frames as it is kept: `Estimate` with numbers of outcomes and causes.

    frames, scored: (f,);  all others: (n, ...) of boxes, see `Estimate`
    """

    frames: Ints
    scored: Bools
    frame: Ints
    is_track: Bools
    outcome: NDArray[np.int8]
    id: Ints
    match_id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    range_m: Floats
    cause: NDArray[np.int8]

    @classmethod
    def of(cls, row: int, scores: Scores, labels: CauseLabels, scored: Bools, frames: slice) -> EstimateColumns:
        """The estimate of a row of `scores.series` in a slice of `scores.frames`, with a start and a stop."""
        judged, (agent, _) = scores.judged, scores.series[row]
        rows = np.flatnonzero(judged.series == row)
        frame = np.searchsorted(scores.frames, judged.frame[rows])
        inside = (frame >= frames.start) & (frame < frames.stop)
        rows, frame = rows[inside], frame[inside]
        boxes = judged.boxes.select(rows)
        at = scores.truth.agent_position[frame, scores.agents.index(agent)]
        return cls(
            frames=scores.frames[frames],
            scored=scored[frames],
            frame=frame - frames.start,
            is_track=judged.is_track[rows],
            outcome=judged.outcome[rows].astype(np.int8),
            id=boxes.id,
            match_id=judged.match_id[rows],
            position=boxes.position,
            size=boxes.size,
            yaw=boxes.yaw,
            score=judged.score[rows],
            range_m=np.hypot(*(boxes.position - at)[:, :2].T),
            cause=labels.cause[rows].astype(np.int8),
        )

    @classmethod
    def joined(cls, parts: Sequence[EstimateColumns]) -> EstimateColumns:
        """An estimate in consecutive parts of a run."""
        offset, moved = 0, []
        for part in parts:
            moved.append(part._replace(frame=part.frame + offset))
            offset += len(part.frames)
        return cls(*(np.concatenate(column) for column in zip(*moved, strict=True)))

    def estimate(self, agent: str, estimator: str, period_s: float) -> Estimate:
        """The estimate of an agent, for users' metrics; period_s: s, frame period"""
        columns = self._asdict() | {
            "outcome": np.array(OUTCOMES)[self.outcome],
            "cause": cause_names(self.cause.astype(np.int64)).astype(str),
        }
        return Estimate(agent=agent, estimator=estimator, period_s=period_s, **columns)


def estimates_of(scores: Scores, labels: CauseLabels, scored: Bools, period_s: float) -> list[Estimate]:
    """The estimates of `scores.series`, for users' metrics."""
    every = slice(0, len(scores.frames))
    return [
        EstimateColumns.of(row, scores, labels, scored, every).estimate(*name, period_s)
        for row, name in enumerate(scores.series)
    ]
