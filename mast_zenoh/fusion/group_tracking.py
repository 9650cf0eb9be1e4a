"""Group tracking: from clusters to fused objects with persistent ids."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, concatenate
from mast_zenoh.fusion.base import Fusion, GroupTracker
from mast_zenoh.fusion.returning_objects import ReturningObjects
from mast_zenoh.tracking.assignment import Assignment, BipartiteAssignment
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.innovations import Innovations

_BIPARTITE = BipartiteAssignment()


class GroupTrackerWrapper(GroupTracker):
    """Fuses each cluster and tracks the fused states.

    fusion: fuses each cluster; tracker: tracks the results (`step_states`) with the fusion's covariances; not shared
    id_memory_s: s for which an object that the tracker has lost may return under its id, see `ReturningObjects`; 0: not
        at all
    """

    def __init__(self, *, fusion: Fusion, tracker: Tracker, id_memory_s: float = 4.0) -> None:
        if not id_memory_s >= 0.0:
            raise ValueError(f"id_memory_s: found {id_memory_s}, expected 0 or more")
        self._fusion = fusion
        self._tracker = tracker
        self._returning = ReturningObjects(id_memory_s)
        self._clusters = np.zeros(0, np.int64)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        fused = self._fusion.fuse(states, labels, weights)
        picture = self._tracker.step_states(time_ns, fused)
        self._clusters = _clusters(fused.id, self._tracker.matched)
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
        return self._tracker.innovations

    def reset(self) -> None:
        self._tracker.reset()
        self._returning.reset()
        self._clusters = np.zeros(0, np.int64)


class UnfilteredGroupTracker(GroupTracker):
    """Fuses each cluster and assigns ids by the nearest predicted object.

    An object that no agent reports in a frame is dropped from the picture; its id is remembered for `memory_s`.

    fusion: makes one state of a cluster
    gate_m: m, in the bird's-eye view, maximum distance of an object from its predicted position
    memory_s: s for which an unreported object may return under its id
    assignment: how clusters are assigned to objects
    """

    def __init__(
        self, *, fusion: Fusion, gate_m: float = 4.0, memory_s: float = 1.0, assignment: Assignment = _BIPARTITE
    ) -> None:
        if not gate_m > 0.0:
            raise ValueError(f"gate_m: found {gate_m}, expected more than 0")
        self._fusion = fusion
        self._gate_m = gate_m
        self._memory_ns = round(memory_s * 1e9)
        self._assignment = assignment
        self.reset()

    def reset(self) -> None:
        self._objects = ObjectStates.empty()
        self._seen_ns = np.zeros(0, np.int64)
        self._next_id = 0
        self._clusters = np.zeros(0, np.int64)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        fused = self._fusion.fuse(states, labels, weights)
        remembered = time_ns - self._seen_ns <= self._memory_ns
        objects, seen_ns = self._objects.select(remembered), self._seen_ns[remembered]
        predicted = objects.position[:, :2] + objects.velocity[:, :2] * ((time_ns - seen_ns) * 1e-9)[:, None]
        i, j, dx, dy = neighbours(predicted, fused.position, np.full(len(predicted), self._gate_m))
        chosen = self._assignment.match(i, j, np.hypot(dx, dy) - self._gate_m)
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
