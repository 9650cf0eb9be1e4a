"""Scores every agent, estimate and frame of a recorded run; one estimate as users' metrics get it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools, Floats, Ints, row_order
from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner, SetDistance, centre_distance
from mast_zenoh.metrics.causes import CauseLabels, cause_names
from mast_zenoh.metrics.record import Record, Series, TrackTable, TruthTable
from mast_zenoh.metrics.scores import (
    FALSE,
    MATCHED,
    MISSED,
    OUTCOMES,
    UNEVALUATED,
    Judged,
    LastMatches,
    MatchedPairs,
    Scores,
    Switches,
    Texts,
)

_NONE_EARLIER: LastMatches = MappingProxyType({})


class Scorer:
    """Compares estimates with the truth (docs/explanation-metrics-and-causes.md).

    For each agent and frame, the truth consists of the objects within `range_m` of the agent (bird's-eye view) with at
    least `min_points` lidar points of at least one agent; tracks beyond the same range are left out. A pair of the
    assigner is a true positive (TP), a truth object without a track a false negative (FN), a track without a truth
    object a false positive (FP). RMSE is over the bird's-eye centre distances of the pairs. An identity switch is
    counted when the track that matches an object has a different id from the previous one.

    assigner:      matches tracks with truth; None: CenterDistanceAssigner()
    distance:      parameters of OSPA and GOSPA; None: SetDistance()
    range_m:       m, around each agent, in which objects and tracks count
    min_points:    least lidar points of at least one agent on an object that counts
    include_self:  whether the agent's own object counts as truth for it. If not, a track of it is not false either but
                   unevaluated
    ignore_unseen: whether tracks of objects that are not evaluated (unseen by all agents, or out of range) are
                   unevaluated too; by default they are false
    Raises ValueError for invalid values.
    """

    def __init__(
        self,
        *,
        assigner: Assigner | None = None,
        distance: SetDistance | None = None,
        range_m: float = 100.0,
        min_points: int = 5,
        include_self: bool = True,
        ignore_unseen: bool = False,
    ) -> None:
        if not range_m > 0.0:
            raise ValueError(f"range_m: found {range_m}, expected more than 0")
        self.assigner = assigner or CenterDistanceAssigner()
        self.distance = distance or SetDistance()
        self.range_m = range_m
        self.min_points = min_points
        self.include_self = include_self
        self.ignore_unseen = ignore_unseen

    def score(self, record: Record, frames: Ints | None = None, earlier: LastMatches = _NONE_EARLIER) -> Scores:
        """Score all frames with truth, or some of them.

        A frame without a message of an estimator counts as an empty estimate. The order of rows and of messages does
        not matter. Estimates with the same messages are scored once.

        frames: (f,) ascending;  earlier: which tracks last matched which objects before these
        """
        frames = record.frames() if frames is None else frames
        table = record.truth(frames)
        series, same_as = _distinct_series(record, frames)
        tracks = record.tracks(series, frames)
        boxes, order = tracks.boxes.sorted()
        of_series = np.searchsorted(boxes.group, np.arange(len(series) + 1) * len(frames)).tolist()

        # One series per agent and estimator; all are arranged as consecutive groups and scored at once.
        names, rows = [], []
        for a, agent in enumerate(record.agents):
            position = table.agent_position[:, a]
            near, evaluated, excused_mask = self._truth_masks(table, a)
            truth = [mask.nonzero()[0] for mask in (evaluated, near & ~evaluated, excused_mask)]
            for k, each in enumerate(series):
                if each.agent in ("", agent):
                    series_rows = slice(*of_series[k : k + 2])
                    frame = boxes.group[series_rows] - k * len(frames)
                    in_range = self._near(boxes.position[series_rows], position.take(frame, 0)).nonzero()[0]
                    names.append((agent, each.estimator))
                    rows.append((*truth, in_range + (len(table.boxes) + series_rows.start)))
        all_boxes = Boxes.join([table.boxes, boxes])
        truth_rows, unevaluated, excused, track_rows = ([each[kind] for each in rows] for kind in range(4))
        shape = len(names), len(frames)
        # The evaluated objects, then other objects in range (for figures), then the tracks in range.
        picked = _arrange(all_boxes, [*truth_rows, *unevaluated, *track_rows], shape)
        of_truth, of_tracks = (_concatenate_rows(each) for each in (truth_rows, track_rows))
        tables = of_truth, order.take(of_tracks - len(table.boxes)), table, tracks
        compared = picked, _arrange(all_boxes, excused, shape)
        matches = [(row, *earlier[name]) for row, name in enumerate(names) if name in earlier]
        return self._compare(*compared, tables, tuple(names), frames, record.agents, same_as, matches)

    def _compare(
        self,
        boxes: Boxes,
        excused: Boxes,
        tables: tuple[Ints, Ints, TruthTable, TrackTable],
        series: tuple[tuple[str, str], ...],
        frames: Ints,
        agents: tuple[str, ...],
        same_as: dict[tuple[str, str], tuple[str, str]],
        earlier: Sequence[tuple[int, Ints, Ints]],
    ) -> Scores:
        """The scores of all series.

        boxes: arranged evaluated objects, other objects and tracks;  excused: objects whose tracks are not false
        tables: the rows of the evaluated objects and of the tracks in the tables that follow
        earlier: rows of series, objects and the tracks that matched them before
        """
        assigner = self.assigner
        truth = boxes.select(slice(0, len(tables[0])))
        tracks = boxes.select(slice(len(boxes) - len(tables[1]), None))
        pairs = assigner.assign(truth, tracks)
        # Floating-point sums depend on the order of their terms, so pairs are sorted by id.
        pairs = pairs[row_order(truth.id[pairs[:, 0]], truth.group[pairs[:, 0]])]
        of_truth, of_track = np.full(len(truth), -1, np.int64), np.full(len(tracks), -1, np.int64)
        of_truth[pairs[:, 0]] = tracks.id[pairs[:, 1]]
        of_track[pairs[:, 1]] = truth.id[pairs[:, 0]]
        truth_outcome = np.full(len(truth), MISSED, np.int64)
        truth_outcome[pairs[:, 0]] = MATCHED
        track_outcome = np.full(len(tracks), FALSE, np.int64)
        track_outcome[pairs[:, 1]] = MATCHED

        evaluated = tracks
        if len(excused):
            false_rows = np.flatnonzero(track_outcome == FALSE)
            excused_pairs = assigner.assign(excused, tracks.select(false_rows))
            track_outcome[false_rows[excused_pairs[:, 1]]] = UNEVALUATED
            of_track[false_rows[excused_pairs[:, 1]]] = excused.id[excused_pairs[:, 0]]
            evaluated = tracks.select(track_outcome != UNEVALUATED)

        shape = len(series), len(frames)

        def count(group: Ints) -> Ints:
            return np.bincount(group, minlength=shape[0] * shape[1]).reshape(shape).astype(np.int64)

        group = truth.group[pairs[:, 0]]
        centres = truth.position.take(pairs[:, 0], 0), tracks.position.take(pairs[:, 1], 0)
        distance_m = centre_distance(*centres, assigner.dimensions)
        squared_error: Floats = np.bincount(group, distance_m**2, minlength=shape[0] * shape[1]).astype(np.float64)
        matched = MatchedPairs(group, shape[1], pairs[:, 0], pairs[:, 1], *tables, assigner.dimensions)
        number = count(group)

        def mean(errors: Floats) -> Floats:
            total = np.bincount(group, errors, minlength=number.size).reshape(shape)
            means: Floats = np.divide(total, number, out=np.full(shape, np.nan), where=number > 0)
            return means

        ospa, gospa = self.distance.of(truth, evaluated, shape[0] * shape[1])
        switched, before = _switches(group, truth.id[pairs[:, 0]], tracks.id[pairs[:, 1]], shape[1], earlier)
        return Scores(
            series=series,
            frames=frames,
            fn=count(truth.group[truth_outcome == MISSED]),
            fp=count(tracks.group[track_outcome == FALSE]),
            tp=number,
            squared_error=squared_error.reshape(shape),
            id_switches=count(group[switched]),
            ospa_m=ospa.reshape(shape),
            gospa_m=gospa.reshape(shape),
            **{name: mean(errors) for name, errors in matched.box_errors().items()},
            switches=Switches(
                *np.divmod(group[switched], max(shape[1], 1)),
                truth.id[pairs[switched, 0]],
                before,
                tracks.id[pairs[switched, 1]],
            ),
            judged=_judged(
                boxes, frames, (truth_outcome, of_truth), (track_outcome, of_track), tables[3].score[tables[1]]
            ),
            pairs=matched,
            agents=agents,
            same_as=same_as,
        )

    def _truth_masks(self, table: TruthTable, agent: int) -> tuple[Bools, Bools, Bools]:
        """Masks of the truth rows: near an agent, evaluated, and excused.

        Tracks of excused objects are not false.
        """
        near = self._near(table.boxes.position, table.agent_position[table.boxes.group, agent])
        own = table.boxes.id == table.agent_object[table.boxes.group, agent]
        evaluated = near & (table.seen >= self.min_points)
        if not self.include_self:
            evaluated &= ~own
        excused = ~evaluated if self.ignore_unseen else own & (not self.include_self)
        return near, evaluated, excused

    def _near(self, position: Floats, agent_position: Floats) -> Bools:
        """(n,) whether positions (n, 3) are in range of an agent at (n, 3)."""
        return centre_distance(position, agent_position) <= self.range_m


def _distinct_series(record: Record, frames: Ints) -> tuple[list[Series], dict[tuple[str, str], tuple[str, str]]]:
    """The distinct series, and the equal distinct series of each of the others.

    Series are equal if they have the same messages.
    """
    series = record.series()
    same_as: dict[tuple[str, str], tuple[str, str]] = {}
    distinct: list[Series] = []
    for each in series:
        candidates = [other for other in distinct if other.agent in ("", each.agent)] if each.agent else []
        twin = next((other for other in candidates if record.same(each, other, frames)), None)
        if twin is None:
            distinct.append(each)
        else:
            same_as[each] = each.agent, twin.estimator
    return distinct, same_as


def _arrange(boxes: Boxes, rows: Sequence[Ints], shape: tuple[int, int]) -> Boxes:
    """Rows of `boxes`, given by series or by kind and series, with group = series · frames + frame."""
    n_series, n_frames = shape
    series = np.repeat(np.arange(len(rows)) % max(n_series, 1), [len(each) for each in rows])
    picked = boxes.select(_concatenate_rows(rows))
    return picked.in_group(series * n_frames + picked.group % max(n_frames, 1))


def _concatenate_rows(rows: Sequence[Ints]) -> Ints:
    """Concatenate the rows of all series."""
    return np.concatenate([np.zeros(0, np.int64), *rows])


def _switches(
    group: Ints, truth_id: Ints, track_id: Ints, n_frames: int, earlier: Sequence[tuple[int, Ints, Ints]]
) -> tuple[Ints, Ints]:
    """Pairs whose object was previously matched by another track; and its id.

    In the same series. earlier: rows of series, objects and the tracks that matched them before
    """
    series = group // max(n_frames, 1)
    n = sum(len(objects) for _, objects, _ in earlier)
    if n:
        rows, objects, tracks = zip(*earlier, strict=True)
        series = np.concatenate([np.repeat(rows, [len(each) for each in objects]), series])
        group = np.concatenate([np.full(n, -1), group])
        truth_id, track_id = np.concatenate([*objects, truth_id]), np.concatenate([*tracks, track_id])
    order = np.lexsort((group, truth_id, series))
    same = (np.diff(series[order]) == 0) & (np.diff(truth_id[order]) == 0)
    at = (same & (np.diff(track_id[order]) != 0)).nonzero()[0]
    by_pair = np.argsort(order[at + 1])
    return order[at + 1][by_pair] - n, track_id[order[at]][by_pair]


def _judged(boxes: Boxes, frames: Ints, truth: tuple[Ints, Ints], track: tuple[Ints, Ints], score: Floats) -> Judged:
    """All boxes sorted as in `Judged`; truth, track: outcome and matched id."""
    others = len(boxes) - len(truth[0]) - len(score)
    is_track = np.arange(len(boxes)) >= len(boxes) - len(score)
    outcome = np.concatenate([truth[0], np.full(others, UNEVALUATED), track[0]])
    match = np.concatenate([truth[1], np.full(others, -1), track[1]])
    scores = np.concatenate([np.full(len(boxes) - len(score), np.nan), score])
    sort_key = (boxes.group * 2 + is_track) * len(OUTCOMES) + outcome
    order = row_order(boxes.id, sort_key, ties=lambda: boxes.position.T[::-1])
    boxes = boxes.select(order)
    series, frame = np.divmod(boxes.group, max(len(frames), 1))
    frame_number = frames[frame] if len(frame) else frame
    return Judged(
        series, frame_number, is_track.take(order), outcome.take(order), boxes, match.take(order), scores.take(order)
    )


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
