"""Tells a faulty agent from a liar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.integrity.base import FAULTY, SUSPENDED, Assessment, Batch, Integrity
from mast_zenoh.integrity.cumulative import MAX_STEP_S, SAMPLES_PER_S
from mast_zenoh.integrity.fault_fit import (
    PRIOR,
    Displacements,
    corrected,
    displacements,
    explained,
    misfit,
    normal_equations,
)
from mast_zenoh.integrity.sequential import MAX_NAMES, SequentialConsistency
from mast_zenoh.integrity.views import SweptView

#: Batches in which every agent is fitted once, and log-odds below which one is fitted in each: consecutive offsets of
#: honest agents correlate at 0.8, so that most batches show nothing new.
ROUND, SUSPECT = 5, 2.0
#: Mean of Huber's loss of a displacement up to which a fit is good.
FIT = 1.2
#: Difference of the sums of Huber's loss from which a batch shows another fault than those before.
CHANGED = 5.0
#: Sums of no batches.
NOTHING = np.zeros((4, 4)), np.zeros(4)
#: m, m/s: a track by which turns and delays are compared with displacements.
ARM_M, SPEED_MPS = 30.0, 10.0
#: ns, between two faults that excuse what an agent did before they were found.
FORGIVE_NS = 60_000_000_000


@dataclass(slots=True)
class _Estimate:
    """Sums and fault of one agent.

    fault: x m, y m, turn rad, delay s, as applied; statistic: twice the log-likelihood that it gains
    time_ns: ns, of the last fit, or of the first batch
    """

    time_ns: int
    information: Floats = field(default_factory=lambda: np.zeros((4, 4)))
    score: Floats = field(default_factory=lambda: np.zeros(4))
    fault: Floats = field(default_factory=lambda: np.zeros(4))
    statistic: float = 0.0
    applied: bool = False
    forgiven_until_ns: int = 0
    loss: float = 0.0


class FaultOrLie(Integrity):
    """Corrects what a pose error or a wrong clock explains, and leaves the rest to another stage.

    A fault moves all tracks of an agent alike: it is fitted as a displacement, a turn and a time offset of the whole
    agent to all its tracks that other agents report, too. Where the fit is significant and explains most of them, the
    agent is faulty: its tracks and its view are corrected, and it keeps its vote. A lie concerns some of its tracks:
    what remains after the correction is evidence for `stage`, as without a fault.

    stage: judges the corrected tracks; None: SequentialConsistency()
    significance: gain in twice the log-likelihood from which a fault is corrected; 30 is exceeded by 5 in a million of
        a chi-square distribution with four degrees
    least_m: m, displacement below which nothing is corrected
    share: of the tracks that the fit must explain
    memory_s: s, over which displacements are summed

    Weaknesses: an agent that moves all its tracks alike on purpose is corrected, not suspended, which does no harm;
    two agents that nobody else sees are left as they are; errors beyond GATE_M are not found.
    """

    def __init__(
        self,
        *,
        stage: Integrity | None = None,
        significance: float = 30.0,
        least_m: float = 0.3,
        share: float = 0.7,
        memory_s: float = 1.5,
    ) -> None:
        if not memory_s > 0.0:
            raise ValueError(f"memory_s: found {memory_s}, expected more than 0")
        self._stage = stage or SequentialConsistency()
        self._significance = significance
        self._least_m = least_m
        self._share = share
        self._memory_s = memory_s
        self.reset()

    def reset(self) -> None:
        self._stage.reset()
        self._estimates: dict[str, _Estimate] = {}
        self._suspects: set[str] = set()  # agents that are fitted in every batch
        self._suspended: set[str] = set()  # agents whose tracks are no reference for others

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        states, views = self._stage.correct(time_ns, states, agent, agents, views)
        result, seen = states, dict(views)
        suspended = [row for row, name in enumerate(agents) if name in self._suspended]
        due = self._due(time_ns, agents)
        for number, name in enumerate(agents):
            estimate = self._estimates[name]
            self._note_loss(estimate, views.get(name))
            if not (name in due or estimate.applied):
                continue
            mine = agent == number
            pivot = self._pivot(states.select(mine), views.get(name))
            if name in due and mine.any():
                self._fit(name, time_ns, states, agent, number, pivot, suspended)
            if estimate.applied:
                result = corrected(result, mine, estimate.fault, pivot)
                if name in seen:
                    seen[name] = corrected_view(seen[name], estimate.fault)
        if len(self._estimates) > MAX_NAMES:
            self._estimates = {name: self._estimates[name] for name in agents}
        return result, seen

    def _due(self, time_ns: int, agents: tuple[str, ...]) -> set[str]:
        """The agents that are fitted in a batch: those whose last fit is the longest ago, and suspects."""
        for name in agents:
            self._estimates.setdefault(name, _Estimate(time_ns))
        oldest = sorted(agents, key=lambda name: self._estimates[name].time_ns)
        return {*oldest[: -(-len(agents) // ROUND)], *self._suspects.intersection(agents)}

    def _pivot(self, own: ObjectStates, view: SweptView | None) -> Floats:
        """(2,) m: the agent's sensor, else the middle of its tracks."""
        if view is not None:
            return np.asarray(view.view.position[:2])
        return own.position[:, :2].mean(axis=0) if len(own) else np.zeros(2)

    def _fit(
        self,
        name: str,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        number: int,
        pivot: Floats,
        suspended: list[int],
    ) -> None:
        """Update the estimate of an agent from a batch; suspended: numbers of agents that are no reference."""
        estimate = self._estimates[name]
        own = canonical(states.select(agent == number))
        others = (agent != number) & ~np.isin(agent, suspended)
        other, other_agent = states.select(others), agent[others]
        order = np.lexsort((other.id, other_agent))
        found = displacements(own, other.select(order), other_agent[order], pivot, estimate.fault * estimate.applied)
        elapsed_s = (time_ns - estimate.time_ns) * 1e-9
        samples = SAMPLES_PER_S * min(elapsed_s, MAX_STEP_S)
        keep = np.exp(-elapsed_s / self._memory_s)
        estimate.time_ns = time_ns
        past = keep * estimate.information, keep * estimate.score
        known = estimate.fault * estimate.applied
        fault, total = _solved(found, samples, past, estimate.fault, known)
        if found.others and misfit(found, fault) > FIT * len(found.offset):
            # What was known does not explain this batch. It may be a new fault: fitted to this batch alone.
            anew, sums = _solved(found, samples, NOTHING, None, np.zeros(4), steps=3)
            if misfit(found, anew) < misfit(found, fault) - CHANGED:
                fault, total = anew, sums
        estimate.fault, (estimate.information, estimate.score) = fault, total
        estimate.statistic = float(estimate.score @ fault)
        significant = estimate.statistic >= self._significance and found.others >= 2
        large = size_m(fault) >= self._least_m
        common = explained(found, fault) >= self._share
        # Once corrected, an agent stays so until nothing is left to correct.
        applied = bool(large and ((significant and common) or estimate.applied))
        if applied and not estimate.applied and time_ns >= estimate.forgiven_until_ns:
            self._stage.forgive(name)
            estimate.forgiven_until_ns = time_ns + FORGIVE_NS
        estimate.applied = applied

    def _note_loss(self, estimate: _Estimate, view: SweptView | None) -> None:
        """Update the share of frames in which nothing of the agent arrived."""
        if view is not None:
            estimate.loss += 0.02 * (float(view.age_s > 0.0) - estimate.loss)

    def assess(self, batch: Batch) -> Assessment:
        assessment = self._stage.assess(batch)
        estimates = [self._estimates.get(name, _Estimate(batch.time_ns)) for name in batch.agents]
        trust = assessment.agents
        self._suspects = {name for name, odds in zip(batch.agents, trust.log_odds, strict=True) if odds < SUSPECT}
        self._suspended = {name for name, state in zip(batch.agents, trust.state, strict=True) if state == SUSPENDED}
        faulty = np.array([estimate.applied for estimate in estimates], np.bool_) & (trust.state != SUSPENDED)
        faults = np.array([estimate.fault * estimate.applied for estimate in estimates]).reshape(-1, 4)
        reasons = tuple(
            described(estimate.fault) if fault else reason
            for estimate, fault, reason in zip(estimates, faulty.tolist(), trust.reason, strict=True)
        )
        agents = replace(
            trust,
            state=np.where(faulty, FAULTY, trust.state).astype(np.uint8),
            reason=reasons,
            offset=faults[:, :2],
            turn=faults[:, 2],
            delay=-faults[:, 3],
            loss=np.array([estimate.loss for estimate in estimates]),
        )
        return replace(assessment, agents=agents)


