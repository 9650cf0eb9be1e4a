"""Information matrix fusion: a picture that takes from each agent's track only what is new in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate, within_runs
from mast_zenoh.fusion.base import state_vectors, trusted_rows
from mast_zenoh.fusion.group_tracking import GroupTrackerWrapper
from mast_zenoh.tracking.box_tracker import KalmanBoxTracker3D
from mast_zenoh.tracking.interacting_models import InteractingModels
from mast_zenoh.tracking.kalman import BoxFilter, inverse, make_positive_definite, predicted
from mast_zenoh.tracking.tracks import COVARIANCE, ID, MEAN, ROW, covariances

#: ns after which a track that is not fused any more is forgotten: what is left of its information is next to nothing.
_MEMORY_NS = 3_000_000_000
#: Tracks that are remembered though they are not fused any more, at most: limits what a hostile source costs.
_MOST_UNFUSED = 10_000
#: Least share of an object's information that remains when tracks become less certain.
_LEAST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Contributions:
    """n tracks of c clusters; those of a cluster are adjacent.

    states: n rows, their covariances positive definite; agent: (n,) numbers of the agents
    weight: (n,) in (0, 1], trust relative to the most trusted of the cluster
    start, size: (c,) of each cluster
    """

    states: ObjectStates
    agent: Ints
    weight: Floats
    start: Ints
    size: Ints

    @classmethod
    def of(cls, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None) -> Contributions:
        """Those of n tracks that have a positive weight; the clusters are in the order of `labels` (n,)."""
        rows = trusted_rows(agent, labels, weights)
        _, start, size = np.unique(labels.take(rows), return_index=True, return_counts=True)
        weight = np.ones(len(rows))
        if weights is not None and len(rows):
            weight = weights.take(rows)
            weight = weight / np.repeat(np.maximum.reduceat(weight, start), size)
        states = states.select(rows)
        states = states.with_(covariance=make_positive_definite(states.covariance))
        return cls(states, agent.take(rows), weight, start, size)

    def of_clusters(self, cluster: Ints) -> tuple[Ints, Ints]:
        """For each member of k clusters: which of the k, and its row."""
        size = self.size.take(cluster)
        which = np.repeat(np.arange(len(cluster)), size)
        return which, self.start.take(cluster.take(which)) + within_runs(size)


class ContributedTracks:
    """What each track has contributed to each object so far, predicted to the time of the last step."""

    def __init__(self) -> None:
        self.states = ObjectStates.empty()
        self._agent = self._object = self._fused_ns = np.zeros(0, np.int64)
        self._time_ns = 0

    @property
    def agents(self) -> set[int]:
        """Numbers of the agents whose tracks are remembered."""
        return set(self._agent.tolist())

    def predict(self, time_ns: int) -> None:
        """Predict all to a time, as the trackers of the agents would."""
        self.states = predicted(self.states, (time_ns - self._time_ns) * 1e-9)
        self._time_ns = time_ns

    def rows_of(self, agent: Ints, track: Ints, object_id: Ints) -> Ints:
        """(n,) rows of `states`; -1: the track has not contributed to the object."""
        known = np.stack([self._agent, self.states.id, self._object])
        keys = np.concatenate([known, np.stack([agent, track, object_id])], axis=1)
        order = np.lexsort(keys)  # stable: what is known comes first
        ordered, count = keys[:, order], known.shape[1]
        same = (ordered[:, 1:] == ordered[:, :-1]).all(axis=0) & (order[:-1] < count) & (order[1:] >= count)
        rows = np.full(len(agent), -1)
        rows[order[1:][same] - count] = order[:-1][same]
        return rows

    def add(self, states: ObjectStates, agent: Ints, object_id: Ints) -> None:
        """Tracks that contribute to objects at the time of the last step."""
        unfused = np.ones(len(self._agent), np.bool_)
        rows = self.rows_of(agent, states.id, object_id)
        unfused[rows[rows >= 0]] = False
        unfused &= self._time_ns - self._fused_ns <= _MEMORY_NS
        kept = unfused.nonzero()[0]
        if len(kept) > _MOST_UNFUSED:
            keys = self._object[kept], self.states.id[kept], self._agent[kept], -self._fused_ns[kept]
            kept = kept[np.lexsort(keys)[:_MOST_UNFUSED]]
        self.states = concatenate([states, self.states.select(kept)])
        self._agent = np.concatenate([agent, self._agent[kept]])
        self._object = np.concatenate([object_id, self._object[kept]])
        self._fused_ns = np.concatenate([np.full(len(states), self._time_ns), self._fused_ns[kept]])


class InformationFilter(BoxFilter):
    """Corrects objects by the new information of the tracks in their clusters.

    Full states are measured by clusters: the row of each is that of its cluster in `contributions`.
    """

    def __init__(self, inner: BoxFilter) -> None:
        self.inner = inner
        self.contributed = ContributedTracks()
        self.contributions: Contributions | None = None

    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        self.inner.predict(t, dt, noise)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        self.inner.correct_speed(t, direction, noise)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        if self.contributions is None or measured.shape[1] != 9:
            self.inner.correct(t, measured, noise)
            return
        prior, mean = inverse(covariances(t)), t[:, MEAN]
        information, vector = self._new_information(t, mean)
        total = prior + information
        total = 0.5 * (total + total.mT)
        enough = _definite(total - _LEAST_SHARE * prior)
        corrected, covariance = measured.copy(), noise.copy()
        covariance[enough] = make_positive_definite(inverse(total[enough]))
        corrected[enough] = mean[enough] + (covariance[enough] @ vector[enough, :, None])[:, :, 0]
        t[:, MEAN], t[:, COVARIANCE] = corrected, covariance.reshape(len(t), 81)

    def _new_information(self, t: Floats, mean: Floats) -> tuple[Floats, Floats]:
        """Sums (k, 9, 9) over the tracks of k objects of their new information, and of it times x - mean: (k, 9)."""
        assert self.contributions is not None
        members = self.contributions
        which, row = members.of_clusters(t[:, ROW].astype(np.int64))
        object_id, states = t[:, ID].astype(np.int64).take(which), members.states.select(row)
        before = self.contributed.rows_of(members.agent.take(row), states.id, object_id)
        known = (before >= 0).nonzero()[0]
        terms = np.empty((len(row), 9, 10))
        terms[:, :, :9] = inverse(states.covariance)
        terms[:, :, 9:] = terms[:, :, :9] @ (state_vectors(states) - mean.take(which, 0))[:, :, None]
        old = self.contributed.states.select(before[known])
        old_information = inverse(old.covariance)
        terms[known, :, :9] -= old_information
        terms[known, :, 9:] -= old_information @ (state_vectors(old) - mean.take(which[known], 0))[:, :, None]
        terms *= members.weight.take(row)[:, None, None]
        sums = np.add.reduceat(terms, np.searchsorted(which, np.arange(len(t))))
        return sums[:, :, :9], sums[:, :, 9]


def _definite(matrices: Floats) -> Bools:
    """(n,) which of n symmetric matrices are positive definite."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(matrices)[:, 0] > 0.0)
    return np.ones(len(matrices), np.bool_)


