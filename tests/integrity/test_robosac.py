"""`Robosac`: the first random group that agrees with the ego is admitted."""

from math import log

import plain_boxes as plain
import pytest
from hypothesis import given
from hypothesis import strategies as st
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import Batch, Robosac
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.robosac import largest_sample, samples_needed
from mast_zenoh.streams import stream

AGENTS = ("a", "b", "c", "d", "ego")
CARS = ((9.0, 9.0), (-9.0, 9.0), (9.0, -9.0))


def attacked(*liars: str, phantoms: int = 12, frame: int = 0) -> Batch:
    """Five agents that report three cars; some of them report phantoms of their own, too."""
    tracks: list[Track] = [(name, number, car) for name in AGENTS for number, car in enumerate(CARS)]
    for number, liar in enumerate(liars):
        first = len(CARS) + number * phantoms
        tracks += [(liar, first + k, (-25.0 + 4.0 * k, 20.0 - 5.0 * number)) for k in range(phantoms)]
    return batch(tracks, AGENTS, {name: view((0.0, 0.0)) for name in AGENTS}, frame=frame)


def admitted(stage: Robosac, each: Batch) -> set[str]:
    state = stage.assess(each).agents.state
    return {name for name, value in zip(each.agents, state.tolist(), strict=True) if value != SUSPENDED}


@pytest.mark.parametrize(
    ("others", "attackers", "size", "samples"), [(5, 1, 4, 9), (5, 2, 3, 19), (5, 3, 2, 27), (5, 4, 1, 21)]
)
def test_the_number_of_samples_is_that_printed_in_the_original(others, attackers, size, samples):
    assert samples_needed(0.99, attackers / others, size) == samples


@given(confidence=st.floats(0.01, 0.9999), eta=st.floats(0.01, 0.99), size=st.integers(1, 12))
def test_the_number_of_samples_is_the_least_that_reaches_the_confidence(confidence, eta, size):
    lying = 1.0 - (1.0 - eta) ** size
    needed = samples_needed(confidence, eta, size)
    if lying > 1.0 - 1e-6:  # 1 - lying ** needed loses all digits
        assert needed == pytest.approx(log(1.0 - confidence) / -((1.0 - eta) ** size), rel=1e-5, abs=1)
        return
    assert 1.0 - lying**needed >= confidence - 1e-9
    assert needed == 1 or 1.0 - lying ** (needed - 1) <= confidence + 1e-9


@given(
    confidence=st.floats(0.5, 0.999), eta=st.floats(0.01, 0.95), budget=st.integers(1, 40), others=st.integers(1, 12)
)
def test_the_group_is_the_largest_that_the_budget_is_enough_for(confidence, eta, budget, others):
    size = largest_sample(confidence, eta, budget, others)
    fits = [s for s in range(1, others + 1) if 1.0 - (1.0 - (1.0 - eta) ** s) ** budget >= confidence]
    least = [s for s in range(1, others + 1) if 1.0 - (1.0 - (1.0 - eta) ** s) ** budget >= confidence - 1e-9]
    assert max(fits, default=1) <= size <= max(least, default=1)


@pytest.mark.parametrize("attackers", [4, 9])
def test_if_all_others_may_be_attackers_as_many_groups_are_drawn_as_can_be_checked(attackers: int) -> None:
    stage = Robosac(attackers=attackers, budget=None, sample_size=1)
    assert "ego" in (group := admitted(stage, attacked("a", "b", "c")))
    assert group == {"d", "ego"}, "the agent that agrees is drawn in the end"
    alone = Robosac(attackers=attackers, budget=None, sample_size=1)
    assert admitted(alone, attacked("a", "b", "c", "d")) == {"ego"}
    assert alone.facts()["checks"] == 1000


def reference(each: Batch, stage: Robosac, budget: int, size: int, seed: int, name: str) -> tuple[set[int], int]:
    """Rows that are admitted, and the number of checks, by a transcription of the method."""
    ego = each.agents.index(stage.ego)
    others = [row for row in range(len(each.agents)) if row != ego]

    def seen(rows: list[int]) -> list[plain.Box]:
        return [box for box in plain.perception(each, rows) if plain.in_square(box, each.views[ego], stage.area_m)]

    alone, random = seen([ego]), stream(seed, name, "robosac", each.time_ns)
    for step in range(budget):
        group = random.choice(others, size, replace=False).tolist()
        if plain.jaccard(alone, seen([ego, *group]), stage.match_iou) >= stage.agree:
            return {ego, *group}, step + 1
    return {ego}, budget


@given(
    number=st.integers(0, 10_000),
    agents=st.integers(2, 6),
    objects=st.integers(0, 7),
    size=st.integers(1, 3),
    agree=st.sampled_from([0.2, 0.3, 0.6, 0.9]),
    viewed=st.booleans(),
)
def test_it_admits_whom_the_transcribed_method_admits(number, agents, objects, size, agree, viewed):
    each = plain.random_batch(number, agents, objects, viewed=viewed)
    stage = Robosac(ego="agent_0", budget=4, sample_size=size, agree=agree)
    stage.bind(number, "centre")
    state = stage.assess(each).agents.state
    expected, checks = reference(each, stage, 4, min(size, agents - 1), number, "centre")
    assert {row for row in range(agents) if state[row] != SUSPENDED} == expected
    assert stage.facts()["checks"] == checks


def test_honest_agents_that_were_not_drawn_are_left_out() -> None:
    assert len(admitted(Robosac(), attacked())) == 2, "the budget of 3 is enough for a group of one"
    assert admitted(Robosac(attackers=0), attacked()) == set(AGENTS)


def test_objects_of_those_left_out_alone_are_withheld_and_their_tracks_weigh_nothing() -> None:
    each = attacked("b")
    result = Robosac(attackers=1, budget=30).assess(each)
    assert result.weights is not None
    assert result.objects.withheld.tolist() == [False] * 3 + [True] * 12
    liar = each.agents.index("b")
    assert not result.weights[(each.agent == liar) & (each.labels < 3)].any()


def test_a_batch_without_the_ego_admits_everybody_and_is_counted() -> None:
    stage = Robosac(ego="truck")
    assert admitted(stage, attacked("b")) == set(AGENTS)
    assert stage.facts() == {
        "batches": 0,
        "batches_without_reference": 1,
        "checks": 0,
        "checks_per_batch": None,
        "most_checks": 0,
    }
