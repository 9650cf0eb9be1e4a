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
        self._last = np.zeros(0, np.int64)  # the tracker's ids in the last picture
        self._picture, self._time_ns = ObjectStates.empty(), 0  # the last picture, with the ids that it was given
        self._lost, self._lost_ns = ObjectStates.empty(), np.zeros(0, np.int64)
        self._id: dict[int, tuple[int, int]] = {}  # by id of the tracker: the given id, and when it was last reported

    def of(self, time_ns: int, picture: ObjectStates) -> Ints:
        """(n,) ids of the objects of the tracker's picture, sorted by the tracker's ids."""
        if np.array_equal(picture.id, self._last):
            ids = self._picture.id
        else:
            ids = self._renewed(time_ns, picture)
            self._last = picture.id
        self._picture, self._time_ns = picture.with_(id=ids), time_ns
        return ids

    def _renewed(self, time_ns: int, picture: ObjectStates) -> Ints:
        """The ids where objects came or went."""
        tracked = picture.id.tolist()
        for number, given in zip(self._last.tolist(), self._picture.id.tolist(), strict=True):
            self._id[number] = given, self._time_ns
        self._id = {n: entry for n, entry in self._id.items() if time_ns - entry[1] <= _DORMANT_NS}
        known = np.array([number in self._id for number in tracked], np.bool_)
        ids = np.array([self._id[n][0] if n in self._id else n for n in tracked], np.int64)
        gone = np.flatnonzero(~np.isin(self._picture.id, ids[known]))
        lost = concatenate([self._lost, self._picture.select(gone)]) if len(gone) else self._lost
        lost_ns = np.concatenate([self._lost_ns, np.full(len(gone), self._time_ns)])
        remembered = (~np.isin(lost.id, ids[known]) & (time_ns - lost_ns <= self._memory_ns)).nonzero()[0]
        self._lost, self._lost_ns = lost.select(remembered), lost_ns[remembered]
        new = np.flatnonzero(~known)
        if len(new) and len(self._lost):
            i, j = self._returned(time_ns, picture.select(new))
            ids[new[j]] = self._lost.id[i]
            left = np.delete(np.arange(len(self._lost)), i)
            self._lost, self._lost_ns = self._lost.select(left), self._lost_ns[left]
        return _distinct(ids, picture.id)

    def _returned(self, time_ns: int, new: ObjectStates) -> tuple[Ints, Ints]:
        """Rows of lost objects, and of the new ones that they are."""
        lost, elapsed_s = self._lost, np.asarray((time_ns - self._lost_ns) * 1e-9, np.float64)
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
        return i[chosen], j[chosen]


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


def _distinct(ids: Ints, tracked: Ints) -> Ints:
    """The ids (n,), or the tracker's where two objects would have one: the tracker has continued one that was lost."""
    if len(np.unique(ids)) == len(ids):
        return ids
    ids = ids.copy()
    used: set[int] = set()
    spare = sorted(set(tracked.tolist()) - set(ids.tolist()))
    for row, number in enumerate(ids.tolist()):
        ids[row] = spare.pop() if number in used else number
        used.add(int(ids[row]))
    return ids
