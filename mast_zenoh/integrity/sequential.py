"""Sequential tests of each agent against what the others report and see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import (
    SUSPENDED,
    TRUSTED,
    UNKNOWN,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    Integrity,
)
from mast_zenoh.integrity.calibration import EXCUSED_S, MAX_STEP_S, Tail, accumulate, discoveries
from mast_zenoh.integrity.disputes import disputes
from mast_zenoh.integrity.memory import NOW, AgentMemory
from mast_zenoh.integrity.offsets import OffsetSums, offsets
from mast_zenoh.integrity.visibility import current, lenient_sightings, rays_at
from mast_zenoh.integrity.voting import ExistenceVotes

#: Names of agents that are remembered at most.
MAX_NAMES = 1024
#: s, before the first evidence against an agent, in which it may have lied unnoticed.
GRACE_S = 1.0
#: Least weight of an agent that is not suspended in the middle of its objects.
MIN_MEDIAN_WEIGHT = 0.05
#: Log-odds are limited to this, either way.
MAX_LOG_ODDS = 20.0

#: Tails of both statistics on unattacked junctions, see docs/defences.md.
CONTRADICTION_TAIL = Tail(per_hour=84.0, scale=0.25)
OFFSET_TAIL = Tail(per_hour=4800.0, scale=4.4)
#: Of all agents together; a tenth of what is acceptable, because the tails are extrapolated.
FALSE_ALARMS_PER_HOUR = 0.1


@dataclass(kw_only=True, eq=False)
class SequentialConsistency(Integrity):
    """Suspends agents whose claims the others contradict for too long, or whose positions are off.

    Two statistics for each agent: the cumulative sum (Page 1954) of contradictions in progress: objects that the
    majority of their viewers sees through, that the agent does not report although it clearly sees their place, that
    it claims to see through, or that its own sensor contradicts; and the greatest whitened offset of one of its tracks
    from the median of the agents, summed over `offset_memory_s`. Each counts as an alarm by how rarely an honest agent
    exceeds it, with the false discoveries among all agents controlled (Benjamini and Hochberg 1995).

    Which objects are withheld is decided by `ExistenceVotes`, in which a suspended agent has no vote.

    false_alarms_per_hour: of all agents together
    allowance: contradictions that are subtracted per second, so that an honest agent's sum stays near 0
    offset_memory_s: s, over which offsets are summed
    release_s: s without evidence after which a suspended agent is trusted again, at first; doubled each time
    contradiction_tail, offset_tail: (per hour, scale) of the statistics of an honest agent

    An agent's log-odds are the logarithm of how often an honest agent would look worse, relative to the permitted rate.

    Weaknesses: a lie that no other agent could notice, and liars that outnumber the honest viewers of an object, are
    believed; pedestrians may be moved by half a metre. Suspending an agent costs the objects that it alone reports and
    that were not known before.
    Needs views for all but the offsets. A dispute between two agents without a third counts against neither.
    """

    false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR
    allowance: float = 0.25
    offset_memory_s: float = 5.0
    release_s: float = 30.0
    contradiction_tail: tuple[float, float] = (CONTRADICTION_TAIL.per_hour, CONTRADICTION_TAIL.scale)
    offset_tail: tuple[float, float] = (OFFSET_TAIL.per_hour, OFFSET_TAIL.scale)

    def __post_init__(self) -> None:
        check(
            "more than 0",
            false_alarms_per_hour=self.false_alarms_per_hour,
            offset_memory_s=self.offset_memory_s,
            release_s=self.release_s,
        )
        self._tails = (Tail(*self.contradiction_tail), Tail(*self.offset_tail))
        self._sums = OffsetSums(self.offset_memory_s)
        self.reset()

    def reset(self) -> None:
        # clean_s: since the last alarm or evidence;  seen_s: for which the agent has been observed
        # suspended_ns: time, ns, of the last suspension;  for_offset: whether that was for an offset alone
        # quiet_ns: time, ns, of the last batch without evidence
        numbers = dict.fromkeys(("contradictions", "clean_s", "offset", "seen_s"), 0.0)
        flags = dict(suspended=False, for_offset=False)
        self._agents = AgentMemory(forget_s=600.0, suspensions=0, suspended_ns=0, quiet_ns=NOW, **numbers, **flags)
        self._of = self._agents.of
        self._existence = ExistenceVotes(self._agents)
        self._numbers: dict[str, int] = {}
        self._sums.reset()
        self._time_ns: int | None = None
        self._last = np.zeros(0), np.zeros(0)
        self._reasons: dict[str, str] = {}

    @property
    def calibrated(self) -> dict[str, Floats]:
        """By name, (k,) statistics of the last batch that have a tail, see `tools/calibrate_integrity.py`."""
        return dict(zip(("contradictions", "offset"), self._last, strict=True))

    def excuse(self, agent: str) -> None:
        if agent in self._agents.names:
            row = self._agents.names.index(agent)
            self._sums.forget(self._numbers[agent])
            assert self._time_ns is not None
            recent = self._time_ns - self._of.suspended_ns[row] <= EXCUSED_S * 1e9
            if self._of.suspended[row] and (recent or self._of.for_offset[row]):
                self._of.contradictions[row], self._of.suspended[row] = 0.0, False
                self._reasons.pop(agent, None)

    def assess(self, batch: Batch) -> Assessment:
        dt = 0.0 if self._time_ns is None else min((batch.time_ns - self._time_ns) * 1e-9, MAX_STEP_S)
        self._time_ns = batch.time_ns
        rows = self._meet(batch)
        vote = ~self._of.suspended[rows]
        boxes = ClusterBoxes.of(batch, np.broadcast_to(vote, (batch.clusters, len(vote))))
        seen, own = lenient_sightings(batch, boxes)
        rays = rays_at(batch, boxes, current(batch.views))
        dispute = disputes(batch, boxes, own, seen, rays, vote.astype(np.float64))
        accusations = dispute.accusations
        numbers = np.array([self._numbers[name] for name in batch.agents], np.int64)
        objects = self._existence.follow(batch.time_ns, boxes)
        offset = self._sums.statistics(
            batch.time_ns, numbers, objects, offsets(batch, boxes, self._median_weights(rows))
        )
        count = np.logical_or.reduce(tuple(accusations.values())).sum(axis=0)
        # An honest agent errs about one object at a time: several at once are much rarer.
        total = accumulate(self._of.contradictions[rows], 0.5 * count * (count + 1), self.allowance, dt)
        # Limited, so that it can be forgotten again.
        self._of.contradictions[rows] = np.minimum(total, 2.0 * self._alarm_at(0, len(rows)))
        self._last = self._of.contradictions[rows].copy(), offset
        self._of.offset[rows] = offset
        rates = np.stack([tail.rate(value) for tail, value in zip(self._tails, self._last, strict=True)], axis=1)
        alarms = rates <= self.false_alarms_per_hour / max(
            rates.size, 1
        )  # of suspended agents, which are tested for release alone
        alarms[vote] = discoveries(rates[vote], self.false_alarms_per_hour)
        self._update_suspensions(batch, rows, alarms, accusations, dt)
        judged, weights = self._existence.count(batch, boxes, seen, rays, dispute.impossible, ~self._of.suspended, rows)
        return Assessment(weights, self._agent_trust(batch, rows, rates), judged)

    def _alarm_at(self, statistic: int, agents: int) -> float:
        """The value from which one statistic alone, 0 contradictions or 1 offset, is an alarm."""
        tail = self._tails[statistic]
        return max(tail.value_at(self.false_alarms_per_hour / max(2 * agents, 1)), tail.scale)

    def _median_weights(self, rows: Ints) -> Floats:
        """(a,) weight of each agent in the middle of its objects: the less, the nearer its own offset is to an alarm.

        Of two liars and one honest agent that report an object, the liars thus have no majority once they are off
        elsewhere, where others see the object, too.
        """
        weight = np.clip(1.0 - self._of.offset[rows] / self._alarm_at(1, len(rows)), MIN_MEDIAN_WEIGHT, 1.0)
        return np.asarray(np.where(self._of.suspended[rows], 0.0, weight))

    def _meet(self, batch: Batch) -> Ints:
        """Rows (a,) of the agents of a batch; new ones have no record."""
        rows = self._agents.meet(batch.time_ns, batch.agents)
        if len(self._numbers) > MAX_NAMES:
            self._numbers, self._reasons = {}, {}
            self._sums.reset()
        for name in batch.agents:
            self._numbers.setdefault(name, len(self._numbers))
        return rows

    def _update_suspensions(
        self, batch: Batch, rows: Ints, alarms: Bools, accusations: Mapping[str, Bools], dt: float
    ) -> None:
        """Suspend and release agents. accusations: (c, a) what counts against an agent, by its description"""
        self._of.seen_s[rows] += dt
        alarmed = alarms.any(axis=1)
        self._of.quiet_ns[rows] = np.where(self._last[0] > 0.0, self._of.quiet_ns[rows], batch.time_ns)
        self._of.clean_s[rows] = np.where(alarmed | (self._last[0] > 0.0), 0.0, self._of.clean_s[rows] + dt)
        patience = self.release_s * 2.0 ** np.maximum(self._of.suspensions[rows] - 1, 0)
        released = self._of.suspended[rows] & (self._of.clean_s[rows] >= patience)
        new = alarmed & ~self._of.suspended[rows]
        if new.any():
            # The worst first: the others may only look bad because it has moved the middle of their objects.
            worst = np.argmax(
                np.where(new, self._last[0] / self._tails[0].scale + self._last[1] / self._tails[1].scale, -1.0)
            )
            new = np.arange(len(new)) == worst
            self._sums.reset()
        for row in np.flatnonzero(new).tolist():
            self._existence.keep_known(self._honest_until(rows[row], bool(alarms[row, 0])))
        self._of.suspensions[rows] += new
        self._of.suspended[rows] = (self._of.suspended[rows] | new) & ~released
        self._of.suspended_ns[rows[new]] = batch.time_ns
        self._of.for_offset[rows[new]] = ~alarms[new, 0]
        for row in np.flatnonzero(released).tolist():
            self._reasons.pop(batch.agents[row], None)
        for row in np.flatnonzero(new).tolist():
            self._reasons[batch.agents[row]] = self._reason(row, alarms[row], accusations)

    def _honest_until(self, row: int, lied: bool) -> int:
        """Time, ns, until which there was no evidence against an agent that is suspended now."""
        assert self._time_ns is not None
        if lied:
            return int(self._of.quiet_ns[row]) - round(GRACE_S * 1e9)
        return self._time_ns - round(2.0 * self.offset_memory_s * 1e9)

    def _reason(self, row: int, alarms: Bools, accusations: Mapping[str, Bools]) -> str:
        """Why an agent is suspended."""
        if not alarms[0]:
            return f"reports a position that differs from the other agents' (offset statistic {self._last[1][row]:.0f})"
        most = max(accusations, key=lambda kind: int(accusations[kind][:, row].sum()))
        return f"{most}, {self._last[0][row]:.1f} object-seconds"

    def _agent_trust(self, batch: Batch, rows: Ints, rates: Floats) -> AgentTrust:
        suspended = self._of.suspended[rows]
        least = np.log(np.maximum(rates, 1e-300) / self.false_alarms_per_hour).min(axis=1)
        log_odds = np.clip(least, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        log_odds = np.where(suspended, np.minimum(log_odds, -1.0), log_odds)
        state = np.where(suspended, SUSPENDED, np.where(self._of.seen_s[rows] >= 1.0, TRUSTED, UNKNOWN))
        named = zip(batch.agents, suspended.tolist(), strict=True)
        reasons = tuple(self._reasons.get(name, "") if bad else "" for name, bad in named)
        return AgentTrust.of(1.0 / (1.0 + np.exp(-log_odds)), state.astype(np.uint8), reasons, log_odds=log_odds)
