"""The matched pairs of a scored run: errors of tracks, and the covariances that they came with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.record import TrackTable, TruthTable


class MatchedPairs(NamedTuple):
    """n pairs of a track and a truth object, sorted by series, frame and object.

    series, frame: (n,) rows of `Scores.series` and `Scores.frames`;  object_id: (n,) of the truth object
    truth_row, track_row: (n,) rows of the tables
    """

    series: Ints
    frame: Ints
    object_id: Ints
    truth_row: Ints
    track_row: Ints
    truth: TruthTable
    tracks: TrackTable

    def in_frames(self, scored: slice) -> MatchedPairs:
        """The pairs in a slice of the rows of `Scores.frames`, with a start and a stop."""
        return self._select((self.frame >= scored.start) & (self.frame < scored.stop))

    def of_series(self, row: int) -> MatchedPairs:
        """The pairs of one series."""
        first, last = self.series.searchsorted((row, row + 1)).tolist()
        return self._select(slice(first, last))

    def position_errors(self) -> tuple[Floats, Floats]:
        """Horizontal errors (n, 2) m, and the elements xx, xy, yy (n, 3) m^2 of their covariances."""
        error = self.tracks.boxes.position.take(self.track_row, 0) - self.truth.boxes.position.take(self.truth_row, 0)
        return error[:, :2], self.tracks.spread.take(self.track_row, 0)[:, :3]

    def velocity_errors(self) -> tuple[Floats, Floats]:
        """Horizontal errors (n, 2) m/s, and the elements xx, xy, yy (n, 3) (m/s)^2 of their covariances."""
        error = self.tracks.velocity.take(self.track_row, 0) - self.truth.velocity.take(self.truth_row, 0)
        return error[:, :2], self.tracks.spread.take(self.track_row, 0)[:, 3:]

    def _select(self, index: Bools | slice) -> MatchedPairs:
        return self._replace(
            series=self.series[index],
            frame=self.frame[index],
            object_id=self.object_id[index],
            truth_row=self.truth_row[index],
            track_row=self.track_row[index],
        )


class Sources(NamedTuple):
    """Where the boxes of a layout come from.

    truth, tracks: the tables;  truth_rows, track_rows: the row there of each truth object and track of the layout
    """

    truth: TruthTable
    tracks: TrackTable
    truth_rows: Ints
    track_rows: Ints

    def pairs(self, group: Ints, object_id: Ints, pairs: Ints, n_frames: int) -> MatchedPairs:
        """The pairs (n, 2) of a truth object and a track of the layout.

        group: (n,) series · n_frames + frame, ascending;  object_id: (n,)
        """
        series, frame = np.divmod(group, max(n_frames, 1))
        truth_row, track_row = self.truth_rows[pairs[:, 0]], self.track_rows[pairs[:, 1]]
        return MatchedPairs(series, frame, object_id, truth_row, track_row, self.truth, self.tracks)
