"""Sequential tests of each agent, with disputes settled jointly: who must be lying, if fewer than half are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, by_agent
from mast_zenoh.integrity.base import (
    FAULTY,
    UNKNOWN,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    ObjectTrust,
)
from mast_zenoh.integrity.calibration import MAX_STEP_S, SAMPLES_PER_S, Tail, accumulate, discoveries
from mast_zenoh.integrity.explanations import Explanations, Verdict, mask_of
from mast_zenoh.integrity.fault_fit import described, view_without_fault, without_fault
from mast_zenoh.integrity.fault_or_lie import SUSPECT_LOG_ODDS
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.offsets import KnownOffsetSums, offsets
from mast_zenoh.integrity.relative_faults import RelativeFaults
from mast_zenoh.integrity.sequential import MAX_LOG_ODDS, SequentialConsistency
from mast_zenoh.integrity.testimonies import Testimonies
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import (
    FAR_M,
    RayEvidence,
    Sightings,
    current,
    lenient_sightings,
    rays_at,
    silent_about,
)
from mast_zenoh.integrity.voting import ExistenceVotes

#: Tails of the statistics on unattacked junctions: of one agent's disputes, of those of a pair, and of what an agent's
#: own reports contradict.
CONTRADICTION_TAIL = Tail(per_hour=78.0, scale=0.237)
PAIR_TAIL = Tail(per_hour=43.0, scale=0.234)
OWN_TAIL = Tail(per_hour=40.0, scale=0.248)
#: The same of the offset of a known size, and m, that size.
KNOWN_OFFSET_TAIL, KNOWN_OFFSET_M = Tail(per_hour=2400.0, scale=0.433), 1.0
#: Disputes an hour of each pair of honest agents that count as one. A pair alone suspends nobody.
DISPUTES_PER_HOUR = 1.0
#: s, for which an agent that may have a fault is not suspended for what it does.
FAULT_FOUND_S = 1.0
#: s, for which a dispute about where an object is lasts.
APART_S = 10.0
#: Share of the statistic of an alarm up to which an agent is where the middle of an object is.
ON_THE_SPOT = 0.25
#: Objects that an agent alone may report whose honesty is open: so many, and this many times what is usual for the
#: agents now; of others, UNDISPUTED times as many.
ALONE, ALONE_TIMES, UNDISPUTED = 6, 2.0, 4
#: s, over which the number of objects is averaged that an agent reports and nobody else looks at.
USUAL_S = 10.0


@dataclass(kw_only=True, eq=False)
class JointConsistency(SequentialConsistency):
    """`SequentialConsistency` that suspends only agents that lie in every explanation of all recent disputes.

    Each object about which two agents contradict each other, however many others look at it, counts for that pair; so
    does each object that both report at places too far apart. Pairs whose sum an honest pair seldom exceeds disagree.
    An explanation is a set of fewer than half of the agents with one of each pair that disagrees (`explanations`). An
    agent is suspended if its own sum is an alarm, as before, and it is in every explanation. Two accusers of five prove
    nothing, since two may lie; three do. Agents that are in some explanations alone are not suspended: their reason
    says so.

    A pose error or a wrong clock is corrected first, in tracks and views: it displaces all tracks of an agent alike.
    The agents with a fault are the smallest set, fewer than half, that has one of each pair whose common tracks differ
    by one displacement, turn and delay (`relative_faults`), on one agent or on several at once. Of two sets of one
    size, nothing says which, and nobody is corrected.

    An object is withheld only while it is false in every explanation, or nobody that is not suspended reports it. Of
    the objects that an agent alone reports and nobody's rays end at, the newest are withheld, if they are far more than
    others have alone.

    significance: gain in twice the log-likelihood from which the tracks of two agents differ; 30 is exceeded by 5 in a
        million of a chi-square distribution with four degrees
    least_m: m, displacement below which nothing is corrected
    share: of the common tracks that the difference must explain
    fault_memory_s: s, over which differences are summed
    anchors: names of agents that are known to be honest, and never suspended: a receiver trusts its own sensors
    disputes_per_hour: of a pair of honest agents that count as a disagreement
    pair_tail: (per hour, scale) of the sums of a pair of honest agents

    Weaknesses: a lie that no other agent could notice, or only as many as may be lying themselves, is believed, up to a
    few objects. An agent that moves all its tracks alike on purpose is corrected, not suspended, which does no harm.
    Suspending an agent costs the objects that it alone reports and that were not known before.
    """

    significance: float = 30.0
    least_m: float = 0.3
    share: float = 0.7
    fault_memory_s: float = 1.5
    contradiction_tail: tuple[float, float] = (CONTRADICTION_TAIL.per_hour, CONTRADICTION_TAIL.scale)
    anchors: tuple[str, ...] = ()
    disputes_per_hour: float = DISPUTES_PER_HOUR
    pair_tail: tuple[float, float] = (PAIR_TAIL.per_hour, PAIR_TAIL.scale)

    def __post_init__(self) -> None:
        check("more than 0", disputes_per_hour=self.disputes_per_hour, fault_memory_s=self.fault_memory_s)
        self._pair_tail = Tail(*self.pair_tail)
        self._known_offsets = KnownOffsetSums(KNOWN_OFFSET_M, SAMPLES_PER_S)
        self._faults = RelativeFaults(self.significance, self.least_m, self.share, self.fault_memory_s)
        super().__post_init__()

    def reset(self) -> None:
        super().reset()
        self._faults.reset()
        self._known_offsets.reset()
        self._found = np.zeros((0, 4))  # (a, 4) faults of the agents of the last batch
        self._suspicious = False  # whether an agent of the last batch looks worse than most honest ones ever do
        self._lost = np.zeros(0)  # (m,) share of frames in which nothing of an agent arrived
        self._in_doubt_s = np.zeros(0)  # (m,) s, for which an agent was to be suspended that may have a fault
        self._existence: JointVotes = JointVotes(self._agents)
        self._pairs = np.zeros((0, 0))  # (m, m) cumulative disputes of each pair, object-seconds
        self._apart_ns = np.zeros((0, 0), np.int64)  # (m, m) ns, when a pair last reported an object apart; 0: never
        self._own = np.zeros(0)  # (m,) cumulative contradictions of an agent with itself, object-seconds
        self._settled: tuple[bytes, Explanations, Verdict] | None = None
        # of the last batch: (p,) sums of pairs, (a,) of what agents' own reports contradict, and of known offsets
        self._last_more = np.zeros(0), np.zeros(0), np.zeros(0)

    @property
    def calibrated(self) -> dict[str, Floats]:
        return super().calibrated | dict(zip(("pair", "own", "known offset"), self._last_more, strict=True))

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        pivots = np.zeros((len(agents), 2))
        for row, name in enumerate(agents):
            mine = agent == row
            if name in views:
                pivots[row] = views[name].view.position[:2]
            elif mine.any():
                pivots[row] = states.position[mine, :2].mean(axis=0)
        order = by_agent(states, agent)  # the order of the rows must not matter
        tracks = states.select(order), agent[order], agents, pivots
        for name in self._faults.update(time_ns, *tracks, urgent=self._suspicious):
            self.excuse(name)
        self._found = self._faults.faults(pivots)
        corrected = dict(views)
        for row in np.flatnonzero(self._found.any(axis=1)).tolist():
            states = without_fault(states, agent == row, self._found[row], pivots[row])
            if agents[row] in views:
                corrected[agents[row]] = view_without_fault(views[agents[row]], self._found[row])
        return states, corrected

    def excuse(self, agent: str) -> None:
        super().excuse(agent)
        if agent in self._agents.names:
            row = self._agents.names.index(agent)
            self._of.contradictions[row] = self._own[row] = self._in_doubt_s[row] = 0.0
            self._pairs[row] = self._pairs[:, row] = 0.0
            self._known_offsets.forget(self._numbers[agent])
            self._apart_ns[row] = self._apart_ns[:, row] = 0

    def assess(self, batch: Batch) -> Assessment:
        dt = 0.0 if self._time_ns is None else min((batch.time_ns - self._time_ns) * 1e-9, MAX_STEP_S)
        self._time_ns = batch.time_ns
        rows = self._meet(batch)
        vote = ~self._of.suspended[rows]
        boxes = ClusterBoxes.of(batch, np.broadcast_to(vote, (batch.clusters, len(vote))))
        seen, own = lenient_sightings(batch, boxes)
        rays = rays_at(batch, boxes, current(batch.views))
        said = Testimonies.of(batch, boxes, own, seen, rays)
        accusations = said.accusations
        offset, known = self._offsets(batch, boxes, rows, dt)
        self._add_disputes(rows, said, dt)
        count = np.logical_or.reduce(tuple(accusations.values())).sum(axis=0)
        self._of.contradictions[rows] = self._summed(self._of.contradictions[rows], count, self._tails[0], dt)
        self._of.offset[rows] = offset
        self._last = self._of.contradictions[rows].copy(), offset
        pairs = self._pairs[np.ix_(rows, rows)]
        self._last_more = pairs[np.triu_indices(len(rows), 1)], self._own[rows], known
        explanations, verdict = self._explain(batch, rows, pairs)
        statistics = zip((*self._tails, KNOWN_OFFSET_TAIL), (*self._last, known), strict=True)
        rates = np.stack([tail.rate(value) for tail, value in statistics], axis=1)
        alarms = rates <= self.false_alarms_per_hour / max(rates.size, 1)
        alarms[vote] = discoveries(rates[vote], self.false_alarms_per_hour)
        alarms[vote & ~verdict.lying] = False
        self._wait_for_faults(rows, alarms, dt)
        self._update_suspensions(batch, rows, alarms, accusations, dt)
        believed = ~self._of.suspended
        if (vote & ~believed[rows]).any():
            self._known_offsets.reset()
        judged, weights = self._existence.settle(
            batch, boxes, seen, rays, said.impossible, believed, rows, explanations, verdict.open
        )
        return Assessment(weights, self._judged(batch, rows, rates, verdict), judged)

    def _wait_for_faults(self, rows: Ints, alarms: Bools, dt: float) -> None:
        """Take back the alarms of agents that may have a fault, for a while: it excuses them once it is found."""
        differs = (
            self._faults.differ.any(axis=1) if len(self._faults.differ) == len(rows) else np.zeros(len(rows), bool)
        )
        doubt = alarms.any(axis=1) & differs & (self._in_doubt_s[rows] < FAULT_FOUND_S)
        self._in_doubt_s[rows] = np.where(
            doubt, self._in_doubt_s[rows] + dt, self._in_doubt_s[rows] * (~doubt & differs)
        )
        alarms[doubt] = False

    def _offsets(self, batch: Batch, boxes: ClusterBoxes, rows: Ints, dt: float) -> tuple[Floats, Floats]:
        """(a,) greatest statistics of an offset of each agent, of any size and of the known one.

        Notes which agents report an object apart.
        """
        numbers = np.array([self._numbers[name] for name in batch.agents], np.int64)
        objects = self._existence.follow(batch.time_ns, boxes)
        measured = offsets(batch, boxes, self._median_weights(rows))
        some = self._sums.of_objects(batch.time_ns, numbers, objects, measured)
        known = self._known_offsets.of_objects(batch.time_ns, numbers, objects, measured, dt)
        self._apart_ns = self._agents.carry(self._agents.carry(self._apart_ns, 0), 0, axis=1)
        rate = self.false_alarms_per_hour / max(3 * len(rows), 1)
        share = np.maximum(some / self._alarm_at(1, len(rows)), known / KNOWN_OFFSET_TAIL.value_at(rate))
        for cluster, off in zip(*np.nonzero(share >= 1.0), strict=True):
            there = measured.valid[cluster] & (share[cluster] <= ON_THE_SPOT)
            pair = np.ix_([rows[off]], rows[there])
            self._apart_ns[pair] = batch.time_ns
            self._apart_ns[pair[1].T, pair[0].T] = batch.time_ns
        return some.max(axis=0, initial=0.0), known.max(axis=0, initial=0.0)

    def _summed(self, total: Floats, count: Ints, tail: Tail, dt: float) -> Floats:
        """Cumulative sums after a batch with `count` contradictions.

        An honest agent errs about one object at a time: several at once are much rarer. Limited, so that they can be
        forgotten again.
        """
        after = accumulate(total, np.asarray(0.5 * count * (count + 1), np.float64), self.allowance, dt)
        return np.minimum(after, 2.0 * max(tail.value_at(self.false_alarms_per_hour / 10.0), tail.scale))

    def _add_disputes(self, rows: Ints, said: Testimonies, dt: float) -> None:
        self._pairs = self._agents.carry(self._agents.carry(self._pairs, 0.0), 0.0, axis=1)
        self._own, self._lost, self._in_doubt_s = (
            self._agents.carry(each, 0.0) for each in (self._own, self._lost, self._in_doubt_s)
        )
        pairs = np.ix_(rows, rows)
        self._pairs[pairs] = self._summed(self._pairs[pairs], said.between, self._pair_tail, dt)
        self._own[rows] = self._summed(self._own[rows], said.against_itself, OWN_TAIL, dt)

    def _explain(self, batch: Batch, rows: Ints, pairs: Floats) -> tuple[Explanations, Verdict]:
        """The explanations of the disputes of the agents of a batch. pairs: (a, a) cumulative disputes of each pair"""
        apart_ns = self._apart_ns[np.ix_(rows, rows)]
        disputes = self._pair_tail.rate(pairs) <= self.disputes_per_hour
        disputes |= (apart_ns > 0) & (batch.time_ns - apart_ns <= APART_S * 1e9)
        lying = OWN_TAIL.rate(self._own[rows]) <= self.false_alarms_per_hour / max(len(rows), 1)
        lying |= self._of.suspended[rows]
        honest = np.isin(batch.agents, self.anchors)
        key = disputes.tobytes() + lying.tobytes() + honest.tobytes()
        if self._settled is None or self._settled[0] != key:
            explanations = Explanations(disputes, lying, honest)
            self._settled = key, explanations, explanations.verdict()
        return self._settled[1], self._settled[2]

    def _judged(self, batch: Batch, rows: Ints, rates: Floats, verdict: Verdict) -> AgentTrust:
        """The trust in the agents; the reason of those that may be lying says so."""
        trust = self._agent_trust(batch, rows, rates)
        suspended = self._of.suspended[rows]
        self._suspicious = bool((trust.log_odds[~suspended] < SUSPECT_LOG_ODDS).any())
        odds = np.where(suspended, trust.log_odds, np.maximum(trust.log_odds, 0.0))
        undecided = verdict.open & ~suspended
        faults = self._found if len(self._found) == len(rows) else np.zeros((len(rows), 4))
        faulty = faults.any(axis=1) & ~suspended
        suspects = ", ".join(np.array(batch.agents)[undecided].tolist()) if undecided.any() else ""
        reasons = tuple(
            described(fault)
            if has_fault
            else f"may be lying, or those that contradict it are: {suspects}"
            if suspect
            else reason
            for fault, has_fault, suspect, reason in zip(
                faults, faulty.tolist(), undecided.tolist(), trust.reason, strict=True
            )
        )
        state = np.where(faulty, FAULTY, np.where(undecided, UNKNOWN, trust.state)).astype(np.uint8)
        late = [view is not None and view.age_s > 0.0 for view in batch.views]
        known = np.array([view is not None for view in batch.views], np.bool_)
        self._lost[rows] += np.where(known, 0.02 * (np.array(late, np.float64) - self._lost[rows]), 0.0)
        return AgentTrust.of(
            1.0 / (1.0 + np.exp(-odds)),
            state,
            reasons,
            log_odds=np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS),
            offset=faults[:, :2].copy(),
            turn=faults[:, 2].copy(),
            delay=-faults[:, 3],
            loss=self._lost[rows].copy(),
        )


class JointVotes(ExistenceVotes):
    """`ExistenceVotes` that withhold an object only while it is false in every explanation.

    Objects where no other sensor looks can be neither confirmed nor refuted. Of a suspended agent, as many of them are
    believed as it had on average before, the oldest: disbelieving all would cost more than it saves.
    """

    def __init__(self, agents: AgentMemory) -> None:
        super().__init__(agents)
        # (k, 2) mean number of objects that an agent reports and nobody else looks at, and s, over which it is averaged
        self._unseen = np.zeros((0, 2))
        self._met_ns: int | None = None

    def settle(
        self,
        batch: Batch,
        boxes: ClusterBoxes,
        seen: Sightings,
        rays: RayEvidence,
        impossible: Bools,
        believed: Bools,
        agent_rows: Ints,
        explanations: Explanations,
        disputed: Bools,
    ) -> tuple[ObjectTrust, Floats]:
        """As `count`, with the explanations of the disputes of the batch's agents, and (a,) whose honesty is open."""
        reported, rows, voter = batch.reported, self._rows, believed[agent_rows]
        clear, silent = rays.mostly_clear, silent_about(batch, boxes, seen, rays, FAR_M)
        claims = reported & ~clear & ~impossible & voter
        votes = voter.astype(np.float64)
        confirming, contradicting = (claims | silent) @ votes, clear @ votes
        denied = np.flatnonzero(claims.any(axis=1) & (clear & voter).any(axis=1))
        refuted = np.zeros(len(rows), np.bool_)
        refuted[denied] = [
            explanations.false(mask_of(claims[row] | (silent[row] & voter)), mask_of(clear[row] & voter))
            for row in denied.tolist()
        ]
        refuted |= ~claims.any(axis=1) & (contradicting > confirming)
        balance = self._votes.vote(rows, np.where(refuted, -1.0, 1.0))
        self._note_witnesses(claims, agent_rows)
        unseen = reported & ~clear & ~impossible & ~(seen.in_view & voter & ~reported).any(axis=1, keepdims=True)
        unseen &= (reported.sum(axis=1) == 1)[:, None]
        claimed = claims.any(axis=1) | self._usually_unseen(batch.time_ns, unseen, voter, agent_rows)
        sole = np.asarray((claims | (silent & voter)).sum(axis=1) == 1) & ~self._confirmed(believed)
        beyond = self._beyond_usual(claims & sole[:, None], disputed)
        withheld = (balance < 0.0) | ~self._stays(batch.time_ns, claimed, believed) | beyond
        objects = ObjectTrust(
            (1.0 + confirming) / (2.0 + confirming + contradicting),
            (seen.in_view | reported).sum(axis=1),
            claims.sum(axis=1),
            (clear & voter).sum(axis=1),
            withheld,
        )
        return objects, batch.weights(claims)

    def _usually_unseen(self, time_ns: int, unseen: Bools, voter: Bools, agent_rows: Ints) -> Bools:
        """(c,) the oldest objects that only a suspended agent reports and nobody else looks at, as many as usual.

        unseen: (c, a) which agent alone reports an object where nobody else looks; voter: (a,) agents not suspended
        """
        elapsed_s = 0.0 if self._met_ns is None else (time_ns - self._met_ns) * 1e-9
        self._met_ns = time_ns
        self._unseen = self._agents.carry(self._unseen, 0.0)
        usual, seconds = self._unseen[agent_rows].T
        believed = self._oldest(unseen & ~voter, np.rint(usual))
        seconds = np.where(voter, np.minimum(seconds + elapsed_s, USUAL_S), seconds)
        step = np.where(voter, elapsed_s / np.maximum(seconds, 1e-9), 0.0)
        self._unseen[agent_rows] = np.column_stack([usual + step * (unseen.sum(axis=0) - usual), seconds])
        return believed

    def _oldest(self, objects: Bools, most: Floats) -> Bools:
        """(c,) the oldest of each agent's objects (c, a), at most (a,) so many."""
        chosen = np.zeros(len(objects), np.bool_)
        for column in np.flatnonzero(objects.any(axis=0)).tolist():
            own = np.flatnonzero(objects[:, column])
            oldest = np.argsort(self._of.first_ns[self._rows[own]], kind="stable")
            chosen[own[oldest[: int(most[column])]]] = True
        return chosen

    def _beyond_usual(self, alone: Bools, disputed: Bools) -> Bools:
        """(c,) the newest of the objects that an agent alone reports (c, a), beyond what is usual."""
        count = alone.sum(axis=0)
        most = (ALONE + ALONE_TIMES * np.median(count)) * np.where(disputed, 1, UNDISPUTED) if len(count) else count
        over = alone & (count > most)
        return np.asarray(over.any(axis=1) & ~self._oldest(over, np.asarray(most, np.float64)))
