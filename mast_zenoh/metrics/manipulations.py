"""Manipulations of objects by interposers, and the estimates that they influence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints

#: Kinds of manipulation, by their code.
KINDS = ("inserted", "removed", "moved", "altered")
INSERTED, REMOVED, MOVED, ALTERED = range(len(KINDS))

#: The columns of `Manipulations` with a row for each of them.
COLUMNS = ("passage", "culprit", "kind", "frame", "object", "position", "original", "velocity", "lasts", "of_box")


@dataclass(frozen=True, slots=True)
class Manipulations:
    """n manipulations of objects.

    culprits: c names of adversaries and other interposers except links, sorted
    passage:  (n,) row of `reach`: an interposer on a wire
    culprit:  (n,) row of `culprits`; -1: a link, which counts as a fault
    kind:     (n,) index into KINDS
    frame:    (n,)
    object:   (n,) episode of an insertion, else the id of the truth object; below 0: unknown
    position: (n, 3) m, world frame: the claimed position, or the original one of a removed object
    original: (n, 3) m, world frame: the original position; NaN for an inserted object
    velocity: (n, 3) m/s, world frame; zero if unknown
    lasts:    (n,) number of frames after its own in which it still counts
    of_box:   (n,) bool, altered in size, heading and class alone: the object is found where it was
    reach:    (p, s) bool: which of s series can lack or displace an object because of each of p passages
    altered:  (p, s) bool: which can because of an object that was altered and not moved: not what is judged as sent
    shown:    (p, s) bool: which can have a false track because of it
    delay:    (p, s) number of frames after its own from which on a manipulation can have been used for each series
    """

    culprits: tuple[str, ...]
    reach: Bools
    altered: Bools
    shown: Bools
    delay: Ints
    passage: Ints
    culprit: Ints
    kind: Ints
    frame: Ints
    object: Ints
    position: Floats
    original: Floats
    velocity: Floats
    lasts: Ints
    of_box: Bools

    def __len__(self) -> int:
        return len(self.kind)

    def select(self, rows: Bools | Ints) -> Manipulations:
        """The rows selected by a mask or an index array."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    @classmethod
    def joined(cls, parts: Sequence[Manipulations]) -> Manipulations:
        """The manipulations of several parts of a run, in that order; passages are those of the last part."""
        culprits = tuple(sorted({name for part in parts for name in part.culprits}))
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS}
        rows = [np.array([*(culprits.index(name) for name in part.culprits), -1], np.int64) for part in parts]
        columns["culprit"] = np.concatenate([row[part.culprit] for row, part in zip(rows, parts, strict=True)])
        return replace(parts[-1], culprits=culprits, **columns)

    def first_shown(self, series: Ints, by: Bools, span: int) -> Ints:
        """First frame (n,) in which a series can have an object that any of the culprits (n, c) showed.

        `span` if none did. The object must be visible in the series. For rows without a culprit, links are used.
        """
        first_frame = np.full((len(self.culprits) + 1, self.shown.shape[1]), span)  # the last row is for links
        shows = np.isin(self.kind, (INSERTED, MOVED))
        for culprit in range(-1, len(self.culprits)):
            rows = (shows & (self.culprit == culprit)).nonzero()[0]
            if len(rows):
                passage = self.passage[rows]
                frame = np.where(self.shown[passage], self.frame[rows, None] + self.delay[passage], span)
                first_frame[culprit] = frame.min(axis=0)
        responsible = np.column_stack([by, ~by.any(axis=1)])
        return np.asarray(np.where(responsible, first_frame[:, series].T, span).min(axis=1))
