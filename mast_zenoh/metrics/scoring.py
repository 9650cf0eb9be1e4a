"""Scores a recorded run: every agent, every estimator and every frame at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.ordering import row_order
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.assignment import Assigner, CenterDistanceAssigner
from mast_zenoh.metrics.boxes import Boxes, centre_distance
from mast_zenoh.metrics.ospa import SetDistance
from mast_zenoh.metrics.record import Record, Series, TruthTable
from mast_zenoh.metrics.scores import FALSE, MATCHED, MISSED, OUTCOMES, UNEVALUATED, Judged, Scores, Seen, Switches


class Scorer:
    """Compares what agents believe with the truth (docs/metrics.md).

    For each agent and frame the truth is what lies within `range_m` of the agent (bird's-eye view) and is hit by at
    least `min_points` lidar points of at least one agent; tracks beyond the same range are left out. A pair of the
    assigner is a true positive (TP), a truth object without a track a false negative (FN), a track without a truth
    object a false positive (FP). RMSE is over the bird's-eye centre distances of the pairs. An identity switch is
    counted when the track that matches an object has another id than the one that matched it last.

    assigner:      matches tracks with truth; None: CenterDistanceAssigner()
    distance:      parameters of OSPA and GOSPA; None: SetDistance()
    include_self:  whether the object that the agent is counts as truth for it. If not, a track of it is not false
                   either: it goes unevaluated
    ignore_unseen: whether tracks of objects that are not evaluated (nobody sees them, or they are out of range) go
                   unevaluated as well; by default they are false
    Raises ValueError for values that make no sense.
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

    def score(self, record: Record) -> Scores:
        """The scores of all frames of which the truth is known.

        A frame without a message of an estimator counts as one in which it believed nothing. The order of rows, and
        the order in which messages came, do not matter. Estimates that are the same messages are scored once.
        """
        frames = record.frames()
        table = record.truth(frames)
        series, same_as = _distinct(record, frames)
        tracks = record.tracks(series, frames)
        boxes, order = tracks.boxes.sorted()
        of_series = np.searchsorted(boxes.group, np.arange(len(series) + 1) * len(frames)).tolist()

        # One series per agent and estimator; all are laid out in one row of groups and scored in one go.
        names, rows = [], []
        for a, agent in enumerate(record.agents):
            position = table.agent_position[:, a]
            near, evaluated, excusing = self._split(table, a)
            truth = [mask.nonzero()[0] for mask in (evaluated, near & ~evaluated, excusing)]
            for k, each in enumerate(series):
                if each.agent in ("", agent):
                    mine = slice(*of_series[k : k + 2])
                    frame = boxes.group[mine] - k * len(frames)
                    heard = self._near(boxes.position[mine], position.take(frame, 0)).nonzero()[0]
                    names.append((agent, each.estimator))
                    rows.append((*truth, heard + (len(table.boxes) + mine.start)))
        everything = Boxes.join([table.boxes, boxes])
        seen, unevaluated, excused, believed = ([each[kind] for each in rows] for kind in range(4))
        layout = _Layout.of(tuple(names), frames, everything, (seen, unevaluated, believed), excused)
        score = tracks.score.take(order).take(_together(believed) - len(table.boxes))
        return _compare(self.assigner, self.distance, layout, score, same_as)

    def _split(self, table: TruthTable, agent: int) -> tuple[Bools, Bools, Bools]:
        """Of the truth's rows: those near an agent, those it is measured by, those whose tracks are excused."""
        near = self._near(table.boxes.position, table.agent_position[table.boxes.group, agent])
        own = table.boxes.id == table.agent_object[table.boxes.group, agent]
        evaluated = near & (table.seen >= self.min_points)
        if not self.include_self:
            evaluated &= ~own
        excused = ~evaluated if self.ignore_unseen else own & (not self.include_self)
        return near, evaluated, excused

    def _near(self, position: Floats, agent_position: Floats) -> Bools:
        """(n,) which places (n, 3) are in range of an agent that is at (n, 3)."""
        return centre_distance(position, agent_position) <= self.range_m


def _distinct(record: Record, frames: Ints) -> tuple[list[Series], dict[tuple[str, str], tuple[str, str]]]:
    """The series that differ, and of each other one, as (agent, estimator), that which it is the same as."""
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


@dataclass(frozen=True, slots=True)
class _Layout:
    """Boxes of all series and frames in one row of groups; group = series · frames + frame.

    boxes:   first what the series are measured by, then other objects in range, which are for the figures, then the
             tracks in range
    counts:  how many there are of these three
    excused: objects whose tracks are not false although they are not measured by
    """

    series: tuple[tuple[str, str], ...]
    frames: Ints
    boxes: Boxes
    counts: tuple[int, int, int]
    excused: Boxes

    @classmethod
    def of(
        cls,
        series: tuple[tuple[str, str], ...],
        frames: Ints,
        boxes: Boxes,
        kinds: Sequence[Sequence[Ints]],
        excused: Sequence[Ints],
    ) -> _Layout:
        """The layout of rows of `boxes`, given for each of the three kinds, and for the excused, by series."""
        picked = _laid_out(boxes, [rows for kind in kinds for rows in kind], len(series), len(frames))
        of_seen, of_others, of_tracks = (sum(map(len, kind)) for kind in kinds)
        counts = of_seen, of_others, of_tracks
        return cls(series, frames, picked, counts, _laid_out(boxes, excused, len(series), len(frames)))

    @property
    def truth(self) -> Boxes:
        """What the series are measured by."""
        return self.boxes.select(slice(0, self.counts[0]))

    @property
    def tracks(self) -> Boxes:
        """The tracks in range."""
        return self.boxes.select(slice(len(self.boxes) - self.counts[2], None))


def _laid_out(boxes: Boxes, rows: Sequence[Ints], n_series: int, n_frames: int) -> Boxes:
    """Rows of `boxes` by series, or by kind and series, as a layout has them."""
    series = np.repeat(np.arange(len(rows)) % max(n_series, 1), [len(each) for each in rows])
    picked = boxes.select(_together(rows))
    return picked.in_group(series * n_frames + picked.group % max(n_frames, 1))


def _together(rows: Sequence[Ints]) -> Ints:
    """The rows of all series."""
    return np.concatenate([np.zeros(0, np.int64), *rows])


def _compare(
    assigner: Assigner,
    distance: SetDistance,
    layout: _Layout,
    score: Floats,
    same_as: dict[tuple[str, str], tuple[str, str]],
) -> Scores:
    """The scores of what is laid out; score: (n,) of the tracks."""
    truth, tracks, excused = layout.truth, layout.tracks, layout.excused
    pairs = assigner.assign(truth, tracks)
    # Sums of fractions depend on the order of their terms: that of the ids, not that in which the messages came.
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
        left = np.flatnonzero(track_outcome == FALSE)
        pardons = assigner.assign(excused, tracks.select(left))
        track_outcome[left[pardons[:, 1]]] = UNEVALUATED
        of_track[left[pardons[:, 1]]] = excused.id[pardons[:, 0]]
        evaluated = tracks.select(track_outcome != UNEVALUATED)

    shape = len(layout.series), len(layout.frames)

    def count(group: Ints) -> Ints:
        return np.bincount(group, minlength=shape[0] * shape[1]).reshape(shape).astype(np.int64)

    group = truth.group[pairs[:, 0]]
    apart = centre_distance(truth.position.take(pairs[:, 0], 0), tracks.position.take(pairs[:, 1], 0))
    squared_error: Floats = np.bincount(group, apart**2, minlength=shape[0] * shape[1]).astype(np.float64)
    ospa, gospa = distance.of(truth, evaluated, shape[0] * shape[1])
    switched, before = _switches(group, truth.id[pairs[:, 0]], tracks.id[pairs[:, 1]], shape[1])
    return Scores(
        series=layout.series,
        frames=layout.frames,
        fn=count(truth.group[truth_outcome == MISSED]),
        fp=count(tracks.group[track_outcome == FALSE]),
        tp=count(group),
        squared_error=squared_error.reshape(shape),
        id_switches=count(group[switched]),
        ospa_m=ospa.reshape(shape),
        gospa_m=gospa.reshape(shape),
        seen=Seen(*np.divmod(truth.group, max(shape[1], 1)), truth.id, truth_outcome == MATCHED),
        switches=Switches(
            *np.divmod(group[switched], max(shape[1], 1)),
            truth.id[pairs[switched, 0]],
            before,
            tracks.id[pairs[switched, 1]],
        ),
        judged=_judged(layout, (truth_outcome, of_truth), (track_outcome, of_track), score),
        same_as=same_as,
    )


def _switches(group: Ints, truth_id: Ints, track_id: Ints, n_frames: int) -> tuple[Ints, Ints]:
    """The pairs whose object was matched last, in the same series, by a track of another id, and that other id."""
    series = group // max(n_frames, 1)
    order = np.lexsort((group, truth_id, series))
    same = (np.diff(series[order]) == 0) & (np.diff(truth_id[order]) == 0)
    at = (same & (np.diff(track_id[order]) != 0)).nonzero()[0]
    by_pair = np.argsort(order[at + 1])
    return order[at + 1][by_pair], track_id[order[at]][by_pair]


def _judged(layout: _Layout, truth: tuple[Ints, Ints], track: tuple[Ints, Ints], score: Floats) -> Judged:
    """All boxes in the order of `Judged`; truth, track: outcome and matched id."""
    boxes, others = layout.boxes, layout.counts[1]
    is_track = np.arange(len(boxes)) >= len(boxes) - len(score)
    outcome = np.concatenate([truth[0], np.full(others, UNEVALUATED), track[0]])
    match = np.concatenate([truth[1], np.full(others, -1), track[1]])
    scores = np.concatenate([np.full(len(boxes) - len(score), np.nan), score])
    place = (boxes.group * 2 + is_track) * len(OUTCOMES) + outcome
    order = row_order(boxes.id, place, ties=tuple(boxes.position.T[::-1]))
    boxes = boxes.select(order)
    series, frame = np.divmod(boxes.group, max(len(layout.frames), 1))
    at = layout.frames[frame] if len(frame) else frame
    return Judged(series, at, is_track.take(order), outcome.take(order), boxes, match.take(order), scores.take(order))
