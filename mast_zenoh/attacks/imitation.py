"""Making false objects look like the victim's own: identity, covariance and score."""

from __future__ import annotations

from statistics import median

import numpy as np

from mast_zenoh.states import Floats, Ints, ObjectStates

#: Standard deviations [x y z l w h vx vy vz] and score of a false object when the victim shows nothing to imitate.
DEFAULT_STD: Floats = np.array([0.5, 0.5, 0.5, 0.2, 0.2, 0.2, 1.0, 1.0, 0.5])
DEFAULT_SCORE = 0.9


def imitate(false: ObjectStates, real: ObjectStates) -> ObjectStates:
    """False objects with the covariance and score that are typical of the victim's objects in this frame.

    The covariance is that of the real object with the median trace (a mean would be blown up by a track that has
    just begun), the score the median score. `real` must be in canonical order.
    """
    if len(false) == 0:
        return false
    covariance, score = np.diag(DEFAULT_STD**2), DEFAULT_SCORE
    if len(real):
        by_trace = np.argsort(np.trace(real.covariance, axis1=1, axis2=2), kind="stable")
        covariance = real.covariance[by_trace[(len(real) - 1) // 2]]
        score = median(real.score.tolist())
    return false.with_(
        covariance=np.repeat(covariance[None], len(false), 0),
        score=np.full(len(false), score),
    )


class ForgedIds:
    """Track ids for false objects: one per target for as long as it lasts, never one that the victim uses.

    Ids start `gap` above the highest that the victim has shown, so that the victim's own numbering does not reach
    them soon. If it does all the same, the false object takes a new id at once.
    """

    def __init__(self, gap: int) -> None:
        self._gap = gap
        self._highest = -1
        self._next = 0
        self._of_target: dict[int, int] = {}

    def observe(self, seen: Ints) -> None:
        """Note the victim's ids (n,) of one message; ids that collide with them are given up."""
        if len(seen):
            self._highest = max(self._highest, int(seen.max()))
            used = set(self._of_target.values()).intersection(seen.tolist())
            if used:
                self._of_target = {number: id for number, id in self._of_target.items() if id not in used}

    def of(self, targets: Ints) -> Ints:
        """(k,) int64 ids of the false objects with these target numbers."""
        for number in sorted(set(targets.tolist()) - self._of_target.keys()):
            self._next = max(self._next, self._highest + self._gap)
            self._of_target[number] = self._next
            self._next += 1
        return np.array([self._of_target[number] for number in targets.tolist()], np.int64)
