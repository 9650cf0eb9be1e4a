"""The matched pairs of a scored run: errors of tracks, and the covariances that they came with."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.boxes import centre_distance
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
    dimensions: of the distance of a pair, see `boxes.centre_distance`
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

    def _rows(self, series: int, frames: slice) -> tuple[Ints, Ints]:
        """The rows (n,) of the truth and of the tracks of one series' pairs in a slice of the frames."""
        begin = series * self.n_frames
        first, last = self.group.searchsorted((begin + frames.start, begin + frames.stop)).tolist()
        return self.truth_rows.take(self.truth_box[first:last]), self.track_rows.take(self.track_box[first:last])


class Sources(NamedTuple):
    """Where the boxes of a layout come from.

    truth, tracks: the tables;  truth_rows, track_rows: the row there of each truth object and track of the layout
    """

    truth: TruthTable
    tracks: TrackTable
    truth_rows: Ints
    track_rows: Ints

    def pairs(self, group: Ints, pairs: Ints, n_frames: int, dimensions: int) -> MatchedPairs:
        """The pairs (n, 2) of a truth object and a track of the layout; group: (n,), dimensions: see `MatchedPairs`."""
        truth_box, track_box = pairs.T
        return MatchedPairs(
            group, n_frames, truth_box, track_box, self.truth_rows, self.track_rows, self.truth, self.tracks, dimensions
        )
