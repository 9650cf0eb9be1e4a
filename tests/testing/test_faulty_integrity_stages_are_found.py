"""Faulty integrity stages are found, and their fault is named."""

from dataclasses import replace

import numpy as np
import pytest

from mast_zenoh import testing
from mast_zenoh.integrity import NoIntegrity

DRAWN = np.random.default_rng()


def stage(name: str, **methods):
    """An instance of a class of this name with other methods."""
    return type(name, (NoIntegrity,), methods)()


def weighing(name: str, weights):
    """A stage whose weights are a function of the batch."""
    return stage(name, assess=lambda self, batch: replace(NoIntegrity.assess(self, batch), weights=weights(batch)))


def stating(name: str, part: str, **values):
    """A stage in whose agents or objects some values are functions of the batch."""

    def assess(self, batch):
        result = NoIntegrity.assess(self, batch)
        return replace(result, **{part: replace(getattr(result, part), **{k: f(batch) for k, f in values.items()})})

    return stage(name, assess=assess)


def remembering(self, batch):
    """Counts batches, also over a reset."""
    self.count = getattr(self, "count", 0) + 1
    result = NoIntegrity.assess(self, batch)
    return replace(result, agents=replace(result.agents, mean=result.agents.mean / self.count))


def sorting(self, batch):
    batch.states.position.sort(axis=0)
    return NoIntegrity.assess(self, batch)


FAULTY = {
    "Random.assess .*: two copies differ": weighing("Random", lambda b: DRAWN.uniform(size=len(b.states))),
    "FirstRow.assess .*: depends on the order of the rows: weights": weighing(
        "FirstRow", lambda batch: (np.arange(len(batch.states)) == 0).astype(float)
    ),
    "Remembering.assess .*: after `reset` it is not as newly made": stage("Remembering", assess=remembering),
    "Negative.assess .*: a weight is below 0": weighing("Negative", lambda batch: np.full(len(batch.states), -1.0)),
    r"OneWeight.assess .*: weights has the shape \(1,\), expected \(0,\)": weighing("OneWeight", lambda b: np.ones(1)),
    "Sure.assess .*numbers that are not finite": stating(
        "Sure", "agents", log_odds=lambda batch: np.full(len(batch.agents), np.inf)
    ),
    "Overrated.assess .*: agents.mean is not from 0 to 1": stating(
        "Overrated", "agents", mean=lambda batch: np.full(len(batch.agents), 1.5)
    ),
    "Speechless.assess .*: found 0 reasons, expected 5": stating("Speechless", "agents", reason=lambda batch: ()),
    "NoState.assess .*: a state is not an index into STATES": stating(
        "NoState", "agents", state=lambda batch: np.full(len(batch.agents), 9, np.uint8)
    ),
    "Weighed.assess .*: objects.withheld is float64, expected bool": stating(
        "Weighed", "objects", withheld=lambda batch: np.zeros(batch.clusters)
    ),
    "CountsTracks.assess .*: objects.confirming is not from 0 to 5, all agents": stating(
        "CountsTracks", "objects", confirming=lambda batch: np.full(batch.clusters, len(batch.states) + 6)
    ),
    r"Sorting.assess: changed its input batch.states.position": stage("Sorting", assess=sorting),
    "Dropping.correct: ids or their order differ from the input's": stage(
        "Dropping", correct=lambda self, time, states, *rest: (states.select(np.arange(len(states)) > 0), rest[-1])
    ),
}


@pytest.mark.parametrize("message", FAULTY)
def test_what_a_stage_does_wrong_is_named(message):
    with pytest.raises(AssertionError, match=message):
        testing.check_integrity(FAULTY[message])
