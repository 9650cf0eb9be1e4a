"""Outcomes of tracks and truth objects over time. Pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.places import Places
from mast_zenoh.metrics.scores import UNEVALUATED, Scores

#: Smaller ids are used directly; an adversary may send any.
_PLAIN_IDS = 1 << 32


class Histories(NamedTuple):
    """n rows of `Scores.judged`, all tracks or all truth objects.

    Sorted by series, id and frame.

    row:      (n,) of `Scores.judged`;  series, frame, id, match, outcome: (n,), see `Judged`
    position: (n, 3) m, world frame
    group:    (n,) a number of series and frame
    """

    row: Ints
    series: Ints
    frame: Ints
    id: Ints
    match: Ints
    outcome: Ints
    position: Floats
    group: Ints

    @classmethod
    def of(cls, scores: Scores, rows: Ints, span: int) -> Histories:
        """The given rows of `scores.judged`; span: greater than any frame number."""
        judged = scores.judged
        series, frame = judged.series[rows], judged.frame[rows]
        id_, position = judged.id[rows], judged.boxes.position[rows]
        group = series * span + frame
        return cls(rows, series, frame, id_, judged.match_id[rows], judged.outcome[rows], position, group)

    @classmethod
    def of_wrong(cls, scores: Scores, outcome: int, span: int, *, tracks: bool) -> Histories:
        """All rows of the tracks or truth objects that ever have a given outcome.

        In any frame of a series.
        """
        judged = scores.judged
        ids = judged.id
        if len(ids) and not (ids.min() >= 0 and ids.max() < _PLAIN_IDS):
            ids = np.unique(ids, return_inverse=True)[1].reshape(-1)
        key = judged.series * (int(ids.max(initial=0)) + 1) + ids
        rows = np.flatnonzero(judged.is_track == tracks)
        row_keys = key[rows]
        rows = rows[np.isin(row_keys, row_keys[judged.outcome[rows] == outcome])]
        return cls.of(scores, rows[np.lexsort((judged.frame[rows], key[rows]))], span)

    @classmethod
    def of_truths_beside(cls, scores: Scores, rows: Ints, span: int) -> Histories:
        """The truth objects in the series and frames of these rows of `scores.judged`."""
        judged = scores.judged
        group = judged.boxes.group
        involved = np.zeros(int(group.max(initial=0)) + 1, bool)
        involved[group[rows]] = True
        return cls.of(scores, np.flatnonzero(~judged.is_track & involved[group]), span)

    def places(self, rows: Bools | Ints) -> Places:
        """The positions of some rows; rows of different series or frames are never paired."""
        return Places(self.group[rows], self.position[rows])

    def adjacent(self, valid: Bools, stops: Bools, max_frames: int, *, later: bool = False) -> Ints:
        """The last row (n,) with `stops` up to each row, in its series and id.

        later: the first one at or after each row instead

        -1 if there is none, if it is not `valid`, or if it is more than `max_frames` frames away.
        """
        direction = slice(None, None, -1) if later else slice(None)
        n = len(self.row)
        stop_row = np.maximum.accumulate(np.where(stops[direction], np.arange(n), -1)) if n else np.zeros(0, np.int64)
        last = stop_row[direction]
        known = last >= 0
        last = np.where(known & later, n - 1 - last, last)
        same = known & (self.series[last] == self.series) & (self.id[last] == self.id) & valid[last]
        same &= np.abs(self.frame[last] - self.frame) <= max_frames
        return np.where(same, last, -1)

    def period_start(self) -> Ints:
        """First frame (n,) of the current evaluated, or unevaluated, period of each row."""
        seen = self.outcome != UNEVALUATED
        first = np.ones(len(self.row), bool)
        first[1:] = (np.diff(self.series) != 0) | (np.diff(self.id) != 0) | (np.diff(self.frame) != 1)
        first[1:] |= seen[1:] != seen[:-1]
        start = np.maximum.accumulate(np.where(first, np.arange(len(first)), 0)) if len(first) else first.astype(int)
        return np.asarray(self.frame[start])
