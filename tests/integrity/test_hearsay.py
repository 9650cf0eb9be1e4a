"""What others tell decides what a stage leaves open, and nothing else."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import Assessment, Batch, Hearsay, Integrity
from mast_zenoh.integrity.base import SUSPENDED, TRUSTED, UNDECIDED, AgentTrust, ObjectTrust
from mast_zenoh.integrity.hearsay import LEAST, OPEN

AGENTS = ("a", "b", "c", "d", "e", "me", "x")
HONEST = 0.999


class Fixed(Integrity):
    """A stage with a fixed trust in agents; below 0.2 they are suspended, up to 0.5 undecided."""

    def __init__(self, trust: Mapping[str, float]) -> None:
        self.trust = trust

    def assess(self, batch: Batch) -> Assessment:
        mean = np.array([self.trust.get(name, HONEST) for name in batch.agents])
        state = np.where(mean < 0.2, SUSPENDED, np.where(mean <= OPEN, UNDECIDED, TRUSTED)).astype(np.uint8)
        none = np.zeros(batch.clusters, np.int64)
        objects = ObjectTrust(np.ones(batch.clusters), none, none, none, np.zeros(batch.clusters, np.bool_))
        return Assessment(None, AgentTrust.of(mean, state), objects)

    def reset(self) -> None:
        pass


def batch() -> Batch:
    """Cluster 0 is an object that all report, and cluster k + 1 one that agent k alone reports."""
    a = len(AGENTS)
    places = np.concatenate([np.zeros(a), 10.0 * np.arange(1, a + 1)])
    states = ObjectStates.of(np.column_stack([places, np.zeros(2 * a), np.zeros(2 * a)]), id=np.arange(2 * a))
    labels = np.concatenate([np.zeros(a, np.int64), np.arange(1, a + 1)])
    return Batch(0, states, np.tile(np.arange(a), 2), labels, AGENTS, (None,) * a)


def assess(own: Mapping[str, float], trusts: Mapping[str, Mapping[str, float]], **settings: Any) -> Assessment:
    stage = Hearsay(stage=Fixed(own), **settings)
    stage.hear("me", trusts)
    return stage.assess(batch())


def suspended(own: Mapping[str, float], trusts: Mapping[str, Mapping[str, float]], **settings: Any) -> set[str]:
    state = assess(own, trusts, **settings).agents.state
    return {name for name, each in zip(AGENTS, state.tolist(), strict=True) if each == SUSPENDED}


def drawn(random: np.random.Generator, values: list[float]) -> dict[str, float]:
    return dict(zip(AGENTS, random.choice(values, len(AGENTS)).tolist(), strict=True))


def tell(tellers: str, **trust: float) -> dict[str, dict[str, float]]:
    return dict.fromkeys(tellers, trust)


def test_most_others_decide_a_dispute_that_is_open() -> None:
    own = {"x": 0.5, "me": 0.5}
    assert suspended(own, tell("abcd", x=0.5) | tell("e", x=1.0)) == {"x"}
    assert suspended(own, tell("abc", x=0.5) | tell("de", x=1.0)) == set()
    assert suspended(own, {}) == set()


def test_objects_that_doubted_agents_alone_report_are_withheld_and_their_tracks_have_no_weight() -> None:
    found = assess({"x": 0.5}, tell("abcde", x=0.0))
    row = AGENTS.index("x")
    assert np.flatnonzero(found.objects.withheld).tolist() == [1 + row]
    assert found.weights is not None
    assert np.flatnonzero(found.weights == 0.0).tolist() == [row], "of the object that all report"
    assert found.agents.reason[row] == "others doubt it (1.00)"
    assert found.agents.mean[row] == 0.5, "what is heard does not change what is told"


def test_whatever_is_told_nobody_is_suspended_whom_the_stage_trusts_more_than_the_bound() -> None:
    random, hits = np.random.default_rng(0), 0
    for _ in range(300):
        weight = random.uniform(0.0, 0.59)
        own = drawn(random, [0.1, 0.5, 0.6, 0.8, HONEST])
        trusts = {teller: drawn(random, [0.0, 0.0, 0.0, 0.0, 0.5, 1.0]) for teller in AGENTS}
        more = suspended(own, trusts, weight=weight) - suspended(own, {})
        hits += len(more)
        for name in more:
            assert own[name] <= LEAST + weight
            tellers = [teller for teller in AGENTS if teller not in (name, "me")]
            doubt = np.mean([(own[teller] >= 0.2) * own[teller] * (1.0 - trusts[teller][name]) for teller in tellers])
            assert weight * doubt > max(own[name], OPEN) - LEAST
        assert "me" not in more
    assert hits > 50, "there is something to bound"


@pytest.mark.parametrize("liars", [1, 2, 3])
def test_slander_by_up_to_a_third_of_the_tellers_has_no_effect_and_by_more_only_in_an_open_dispute(liars: int) -> None:
    slander = tell("abcdef"[:liars], x=0.0, e=0.0) | tell("abcde"[liars:], x=HONEST, e=HONEST)
    assert suspended({}, slander) == set()
    assert suspended({"x": 0.5}, slander) == ({"x"} if liars > 1 else set())


def test_what_an_agent_says_of_itself_and_what_suspended_agents_say_does_not_count() -> None:
    assert suspended({"x": 0.5}, tell("x", x=0.0)) == set()
    assert suspended({"x": 0.5} | dict.fromkeys("abcde", 0.1), tell("abcde", x=0.0)) == set("abcde")


def test_without_gossip_the_assessment_is_that_of_the_stage() -> None:
    alone, with_hearsay = Fixed({"x": 0.3}).assess(batch()), assess({"x": 0.3}, {})
    assert with_hearsay.weights is None
    assert np.array_equal(with_hearsay.agents.state, alone.agents.state)
    assert with_hearsay.agents.reason == alone.agents.reason
