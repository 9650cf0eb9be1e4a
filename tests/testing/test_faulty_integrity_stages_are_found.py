"""Faulty integrity stages are found, and their fault is named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.integrity import Assessment, Batch, NoIntegrity


class Random(NoIntegrity):
    """Weighs tracks by chance."""

    random = np.random.default_rng()

    def assess(self, batch: Batch) -> Assessment:
        return replace(super().assess(batch), weights=self.random.uniform(size=len(batch.states)))


class FirstRow(NoIntegrity):
    """Believes whoever comes first."""

    def assess(self, batch: Batch) -> Assessment:
        return replace(super().assess(batch), weights=(np.arange(len(batch.states)) == 0).astype(float))


class Remembering(NoIntegrity):
    """Counts batches, also over a reset."""

    count = 0

    def assess(self, batch: Batch) -> Assessment:
        self.count += 1
        result = super().assess(batch)
        return replace(result, agents=replace(result.agents, mean=result.agents.mean / self.count))


class Changed(NoIntegrity):
    """Returns changed results."""

    part, values = "agents", {}

    def assess(self, batch: Batch) -> Assessment:
        result = super().assess(batch)
        part = replace(getattr(result, self.part), **{name: make(batch) for name, make in self.values.items()})
        return replace(result, **{self.part: part})


class Negative(NoIntegrity):
    def assess(self, batch: Batch) -> Assessment:
        return replace(super().assess(batch), weights=np.full(len(batch.states), -1.0))


class OneWeight(NoIntegrity):
    def assess(self, batch: Batch) -> Assessment:
        return replace(super().assess(batch), weights=np.ones(1))


class Sure(Changed):
    values = {"log_odds": lambda batch: np.full(len(batch.agents), np.inf)}


class Overrated(Changed):
    values = {"mean": lambda batch: np.full(len(batch.agents), 1.5)}


class Speechless(Changed):
    values = {"reason": lambda batch: ()}


class NoState(Changed):
    values = {"state": lambda batch: np.full(len(batch.agents), 9, np.uint8)}


class Weighed(Changed):
    part, values = "objects", {"withheld": lambda batch: np.zeros(batch.clusters)}


class CountsTracks(Changed):
    part, values = "objects", {"confirming": lambda batch: np.full(batch.clusters, len(batch.states) + 6)}


class Sorting(NoIntegrity):
    def assess(self, batch: Batch) -> Assessment:
        batch.states.position.sort(axis=0)
        return super().assess(batch)


class Dropping(NoIntegrity):
    def correct(self, time_ns: int, states: Any, agent: Any, agents: Any, views: Any) -> Any:
        return states.select(np.arange(len(states)) > 0), views


@pytest.mark.parametrize(
    ("faulty", "message"),
    [
        (Random(), "Random.assess .*: two copies differ"),
        (FirstRow(), "FirstRow.assess .*: depends on the order of the rows: weights"),
        (Remembering(), "Remembering.assess .*: after `reset` it is not as newly made"),
        (Negative(), "Negative.assess .*: a weight is below 0"),
        (OneWeight(), r"OneWeight.assess .*: weights has the shape \(1,\), expected \(0,\)"),
        (Sure(), "Sure.assess .*numbers that are not finite"),
        (Overrated(), "Overrated.assess .*: agents.mean is not from 0 to 1"),
        (Speechless(), "Speechless.assess .*: found 0 reasons, expected 5"),
        (NoState(), "NoState.assess .*: a state is not an index into STATES"),
        (Weighed(), "Weighed.assess .*: objects.withheld is float64, expected bool"),
        (CountsTracks(), "CountsTracks.assess .*: objects.confirming is not from 0 to 5, all agents"),
        (Sorting(), r"Sorting.assess: changed its input batch.states.position"),
        (Dropping(), "Dropping.correct: ids or their order differ from the input's"),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, str) else "",
)
def test_what_a_stage_does_wrong_is_named(faulty: NoIntegrity, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        testing.check_integrity(faulty)
