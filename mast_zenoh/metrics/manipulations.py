"""Manipulations of objects by interposers, and the estimates that they influence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints

#: Kinds of manipulation, by their code.
KINDS = ("inserted", "removed", "moved", "altered")
INSERTED, REMOVED, MOVED, ALTERED = range(len(KINDS))


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
    velocity: (n, 3) m/s, world frame; zero if unknown
    lasts:    (n,) number of frames after its own in which it still counts
    reach:    (p, s) bool: which of s series can be influenced through each of p passages
    """

    culprits: tuple[str, ...]
    reach: Bools
    passage: Ints
    culprit: Ints
    kind: Ints
    frame: Ints
    object: Ints
    position: Floats
    velocity: Floats
    lasts: Ints

    def __len__(self) -> int:
        return len(self.kind)

    def select(self, rows: Bools | Ints) -> Manipulations:
        """The rows selected by a mask or an index array."""
        columns = ("passage", "culprit", "kind", "frame", "object", "position", "velocity", "lasts")
        return Manipulations(self.culprits, self.reach, *(getattr(self, name)[rows] for name in columns))


def no_manipulations(n_series: int) -> Manipulations:
    """Manipulations without rows."""
    zero, nowhere = np.zeros(0, np.int64), np.zeros((0, 3))
    return Manipulations((), np.zeros((0, n_series), bool), zero, zero, zero, zero, zero, nowhere, nowhere, zero)