def _solved(
    found: Displacements,
    samples: float,
    past: tuple[Floats, Floats],
    start: Floats | None,
    expected: Floats,
    steps: int = 1,
) -> tuple[Floats, tuple[Floats, Floats]]:
    """The fault (4,) that fits best, and the sums (4, 4), (4,) with those of the past.

    samples: independent ones that the displacements stand for
    start: (4,) fault from which outliers are judged at first; None: none are
    expected: (4,) fault, as far as nothing shows another: standing objects show no delay
    steps: number of fits; outliers of each are judged from the one before
    """
    for _ in range(steps):
        information, score = normal_equations(found, start)
        total = past[0] + samples * information, past[1] + samples * score
        solution = np.linalg.solve(total[0] + np.diag(1.0 / PRIOR), total[1] + expected / PRIOR)
        start = np.asarray(solution, np.float64)
    assert start is not None
    return start, total


def canonical(states: ObjectStates) -> ObjectStates:
    """The tracks of one agent by id."""
    return states.select(np.argsort(states.id, kind="stable"))


def size_m(fault: Floats) -> float:
    """m, by which a fault (4,) moves a track that is ARM_M away and drives at SPEED_MPS."""
    x, y, turn, delay = fault.tolist()
    return float(max(np.hypot(x, y), ARM_M * abs(turn), SPEED_MPS * abs(delay)))


def late(delay: float) -> str:
    """A time offset in words; delay: s, positive if the tracks are ahead."""
    return f"{abs(delay):.2f} s {'early' if delay > 0.0 else 'late'}"


def described(fault: Floats) -> str:
    """A fault (4,) in words."""
    x, y, turn, delay = fault.tolist()
    return f"all its tracks are off by {np.hypot(x, y):.1f} m and {np.degrees(turn):.1f} degrees, and {late(delay)}"


def corrected_view(view: SweptView, fault: Floats) -> SweptView:
    """A view without a fault (4,): its sensor is the pivot of the turn."""
    position = view.view.position - np.array([fault[0], fault[1], 0.0])
    return replace(
        view, view=replace(view.view, position=position, rotation=rotation_from_yaw(-fault[2]) @ view.view.rotation)
    )
