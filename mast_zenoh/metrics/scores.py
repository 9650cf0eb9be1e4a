"""The scores of a run: matched pairs, tables per frame and object, and the summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.assignment import centre_distance, iou_3d
from mast_zenoh.metrics.estimates import rank_of
from mast_zenoh.metrics.record import TrackTable, TruthTable


class PairErrors(NamedTuple):
    """n pairs of a track and a truth object.

    truth_row: (n,) rows of the truth
    position, velocity: horizontal errors (n, 2), m and m/s, and the elements xx, xy, yy (n, 3) of their covariances
    """

    truth_row: Ints
    position: tuple[Floats, Floats]
    velocity: tuple[Floats, Floats]


class MatchedPairs(NamedTuple):
    """n pairs of a truth object and a track.

    group: (n,) series · n_frames + frame, rows of `Scores.series` and `Scores.frames`, ascending
    truth_box, track_box: (n,) numbers of the truth objects, and of the tracks, among those of all series
    truth_rows, track_rows: the row of each of these in the tables `truth` and `tracks`
    dimensions: of the distance of a pair, see `assignment.centre_distance`
    """

    group: Ints
    n_frames: int
    truth_box: Ints
    track_box: Ints
    truth_rows: Ints
    track_rows: Ints
    truth: TruthTable
    tracks: TrackTable
    dimensions: int

    def last(self, series: int, frames: slice) -> tuple[Ints, Ints]:
        """Ascending ids (k,) of the objects of a series, and the ids (k,) of the tracks that matched them last."""
        truth_row, track_row = self._rows(series, frames)
        return _last_of_each(self.truth.boxes.id.take(truth_row), self.tracks.boxes.id.take(track_row))

    def errors(self, series: int, frames: slice) -> PairErrors:
        """The errors of one series in a slice of the frames, with a start and a stop."""
        truth_row, track_row = self._rows(series, frames)
        truth, tracks, spread = self.truth, self.tracks, self.tracks.spread.take(track_row, 0)
        position = tracks.boxes.position.take(track_row, 0) - truth.boxes.position.take(truth_row, 0)
        velocity = tracks.velocity.take(track_row, 0) - truth.velocity.take(truth_row, 0)
        return PairErrors(truth_row, (position[:, :2], spread[:, :3]), (velocity[:, :2], spread[:, 3:]))

    def ranked(self, series: int, frames: slice) -> tuple[Ints, Ints, Floats, Floats]:
        """Ids of the objects and of the tracks, scores, and distances (m) of one series' pairs (n,).

        In order of time; frames: a slice with a start and a stop
        """
        truth_row, track_row = self._rows(series, frames)
        truth, tracks = self.truth.boxes, self.tracks.boxes
        centres = truth.position.take(truth_row, 0), tracks.position.take(track_row, 0)
        error_m = centre_distance(*centres, self.dimensions)
        return truth.id.take(truth_row), tracks.id.take(track_row), self.tracks.score.take(track_row), error_m

    def box_errors(self) -> dict[str, Floats]:
        """The errors (n,) of the boxes and velocities of all pairs, by their names in `Scores`.

        A heading's is the smallest angle, 0 to 180 degrees; a speed's and a velocity's are in the bird's-eye view.
        """
        truth_row, track_row = self.truth_rows.take(self.truth_box), self.track_rows.take(self.track_box)
        truth, tracks = self.truth.boxes.select(truth_row), self.tracks.boxes.select(track_row)
        size = np.abs(tracks.size - truth.size)
        velocity, true_velocity = self.tracks.velocity.take(track_row, 0), self.truth.velocity.take(truth_row, 0)
        return {
            "length_error_m": size[:, 0],
            "width_error_m": size[:, 1],
            "heading_error_deg": np.degrees(np.abs(wrap_angle(tracks.yaw - truth.yaw))),
            "speed_error_mps": np.abs(np.hypot(*velocity[:, :2].T) - np.hypot(*true_velocity[:, :2].T)),
            "velocity_error_mps": centre_distance(velocity, true_velocity),
            "iou_3d": iou_3d(truth, tracks),
        }

    def _rows(self, series: int, frames: slice) -> tuple[Ints, Ints]:
        """The rows (n,) of the truth and of the tracks of one series' pairs in a slice of the frames."""
        begin = series * self.n_frames
        first, last = self.group.searchsorted((begin + frames.start, begin + frames.stop)).tolist()
        return self.truth_rows.take(self.truth_box[first:last]), self.track_rows.take(self.track_box[first:last])


