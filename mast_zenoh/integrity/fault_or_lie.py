"""Tells a faulty agent from a liar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, by_agent
from mast_zenoh.integrity.base import FAULTY, SUSPENDED, Assessment, Batch, Integrity
from mast_zenoh.integrity.fault_fit import (
    FaultEstimate,
    agreeing,
    described,
    displacement_m,
    displacements,
    view_without_fault,
    without_fault,
)
from mast_zenoh.integrity.sequential import MAX_NAMES, SequentialConsistency
from mast_zenoh.integrity.views import SweptView

#: Batches in which every agent is fitted once, and log-odds below which one is fitted in each: consecutive offsets of
#: honest agents correlate at 0.8, so that most batches show nothing new.
FIT_PERIOD_BATCHES, SUSPECT_LOG_ODDS = 5, 2.0
#: ns, between two faults that excuse what an agent did before they were found.
EXCUSE_NS = 60_000_000_000


@dataclass(kw_only=True, eq=False)
class FaultOrLie(Integrity):
    """Corrects what a pose error or a wrong clock explains, and leaves the rest to another stage.

    A fault moves all tracks of an agent alike: it is fitted as a displacement, a turn and a time offset of the whole
    agent to all its tracks that other agents report, too. Where the fit is significant and explains most of them, the
    agent is faulty: its tracks and its view are corrected, and it keeps its vote. A lie concerns some of its tracks:
    what remains after the correction is evidence for `stage`, as without a fault.

    Of several agents that look faulty at once, the one that its fault explains most about is corrected first, and the
    others are fitted anew: next to two agents with a fault, an honest one looks as if it had half of it. An agent of
    the largest group whose tracks agree, directly or by way of others, is never corrected: a minority that moves all
    its tracks alike is off itself. Of two groups of one size, nothing says which.

    stage: judges the corrected tracks; None: SequentialConsistency()
    significance: gain in twice the log-likelihood from which a fault is corrected; 30 is exceeded by 5 in a million of
        a chi-square distribution with four degrees
    least_m: m, displacement below which nothing is corrected
    share: of the tracks that the fit must explain
    memory_s: s, over which displacements are summed

    Weaknesses: an agent that moves all its tracks alike on purpose is corrected, not suspended, which does no harm;
    two agents that nobody else sees are left as they are; errors beyond GATE_M are not found.
    """

    stage: Integrity | None = None
    significance: float = 30.0
    least_m: float = 0.3
    share: float = 0.7
    memory_s: float = 1.5

    def __post_init__(self) -> None:
        check("more than 0", memory_s=self.memory_s)
        self._stage = self.stage or SequentialConsistency()
        self.reset()

    def bind(self, seed: int, name: str) -> None:
        self._stage.bind(seed, name)

    def facts(self) -> dict[str, Any]:
        return self._stage.facts()

    def reset(self) -> None:
        self._stage.reset()
        self._estimates: dict[str, FaultEstimate] = {}
        self._suspects: set[str] = set()  # agents that are fitted in every batch
        self._suspended: set[str] = set()  # agents whose tracks are no reference for others

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        states, views = self._stage.correct(time_ns, states, agent, agents, views)
        for name in agents:
            self._note_loss(self._estimates.setdefault(name, FaultEstimate(time_ns)), views.get(name))
        pivots = [self._pivot(states, agent == row, views.get(name)) for row, name in enumerate(agents)]
        due = self._due(agents)
        agree = self._fit(time_ns, states, agent, agents, pivots, due)
        if any(self._convincing(self._estimates[name]) for name in due):
            agree |= self._fit(time_ns, states, agent, agents, pivots, set(agents) - due)
            self._apply_most_convincing(time_ns, agents, agree)
        for name in agents:
            # Once corrected, an agent stays so until nothing is left to correct.
            self._estimates[name].applied &= bool(displacement_m(self._estimates[name].fault) >= self.least_m)
        seen = {
            name: view_without_fault(view, self._estimates[name].fault) if self._applied(name) else view
            for name, view in views.items()
        }
        result = self._without_faults(states, agent, agents, pivots)
        if len(self._estimates) > MAX_NAMES:
            self._estimates = {name: self._estimates[name] for name in agents}
        return result, seen

    def _due(self, agents: tuple[str, ...]) -> set[str]:
        """The agents that are fitted in a batch: those whose last fit is the longest ago, and suspects."""
        oldest = sorted(agents, key=lambda name: self._estimates[name].time_ns)
        return {*oldest[: -(-len(agents) // FIT_PERIOD_BATCHES)], *self._suspects.intersection(agents)}

    def _pivot(self, states: ObjectStates, mine: Bools, view: SweptView | None) -> Floats:
        """(2,) m: the agent's sensor, else the middle of its tracks."""
        if view is not None:
            return np.asarray(view.view.position[:2])
        return states.position[mine, :2].mean(axis=0) if mine.any() else np.zeros(2)

    def _applied(self, name: str) -> bool:
        return name in self._estimates and self._estimates[name].applied

    def _without_faults(
        self, states: ObjectStates, agent: Ints, agents: tuple[str, ...], pivots: Sequence[Floats]
    ) -> ObjectStates:
        """The tracks without the faults that are known; pivots: (2,) m, of each agent"""
        for row, name in enumerate(agents):
            if self._applied(name):
                states = without_fault(states, agent == row, self._estimates[name].fault, pivots[row])
        return states

    def _fit(
        self,
        time_ns: int,
        states: ObjectStates,
        agent: Ints,
        agents: tuple[str, ...],
        pivots: Sequence[Floats],
        names: set[str],
    ) -> dict[int, set[int]]:
        """Update the estimates of some agents from a batch; pivots: (2,) m, of each agent.

        Returns for each of these agents that has tracks the rows of the agents whose tracks agree with its own.
        """
        reference = self._without_faults(states, agent, agents, pivots)
        suspended = [row for row, name in enumerate(agents) if name in self._suspended]
        corrected = np.array([row for row, name in enumerate(agents) if self._applied(name)], np.int64)
        order = by_agent(states, agent)  # the order of the rows must not matter
        agent = agent[order]
        trusted = ~np.isin(agent, suspended)
        result = {}
        for row, name in enumerate(agents):
            mine = agent == row
            if name in names and mine.any():
                others = ~mine & trusted
                estimate = self._estimates[name]
                found = displacements(
                    states.select(order[mine]),
                    reference.select(order[others]),
                    agent[others],
                    pivots[row],
                    estimate.known,
                )
                known = estimate.known
                estimate.update(time_ns, found, self.memory_s)
                result[row] = set(agreeing(found, known, estimate.fault, corrected).tolist())
        return result

    def _convincing(self, estimate: FaultEstimate) -> bool:
        """Whether an agent that is not corrected looks faulty."""
        significant = estimate.statistic >= self.significance and estimate.others >= 2
        common = estimate.share >= self.share
        large = bool(displacement_m(estimate.fault) >= self.least_m)
        return not estimate.applied and significant and common and large

    def _apply_most_convincing(self, time_ns: int, agents: tuple[str, ...], agree: Mapping[int, set[int]]) -> None:
        """Correct the agent with the most convincing fault; forget what the others looked like next to it.

        agree: by row of an agent, the rows of those whose tracks agree with its own
        """
        sound = {agents[row] for row in largest_groups(len(agents), agree)}
        suspects = [name for name in agents if self._convincing(self._estimates[name]) and name not in sound]
        if not suspects:
            return
        name = max(suspects, key=lambda name: self._estimates[name].statistic)
        for other in agents:
            if other != name:
                self._estimates[other].forget()
        estimate = self._estimates[name]
        estimate.applied = True
        if time_ns >= estimate.excused_until_ns:
            self._stage.excuse(name)
            estimate.excused_until_ns = time_ns + EXCUSE_NS

    def _note_loss(self, estimate: FaultEstimate, view: SweptView | None) -> None:
        """Update the share of frames in which nothing of the agent arrived."""
        if view is not None:
            estimate.loss += 0.02 * (float(view.age_s > 0.0) - estimate.loss)

    def assess(self, batch: Batch) -> Assessment:
        assessment = self._stage.assess(batch)
        estimates = [self._estimates.get(name, FaultEstimate(batch.time_ns)) for name in batch.agents]
        trust = assessment.agents
        self._suspects = {
            name for name, odds in zip(batch.agents, trust.log_odds, strict=True) if odds < SUSPECT_LOG_ODDS
        }
        self._suspended = {name for name, state in zip(batch.agents, trust.state, strict=True) if state == SUSPENDED}
        faulty = np.array([estimate.applied for estimate in estimates], np.bool_) & (trust.state != SUSPENDED)
        faults = np.array([estimate.known for estimate in estimates]).reshape(-1, 4)
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


def largest_groups(count: int, agree: Mapping[int, set[int]]) -> set[int]:
    """The rows of the agents in the largest group that agrees, directly or by way of others; in all that are largest.

    agree: by row of one of `count` agents, the rows of those that agree with it. Two agents agree if each does with
    the other: what is wrong with one of them may show only in its own fit.
    """
    groups: list[set[int]] = [{row} for row in range(count)]
    for row, others in agree.items():
        joined = {row, *(other for other in others if row in agree.get(other, ()))}
        touched = [group for group in groups if group & joined]
        groups = [*(group for group in groups if not group & joined), joined.union(*touched)]
    most = max(map(len, groups), default=0)
    return {row for group in groups if len(group) == most for row in group}
