"""What interposers did to objects: by whom, to which object, and which estimates it can influence. Pure."""

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

    culprits: c names of adversaries and other interposers that are no links, sorted
    passage:  (n,) row of `reach`: the way of an interposer through a wire
    culprit:  (n,) row of `culprits`; -1: a link, so that it counts as a fault
    kind:     (n,) index into KINDS
    frame:    (n,)
    object:   (n,) the object: of an insertion its episode, else the id of the truth object; below 0: none is known
    position: (n, 3) m, world frame: where the object is shown; of one that is not shown any more, where it was
    velocity: (n, 3) m/s, world frame; zero where it is not known
    lasts:    (n,) frames after its own in which it still counts
    reach:    (p, s) bool: which of s series can have been influenced by what went through each of p passages
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
        """The rows that a mask or an index array picks."""
        columns = ("passage", "culprit", "kind", "frame", "object", "position", "velocity", "lasts")
        return Manipulations(self.culprits, self.reach, *(getattr(self, name)[rows] for name in columns))


def none(n_series: int) -> Manipulations:
    """No manipulation at all."""
    zero, nowhere = np.zeros(0, np.int64), np.zeros((0, 3))
    return Manipulations((), np.zeros((0, n_series), bool), zero, zero, zero, zero, zero, nowhere, nowhere, zero)