@dataclass(kw_only=True, eq=False)
class InformationMatrixGroupTracker(GroupTrackerWrapper):
    """Information matrix fusion: adds to each object what is new in its tracks since they were fused last.

    P^-1 = P_prior^-1 + sum (P_i(k)^-1 - P_i(k|k-1)^-1), and the same for P^-1 x, where P_i(k|k-1) is the track of agent
    i as it was fused last, predicted to now (Chong, Mori, Chang, Distributed Multitarget Multisensor Tracking, 1990;
    Aeberhard, Schlichthaerle, Kaempchen, Bertram, IEEE Transactions on Intelligent Transportation Systems 13(4), 2012,
    for cars). What is subtracted is also called a channel filter (Grime, Durrant-Whyte, Control Engineering Practice
    2(5), 1994).

    Exact if the agents' errors are independent, given the object's motion, and every track arrives in every frame. It
    is too certain where agents share errors (of their clocks, map or constraints), where the motion is not as assumed
    between fewer messages, where a track gets a new id, and where tracks contain each other (relays, rumours).

    fusion: of a cluster that is a new object; the result also assigns clusters to objects, and gives heading and class
    tracker: of the objects; here, its `independent_states` is true
    id_memory_s: see `GroupTrackerWrapper`

    Tracks are told apart by agent and id, and remembered for `_MEMORY_NS` by object: a track that moves to another one
    is new there. Trust in a track multiplies its new information, relative to the most trusted track of its cluster. If
    tracks become so uncertain that hardly any information would remain, the object is what `fusion` makes of them.
    """

    tracker: KalmanBoxTracker3D

    def __post_init__(self) -> None:
        if isinstance(self.tracker.filter, InteractingModels):
            kind = type(self.tracker).__name__
            raise ValueError(f"tracker: found {kind}, expected one with a single motion model: KalmanBoxTracker3D")
        super().__post_init__()
        self.tracker.independent_states = True
        self._inner = self.tracker.filter
        self._forget()

    def _forget(self) -> None:
        self._filter = InformationFilter(self._inner)
        self.tracker.filter = self._filter
        self._names: tuple[str, ...] = ()
        self._numbers: dict[str, int] = {}
        self._number_of = np.zeros(0, np.int64)
        self._next_number = 0

    def name_agents(self, agents: tuple[str, ...]) -> None:
        if agents == self._names:
            return
        remembered = self._filter.contributed.agents
        self._numbers = {name: k for name, k in self._numbers.items() if k in remembered or name in agents}
        for name in agents:
            if name not in self._numbers:
                self._numbers[name] = self._next_number
                self._next_number += 1
        self._names, self._number_of = agents, np.array([self._numbers[name] for name in agents], np.int64)

    def step(
        self, time_ns: int, states: ObjectStates, agent: Ints, labels: Ints, weights: Floats | None = None
    ) -> tuple[ObjectStates, Ints]:
        number = self._number_of[agent] if self._names else agent
        contributed, contributions = self._filter.contributed, Contributions.of(states, number, labels, weights)
        self._filter.contributions = contributions
        contributed.predict(time_ns)
        result = super().step(time_ns, states, agent, labels, weights)
        self.tracker.innovations.at_most = True  # the clusters' errors are those of the objects
        ids, clusters = self.tracker.measured
        which, row = contributions.of_clusters(clusters)
        contributed.add(contributions.states.select(row), contributions.agent.take(row), ids.take(which))
        return result

    def reset(self) -> None:
        super().reset()
        self._forget()
