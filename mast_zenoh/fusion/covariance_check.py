"""How far the centre believes the covariances that agents report."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import trusted_rows
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import MAX_VARIANCE, symmetrise

#: Kept pairs of a track with later ones of its cluster: limits what a hostile source costs.
_MAX_PARTNERS = 32
#: Most agents that are compared with each other.
_MAX_AGENTS = 1000
#: Pairs as consistent as expected that each two agents start with.
_PRIOR_PAIRS = 10.0
#: What is known of an agent is kept for so many times the averaging time while it is absent, of at most so many agents.
_ABSENCES, _MAX_ABSENT = 10.0, 100
#: Sum of pairs below which two agents have not been compared.
_FORGOTTEN = 1e-3
#: s, after which tracks show something new: offsets of agents in consecutive frames correlate at 0.8. Every frame
#: counts as a share of it, so that no frame matters more than others.
_PERIOD_S = 0.5
#: Number of other agents that one must disagree with to be the one that is wrong.
_JUDGES = 2
#: Of the 81 numbers of a covariance: x x, y y, x y, y x of the position, and the same of the velocity.
_HORIZONTAL = np.array([0, 10, 1, 9, 60, 70, 61, 69])
#: Variances of position and velocity.
_VARIANCES = np.array([[0, 10], [60, 70]])
_EIGHT = np.arange(8)


class CovarianceCheck(ABC):
    """Replaces reported covariances by believable ones."""

    @abstractmethod
    def floored(self, states: ObjectStates) -> ObjectStates:
        """n tracks with covariances that a sensor can achieve; before they are clustered."""

    @abstractmethod
    def inflated(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        agents: tuple[str, ...],
        labels: Ints,
        weights: Floats | None,
    ) -> ObjectStates:
        """n clustered tracks, as uncertain as they are inconsistent; before they are fused.

        agent, labels: (n,) rows of `agents`, sorted names, and clusters, with at most one track of an agent
        weights: (n,) how far each is trusted, 0: it does not count
        """

    @abstractmethod
    def reset(self) -> None:
        """Return to the initial state."""


class ReportedCovariances(CovarianceCheck):
    """Believes every covariance as it is reported."""

    def floored(self, states: ObjectStates) -> ObjectStates:
        return states

    def inflated(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        agents: tuple[str, ...],
        labels: Ints,
        weights: Floats | None,
    ) -> ObjectStates:
        return states

    def reset(self) -> None:
        pass


class CheckedCovariances(CovarianceCheck):
    """Limits covariances to what sensors achieve, and inflates those of agents that disagree with the others.

    Floor: no eigenvalue of a covariance, in units of the least standard deviations, is below 1. A position in the world
    depends on the agent's pose: a heading of 0.1 degrees (two antennas and inertial sensors) is 0.09 m at 50 m. Heights
    and sizes depend on the lidar's ranging, 0.02 to 0.03 m (Velodyne HDL-32E); speeds on the agent's own, 0.05 m/s, and
    its heading.

    Inflation: normalised innovations squared between the tracks of two agents in one cluster, averaged over
    `averaging_s` in all frames: an agent that is honest now and then is inflated by its average. What an agent claims
    is compared with the half of the others that it agrees with best, so that a minority makes no honest agent
    suspicious. Above `limit` times the expected value, variances grow by the excess of the observed differences
    (covariance matching: Mehra, IEEE Transactions on Automatic Control 17(5), 1972; Myers and Tapley, same journal
    21(4), 1976), position and velocity separately. Of two agents alone, both grow. If an agent is compared with a
    single other one, its position grows by `most_position_std_m` at most: either may be wrong, and a dispute must not
    make the tracks of both too uncertain to be reported. What is known of an agent outlasts its absence, see
    `_ABSENCES`.

    least_position_std_m, least_height_std_m, least_size_std_m: m, per axis; least_speed_std_mps: m/s, per axis
    most_position_std_m: m, per axis, the most that is added; half of the variance up to which trackers report
    limit: ratio of innovations to their expectation above which variances grow; honest agents had up to 1.2
    averaging_s: s, after which a comparison counts 1/e; an agent that is compared with nobody stays as it was
    """

    def __init__(
        self,
        *,
        least_position_std_m: float = 0.1,
        least_height_std_m: float = 0.03,
        least_size_std_m: float = 0.03,
        least_speed_std_mps: float = 0.1,
        most_position_std_m: float = 0.6,
        limit: float = 2.0,
        averaging_s: float = 1.5,
    ) -> None:
        parameters = locals()
        check("more than 0", **{name: parameters[name] for name in parameters.keys() - {"self", "limit"}})
        check("1 or more", limit=limit)
        position, size, speed = [least_position_std_m] * 2, [least_size_std_m] * 3, [least_speed_std_mps] * 3
        least = np.array([*position, least_height_std_m, *size, *speed])
        self._unit = least[:, None] * least
        self._per_unit = 1.0 / self._unit
        self._most = most_position_std_m**2
        self._limit = limit
        self._averaging_s = averaging_s
        self.reset()

    def reset(self) -> None:
        self._agents: tuple[str, ...] = ()  # those present, the first rows
        self._absent: dict[str, int] = {}  # ns, when the others were present for the last time, in the order of rows
        self._time_ns: int | None = None  # of the last frame
        self._sums = np.zeros((0, 0, 2, 4))  # by agent and agent, of position and velocity, see `_comparisons`
        self._excess = np.zeros((0, 2))  # by agent, what its variances of position and velocity grow by

    def floored(self, states: ObjectStates) -> ObjectStates:
        if achievable(states.covariance, self._per_unit, 2.0, MAX_VARIANCE):
            return states
        limited = np.clip(states.covariance, -MAX_VARIANCE, MAX_VARIANCE)
        scaled = 0.5 * (limited + limited.transpose(0, 2, 1)) * self._per_unit
        doubtful = (np.diagonal(scaled, axis1=1, axis2=2) < 1.0).any(axis=1)
        doubtful |= (limited != states.covariance).any(axis=(1, 2))
        if not symmetrise(scaled[~doubtful], 2.0, MAX_VARIANCE)[1]:
            doubtful[:] = True
        rows = doubtful.nonzero()[0]
        values, vectors = np.linalg.eigh(scaled[rows])
        bad = (values[:, 0] < 1.0) | (limited[rows] != states.covariance[rows]).any(axis=(1, 2))
        vectors = vectors[bad]
        repaired = (vectors * np.maximum(values[bad], 1.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
        covariance = states.covariance.copy()
        covariance[rows[bad]] = 0.5 * (repaired + repaired.transpose(0, 2, 1)) * self._unit
        return states.with_(covariance=covariance)

    def inflated(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        agents: tuple[str, ...],
        labels: Ints,
        weights: Floats | None,
    ) -> ObjectStates:
        self._resume(time_ns, agents)
        elapsed_s = math.inf if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        if elapsed_s > 0.0:
            if len(agents) <= _MAX_AGENTS:
                self._compare(elapsed_s, _comparisons(states, agent, len(agents), labels, weights))
            self._time_ns = time_ns
        if not self._excess.any():
            return states
        covariance = states.covariance.reshape(len(states), 81).copy()
        for quantity, columns in enumerate(_VARIANCES):
            covariance[:, columns] += self._excess[agent, quantity, None]
        return states.with_(covariance=covariance.reshape(-1, 9, 9))

    def _compare(self, elapsed_s: float, comparisons: Floats) -> None:
        """Add the comparisons of a frame; those of absent agents do not age."""
        count = len(self._agents)
        sums = self._sums[:count, :count]
        decay, share = math.exp(-elapsed_s / self._averaging_s), min(elapsed_s / _PERIOD_S, 1.0)
        doubtful = decay_and_add(self._sums, comparisons, decay, share, self._limit, _PRIOR_PAIRS)
        if doubtful or self._excess[:count].any():  # otherwise it is 0
            compared = (sums[..., 0] > _FORGOTTEN).any(axis=1)
            self._excess[:count] = np.where(compared, _excess(sums, self._limit, self._most), self._excess[:count])

    def _resume(self, time_ns: int, agents: tuple[str, ...]) -> None:
        """Carry the sums over to other agents; those of absent ones follow in the last rows."""
        if agents == self._agents:
            return
        last_ns = self._absent | dict.fromkeys(self._agents, time_ns if self._time_ns is None else self._time_ns)
        oldest_ns = time_ns - round(_ABSENCES * self._averaging_s * 1e9)
        row = {name: k for k, name in enumerate((*self._agents, *self._absent)) if last_ns[name] >= oldest_ns}
        absent = sorted(row.keys() - set(agents), key=lambda name: (-last_ns[name], name))[:_MAX_ABSENT]
        names = (*agents, *absent)
        new = np.array([k for k, name in enumerate(names) if name in row], np.int64)
        old = np.array([row[name] for name in names if name in row], np.int64)
        count = len(names) if len(agents) <= _MAX_AGENTS else 0
        sums, excess = np.zeros((count, count, 2, 4)), np.zeros((len(names), 2))
        if count and len(self._sums):
            sums[new[:, None], new] = self._sums[old[:, None], old]
        excess[new] = self._excess[old]
        self._agents, self._sums, self._excess = agents, sums, excess
        self._absent = {name: last_ns[name] for name in absent}


def _comparisons(states: ObjectStates, agent: Ints, agents: int, labels: Ints, weights: Floats | None) -> Floats:
    """(a, a, 2, 4) sums over the pairs of tracks of two agents in one cluster, of position and of velocity.

    They are the number of pairs, normalised innovations squared, squared differences, and traces of their covariances.
    """
    rows = trusted_rows(agent, labels, weights)
    motion, spread = horizontal_motion(states.position, states.velocity, states.covariance, rows)
    return compare_members(motion, spread, agent.take(rows), labels.take(rows), agents, _MAX_PARTNERS)


@kernel
def achievable(covariance: Floats, per_unit: Floats, least: float, most: float) -> bool:
    """Whether all covariances (n, 9, 9), multiplied by `per_unit` (9, 9), are within limits, see `symmetrise`."""
    return symmetrise(covariance * per_unit, least, most)[1]


@kernel
def horizontal_motion(position: Floats, velocity: Floats, covariance: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """Horizontal position and velocity (k, 4) of tracks `rows` of n, and their covariances (k, 8), see `_HORIZONTAL`.

    position, velocity: (n, 3); covariance: (n, 9, 9)
    """
    motion = np.concatenate([position[:, :2], velocity[:, :2]], axis=1).take(rows, 0)
    return motion, covariance.reshape(len(position), 81)[rows[:, None], _HORIZONTAL]


@kernel
def compare_members(motion: Floats, spread: Floats, agent: Ints, label: Ints, agents: int, partners: int) -> Floats:
    """(agents, agents, 2, 4) sums over pairs of tracks with one label, see `_comparisons`.

    motion: (n, 4) x, y of position and of velocity; spread: (n, 8) their covariances, see `_HORIZONTAL`
    agent, label: (n,) of each track, sorted by label, then agent
    partners: number of following tracks that each is compared with
    """
    pairs = [(label[shift:] == label[:-shift]).nonzero()[0] for shift in range(1, min(partners, len(label) - 1) + 1)]
    if not any(len(rows) for rows in pairs):
        return np.zeros((agents, agents, 2, 4))
    i = np.concatenate(pairs)
    j = np.concatenate([rows + shift for shift, rows in enumerate(pairs, 1)])
    x, y = (motion.take(i, 0) - motion.take(j, 0)).reshape(-1, 2, 2).transpose(2, 0, 1)
    xx, yy, xy, yx = (spread.take(i, 0) + spread.take(j, 0)).reshape(-1, 2, 4).transpose(2, 0, 1)
    xy = 0.5 * (xy + yx)
    values = np.empty((len(i), 2, 4))
    values[..., 0] = 1.0
    values[..., 1] = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    values[..., 2] = x * x + y * y
    values[..., 3] = xx + yy
    codes = ((agent.take(i) * agents + agent.take(j)) * 8)[:, None] + _EIGHT
    sums = np.bincount(codes.ravel(), values.ravel(), agents * agents * 8).reshape(agents, agents, 2, 4)
    return np.asarray(sums + sums.transpose(1, 0, 2, 3))


@kernel
def decay_and_add(
    sums: Floats, comparisons: Floats, decay: float, share: float, limit: float, prior_pairs: float
) -> bool:
    """Decay the sums in place, add a share of the new ones; whether any two agents exceed the limit.

    The limit is `limit` times the expected innovations, if each two agents begin with `prior_pairs` consistent pairs.

    sums: (b, b, 2, 4) see `_comparisons`; those of the first a agents change
    comparisons: (a, a, 2, 4) the new ones, a <= b
    """
    part = sums[: len(comparisons), : len(comparisons)]
    part *= decay
    part += share * comparisons
    return bool((part[..., 1] + 2.0 * prior_pairs > 2.0 * limit * (part[..., 0] + prior_pairs)).any())


def _excess(sums: Floats, limit: float, most: float) -> Floats:
    """(a, 2) what the variances of position and velocity of each agent grow by, m² and (m/s)².

    sums: (a, a, 2, 4) see `_comparisons`; most: m², limit for the position of an agent with a single partner
    """
    agents = len(sums)
    pairs, nis, squared, trace = np.moveaxis(sums, -1, 0)
    ratio = 0.5 * (nis + 2.0 * _PRIOR_PAIRS) / (pairs + _PRIOR_PAIRS)
    known = pairs > _FORGOTTEN
    excess = 0.5 * (squared - trace) / np.where(known, pairs, 1.0)
    middle = np.maximum(known.sum(axis=1) - 1, 0) // 2  # the lower median of those that it was compared with
    row, quantity = np.arange(agents)[:, None], np.arange(2)

    def of_best_half(values: Floats) -> Floats:
        ordered = np.sort(np.where(known, values, np.inf), axis=1)[row, middle, quantity]
        return np.where(np.isfinite(ordered), ordered, 0.0)

    share = np.maximum(1.0 - limit / np.maximum(of_best_half(ratio), limit), 0.0)
    result = share * np.maximum(of_best_half(excess), 0.0)
    undecided = known[..., 0].sum(axis=1) < _JUDGES
    result[undecided, 0] = np.minimum(result[undecided, 0], most)
    return np.asarray(result)
