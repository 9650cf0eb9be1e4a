"""Joint estimation of which agents are honest and which objects exist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.alarms import EXCUSED_S, MAX_STEP_S, SAMPLES_PER_S
from mast_zenoh.integrity.base import (
    SUSPENDED,
    TRUSTED,
    UNKNOWN,
    AgentTrust,
    Assessment,
    Batch,
    ClusterBoxes,
    Integrity,
    ObjectTrust,
)
from mast_zenoh.integrity.disputes import conspicuous
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.visibility import RayEvidence, Sightings, current, lenient_sightings, rays_at

#: Steps of the iteration in each batch; agents' log-odds change little between batches.
STEPS = 3
#: Share of the weight of a denial that silence about a clearly visible object has.
SILENCE = 0.3
#: Log-odds of an agent are limited to this: nobody becomes so trusted that its lies are free.
MAX_LOG_ODDS = 6.0


@dataclass(kw_only=True, eq=False)
class TruthDiscovery(Integrity):
    """Estimates jointly how reliable agents are and which objects exist, by expectation-maximisation.

    After Wang, Kaplan, Abdelzaher: On truth discovery in social sensing (IPSN 2012). In each batch, the log-odds that
    an object exists are the sum over its viewers: an agent that reports it adds its own log-odds of being honest, one
    that sees through its place subtracts them. In turn, each claim that the other viewers confirm or refute counts for
    or against its agent, by the ratio of the rates at which liars and honest agents make false claims. A sole witness
    thus inherits its agent's trust, and a dispute between two equally trusted agents is open and counts against
    neither.

    anchors: names of agents that are trusted always: the command centre's own sensors
    prior: log-odds that a new agent is honest
    honest_rate, liar_rate: share of false claims of an honest agent, and of a liar
    memory_s: s, over which evidence about agents is forgotten
    suspend_at: log-odds below which an agent is suspended; it is trusted again above 0

    Weaknesses: offsets below the clusterer's radius are not noticed; liars that outnumber the honest viewers of many
    objects are believed; a liar whose claims are nearly all true stays trusted.
    """

    anchors: tuple[str, ...] = ()
    prior: float = 3.0
    honest_rate: float = 0.005
    liar_rate: float = 0.05
    memory_s: float = 60.0
    suspend_at: float = -4.6

    def __post_init__(self) -> None:
        if not 0.0 < self.honest_rate < self.liar_rate < 1.0:
            raise ValueError(
                f"honest_rate, liar_rate: found {self.honest_rate}, {self.liar_rate}, expected 0 < first < second < 1"
            )
        check("more than 0", memory_s=self.memory_s)
        self._gain = np.log((1.0 - self.honest_rate) / (1.0 - self.liar_rate))
        self._loss = np.log(self.liar_rate / self.honest_rate)
        self.reset()

    def reset(self) -> None:
        # suspended_ns: time, ns, of the last suspension
        self._agents = AgentMemory(forget_s=600.0, log_odds=float(self.prior), suspended=False, suspended_ns=0)
        self._of = self._agents.of
        self._time_ns: int | None = None

    def excuse(self, agent: str) -> None:
        if agent in self._agents.names:
            row = self._agents.names.index(agent)
            assert self._time_ns is not None
            if not self._of.suspended[row] or self._time_ns - self._of.suspended_ns[row] <= EXCUSED_S * 1e9:
                self._of.log_odds[row], self._of.suspended[row] = self.prior, False

    def assess(self, batch: Batch) -> Assessment:
        dt = 0.0 if self._time_ns is None else min((batch.time_ns - self._time_ns) * 1e-9, MAX_STEP_S)
        self._time_ns = batch.time_ns
        rows = self._agents.meet(batch.time_ns, batch.agents)
        anchored = np.isin(np.array(batch.agents), self.anchors)
        boxes = ClusterBoxes.of(batch)
        seen, own = lenient_sightings(batch, boxes)
        claims = votes(batch.reported, own, boxes.size, seen, rays_at(batch, boxes, current(batch.views)))
        before = self.prior + (self._of.log_odds[rows] - self.prior) * np.exp(-dt / self.memory_s)
        before[anchored] = MAX_LOG_ODDS
        log_odds = before
        for _ in range(STEPS):
            exists, evidence = believed(claims, log_odds)
            right, wrong = outcomes(claims, evidence)
            wrong += (batch.reported & (claims < 0.0) & (exists < 0.0)[:, None]).sum(axis=0)
            change = dt * SAMPLES_PER_S * (self._gain * right - self._loss * wrong)
            log_odds = np.where(anchored, MAX_LOG_ODDS, np.clip(before + change, -MAX_LOG_ODDS, MAX_LOG_ODDS))
        self._of.log_odds[rows] = log_odds
        low = log_odds < self.suspend_at
        self._of.suspended_ns[rows[low & ~self._of.suspended[rows]]] = batch.time_ns
        self._of.suspended[rows] = low | (self._of.suspended[rows] & (log_odds < 0.0))
        return self._assessment(batch, rows, exists, claims, seen)

    def _assessment(self, batch: Batch, rows: Ints, exists: Floats, claims: Floats, seen: Sightings) -> Assessment:
        log_odds, suspended = self._of.log_odds[rows], self._of.suspended[rows]
        trusted = np.where(log_odds >= 0.5 * self.prior, TRUSTED, UNKNOWN)
        state = np.where(suspended, SUSPENDED, trusted).astype(np.uint8)
        reasons = tuple("its claims are refuted more often than an honest agent's" if s else "" for s in suspended)
        agents = AgentTrust.of(1.0 / (1.0 + np.exp(-log_odds)), state, reasons, log_odds=log_odds)
        believable = batch.reported & (claims > 0.0) & ~suspended
        withheld = (exists < 0.0) | ~believable.any(axis=1)
        objects = ObjectTrust(
            1.0 / (1.0 + np.exp(-np.clip(exists, -50.0, 50.0))),
            (seen.in_view | batch.reported).sum(axis=1),
            believable.sum(axis=1),
            (claims <= -1.0).sum(axis=1),
            withheld,
        )
        return Assessment(batch.weights(believable), agents, objects)


def votes(reported: Bools, own: Bools, size: Floats, seen: Sightings, rays: RayEvidence) -> Floats:
    """(c, a) how each agent votes on each object: 1 reports it, -1 sees through it, -SILENCE says nothing, 0 no view.

    A claim that the agent's own sensor sees through is a vote against itself. Silence is a vote where the agent's rays
    end, so that phantoms do not turn it against those that see nothing.
    """
    silent = ~reported & rays.ends & ~rays.mostly_clear & seen.in_view & conspicuous(size, seen.distance)
    vote = np.where(reported, 1.0, np.where(silent, -SILENCE, 0.0))
    vote[np.where(reported, own, seen.fully_clear)] = -1.0
    return vote


def believed(claims: Floats, log_odds: Floats) -> tuple[Floats, Floats]:
    """(c,) log-odds that each object exists, and (c, a) those without the vote of each agent.

    claims: (c, a) votes; log_odds: (a,) that each agent is honest; the votes of likely liars count nothing
    """
    contribution = claims * np.maximum(log_odds, 0.0)
    total = contribution.sum(axis=1)
    return total, total[:, None] - contribution


def outcomes(claims: Floats, evidence: Floats) -> tuple[Floats, Floats]:
    """(a,) expected numbers of right and of wrong votes of each agent.

    evidence: (c, a) log-odds that the object exists by the votes of the others. Where the others know nothing, a vote
    is neither.
    """
    certainty = np.tanh(0.5 * evidence)  # from -1, refuted by the others, to 1, confirmed by them
    agreement = np.sign(claims) * certainty
    weight = np.abs(claims)
    return (weight * np.maximum(agreement, 0.0)).sum(axis=0), (weight * np.maximum(-agreement, 0.0)).sum(axis=0)