#: By agent and estimator: ascending ids (k,) of truth objects, and the ids (k,) of the tracks that last matched them.
LastMatches = Mapping[tuple[str, str], tuple[Ints, Ints]]


def _last_of_each(ids: Ints, values: Ints) -> tuple[Ints, Ints]:
    """The distinct ids, ascending, and the last value of each."""
    distinct, row = np.unique(ids[::-1], return_index=True)
    return distinct, values[::-1][row]


#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]
Texts = NDArray[Any]  # of str

#: Outcomes of boxes, by their code in `scoring`.
OUTCOMES = ("matched", "missed", "false", "unevaluated")
MATCHED, MISSED, FALSE, UNEVALUATED = range(len(OUTCOMES))


class Judged(NamedTuple):
    """n boxes with outcomes: truth objects in range, and tracks.

    Sorted by series, frame, kind, outcome and id.

    series:   (n,) row of `Scores.series`;  frame: (n,) number of the frame
    is_track: (n,) bool, a track instead of a truth object
    outcome:  (n,) index into OUTCOMES
    boxes:    n boxes, world frame;  match_id: (n,) id of the matched box, -1: none
    score:    (n,) of tracks, NaN for truth objects
    """

    series: Ints
    frame: Ints
    is_track: Bools
    outcome: Ints
    boxes: Boxes
    match_id: Ints
    score: Floats

    @property
    def id(self) -> Ints:
        """Ids (n,) of the boxes."""
        return self.boxes.id


class ObjectsMatched(NamedTuple):
    """k truth objects of a series: ascending ids (k,), and the numbers of frames (k,) evaluated and matched."""

    ids: Ints
    frames: Ints
    matched: Ints

    @classmethod
    def joined(cls, parts: Sequence[ObjectsMatched]) -> ObjectsMatched:
        """The sums over several parts of a run."""
        ids, code = np.unique(np.concatenate([part.ids for part in parts]), return_inverse=True)
        sums = (
            np.bincount(code, np.concatenate([part[column] for part in parts]), len(ids)).astype(np.int64)
            for column in (1, 2)
        )
        return cls(ids, *sums)

    @property
    def completeness(self) -> float | None:
        """Mean over the objects of the fraction of matched frames, 0 to 1; None without objects."""
        return float(np.mean(self.matched / self.frames)) if len(self.ids) else None


class Switches(NamedTuple):
    """k identity switches: a truth object is matched by a different track than before.

    series, frame: (k,) rows of `Scores.series` and `Scores.frames`; truth_id: (k,) of the object
    before, after: (k,) ids of the tracks
    """

    series: Ints
    frame: Ints
    truth_id: Ints
    before: Ints
    after: Ints


@dataclass(frozen=True, slots=True)
class FrameScores:
    """Counts of s series (an agent and one of its estimators) in f frames.

    series:        s pairs (agent, estimator)
    frames:        (f,) int64
    fn, fp, tp:    (s, f) int64
    squared_error: (s, f) m^2, summed over the pairs of the frame
    id_switches:   (s, f) int64
    ospa_m, gospa_m: (s, f) m, distances between the sets of truth objects and tracks
    length_error_m, width_error_m, heading_error_deg, speed_error_mps, velocity_error_mps, iou_3d: (s, f) means over
                   the pairs of the frame, see `MatchedPairs.box_errors`; NaN without a pair
    same_as:       other series, each with the one of `series` that has the same messages and therefore scores; they
                   are in the table per frame and in the summary, but have no separate boxes
    """

    series: tuple[tuple[str, str], ...]
    frames: Ints
    fn: Ints
    fp: Ints
    tp: Ints
    squared_error: Floats
    id_switches: Ints
    ospa_m: Floats
    gospa_m: Floats
    length_error_m: Floats
    width_error_m: Floats
    heading_error_deg: Floats
    speed_error_mps: Floats
    velocity_error_mps: Floats
    iou_3d: Floats
    same_as: Mapping[tuple[str, str], tuple[str, str]]

    @property
    def every_series(self) -> dict[tuple[str, str], int]:
        """Rows of `series` by agent and estimator, including the series in `same_as`."""
        row = {each: k for k, each in enumerate(self.series)}
        every = row | {each: row[other] for each, other in self.same_as.items()}
        agents = {agent: k for k, agent in enumerate(dict.fromkeys(agent for agent, _ in self.series))}
        return dict(sorted(every.items(), key=lambda item: (agents[item[0][0]], rank_of(item[0][1]), item[0][1])))


