"""Faults of pairs of agents: how the tracks of one are displaced, turned and delayed against those of the other.

A fault is (4,): x and y in m, a turn in rad, and a lead in s, by which the tracks are ahead; it moves all tracks of an
agent alike. Of two agents that report the same objects, only the difference of their faults can be seen, whichever of
them has it. Which agents are faulty follows from all pairs together, as for liars: those in every set of fewer than
half of the agents that has one of each pair with a difference (`explanations`). If the smallest such set counted, two
liars could make any agent seem faulty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import neighbours, pairs_within_radius
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.alarms import MAX_STEP_S, SAMPLES_PER_S
from mast_zenoh.integrity.deviations import PRIOR, displacement_m, displacements
from mast_zenoh.integrity.disputes import Explanations
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.kernels import kernel

#: m, distance from where a fault puts a track within which another agent's track is of the same object.
MATCH_M = 1.6
#: Share of the tracks that must be matched so; else the fault is not the known one.
MATCHED = 0.6
#: m, standard deviation of a difference that the covariances do not contain: boxes seen from two sides.
FLOOR_M = 0.1
#: m, how far differences of two objects may differ that have one cause.
COMMON_M = 0.8
#: Standard deviations at which a difference stops to count for more, up to which a fit explains it, and by which it may
#: fit worse than no fault: one that moves half of its tracks alike has no fault.
CLIP, EXPLAINED_SD, WORSE_SD = 1.5, 3.0, 0.5
#: Tracks that two agents must share to be compared.
COMPARABLE = 3
#: Mean of Huber's loss of a difference up to which a fit is good, and difference of the sums of it from which a batch
#: shows another fault than those before.
FIT, CHANGED = 1.2, 5.0
#: m, farthest that two agents may report one object apart, if one has a fault.
GATE_M = 9.0
#: m, beyond which a track may be of the next car of a queue instead, and tracks that must then be displaced alike.
AMBIGUOUS_M, MANY = 3.0, 6
#: Tracks of an agent that are compared, at most, and tracks of each other agent for one: a flood must cost little.
MAX_TRACKS, MAX_NEAR = 200, 6
#: m/s, from which a track is moving.
MOVING_MPS = 2.0
#: Pairs of agents whose fault is searched in one batch, at most, by so many tracks of one of them.
SEARCHES, SEARCHED_TRACKS = 3, 40
#: Turns, rad, and leads, s, that are tried where few tracks match.
TURNS, LEADS = np.linspace(-0.12, 0.12, 13), np.linspace(-0.6, 0.6, 13)
#: Twice the log-likelihood by which a fault that is corrected may fit worse than none, before it is forgotten.
DOUBT = 10.0
#: Share of the significance from which a pair counts for a fault that explains the other pairs of the agent, too.
SUPPORT = 0.4
#: s, between two fits while no agent is suspect: consecutive tracks show little new.
FIT_S = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """k differences of the positions of two agents' tracks, each once from either side.

    one, other: (k,) rows of the two agents;  track: (k,) row of the track of the one
    offset: (k, 2) m, by which the track of the one is displaced
    information: (k, 2, 2) 1/m^2;  design: (k, 2, 4) derivatives of the offset by the fault, about a fixed point
    """

    one: Ints
    other: Ints
    track: Ints
    offset: Floats
    information: Floats
    design: Floats

    @classmethod
    def of(cls, states: ObjectStates, agent: Ints, about: Floats) -> Differences:
        """The differences of tracks within GATE_M.

        states: n tracks of all agents, in one frame at one time;  agent: (n,), ascending
        about:  (2,) m, the fixed point about which agents turn
        """
        used = _first_of_each(agent, MAX_TRACKS)
        position = states.position[used]
        i, j, dx, dy = neighbours(position, position, np.full(len(position), GATE_M))
        i, j = used[i], used[j]
        apart = np.flatnonzero(agent[i] != agent[j])
        i, j, offset = i[apart], j[apart], -np.column_stack([dx[apart], dy[apart]])
        near = _nearest(i, j, agent, offset)
        if len(near) < len(i):
            i, j, offset = i[near], j[near], offset[near]
        (xx, xy), (yx, yy) = (states.covariance[i, :2, :2] + states.covariance[j, :2, :2]).transpose(1, 2, 0)
        xx, yy = xx + FLOOR_M**2, yy + FLOOR_M**2
        information = np.stack([yy, -xy, -yx, xx], axis=-1).reshape(-1, 2, 2)
        information /= (xx * yy - xy * yx)[:, None, None]
        arm = 0.5 * (states.position[i, :2] + states.position[j, :2]) - about
        design = displacements(arm, 0.5 * (states.velocity[i, :2] + states.velocity[j, :2]))
        return cls(agent[i], agent[j], i, offset, information, design)

    def select(self, rows: Bools | Ints) -> Differences:
        """Some of them."""
        return Differences(
            self.one[rows],
            self.other[rows],
            self.track[rows],
            self.offset[rows],
            self.information[rows],
            self.design[rows],
        )

    def left(self, fault: Floats) -> Floats:
        """(k, 2) m, what a fault of each pair (a, a, 4) leaves of the differences."""
        return np.asarray(self.offset - np.einsum("kij,kj->ki", self.design, fault[self.one, self.other]))

    def matched(self, fault: Floats, *, every: bool = False) -> tuple[Differences, Bools]:
        """Those of tracks of one object, given a fault of each pair (a, a, 4), and (a, a) whether they are few.

        every: whether they are also few if a moving track is not matched: a wrong clock displaces nothing else

        A track is matched with the nearest one of another agent within MATCH_M of where the fault puts it.
        """
        left = self.left(fault)
        distance = np.hypot(left[:, 0], left[:, 1])
        nearest = _least_of_each(self.track * (self.other.max(initial=0) + 1) + self.other, distance)
        near = nearest[distance[nearest] <= MATCH_M]
        a = len(fault)
        moving = nearest[np.hypot(*self.design[nearest, :, 3].T) >= MOVING_MPS]
        lost = moving[distance[moving] > MATCH_M]
        tracks, matched, missing = (_count(self.one[rows], self.other[rows], a) for rows in (nearest, near, lost))
        few = (matched < MATCHED * tracks) | (every & (missing > 0))
        return self.select(near), (tracks >= COMPARABLE) & few

    def deviations(self, fault: Floats) -> Floats:
        """(k,) standard deviations by which they differ from a fault of each pair (a, a, 4)."""
        left = self.left(fault)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", left, self.information, left), 0.0)))

    def sums(self, a: int, values: Floats) -> Floats:
        """(a, a) sums of values (k,) of each pair."""
        return np.bincount(self.one * a + self.other, values, a * a).astype(np.float64).reshape(a, a)

    def equations(self, a: int, fault: Floats | None) -> tuple[Floats, Floats]:
        """Sums (a, a, 4, 4) and (a, a, 4) of weighted least squares of each pair.

        fault: (a, a, 4) from which outliers are judged, and their weight limited; None: nothing is an outlier
        """
        limit = np.full(len(self.one), np.inf) if fault is None else CLIP / np.maximum(self.deviations(fault), 1e-9)
        return pair_equations(
            self.one, self.other, self.offset, self.information, self.design, np.minimum(1.0, limit), a
        )


@kernel
def pair_equations(
    one: Ints, other: Ints, offset: Floats, information: Floats, design: Floats, weight: Floats, a: int
) -> tuple[Floats, Floats]:
    """Weighted sums (a, a, 4, 4) and (a, a, 4) of the equations of each pair; the columns of `Differences`.

    weight: (k,) of each difference
    """
    weighted = np.swapaxes(design, 1, 2) @ information * weight[:, None, None]
    matrix, vector = np.zeros((a, a, 4, 4)), np.zeros((a, a, 4))
    np.add.at(matrix, (one, other), weighted @ design)
    np.add.at(vector, (one, other), np.einsum("kij,kj->ki", weighted, offset))
    return matrix, vector


def _starts(group: Ints) -> Ints:
    """First rows of groups (k,) whose members follow each other."""
    return np.flatnonzero(np.diff(group, prepend=-1))


def _first_of_each(group: Ints, most: int) -> Ints:
    """Rows of the first members of each group, at most so many. group: (k,), members follow each other"""
    start = _starts(group)
    size = np.diff(start, append=len(group))
    if size.max(initial=0) <= most:
        return np.arange(len(group))
    return np.flatnonzero(np.arange(len(group)) - np.repeat(start, size) < most)


def _least_of_each(group: Ints, values: Floats) -> Ints:
    """Row of the least value in each group, the first of equals. group: (k,), members follow each other"""
    if not len(group):
        return np.zeros(0, np.int64)
    start = _starts(group)
    least = np.repeat(np.minimum.reduceat(values, start), np.diff(start, append=len(group)))
    rows = np.flatnonzero(values == least)
    return rows[_starts(group[rows])]


def _nearest(track: Ints, other: Ints, agent: Ints, offset: Floats) -> Ints:
    """Rows of the MAX_NEAR nearest differences of each track from those of each other agent.

    track, other: (k,) rows of the two tracks, sorted; agent: of all tracks, ascending;  offset: (k, 2) m
    """
    pair = track * (int(agent.max(initial=0)) + 1) + agent[other]
    if np.diff(_starts(pair), append=len(pair)).max(initial=0) <= MAX_NEAR:
        return np.arange(len(pair))
    order = np.lexsort((other, np.hypot(offset[:, 0], offset[:, 1]), pair))
    return np.sort(order[_first_of_each(pair[order], MAX_NEAR)])


def _count(one: Ints, other: Ints, a: int) -> Ints:
    return np.bincount(one * a + other, minlength=a * a).reshape(a, a)


def most_common(found: Differences, pair: tuple[int, int]) -> Floats | None:
    """The fault (4,) of one agent of a pair against the other that matches most of its tracks; None: no better one.

    Each turn and each lead is tried, with the displacement that most of the tracks then have in common. The least fault
    of equals is chosen, if it matches most of the tracks, and more than none at all; of those farther away than
    AMBIGUOUS_M, MANY.
    """
    mine = np.flatnonzero((found.one == pair[0]) & (found.other == pair[1]))
    track = np.cumsum(np.diff(found.track[mine], prepend=-1) > 0) - 1
    mine, track = mine[track < SEARCHED_TRACKS], track[track < SEARCHED_TRACKS]
    if not len(mine):
        return None
    left = found.offset[mine] - np.einsum("kij,hj->hki", found.design[mine][:, :, 2:], _TRIED)
    count, size = common_tracks(left, track, COMMON_M), np.hypot(left[..., 0], left[..., 1])
    chosen = np.where(count == count.max(axis=1, keepdims=True), size, np.inf).argmin(axis=1)
    support = count[np.arange(len(left)), chosen]
    best = int(support.argmax())
    before = len(np.unique(track[size[0] <= COMMON_M]))
    if support[best] < max(before + 1, MATCHED * (track[-1] + 1), COMPARABLE):
        return None
    shift = left[best, chosen[best]]
    matched = np.hypot(*(left[best] - shift).T) <= COMMON_M
    near = len(np.unique(track[matched & (size[0] <= AMBIGUOUS_M)]))
    if near <= before and support[best] - near < MANY:
        return None
    return np.array([*shift, *_TRIED[best]])


@kernel
def common_tracks(left: Floats, track: Ints, radius_m: float) -> Ints:
    """(h, k) number of tracks with a displacement within a radius of each, for each of h attempts.

    left: (h, k, 2) m;  track: (k,) ascending, of each displacement
    """
    result = np.zeros(left.shape[:2], np.int64)
    for row, each in enumerate(left):
        i, j, _, _ = pairs_within_radius(each, each, np.full(len(each), radius_m))
        near = np.zeros((len(each), int(track.max(initial=0)) + 1), np.bool_)
        near[i, track[j]] = True
        result[row] = near.sum(axis=1)
    return result


def _tried() -> Floats:
    """(h, 2) turns and leads that are tried: none, then each turn and each lead, the smallest first."""
    turns, leads = (each[np.argsort(np.abs(each), kind="stable")] for each in (TURNS, LEADS))
    return np.array([(0.0, 0.0), *((turn, 0.0) for turn in turns), *((0.0, lead) for lead in leads)])


_TRIED = _tried()


@dataclass(slots=True, eq=False)
class PairFits:
    """The fault of one agent against another one, of each pair of m agents, about the fixed point.

    information: (m, m, 4, 4), score: (m, m, 4) sums of weighted least squares;  fault: (m, m, 4) that fits them
    explains: (m, m) share of the common tracks that it explains
    """

    information: Floats
    score: Floats
    fault: Floats
    explains: Floats

    @classmethod
    def of(cls, m: int) -> PairFits:
        """Of m agents, before any evidence."""
        return cls(np.zeros((m, m, 4, 4)), np.zeros((m, m, 4)), np.zeros((m, m, 4)), np.zeros((m, m)))

    def of_pairs(self, pairs: tuple[Ints, ...]) -> PairFits:
        """Those of some pairs, an index of both axes."""
        return PairFits(self.information[pairs], self.score[pairs], self.fault[pairs], self.explains[pairs])

    def put(self, pairs: tuple[Ints, ...], fits: PairFits) -> None:
        """Replace those of some pairs."""
        self.information[pairs], self.score[pairs] = fits.information, fits.score
        self.fault[pairs], self.explains[pairs] = fits.fault, fits.explains

    def carried(self, agents: AgentMemory) -> PairFits:
        """Those of the agents that are remembered now."""
        columns = (self.information, self.score, self.fault, self.explains)
        return PairFits(*(agents.carry(agents.carry(column, 0.0), 0.0, axis=1) for column in columns))


class RelativeFaults:
    """Estimates the differences of the faults of all pairs of agents, and from them the faults of agents.

    significance: gain in twice the log-likelihood from which two agents differ
    least_m:  m, displacement below which they do not
    share:    of their common tracks that the difference must explain
    memory_s: s, over which differences are summed

    names: of the a agents of the last update
    """

    def __init__(self, significance: float, least_m: float, share: float, memory_s: float) -> None:
        self._significance, self._least_m, self._share, self._memory_s = significance, least_m, share, memory_s
        self._agents = AgentMemory()
        self._fits = PairFits.of(0)
        self._corrected = np.zeros((0, 4))  # (m, 4) of each agent, about the fixed point
        self._about: Floats | None = None
        self._turn = 0  # of the pairs whose fault is searched
        self._unsearched: Bools = np.zeros((0, 0), np.bool_)  # (a, a) pairs of the last batch whose fault is not yet
        self._time_ns: int | None = None
        self.names: tuple[str, ...] = ()
        self.differ: Bools = np.zeros((0, 0), np.bool_)
        self._rows: Ints = np.zeros(0, np.int64)

    def update(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        names: tuple[str, ...],
        pivots: Floats,
        suspended: Bools,
        *,
        urgent: bool = False,
    ) -> tuple[str, ...]:
        """Add a batch, if it is time to; returns the agents that are newly found to be faulty.

        states: n tracks of all agents as they were reported, world frame; agent: (n,) rows of `names` (a)
        pivots: (a, 2) m, about which each agent turns;  suspended: (a,) agents whose word does not count about others
        urgent: whether to add it in any case, and to look for faults that only moving tracks show
        """
        if self._about is None:
            self._about = pivots.mean(axis=0) if len(pivots) else np.zeros(2)
        elapsed_s = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        changed = self._meet(time_ns, names)
        if self._time_ns is not None and elapsed_s < FIT_S and not (changed or urgent):
            return ()
        self._time_ns = time_ns
        pairs = np.ix_(self._rows, self._rows)
        differences = Differences.of(states, agent, self._about)
        keep, samples = np.exp(-elapsed_s / self._memory_s), SAMPLES_PER_S * min(elapsed_s, MAX_STEP_S)
        prior = self._priors(pivots)
        self._fits.information *= keep
        self._fits.score *= keep
        fits = self._fit(differences, samples, self._fits.of_pairs(pairs), prior, urgent)
        self._fits.put(pairs, fits)
        return self._settle(fits, pivots, prior, suspended)

    def _meet(self, time_ns: int, names: tuple[str, ...]) -> bool:
        """Take the agents of a batch; whether they are others than in the last one."""
        changed = names != self.names
        self._rows, self.names = self._agents.meet(time_ns, names), names
        self._fits = self._fits.carried(self._agents)
        self._corrected = self._agents.carry(self._corrected, 0.0)
        return changed

    def _search(self, differences: Differences, known: Floats, few: Bools) -> tuple[Floats, Bools]:
        """Look for another fault of pairs (a, a) of which few tracks match the known one (a, a, 4), of some at a time.

        Returns the faults (a, a, 4) with those that are found, and which are (a, a).
        """
        fault, found = known.copy(), np.zeros(few.shape, np.bool_)
        poor = np.argwhere(np.triu(few & few.T)).tolist()
        for turn in range(min(SEARCHES, len(poor))):
            one, other = poor[(self._turn + turn) % len(poor)]
            few[one, other] = few[other, one] = False
            guess = most_common(differences, (one, other))
            if guess is not None:
                fault[one, other], fault[other, one] = guess, -guess
                found[one, other] = found[other, one] = True
        self._turn += SEARCHES
        self._unsearched = few & few.T
        return fault, found

    def _fit(self, differences: Differences, samples: float, past: PairFits, prior: Floats, urgent: bool) -> PairFits:
        """The fits of each pair, with a batch. past: before it;  samples: independent ones that the batch counts for"""
        a = len(prior)
        near, few = differences.matched(past.fault, every=urgent)
        start, anew = self._search(differences, past.fault, few)
        if anew.any():
            near, _ = differences.matched(start)
        information, score = (samples * each for each in near.equations(a, start))
        total = past.information + information, past.score + score
        fault = _solved(total, prior)
        count = near.sums(a, np.ones(len(near.one)))
        deviation = near.deviations(fault)
        loss = near.sums(a, huber_loss(deviation))
        poor_fit = loss > FIT * count
        if poor_fit.any() or anew.any():
            fresh = start
            for step in range(3):
                of_batch = [samples * each for each in near.equations(a, fresh if step or anew.any() else None)]
                fresh = _solved(of_batch, prior)
            better = near.sums(a, huber_loss(near.deviations(fresh))) < loss - CHANGED
            changed = poor_fit & better | anew
            for summed, alone in zip(total, of_batch, strict=True):
                summed[changed] = alone[changed]
            fault[changed] = fresh[changed]
            deviation = near.deviations(fault)
        worse = deviation > near.deviations(np.zeros_like(fault)) + WORSE_SD
        explained = near.sums(a, ((deviation <= EXPLAINED_SD) & ~worse).astype(np.float64))
        share = np.where(count >= COMPARABLE, explained / np.maximum(count, 1.0), past.explains)
        return PairFits(total[0], total[1], fault, share)

    def _priors(self, pivots: Floats) -> Floats:
        """(a, 4, 4) inverse covariance, about the fixed point, of a fault of each agent before any evidence."""
        assert self._about is not None
        own = about_pivot(pivots - self._about)
        return np.asarray(np.swapaxes(own, 1, 2) @ (own / PRIOR[:, None]))

    def _settle(self, fits: PairFits, pivots: Floats, prior: Floats, suspended: Bools) -> tuple[str, ...]:
        """Find out which agents are faulty; returns those that were not before."""
        assert self._about is not None
        own = about_pivot(pivots - self._about)
        size = displacement_m(np.einsum("aij,abj->abi", own, fits.fault))
        gain = np.einsum("abi,abi->ab", fits.score, fits.fault)
        may_differ = (gain >= SUPPORT * self._significance) & (size >= self._least_m) & (fits.explains >= self._share)
        may_differ &= may_differ.T
        self.differ = may_differ & (gain >= self._significance)
        faulty = self._still_faulty(fits)
        with_new = faulty | self._found(fits, may_differ, prior, suspended)
        if 2 * with_new.sum() < len(with_new):  # never half of the agents: then only those known before stay
            faulty = with_new
        # The word of suspended agents counts no more than that of faulty ones.
        sound = ~faulty & ~suspended
        corrected = np.zeros((len(faulty), 4))
        for row in np.flatnonzero(faulty).tolist():
            # What nothing shows any more, as the delay of standing objects, stays as it was.
            before = self._corrected[self._rows[row]]
            corrected[row] = _common(fits, row, sound, prior[row], before)
        corrected[displacement_m(np.einsum("aij,aj->ai", own, corrected)) < self._least_m] = 0.0
        new = np.asarray(corrected.any(axis=1) & ~self._corrected[self._rows].any(axis=1))
        self._corrected[self._rows] = corrected
        return tuple(name for name, each in zip(self.names, new.tolist(), strict=True) if each)

    def _found(self, fits: PairFits, differ: Bools, prior: Floats, suspended: Bools) -> Bools:
        """(a,) agents with one fault that explains why they differ from the others; differ: (a, a) pairs that may."""
        found = _in_every_explanation(differ, suspended)
        if found.any() and self._unsearched.any():
            # Pairs that are still to be searched may differ, too: nobody is corrected who might then not be at fault.
            found &= _in_every_explanation(differ | self._unsearched, suspended)
        # What two liars make an agent differ by is not what it differs by from an honest one by chance.
        supported, sound = differ.copy(), ~found & ~suspended
        for row in np.flatnonzero(found).tolist():
            fault = _common(fits, row, sound, prior[row], np.zeros(4))
            supported[row] &= _gain(fits.score[row], fits.information[row], fault) >= SUPPORT * self._significance
            supported[:, row] &= supported[row]
        return found & _in_every_explanation(supported, suspended) if found.any() else found

    def _still_faulty(self, fits: PairFits) -> Bools:
        """(a,) agents with a fault that is corrected, and that the differences from the others do not refute."""
        corrected = self._corrected[self._rows]
        faulty = corrected.any(axis=1)
        score, information = (each[:, ~faulty].sum(axis=1) for each in (fits.score, fits.information))
        gain = _gain(score, information, corrected)
        return np.asarray(faulty & (gain >= -DOUBT))

    @property
    def doubtful(self) -> Bools:
        """(a,) agents of the last update that may have a fault: they differ, or match few tracks of others."""
        return np.asarray((self.differ | self._unsearched).any(axis=1))

    def faults(self, pivots: Floats) -> Floats:
        """(a, 4) the fault of each agent of the last update, about its pivot (a, 2) m; zeros: none."""
        if self._about is None:
            return np.zeros((len(pivots), 4))
        return np.asarray(np.einsum("aij,aj->ai", about_pivot(pivots - self._about), self._corrected[self._rows]))


def _gain(score: Floats, information: Floats, fault: Floats) -> Floats:
    """(k,) twice the log-likelihood that a fault (4,) or (k, 4) gains. score: (k, 4), information: (k, 4, 4)"""
    return np.asarray(
        2.0 * np.sum(score * fault, axis=-1) - np.sum(fault * (information @ fault[..., None])[..., 0], axis=-1)
    )


def _common(fits: PairFits, row: int, sound: Bools, prior: Floats, before: Floats) -> Floats:
    """(4,) the fault of an agent against sound ones (a,). before: (4,) the most likely without evidence"""
    information = fits.information[row, sound].sum(axis=0) + prior
    return np.asarray(np.linalg.solve(information, fits.score[row, sound].sum(axis=0) + prior @ before))


def _in_every_explanation(differ: Bools, suspended: Bools) -> Bools:
    """(a,) the faulty agents, given which pairs differ (a, a); suspended: (a,) agents whose word does not count."""
    if not differ.any():
        return np.zeros(len(differ), np.bool_)
    nobody = np.zeros(len(differ), np.bool_)

    def faulty(untrusted: Bools) -> Bools:
        explanations = Explanations(differ, untrusted, nobody)
        return explanations.verdict().lying & ~untrusted if explanations.possible() else nobody

    result = faulty(suspended)
    for agent in np.flatnonzero(suspended & differ.any(axis=1)).tolist():
        result[agent] = faulty(suspended & (np.arange(len(differ)) != agent))[agent]
    return result


def _solved(total: Sequence[Floats], prior: Floats) -> Floats:
    """(a, a, 4) the fault of each pair that fits sums best.

    total: (a, a, 4, 4) information and (a, a, 4) scores;  prior: (a, 4, 4)
    """
    # From either side it is the same but for the sign, so both use the mean of their priors.
    both = 0.5 * (prior[:, None] + prior[None, :])
    return np.asarray(np.linalg.solve(total[0] + both, total[1][..., None])[..., 0])


def huber_loss(deviation: Floats) -> Floats:
    """Huber's loss of deviations."""
    return np.where(deviation <= CLIP, 0.5 * deviation**2, CLIP * (deviation - 0.5 * CLIP))


def about_pivot(arm: Floats) -> Floats:
    """(a, 4, 4) matrices from faults about a fixed point to those about pivots.

    arm: (a, 2) m, from the fixed point to each pivot
    """
    result = np.tile(np.eye(4), (len(arm), 1, 1))
    result[:, 0, 2], result[:, 1, 2] = -arm[:, 1], arm[:, 0]
    return result
