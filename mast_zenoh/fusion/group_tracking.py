"""Group tracking: from clusters to fused objects with persistent ids, which they keep when they return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.base import Fusion, GroupTracker
from mast_zenoh.fusion.clustering import squared_distance
from mast_zenoh.tracking import classes
from mast_zenoh.tracking.association import Assignment, BipartiteAssignment
from mast_zenoh.tracking.base import Innovations, Tracker
from mast_zenoh.tracking.kalman import make_positive_definite
from mast_zenoh.tracking.tracks import known_class

#: Squared Mahalanobis distance that one in 1,000 of a chi-square distribution with four degrees of freedom exceeds.
RETURN_GATE = 18.47
#: Rows of a covariance that are compared, see `states.COVARIANCE_ORDER`: x y vx vy.
_MOTION = np.array([0, 1, 6, 7])
#: ns for which a tracker may continue an id that it does not report.
_DORMANT_NS = 10_000_000_000


class _GroupedObject(NamedTuple):
    """An object of the tracker."""

    output_id: int
    last_seen_ns: int


class _Lost(NamedTuple):
    """An object as it was seen last: x y vx vy, their covariance, and its class."""

    last_seen_ns: int
    motion: Floats
    covariance: Floats
    class_id: int


class ReturningObjects:
    """Gives an object that returns the id that it had.

    A tracker forgets an object when its position is too uncertain to find it. Here, the object is remembered for
    longer: a new object takes its id if it is where the lost one can be by now, at a speed that it can have by now, and
    of a class that is confused with its own. Both are predicted by the tracker's model (white acceleration). Of several
    candidates the likeliest is taken first.

    memory_s: s for which a lost object is remembered; 0: not at all
    """

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = round(memory_s * 1e9)
        self._tracker_ids, self._output_ids = np.zeros(0, np.int64), np.zeros(0, np.int64)  # of the last picture
        self._picture, self._time_ns = ObjectStates.empty(), 0
        self._known: dict[int, _GroupedObject] = {}  # by tracker id
        self._lost: dict[int, _Lost] = {}  # by output id

    def ids_for(self, time_ns: int, picture: ObjectStates) -> Ints:
        """(n,) ids of the objects of the tracker's picture, sorted by the tracker's ids."""
        if not np.array_equal(picture.id, self._tracker_ids):
            self._output_ids = self._reassign(time_ns, picture)
            self._tracker_ids = picture.id
        self._picture, self._time_ns = picture, time_ns
        return self._output_ids

    def _reassign(self, time_ns: int, picture: ObjectStates) -> Ints:
        """The ids where objects came or went."""
        tracker_ids, before = picture.id.tolist(), self._output_ids.tolist()
        for tracker_id, output_id in zip(self._tracker_ids.tolist(), before, strict=True):
            self._known[tracker_id] = _GroupedObject(output_id, self._time_ns)
        self._known = {key: known for key, known in self._known.items() if time_ns - known.last_seen_ns <= _DORMANT_NS}
        new = [row for row, tracker_id in enumerate(tracker_ids) if tracker_id not in self._known]
        kept = {
            tracker_id: self._known[tracker_id].output_id for tracker_id in tracker_ids if tracker_id in self._known
        }
        ids = [kept.get(tracker_id, tracker_id) for tracker_id in tracker_ids]
        self._note_lost(time_ns, before, set(kept.values()))
        if new and self._lost:
            lost_ids = sorted(self._lost)
            for i, j in zip(*self._match_lost(time_ns, lost_ids, picture.select(np.array(new))), strict=True):
                ids[new[j]] = lost_ids[i]
                del self._lost[lost_ids[i]]
        return np.array(_distinct(ids, tracker_ids), np.int64)

    def _note_lost(self, time_ns: int, before: list[int], present: set[int]) -> None:
        """Remember the objects of the last picture, with the ids `before`, that are not present any more."""
        gone = [row for row, output_id in enumerate(before) if output_id not in present]
        of_gone = *_motion(self._picture, gone), self._picture.class_id[gone].tolist()
        for row, motion, covariance, class_id in zip(gone, *of_gone, strict=True):
            self._lost[before[row]] = _Lost(self._time_ns, motion, covariance, class_id)
        self._lost = {
            output_id: lost
            for output_id, lost in self._lost.items()
            if output_id not in present and time_ns - lost.last_seen_ns <= self._memory_ns
        }

    def _match_lost(self, time_ns: int, ids: list[int], new: ObjectStates) -> tuple[list[int], list[int]]:
        """Rows of `ids` of lost objects, and of the new objects that they are."""
        last_seen_ns, motions, covariances, class_ids = zip(*(self._lost[output_id] for output_id in ids), strict=True)
        elapsed_s = np.array([(time_ns - last_ns) * 1e-9 for last_ns in last_seen_ns])
        motion, class_id = np.array(motions), known_class(np.array(class_ids))
        motion[:, :2] += motion[:, 2:] * elapsed_s[:, None]
        spread = _predicted(make_positive_definite(np.array(covariances)), elapsed_s, class_id)
        measured = make_positive_definite(new.covariance[:, _MOTION[:, None], _MOTION])
        widest = float((measured[:, 0, 0] + measured[:, 1, 1]).max())
        reach = np.sqrt(RETURN_GATE * (spread[:, 0, 0] + spread[:, 1, 1] + widest))
        i, j, dx, dy = neighbours(motion, new.position, reach)
        difference = np.column_stack([dx, dy, new.velocity[j, :2] - motion[i, 2:]])
        total = spread[i] + measured[j]
        distance = squared_distance(difference, total)
        alike = classes.CONFUSION[class_id[i], known_class(new.class_id[j])] >= -1.0
        near = (alike & (distance <= RETURN_GATE)).nonzero()[0]
        i, j = i[near], j[near]
        chosen = greedy_matching(i, j, distance[near] + np.linalg.slogdet(total[near])[1])
        return i[chosen].tolist(), j[chosen].tolist()


def _motion(states: ObjectStates, rows: list[int]) -> tuple[Floats, Floats]:
    """(n, 4) horizontal position and velocity of some rows, and (n, 4, 4) their covariances as they are claimed."""
    motion = np.concatenate([states.position[rows, :2], states.velocity[rows, :2]], axis=1)
    return motion, states.covariance[rows][:, _MOTION[:, None], _MOTION]


def _predicted(covariance: Floats, elapsed_s: Floats, class_id: Ints) -> Floats:
    """(n, 4, 4) covariances of horizontal motion after some time, see `kalman.process_noise`."""
    t, eye = elapsed_s[:, None, None], np.eye(2)
    move = np.broadcast_to(np.eye(4), (len(t), 4, 4)).copy()
    move[:, :2, 2:] = t * eye
    result = move @ covariance @ move.mT
    density = classes.ACCELERATION[class_id][:, None, None]
    result[:, :2, :2] += density * t**3 / 3.0 * eye
    result[:, :2, 2:] += density * t**2 / 2.0 * eye
    result[:, 2:, :2] += density * t**2 / 2.0 * eye
    result[:, 2:, 2:] += density * t * eye
    return np.asarray(result)


def _distinct(ids: list[int], tracker_ids: list[int]) -> list[int]:
    """The ids, each once.

    Two objects would have the same if the tracker has continued one that was lost and has returned. Then the later
    takes the tracker's id, or the lowest of the tracker's that is free.
    """
    if len(set(ids)) == len(ids):
        return ids
    free, used = set(tracker_ids) - set(ids), set[int]()
    result = []
    for output_id, tracker_id in zip(ids, tracker_ids, strict=True):
        if output_id in used:
            output_id = tracker_id if tracker_id in free else min(free)
            free.remove(output_id)
        result.append(output_id)
        used.add(output_id)
    return result


_BIPARTITE = BipartiteAssignment()


@dataclass(kw_only=True, eq=False)
class GroupTrackerWrapper(GroupTracker):
    """Fuses each cluster and tracks the fused states.

    fusion: fuses each cluster; tracker: tracks the results (`step_states`) with the fusion's covariances; not shared
    id_memory_s: s for which an object that the tracker has lost may return under its id, see `ReturningObjects`; 0: not
        at all
    """

    fusion: Fusion
    tracker: Tracker
    id_memory_s: float = 4.0

    def __post_init__(self) -> None:
        check("0 or more", id_memory_s=self.id_memory_s)
        self._returning = ReturningObjects(self.id_memory_s)
        self._clusters = np.zeros(0, np.int64)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        fused = self.fusion.fuse(states, labels, weights)
        picture = self.tracker.step_states(time_ns, fused)
        self._clusters = _clusters(fused.id, self.tracker.matched)
        ids = self._returning.ids_for(time_ns, picture)
        if not np.array_equal(ids, picture.id):
            order = ids.argsort()
            picture = picture.with_(id=ids).select(order)
            self._clusters = self._clusters[order]
        return picture, _support(labels, weights, self._clusters)

    @property
    def clusters(self) -> Ints:
        return self._clusters

    @property
    def innovations(self) -> Innovations | None:
        return self.tracker.innovations

    def reset(self) -> None:
        self.tracker.reset()
        self._returning = ReturningObjects(self.id_memory_s)
        self._clusters = np.zeros(0, np.int64)


@dataclass(kw_only=True, eq=False)
class UnfilteredGroupTracker(GroupTracker):
    """Fuses each cluster and assigns ids by the nearest predicted object.

    An object that no agent reports in a frame is dropped from the picture; its id is remembered for `memory_s`.

    fusion: makes one state of a cluster
    gate_m: m, in the bird's-eye view, maximum distance of an object from its predicted position
    memory_s: s for which an unreported object may return under its id
    assignment: how clusters are assigned to objects
    """

    fusion: Fusion
    gate_m: float = 4.0
    memory_s: float = 1.0
    assignment: Assignment = _BIPARTITE

    def __post_init__(self) -> None:
        check("more than 0", gate_m=self.gate_m)
        self._memory_ns = round(self.memory_s * 1e9)
        self.reset()

    def reset(self) -> None:
        self._objects = ObjectStates.empty()
        self._seen_ns = np.zeros(0, np.int64)
        self._next_id = 0
        self._clusters = np.zeros(0, np.int64)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        fused = self.fusion.fuse(states, labels, weights)
        remembered = time_ns - self._seen_ns <= self._memory_ns
        objects, seen_ns = self._objects.select(remembered), self._seen_ns[remembered]
        predicted = objects.position[:, :2] + objects.velocity[:, :2] * ((time_ns - seen_ns) * 1e-9)[:, None]
        i, j, dx, dy = neighbours(predicted, fused.position, np.full(len(predicted), self.gate_m))
        chosen = self.assignment.match(i, j, np.hypot(dx, dy) - self.gate_m)
        ids = np.full(len(fused), -1)
        ids[j[chosen]] = objects.id[i[chosen]]
        new = np.flatnonzero(ids < 0)
        ids[new] = np.arange(self._next_id, self._next_id + len(new))
        self._next_id += len(new)
        unmatched = np.ones(len(objects), bool)
        unmatched[i[chosen]] = False
        order = np.argsort(ids)
        picture = fused.with_(id=ids).select(order)
        self._objects = concatenate([picture, objects.select(unmatched)])
        self._seen_ns = np.concatenate([np.full(len(picture), time_ns), seen_ns[unmatched]])
        self._clusters = _clusters(fused.id, order)
        return picture, _support(labels, weights, self._clusters)

    @property
    def clusters(self) -> Ints:
        return self._clusters


def _clusters(fused: Ints, matched: Ints) -> Ints:
    """(n,) cluster behind each object; -1: none.

    fused: (c,) labels of the fused clusters; matched: (n,) rows of those, -1 for none
    """
    return np.where(matched >= 0, fused[matched], -1) if len(fused) else np.full(len(matched), -1, np.int64)


def _support(labels: Ints, weights: Floats | None, clusters: Ints) -> Ints:
    """(n,) number of members with positive weight in the cluster behind each object; 0 without one.

    labels, weights: of the members; clusters: (n,) see `_clusters`
    """
    counted = labels if weights is None else labels[weights > 0.0]
    count = np.bincount(counted, minlength=int(clusters.max(initial=0)) + 1)
    return np.where(clusters >= 0, count[clusters], 0)