@dataclass(frozen=True, slots=True)
class Scores(FrameScores):
    """Scores of s series in f frames, with every box.

    switches:      a row per identity switch
    judged:        every box of every series
    pairs:         the matched pairs, with the tables that they come from
    agents:        names, in the order of the columns of the truth
    """

    switches: Switches
    judged: Judged
    pairs: MatchedPairs
    agents: tuple[str, ...]

    @property
    def truth(self) -> TruthTable:
        """The truth of `frames`."""
        return self.pairs.truth

    @property
    def truth_frame(self) -> Ints:
        """Frame numbers (n,) of the rows of `truth`."""
        return self.frames[self.truth.boxes.group]

    def part(self, rows: slice) -> FrameScores:
        """What is known per frame of some rows of `frames`."""
        columns: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(FrameScores)}
        arrays = {name: column[..., rows] for name, column in columns.items() if isinstance(column, np.ndarray)}
        return FrameScores(**columns | arrays)

    def objects_matched(self, scored: slice) -> list[ObjectsMatched]:
        """For how many frames the objects of each series are evaluated, and matched."""
        judged, n = self.judged, len(self.series)
        evaluated = ~judged.is_track & np.isin(judged.outcome, (MATCHED, MISSED))
        rows = np.flatnonzero(evaluated & np.isin(judged.frame, self.frames[scored]))
        ids, code = np.unique(judged.id[rows], return_inverse=True)
        cell, shape = judged.series[rows] * len(ids) + code, (n, len(ids))
        total = np.bincount(cell, minlength=n * len(ids)).reshape(shape)
        matched = np.bincount(cell, judged.outcome[rows] == MATCHED, minlength=n * len(ids)).reshape(shape)
        return [
            ObjectsMatched(ids[frames > 0], frames[frames > 0], matched_frames[frames > 0])
            for matched_frames, frames in zip(matched, total, strict=True)
        ]

    def last_matches(self, before: int, earlier: LastMatches) -> LastMatches:
        """The tracks that last matched the objects of every series before a frame; earlier: before the first frame."""
        known = slice(0, int(np.searchsorted(self.frames, before)))
        result = {}
        for name, row in self.every_series.items():
            parts = [*([earlier[name]] if name in earlier else []), self.pairs.last(row, known)]
            result[name] = _last_of_each(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return result

    def objects(self) -> Table:
        """A row per box and series.

        Columns:
        frame: number of the frame, from 0
        agent, estimator: whose estimate of which kind
        kind: `truth` or `track`
        outcome: `matched`, `missed`, `false` or `unevaluated`
        id: of this box
        match_id: of the box with which it is matched; -1: none
        x, y, z: m, centre in the world
        l, w, h: m, length, width, height
        yaw: rad, heading, counter-clockwise from east
        score: 0 to 1, confidence of a track; missing for truth
        """
        judged, boxes = self.judged, self.judged.boxes
        names = np.array(self.series, object).reshape(-1, 2)
        return {
            "frame": judged.frame,
            "agent": names[:, 0].take(judged.series),
            "estimator": names[:, 1].take(judged.series),
            "kind": np.array(["truth", "track"], object).take(judged.is_track),
            "outcome": np.array(OUTCOMES, object).take(judged.outcome),
            "id": boxes.id,
            "match_id": judged.match_id,
            **{name: boxes.position[:, axis] for axis, name in enumerate("xyz")},
            **{name: boxes.size[:, axis] for axis, name in enumerate("lwh")},
            "yaw": boxes.yaw,
            "score": judged.score,
        }


def means_and_stds(values: NDArray[Any]) -> list[dict[str, float | None]]:
    """Mean and standard deviation of each row of (s, n) values over those that are finite; None without one."""
    finite = np.isfinite(values)
    number = np.maximum(finite.sum(axis=1), 1)
    mean = np.where(finite, values, 0.0).sum(axis=1) / number
    squares = np.where(finite, values - mean[:, None], 0.0) ** 2
    std = np.sqrt(squares.sum(axis=1) / number)
    rows = zip(finite.any(axis=1).tolist(), mean.tolist(), std.tolist(), strict=True)
    return [{"mean": m, "std": s} if any_ else {"mean": None, "std": None} for any_, m, s in rows]


def mean_and_std(values: NDArray[Any]) -> dict[str, float | None]:
    """`means_and_stds` of one row."""
    return means_and_stds(values[None])[0]
