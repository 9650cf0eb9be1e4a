"""Sequential tests of each agent, with all disputes settled jointly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.alarms import EXCUSED_S, MAX_STEP_S, Tail, accumulate, discoveries
from mast_zenoh.integrity.base import (
    SUSPENDED,
    TRUSTED,
    UNDECIDED,
    UNKNOWN,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    Integrity,
)
from mast_zenoh.integrity.deviations import (
    NAMES,
    POSITION,
    QUANTITY,
    REASONS,
    LastingDeviations,
    Means,
    deviations,
    displacements,
)
from mast_zenoh.integrity.disputes import (
    ACCUSATIONS,
    OF_ITSELF,
    Evidence,
    Explanations,
    Testimonies,
    Verdict,
    explained,
)
from mast_zenoh.integrity.existence import BRIEF_S, ExistenceVotes
from mast_zenoh.integrity.memory import NOW, AgentMemory

#: s, before the first evidence against an agent, in which it may have lied unnoticed.
GRACE_S = BRIEF_S + 0.5
#: Least weight of an agent that is not suspended in the middle of its objects.
MIN_MEDIAN_WEIGHT = 0.05
#: Log-odds are limited to this, either way.
MAX_LOG_ODDS = 20.0

#: Tails of the statistics on unattacked junctions, see docs/explanation-defences.md: of one agent's disputes, of those
#: of a pair, of what an agent's own reports contradict, and of deviations.
CONTRADICTION_TAIL = Tail(per_hour=54.0, scale=0.63)
PAIR_TAIL = Tail(per_hour=94.0, scale=0.68)
OWN_TAIL = Tail(per_hour=40.0, scale=0.248)
DEVIATION_TAIL = Tail(per_hour=60.0, scale=1.5)
#: Columns of the statistics of an agent.
CONTRADICTIONS, DEVIATION = range(2)
#: Of all agents together; a fiftieth of what is acceptable, because the tails are extrapolated.
FALSE_ALARMS_PER_HOUR = 0.02
#: Disputes an hour of each pair of honest agents that count as one: a pair alone suspends nobody.
DISPUTES_PER_HOUR = 10.0
#: How much the word of an agent counts that an object is not there: that of two is needed. An anchor's alone is enough.
WORD = 0.5
#: s, for which an agent that may have a fault is not suspended for what it does.
FAULT_AWAITED_S = 1.0
#: s, for which an agent is not suspended for a deviation of position that a fault may explain, and the greatest share
#: of the squared deviations that such a fault may leave.
EXPLAINED_S, UNEXPLAINED = 10.0, 0.3
#: s, of this time that an agent regains in a second: one that differs now and then is not excused for ever.
AWAITED_AGAIN = 0.05
#: Objects of an honest agent that are contradicted at a time, expected before a run shows it.
EXPECTED = 0.05
#: s, over which their number is averaged, of a new agent and later on.
USUAL_FROM_S, USUAL_S = 4.0, 20.0
#: How many times as much evidence is needed at most where more are usual.
MOST_EVIDENCE = 6.0
#: Greatest sum, as many times the alarm of one of ten statistics (of five agents), so that it can be forgotten again.
MAX_SUM = 1.5
#: s, before a suspension for a deviation, in which an agent may have lied unnoticed.
DEVIATED_S = 10.0
#: s, for which a dispute about where an object is lasts.
APART_S = 10.0


@dataclass(kw_only=True, eq=False)
class SequentialConsistency(Integrity):
    """Suspends agents that lie in every explanation of all recent disputes.

    Each object about which two agents contradict each other, however many others look at it, counts for that pair in a
    cumulative sum (Page 1954). Pairs whose sum an honest pair seldom exceeds disagree, and pairs whose tracks deviate
    from each other as those of an honest pair seldom do. An explanation is a set of fewer than half of the agents with
    one of each pair that disagrees (`explanations`).

    Two statistics for each agent: the cumulative sum of contradictions in progress: objects that others see through (if
    one agent alone does, half), that no road user can be, or that it reports twice, each for COUNTED_S after the first
    BRIEF_S, relative to what is usual among the agents now; and the greatest deviation of one of its tracks from the
    median of the agents, in position, velocity, heading or size, as long as it lasts, relative to what is usual in the
    run (`LastingDeviations`). One object alone, however long it is contradicted, is thus no alarm: honest detectors
    have such errors, and the object is withheld. What an agent's own sensor sees through, or is outside its own view,
    is no claim of it, and counts neither for nor against it. Each statistic counts as an alarm by how rarely an honest
    agent exceeds it, with the false discoveries among all agents controlled (Benjamini and Hochberg 1995). An agent is
    suspended if one of them is an alarm, and it is in every explanation. Two accusers of five prove nothing, since two
    may lie; three do. Agents in some explanations alone are `undecided`: their reason says so.

    Which objects are withheld is decided by `ExistenceVotes`.

    anchors: names of agents that are known to be honest, and never suspended: a receiver trusts its own sensors
    false_alarms_per_hour: of all agents together
    allowance: contradictions that are subtracted per second, so that an honest agent's sum stays near 0
    release_s: s without evidence after which a suspended agent is trusted again, at first; doubled each time
    disputes_per_hour: of a pair of honest agents that count as a disagreement
    contradiction_tail, deviation_tail, pair_tail: (per hour, scale) of the statistics of an honest agent, or pair

    An agent's log-odds are the logarithm of how often an honest agent would look worse, relative to the permitted rate.

    Weaknesses: a lie that no other agent could notice, or only as many as may be lying themselves, is believed, up to a
    few objects where others look, and ten and more where nobody does; pedestrians may be moved by half a metre.
    Suspending an agent costs the objects that it alone reports and that were not known before. Needs views for all but
    the deviations.
    """

    anchors: tuple[str, ...] = ()
    false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR
    allowance: float = 0.25
    release_s: float = 30.0
    disputes_per_hour: float = DISPUTES_PER_HOUR
    contradiction_tail: tuple[float, float] = (CONTRADICTION_TAIL.per_hour, CONTRADICTION_TAIL.scale)
    deviation_tail: tuple[float, float] = (DEVIATION_TAIL.per_hour, DEVIATION_TAIL.scale)
    pair_tail: tuple[float, float] = (PAIR_TAIL.per_hour, PAIR_TAIL.scale)

    def __post_init__(self) -> None:
        check(
            "more than 0, finite",
            false_alarms_per_hour=self.false_alarms_per_hour,
            release_s=self.release_s,
            disputes_per_hour=self.disputes_per_hour,
            **{
                f"{name}[{part}]": value
                for name in ("contradiction_tail", "deviation_tail", "pair_tail")
                for part, value in enumerate(getattr(self, name))
            },
        )
        check("0 or more, finite", allowance=self.allowance)
        self._tails = Tail(*self.contradiction_tail), Tail(*self.deviation_tail)
        self._pair_tail = Tail(*self.pair_tail)
        self.reset()

    def reset(self) -> None:
        # contradictions, own: cumulative sums, object-seconds, of disputes and of what contradicts itself
        # kinds: object-seconds of each of ACCUSATIONS since there was no evidence
        # clean_s: since the last alarm or evidence;  seen_s: for which the agent has been observed
        # awaited_s: for which an agent was to be suspended that may have a fault
        # usual: mean number of its objects that are contradicted
        # suspended_ns: time, ns, of the last suspension;  for_deviation: whether that was for a deviation alone
        # misdescribes: whether that was for a velocity, a heading or a size: its objects are where it says
        # quiet_ns: time, ns, of the last batch without evidence;  lying: whether it lies in every explanation
        sums = dict.fromkeys(("contradictions", "own", "clean_s", "deviation", "seen_s", "awaited_s"), 0.0)
        flags = dict.fromkeys(("suspended", "for_deviation", "misdescribes", "lying"), False)
        self._agents = AgentMemory(
            forget_s=600.0,
            number=-1,
            usual=EXPECTED,
            suspensions=0,
            suspended_ns=0,
            quiet_ns=NOW,
            kinds=(0.0,) * len(ACCUSATIONS),
            **sums,
            **flags,
            **ExistenceVotes.COLUMNS,
        )
        self._of = self._agents.of
        self._next_number = 0  # of an agent that was not there before
        self._existence = ExistenceVotes(self._agents)
        self._pairs = np.zeros((0, 0))  # (m, m) cumulative disputes of each pair, object-seconds
        self._apart_ns = np.zeros((0, 0), np.int64)  # (m, m) ns, when a pair last reported an object apart; 0: never
        self._lasting = LastingDeviations()
        self._time_ns: int | None = None
        self._reasons: dict[str, str] = {}
        self._awaited: frozenset[str] | None = None  # None: nobody looks for faults
        self._settled: tuple[bytes, Explanations, Verdict] | None = None
        # of the last batch: (a, 2) statistics, (a,) the greatest difference from one other agent, (a,) which of NAMES
        # deviates most
        self._statistics, self._of_apart = np.zeros((0, len(self._tails))), np.zeros(0)
        self._deviating: Ints = np.zeros(0, np.int64)
        self._disputes: Bools = np.zeros((0, 0), np.bool_)  # (a, a) of the last batch, who disagrees with whom

    @property
    def calibrated(self) -> dict[str, Floats]:
        """By name, (k,) statistics of the last batch that have a tail, see `tools/calibrate_integrity.py`."""
        of_agents = dict(zip(("contradictions", "deviation"), self._statistics.T, strict=True))
        rows = self._agents.rows
        pairs, factor = self._pairs[np.ix_(rows, rows)][np.triu_indices(len(rows), 1)], self._evidence_factor(rows)
        return of_agents | {"pair": pairs / factor, "own": self._of.own[rows] / factor, "apart": self._of_apart}

    def excuse(self, agent: str) -> None:
        if agent not in self._agents.names:
            return
        row = self._agents.names.index(agent)
        assert self._time_ns is not None
        number = int(self._of.number[row])
        self._lasting.forget(number)
        for name in ("contradictions", "own", "kinds", "deviation", "awaited_s"):
            getattr(self._of, name)[row] = 0.0
        self._pairs[row] = self._pairs[:, row] = 0.0
        self._apart_ns[row] = self._apart_ns[:, row] = 0
        recent = self._time_ns - self._of.suspended_ns[row] <= EXCUSED_S * 1e9
        if self._of.suspended[row] and (recent or self._of.for_deviation[row]):
            self._of.suspended[row] = False
            self._reasons.pop(agent, None)

    def await_faults(self, agents: frozenset[str]) -> None:
        self._awaited = agents

    def assess(self, batch: Batch) -> Assessment:
        dt = 0.0 if self._time_ns is None else min((batch.time_ns - self._time_ns) * 1e-9, MAX_STEP_S)
        self._time_ns = batch.time_ns
        rows = self._meet(batch)
        vote = ~self._of.suspended[rows]
        evidence = Evidence.of(batch, vote)
        objects = self._existence.follow(batch.time_ns, evidence.boxes)
        means = self._note_deviations(batch, evidence.boxes, objects)
        honest = np.isin(batch.agents, self.anchors)
        self._add_disputes(evidence.testimonies, honest, dt)
        factor = self._evidence_factor(rows)
        contradictions = self._of.contradictions[rows] / factor
        self._statistics = np.column_stack([contradictions, self._of.deviation[rows]])
        explanations, verdict = self._explain(batch, rows, honest, factor)
        rates = np.column_stack(
            [tail.rate(values) for tail, values in zip(self._tails, self._statistics.T, strict=True)]
        )
        # Of suspended agents, which are tested for release alone, each statistic has its own limit.
        alarms = rates <= self.false_alarms_per_hour / max(rates.size, 1)
        alarms[vote] = discoveries(rates[vote], self.false_alarms_per_hour)
        alarms[vote & ~verdict.lying] = False
        self._of.lying[rows] = verdict.lying
        self._wait_for_faults(batch, evidence.boxes, means, rows, alarms, dt)
        self._update_suspensions(batch, rows, alarms, dt)
        judged, weights = self._existence.settle(evidence, explanations)
        return Assessment(weights, self._agent_trust(batch, rows, rates, verdict), judged)

    def _meet(self, batch: Batch) -> Ints:
        """Rows (a,) of the agents of a batch; new ones have no record."""
        rows = self._agents.meet(batch.time_ns, batch.agents)
        self._pairs = self._agents.carry(self._agents.carry(self._pairs, 0.0), 0.0, axis=1)
        self._apart_ns = self._agents.carry(self._agents.carry(self._apart_ns, 0), 0, axis=1)
        new = rows[self._of.number[rows] < 0]
        self._of.number[new] = self._next_number + np.arange(len(new))
        self._next_number += len(new)
        if len(self._reasons) > len(self._agents.names):
            self._reasons = {name: self._reasons[name] for name in self._agents.names if name in self._reasons}
        return rows

    def _evidence_factor(self, rows: Ints) -> float:
        """How many times as much evidence an alarm takes as is expected: by what is usual among the agents now.

        The middle of those that are not suspended, of two the lower one: half of them cannot raise it.
        """
        usual = np.sort(self._of.usual[rows[~self._of.suspended[rows]]])
        return min(max(usual[(len(usual) - 1) // 2] / EXPECTED, 1.0), MOST_EVIDENCE) if len(usual) else 1.0

    def _deviation_alarm(self, agents: int) -> float:
        """The value from which the deviation of one agent alone is an alarm."""
        return self._tails[DEVIATION].alarm_at(self.false_alarms_per_hour / max(len(self._tails) * agents, 1))

    def _median_weights(self, rows: Ints) -> Floats:
        """(a,) weight of each agent in the middle of its objects: less, the nearer its deviation is to an alarm.

        Of two liars and one honest agent that report an object, the liars thus have no majority once they are off
        elsewhere, where others see the object, too.
        """
        weight = np.clip(1.0 - self._of.deviation[rows] / self._deviation_alarm(len(rows)), MIN_MEDIAN_WEIGHT, 1.0)
        return np.asarray(np.where(self._of.suspended[rows], 0.0, weight))

    def _note_deviations(self, batch: Batch, boxes: ClusterBoxes, objects: Ints) -> Means:
        """The means of the deviations of a batch; notes the greatest of each agent, and who reports an object apart.

        objects: (c,) numbers of the clusters' objects
        """
        rows = self._agents.rows
        measured = deviations(batch, boxes, self._median_weights(rows))
        numbers, believed = self._of.number[rows], ~self._of.suspended[rows]
        means = self._lasting.update(batch.time_ns, numbers, objects, measured, believed)
        statistics, tracks = means.of_agents(len(rows))
        greatest = np.zeros((len(rows), len(NAMES)))
        np.maximum.at(greatest, means.agent, means.length)
        self._deviating, self._of.deviation[rows] = greatest.argmax(axis=1), statistics
        self._of_apart = np.zeros(len(rows))
        # Of agents that are off alone: liars can move the middle from an honest one, but not another one's tracks.
        off = tracks & (statistics >= self._deviation_alarm(len(rows)))[means.agent]
        if off.any():
            one, other, difference = means.apart(off)
            np.maximum.at(self._of_apart, one, difference)
            apart = self._tails[DEVIATION].rate(difference) <= self.false_alarms_per_hour
            one, other = rows[one[apart]], rows[other[apart]]
            self._apart_ns[one, other] = self._apart_ns[other, one] = batch.time_ns
        return means

    def _summed(self, total: Floats, count: Floats | Ints, tail: Tail, dt: float, factor: float) -> Floats:
        """Cumulative sums after a batch with `count` contradictions.

        An honest agent errs about one object at a time: several at once are much rarer. factor: see `_evidence_factor`
        """
        after = accumulate(total, np.asarray(0.5 * count * (count + 1), np.float64), self.allowance, dt)
        return np.minimum(after, MAX_SUM * factor * tail.alarm_at(self.false_alarms_per_hour / 10.0))

    def _add_disputes(self, testimonies: Testimonies, honest: Bools, dt: float) -> None:
        """Add what a batch shows to all sums; those of absent agents and pairs fall as without evidence.

        honest: (a,) agents that are known to be
        """
        of, rows = self._of, self._agents.rows
        kinds = testimonies.accusations(np.where(of.lying[rows], 0.0, np.where(honest, 1.0, WORD)))
        counted = self._existence.counted(testimonies.contradicted, dt)
        counted |= of.suspended[rows]  # one that goes on with the same lies is not released
        kinds *= counted
        counts = np.zeros((2, len(of.own)))
        counts[:, rows] = kinds.max(axis=0).sum(axis=0), kinds[OF_ITSELF].max(axis=0).sum(axis=0)
        between = np.zeros(self._pairs.shape, np.int64)
        between[np.ix_(rows, rows)] = testimonies.between(counted)
        # At first the mean of what there was, so that it is right soon.
        step = 1.0 - np.exp(-dt / np.clip(of.seen_s[rows], USUAL_FROM_S, USUAL_S))
        of.usual[rows] += step * (counts[0, rows] - of.usual[rows])
        factor = self._evidence_factor(rows)
        of.contradictions = self._summed(of.contradictions, counts[0], self._tails[CONTRADICTIONS], dt, factor)
        of.own = self._summed(of.own, counts[1], OWN_TAIL, dt, factor)
        self._pairs = self._summed(self._pairs, between, self._pair_tail, dt, factor)
        of.kinds[rows] += dt * kinds.sum(axis=1).T

    def _explain(self, batch: Batch, rows: Ints, honest: Bools, factor: float) -> tuple[Explanations, Verdict]:
        """The explanations of the disputes of the agents of a batch, and what they say of each.

        honest: (a,) agents that are known to be; factor: see `_evidence_factor`
        """
        pairs, apart_ns = self._pairs[np.ix_(rows, rows)] / factor, self._apart_ns[np.ix_(rows, rows)]
        apart = (apart_ns > 0) & (batch.time_ns - apart_ns <= APART_S * 1e9)
        disputes = self._disputes = (self._pair_tail.rate(pairs) <= self.disputes_per_hour) | apart
        lying = OWN_TAIL.rate(self._of.own[rows] / factor) <= self.false_alarms_per_hour / max(len(rows), 1)
        lying |= self._of.suspended[rows]
        key = disputes.tobytes() + lying.tobytes() + honest.tobytes()
        # Which disputes are left out depends on how strong they are now.
        if self._settled is None or self._settled[0] != key or not self._settled[1].whole:
            rarity = -np.log(self._pair_tail.rate(pairs))
            strength = np.maximum(rarity, np.where(apart, -np.log(self.false_alarms_per_hour), -np.inf))
            explanations = explained(disputes, strength, lying, honest)
            self._settled = key, explanations, explanations.verdict()
        return self._settled[1], self._settled[2]

    def _wait_for_faults(
        self, batch: Batch, boxes: ClusterBoxes, means: Means, rows: Ints, alarms: Bools, dt: float
    ) -> None:
        """Take back the alarms of agents that may have a fault, for a while: it excuses them once it is found."""
        if self._awaited is None:
            return
        before = self._of.awaited_s[rows]
        awaited = np.array([name in self._awaited for name in batch.agents], np.bool_) & (before < FAULT_AWAITED_S)
        for row in np.flatnonzero(alarms[:, DEVIATION] & ~alarms[:, CONTRADICTIONS]).tolist():
            if not awaited[row] and before[row] < EXPLAINED_S:
                awaited[row] = self._is_explained(row, boxes, means)
        waiting = alarms.any(axis=1) & awaited
        self._of.awaited_s[rows] = np.where(waiting, before + dt, np.maximum(before - AWAITED_AGAIN * dt, 0.0))
        alarms[waiting] = False

    def _is_explained(self, row: int, boxes: ClusterBoxes, means: Means) -> bool:
        """Whether a fault of an agent may explain that its positions deviate."""
        most = int(self._deviating[row])
        if QUANTITY[most] != POSITION:
            return False
        arm = boxes.position[:, :2] - boxes.position[:, :2].mean(axis=0)
        return means.left_by_fault(row, most, displacements(arm, boxes.velocity[:, :2])) <= UNEXPLAINED

    def _update_suspensions(self, batch: Batch, rows: Ints, alarms: Bools, dt: float) -> None:
        """Suspend and release agents. alarms: (a, 2) of the statistics"""
        of = self._of
        of.seen_s[rows] += dt
        alarmed = alarms.any(axis=1)
        evidence = of.contradictions[rows] > 0.0
        of.kinds[rows[~evidence]] = 0.0
        of.quiet_ns[rows] = np.where(evidence, of.quiet_ns[rows], batch.time_ns)
        of.clean_s[rows] = np.where(alarmed | evidence, 0.0, of.clean_s[rows] + dt)
        patience = self.release_s * 2.0 ** np.maximum(of.suspensions[rows] - 1, 0)
        released = of.suspended[rows] & (of.clean_s[rows] >= patience)
        new = alarmed & ~of.suspended[rows]
        if new.any():
            # The worst first: the others may only look bad because it has moved the middle of their objects.
            excess = (self._statistics / [tail.scale for tail in self._tails]).sum(axis=1)
            worst = int(np.argmax(np.where(new, excess, -1.0)))
            new = np.arange(len(new)) == worst
            self._lasting.forget_all()
            of.deviation[:] = 0.0
            self._existence.keep_known(self._honest_until(rows[worst], bool(alarms[worst, CONTRADICTIONS])))
            self._reasons[batch.agents[worst]] = self._reason(worst, alarms[worst])
        of.suspensions[rows] += new
        of.suspended[rows] = (of.suspended[rows] | new) & ~released
        of.suspended_ns[rows[new]] = batch.time_ns
        of.for_deviation[rows[new]] = ~alarms[new, CONTRADICTIONS]
        elsewhere = alarms[:, CONTRADICTIONS] | (alarms[:, DEVIATION] & (QUANTITY[self._deviating] == POSITION))
        of.misdescribes[rows] = (of.misdescribes[rows] | new) & ~elsewhere
        for row in np.flatnonzero(released).tolist():
            self._reasons.pop(batch.agents[row], None)

    def _honest_until(self, row: int, lied: bool) -> int:
        """Time, ns, until which there was no evidence against an agent that is suspended now."""
        assert self._time_ns is not None
        if lied:
            return int(self._of.quiet_ns[row]) - round(GRACE_S * 1e9)
        return self._time_ns - round(DEVIATED_S * 1e9)

    def _reason(self, row: int, alarms: Bools) -> str:
        """Why an agent is suspended."""
        contradictions, deviation = self._statistics[row]
        if alarms[CONTRADICTIONS]:
            most = ACCUSATIONS[int(self._of.kinds[self._agents.rows[row]].argmax())]
            return f"{most}, {contradictions:.1f} object-seconds"
        reason = REASONS[NAMES[self._deviating[row]]]
        return f"{reason} ({deviation:.0f} times as much as usual)"

    def _agent_trust(self, batch: Batch, rows: Ints, rates: Floats, verdict: Verdict) -> AgentTrust:
        """The trust in the agents; the reason of those whose honesty is open names those they disagree with."""
        suspended = self._of.suspended[rows]
        least = np.log(np.maximum(rates, 1e-300) / self.false_alarms_per_hour).min(axis=1)
        log_odds = np.clip(least, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        log_odds = np.where(suspended, np.minimum(log_odds, -1.0), log_odds)
        log_odds = np.where(suspended | verdict.lying, log_odds, np.maximum(log_odds, 0.0))
        undecided = verdict.undecided & ~suspended
        log_odds = np.where(undecided, np.minimum(log_odds, 0.0), log_odds)  # nobody of a dispute looks better
        state = np.where(self._of.seen_s[rows] >= 1.0, TRUSTED, UNKNOWN)
        state = np.where(suspended, SUSPENDED, np.where(undecided, UNDECIDED, state)).astype(np.uint8)
        reasons = tuple(
            self._reasons.get(name, "") if suspended[row] else self._open_dispute(batch, row) if undecided[row] else ""
            for row, name in enumerate(batch.agents)
        )
        return AgentTrust.of(1.0 / (1.0 + np.exp(-log_odds)), state, reasons, log_odds=log_odds)

    def _open_dispute(self, batch: Batch, row: int) -> str:
        """Why it is open whether an agent lies."""
        others = [batch.agents[other] for other in np.flatnonzero(self._disputes[row]).tolist()]
        if not others:
            return "may be lying"
        listed = ", ".join(others[:-1]) + " and " * (len(others) > 1) + others[-1]
        return f"either it lies, or {listed} {'does' if len(others) == 1 else 'do'}"
