"""The causes of errors, and the two ways in which an adversary causes them: what it shows, and what it hides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, KINDS, MOVED, REMOVED, Manipulations
from mast_zenoh.metrics.places import Places

#: Causes of false tracks, missed objects and identity switches: attacks first, with the codes of KINDS.
CAUSES = (*KINDS, "duplicate", "lag", "occlusion or range", "clutter", "tracking", "fusion", "link or fault")
DUPLICATE, LAG, SIGHT, CLUTTER, TRACKING, FUSION, FAULT = range(len(KINDS), len(CAUSES))
UNKNOWN = -1
#: Causes that are an attack, and those that are a fault; all others are natural.
ATTACK_CAUSES, FAULT_CAUSES = KINDS, CAUSES[FAULT:]


def named(causes: Ints) -> NDArray[np.object_]:
    """(n,) str, the names of causes; empty where there is none."""
    return np.array([*CAUSES, ""], object)[causes]


def shown(done: Manipulations, period_s: float, coast: int, span: int) -> Places:
    """Where objects that somebody shows are, and where they would have gone at constant velocity in the `coast` frames
    after, or in a gap: a track of them goes on for a while.

    Groups are series * `span` + frame, of every series that each manipulation can have influenced.
    """
    order = np.lexsort((done.frame, done.object, done.passage))
    done = done.select(order)
    steps = np.full(len(done), coast + 1)
    same = (np.diff(done.object) == 0) & (np.diff(done.passage) == 0)
    steps[:-1] = np.where(same, np.minimum(np.diff(done.frame), coast + 1), steps[:-1])
    row = np.repeat(np.arange(len(done)), steps)
    ahead = np.arange(len(row)) - np.repeat(np.cumsum(steps) - steps, steps)
    frame = done.frame[row] + ahead
    row, frame, ahead = row[frame < span], frame[frame < span], ahead[frame < span]
    position = done.position[row] + done.velocity[row] * (ahead * period_s)[:, None]
    at, series = done.reach[done.passage[row]].nonzero()
    return Places(series * span + frame[at], position[at])


@dataclass(frozen=True, slots=True)
class Hidden:
    """Which truth objects were removed, moved or altered, and when.

    parts: for each kind and passage: code of the cause, culprit (-1: a link), the series reached (s,) bool, the ids of
           the objects and the frames (n,), sorted by both, and how many frames after that it counts
    """

    parts: tuple[tuple[int, int, Bools, Ints, Ints, int], ...]

    @classmethod
    def of(cls, done: Manipulations) -> Hidden:
        """The manipulations of known truth objects; one by a link is a fault."""
        parts = []
        mine = done.select(((done.kind != INSERTED) & (done.object >= 0)).nonzero()[0])
        for passage in np.unique(mine.passage).tolist():
            for kind in (REMOVED, MOVED, ALTERED):
                rows = ((mine.passage == passage) & (mine.kind == kind)).nonzero()[0]
                if not len(rows):
                    continue
                rows = rows[np.lexsort((mine.frame[rows], mine.object[rows]))]
                culprit = int(mine.culprit[rows[0]])
                code = kind if culprit >= 0 else FAULT
                lasts = int(mine.lasts[rows[0]])
                parts.append((code, culprit, mine.reach[passage], mine.object[rows], mine.frame[rows], lasts))
        return cls(tuple(parts))

    def lately(self, truth_id: Ints, frame: Ints, series: Ints) -> Iterator[tuple[int, int, Bools]]:
        """For each part (code, culprit, (n,) bool): which of n objects were hidden in their frame or lately before it,
        from a series that this can have influenced."""
        if not len(truth_id):
            return
        for code, culprit, reach, ids, frames, lasts in self.parts:
            span = int(max(frames.max(), frame.max())) + 1
            known = ids * span + frames
            last = np.searchsorted(known, truth_id * span + frame, side="right") - 1
            same = (last >= 0) & (ids[last] == truth_id) & (frame - frames[last] <= lasts)
            yield code, culprit, same & reach[series]


def joined(names: Sequence[str], by: Bools) -> NDArray[np.object_]:
    """(n,) str, the names in each row of (n, a), joined by "+"."""
    result = np.full(len(by), "", object)
    some = np.flatnonzero(by.any(axis=1))
    rows, kind = np.unique(by[some], axis=0, return_inverse=True) if len(some) else (by[:0], some)
    words = ["+".join(name for name, mine in zip(names, row, strict=True) if mine) for row in rows.tolist()]
    result[some] = np.array([*words, ""], object)[kind.ravel()]
    return result
