"""What others say about whom they trust, beside a stage's own judgement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.integrity.base import SUSPENDED, Assessment, Batch, Integrity
from mast_zenoh.integrity.sequential import SequentialConsistency
from mast_zenoh.integrity.views import SweptView

#: Least trust in an agent that a stage has not suspended: of two that contradict each other, each may be honest.
OPEN = 0.5
#: Trust below which an agent is suspended.
LEAST = 0.4


@dataclass(kw_only=True, eq=False)
class Hearsay(Integrity):
    """Lets the doubts of others settle what another stage leaves open.

    The doubt of others in an agent is the mean of 1 - q over those that say something of it, q being the trust in it
    that they tell, times this receiver's own trust in each of them (the discounting of Josang, A Logic for Uncertain
    Probabilities, 2001). Second-hand evidence counts with a small weight beside one's own (Buchegger, Le Boudec, A
    Robust Reputation System for P2P and Mobile Ad-hoc Networks, 2004): an agent is suspended if `stage` suspends it, or
    if the trust of `stage` in it, at least 0.5, minus `weight` times the doubt of others is below 0.4. What an agent
    says of itself does not count, and none of it changes the trust that this receiver tells to others: no rumours.

    stage: judges by evidence; None: SequentialConsistency()
    weight: of the doubt of all others together, 0 to 0.6

    So at most, whatever is told: nobody whom `stage` trusts more than 0.4 + `weight` is suspended, and of those that it
    leaves open, nobody is unless the tellers of more than the share 0.1 / `weight` lie, or all of these doubt.

    Weaknesses: no object that an agent hides is shown by it; in an open dispute, a third of the tellers can have the
    wrong one suspended, by default.
    """

    stage: Integrity | None = None
    weight: float = 0.3

    def __post_init__(self) -> None:
        check("0 or more, finite", weight=self.weight)
        if not self.weight < 1.0 - LEAST:
            raise ValueError(
                f"weight: found {self.weight}, expected less than {1.0 - LEAST}, or hearsay alone suspends"
            )
        self._stage = self.stage or SequentialConsistency()
        self.reset()

    def bind(self, seed: int, name: str) -> None:
        self._stage.bind(seed, name)

    def facts(self) -> dict[str, Any]:
        return self._stage.facts() | {"suspended_by_hearsay": dict(sorted(self._frames.items()))}

    def reset(self) -> None:
        self._stage.reset()
        self._listener = ""
        self._trusts: Mapping[str, Mapping[str, float]] = {}
        self._frames: Counter[str] = Counter()  # by agent, for which only hearsay suspended it

    def correct(
        self, time_ns: int, states: ObjectStates, agent: Ints, agents: tuple[str, ...], views: Mapping[str, SweptView]
    ) -> tuple[ObjectStates, Mapping[str, SweptView]]:
        return self._stage.correct(time_ns, states, agent, agents, views)

    def excuse(self, agent: str) -> None:
        self._stage.excuse(agent)

    def await_faults(self, agents: frozenset[str]) -> None:
        self._stage.await_faults(agents)

    def hear(self, listener: str, trusts: Mapping[str, Mapping[str, float]]) -> None:
        self._listener, self._trusts = listener, trusts

    def assess(self, batch: Batch) -> Assessment:
        assessment = self._stage.assess(batch)
        own = assessment.agents
        suspended = own.state == SUSPENDED
        doubt = self._doubt(batch.agents, np.where(suspended, 0.0, own.mean))
        doubted = ~suspended & (np.maximum(own.mean, OPEN) - self.weight * doubt < LEAST)
        if not doubted.any():
            return assessment
        self._frames.update(np.array(batch.agents)[doubted].tolist())
        believed: Bools = batch.reported & ~(suspended | doubted)
        alone = ~believed.any(axis=1)
        weights = batch.weights(believed)
        objects = assessment.objects
        return Assessment(
            weights if assessment.weights is None else weights * assessment.weights,
            replace(
                own,
                state=np.where(doubted, SUSPENDED, own.state).astype(np.uint8),
                reason=tuple(
                    f"others doubt it ({of_agent:.2f})" if new else reason
                    for new, of_agent, reason in zip(doubted.tolist(), doubt.tolist(), own.reason, strict=True)
                ),
            ),
            replace(objects, withheld=objects.withheld | (alone & (batch.reported & doubted).any(axis=1))),
        )

    def _doubt(self, agents: tuple[str, ...], trust: Floats) -> Floats:
        """(a,) the doubt of others in each agent, 0 to 1. trust: (a,) in them as tellers"""
        in_teller = dict(zip(agents, trust.tolist(), strict=True))
        doubt = np.zeros(len(agents))
        for row, agent in enumerate(agents):
            if agent != self._listener:
                terms = [
                    in_teller.get(teller, 0.0) * (1.0 - said[agent])
                    for teller, said in sorted(self._trusts.items())
                    if agent in said and teller not in (agent, self._listener)
                ]
                doubt[row] = sum(terms) / len(terms) if terms else 0.0
        return doubt
