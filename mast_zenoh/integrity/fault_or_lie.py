"""Tells a faulty agent from a liar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates, by_agent
from mast_zenoh.integrity.base import FAULTY, SUSPENDED, Assessment, Batch, Integrity
from mast_zenoh.integrity.deviations import described, view_without_fault, without_fault
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.relative_faults import RelativeFaults
from mast_zenoh.integrity.sequential import SequentialConsistency
from mast_zenoh.integrity.views import SweptView

#: Log-odds below which an agent is suspect, and faults are looked for in each batch.
SUSPECT_LOG_ODDS = 2.0
#: ns, between two faults that excuse what an agent did before they were found.
EXCUSE_NS = 60_000_000_000
#: Weight of the latest frame in the mean share of frames in which nothing of an agent arrived.
LOSS_STEP = 0.02


@dataclass(kw_only=True, eq=False)
class FaultOrLie(Integrity):
    """Corrects what a pose error or a wrong clock explains, and leaves the rest to another stage.

    A fault moves all tracks of an agent alike. Of each pair of agents, the displacement, turn and delay of one against
    the other is fitted to all tracks of objects that both report. An agent is faulty if it is in every set of fewer
    than half of the agents that has one of each pair that differs so (`relative_faults`): on one agent or on several at
    once. Of five agents, two cannot make another one seem faulty; of four, two can. The tracks and the view of a faulty
    agent are corrected, and it keeps its vote. A lie concerns some of its tracks: what remains after the correction is
    evidence for `stage`, as without a fault. A fault that is newly found excuses what the agent did before, once in a
    minute at most, and `stage` waits up to 10 s before it acts on an agent whose tracks differ as a fault would make
    them.

    stage: judges the corrected tracks; None: SequentialConsistency()
    significance: gain in twice the log-likelihood from which the tracks of two agents differ; 30 is exceeded by 5 in a
        million of a chi-square distribution with four degrees
    least_m: m, displacement below which nothing is corrected
    share: of the common tracks that the difference must explain
    memory_s: s, over which differences are summed

    Weaknesses: an agent that moves all its tracks alike on purpose is corrected, not suspended, which does no harm; as
    many agents with a fault as without are left as they are; two liars of four agents can have an honest one
    corrected; errors beyond 3 m are found only where two agents share six objects, and none beyond 9 m.
    """

    stage: Integrity | None = None
    significance: float = 30.0
    least_m: float = 0.3
    share: float = 0.7
    memory_s: float = 3.0

    def __post_init__(self) -> None:
        check("more than 0, finite", significance=self.significance, memory_s=self.memory_s)
        check("0 or more, finite", least_m=self.least_m)
        check("0 to 1", share=self.share)
        if isinstance(self.stage, FaultOrLie):
            raise ValueError("stage: found FaultOrLie, expected another stage: faults are corrected once")
        self._stage = self.stage or SequentialConsistency()
        self.reset()

    def bind(self, seed: int, name: str) -> None:
        self._stage.bind(seed, name)

    def hear(self, listener: str, trusts: Mapping[str, Mapping[str, float]]) -> None:
        self._stage.hear(listener, trusts)

    def facts(self) -> dict[str, Any]:
        return self._stage.facts()

    def reset(self) -> None:
        self._stage.reset()
        self._faults = RelativeFaults(self.significance, self.least_m, self.share, self.memory_s)
        # loss: share of frames in which nothing of the agent arrived
        # excused_until_ns: ns, until when no further fault excuses what the agent did before it was found
        self._agents = AgentMemory(forget_s=600.0, loss=0.0, excused_until_ns=0)
        self._suspicious = False  # whether an agent of the last batch looks worse than most honest ones ever do
        self._suspended: tuple[str, ...] = ()  # of the last batch
        self._known: dict[str, Floats] = {}  # (4,) fault of each faulty agent of the last batch

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        states, views = self._stage.correct(time_ns, states, agent, agents, views)
        rows = self._agents.meet(time_ns, agents)
        self._note_losses(rows, agents, views)
        order = by_agent(states, agent)  # the order of the rows must not matter
        tracks, of = states.select(order), agent[order]
        pivots = np.zeros((len(agents), 2))
        for row, name in enumerate(agents):
            if name in views:
                pivots[row] = views[name].view.position[:2]
            elif (of == row).any():
                pivots[row] = tracks.position[of == row, :2].mean(axis=0)
        suspended = np.isin(agents, self._suspended)
        for name in self._faults.update(time_ns, tracks, of, agents, pivots, suspended, urgent=self._suspicious):
            self._excuse(time_ns, name, rows[agents.index(name)])
        doubtful = np.flatnonzero(self._faults.doubtful).tolist()
        self._stage.await_faults(frozenset(self._faults.names[row] for row in doubtful))
        faults = self._faults.faults(pivots)
        self._known = {agents[row]: faults[row] for row in np.flatnonzero(faults.any(axis=1)).tolist()}
        corrected = dict(views)
        for name, fault in self._known.items():
            row = agents.index(name)
            states = without_fault(states, agent == row, fault, pivots[row])
            if name in views:
                corrected[name] = view_without_fault(views[name], fault)
        return states, corrected

    def _excuse(self, time_ns: int, name: str, row: int) -> None:
        if time_ns >= self._agents.of.excused_until_ns[row]:
            self._stage.excuse(name)
            self._agents.of.excused_until_ns[row] = time_ns + EXCUSE_NS

    def _note_losses(self, rows: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]) -> None:
        known = np.array([name in views for name in agents], np.bool_)
        late = np.array([name in views and views[name].age_s > 0.0 for name in agents], np.float64)
        loss = self._agents.of.loss
        loss[rows] += np.where(known, LOSS_STEP * (late - loss[rows]), 0.0)

    def assess(self, batch: Batch) -> Assessment:
        assessment = self._stage.assess(batch)
        trust = assessment.agents
        suspended = trust.state == SUSPENDED
        self._suspended = tuple(np.array(batch.agents)[suspended].tolist())
        self._suspicious = bool((trust.log_odds[~suspended] < SUSPECT_LOG_ODDS).any())
        faults = np.array([self._known.get(name, np.zeros(4)) for name in batch.agents]).reshape(-1, 4)
        faulty = faults.any(axis=1) & ~suspended
        reasons = tuple(
            described(fault) if has_fault else reason
            for fault, has_fault, reason in zip(faults, faulty.tolist(), trust.reason, strict=True)
        )
        agents = replace(
            trust,
            state=np.where(faulty, FAULTY, trust.state).astype(np.uint8),
            reason=reasons,
            offset=faults[:, :2].copy(),
            turn=faults[:, 2].copy(),
            delay=-faults[:, 3],
            loss=self._agents.of.loss[self._agents.rows].copy(),
        )
        return replace(assessment, agents=agents)
