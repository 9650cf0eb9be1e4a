"""Ids of objects that were lost, and come back as new tracks."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate
from mast_zenoh.tracking import classes
from mast_zenoh.tracking.covariance_repair import make_positive_definite
from mast_zenoh.tracking.tracks import known_class

#: Squared Mahalanobis distance that one in 1,000 of a chi-square distribution with four degrees of freedom exceeds.
GATE = 18.47
#: Rows of a covariance that are compared, see `states.COVARIANCE_ORDER`: x y vx vy.
_MOTION = np.array([0, 1, 6, 7])
#: ns for which a tracker may continue an id that it does not report.
_DORMANT_NS = 10_000_000_000


class Identities:
    """Gives an object that returns the id that it had.

    A tracker forgets an object when its position is too uncertain to find it. Here, the object is remembered for
    longer: a new object takes its id if it is where the lost one can be by now, at a speed that it can have by now, and
    of a class that is confused with its own. Both are predicted by the tracker's model (white acceleration). Of several
    candidates the likeliest is taken first.

    memory_s: s for which a lost object is remembered; 0: not at all
    """

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = round(memory_s * 1e9)
        self.reset()

    def reset(self) -> None:
        self._last, self._ids = np.zeros(0, np.int64), np.zeros(0, np.int64)  # of the last picture, tracked and given
        self._picture, self._time_ns = ObjectStates.empty(), 0
        self._known: dict[int, tuple[int, int]] = {}  # by tracked id: the given one, and when it was last reported
        self._lost: dict[int, tuple[int, ObjectStates, int]] = {}  # by given id: when, and the row of a picture

    def of(self, time_ns: int, picture: ObjectStates) -> Ints:
        """(n,) ids of the objects of the tracker's picture, sorted by the tracker's ids."""
        if not np.array_equal(picture.id, self._last):
            self._ids = self._renewed(time_ns, picture)
            self._last = picture.id
        self._picture, self._time_ns = picture, time_ns
        return self._ids

    def _renewed(self, time_ns: int, picture: ObjectStates) -> Ints:
        """The ids where objects came or went."""
        tracked, before = picture.id.tolist(), self._ids.tolist()
        self._known |= {n: (given, self._time_ns) for n, given in zip(self._last.tolist(), before, strict=True)}
        self._known = {n: entry for n, entry in self._known.items() if time_ns - entry[1] <= _DORMANT_NS}
        new = [row for row, number in enumerate(tracked) if number not in self._known]
        ids = [self._known[number][0] if number in self._known else number for number in tracked]
        kept = {given for number, given in zip(tracked, ids, strict=True) if number in self._known}
        self._lost |= {given: (self._time_ns, self._picture, row) for row, given in enumerate(before)}
        self._lost = {
            given: entry
            for given, entry in self._lost.items()
            if given not in kept and time_ns - entry[0] <= self._memory_ns
        }
        if new and self._lost:
            lost = sorted(self._lost)
            for i, j in zip(*self._returned(time_ns, lost, picture.select(np.array(new))), strict=True):
                ids[new[j]] = lost[i]
                del self._lost[lost[i]]
        return np.array(_distinct(ids, tracked), np.int64)

    def _returned(self, time_ns: int, ids: list[int], new: ObjectStates) -> tuple[list[int], list[int]]:
        """Rows of `ids` of lost objects, and of the new objects that they are."""
        entries = [self._lost[given] for given in ids]
        lost = concatenate([picture.select(slice(row, row + 1)) for _, picture, row in entries])
        elapsed_s = np.array([(time_ns - lost_ns) * 1e-9 for lost_ns, _, _ in entries])
        motion = np.concatenate([lost.position[:, :2], lost.velocity[:, :2]], axis=1)
        motion[:, :2] += motion[:, 2:] * elapsed_s[:, None]
        spread = _predicted(_motion_covariance(lost), elapsed_s, lost)
        measured = _motion_covariance(new)
        widest = float((measured[:, 0, 0] + measured[:, 1, 1]).max())
        i, j, dx, dy = neighbours(motion, new.position, np.sqrt(GATE * (spread[:, 0, 0] + spread[:, 1, 1] + widest)))
        difference = np.column_stack([dx, dy, new.velocity[j, :2] - motion[i, 2:]])
        total = spread[i] + measured[j]
        distance = np.vecdot(difference, np.linalg.solve(total, difference[:, :, None])[:, :, 0])
        alike = classes.CONFUSION[known_class(lost.class_id[i]), known_class(new.class_id[j])] >= -1.0
        near = (alike & (distance <= GATE)).nonzero()[0]
        i, j = i[near], j[near]
        chosen = greedy_matching(i, j, distance[near] + np.linalg.slogdet(total[near])[1])
        return i[chosen].tolist(), j[chosen].tolist()


def _motion_covariance(states: ObjectStates) -> Floats:
    """(n, 4, 4) covariances of horizontal position and velocity."""
    return make_positive_definite(states.covariance[:, _MOTION[:, None], _MOTION])


def _predicted(covariance: Floats, elapsed_s: Floats, states: ObjectStates) -> Floats:
    """(n, 4, 4) covariances of horizontal motion after some time, see `kalman.process_noise`."""
    t, eye = elapsed_s[:, None, None], np.eye(2)
    move = np.broadcast_to(np.eye(4), (len(t), 4, 4)).copy()
    move[:, :2, 2:] = t * eye
    result = move @ covariance @ move.mT
    density = classes.ACCELERATION[known_class(states.class_id)][:, None, None]
    result[:, :2, :2] += density * t**3 / 3.0 * eye
    result[:, :2, 2:] += density * t**2 / 2.0 * eye
    result[:, 2:, :2] += density * t**2 / 2.0 * eye
    result[:, 2:, 2:] += density * t * eye
    return np.asarray(result)


def _distinct(ids: list[int], tracked: list[int]) -> list[int]:
    """The ids, or the tracker's where two objects would have one: the tracker has continued one that was lost."""
    if len(set(ids)) == len(ids):
        return ids
    spare, used = sorted(set(tracked) - set(ids)), set[int]()
    result = []
    for given in ids:
        result.append(spare.pop() if given in used else given)
        used.add(result[-1])
    return result
