"""`Robosac`: the first random group that agrees with the ego is admitted."""

from __future__ import annotations

from math import inf, log

import numpy as np
import plain_boxes as plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from integrity_batches import Track, batch, view

from mast_zenoh.arrays.states import Bools
from mast_zenoh.integrity import Batch, Robosac, consensus
from mast_zenoh.integrity.base import SUSPENDED, ClusterBoxes
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
def test_the_number_of_samples_is_that_printed_in_the_original(
    others: int, attackers: int, size: int, samples: int
) -> None:
    assert samples_needed(0.99, attackers / others, size) == samples


@given(confidence=st.floats(0.01, 0.9999), eta=st.floats(0.01, 0.99), size=st.integers(1, 12))
def test_the_number_of_samples_is_the_least_that_reaches_the_confidence(
    confidence: float, eta: float, size: int
) -> None:
    lying = 1.0 - (1.0 - eta) ** size
    needed = samples_needed(confidence, eta, size)
    if lying > 1.0 - 1e-6:  # 1 - lying ** needed loses all digits
        assert needed == pytest.approx(log(1.0 - confidence) / -((1.0 - eta) ** size), rel=1e-5, abs=1)
        return
    assert 1.0 - lying**needed >= confidence - 1e-9
    assert needed == 1 or 1.0 - lying ** (needed - 1) <= confidence + 1e-9


@given(
    confidence=st.floats(0.5, 0.999),
    eta=st.floats(0.01, 0.95),
    budget=st.integers(1, 40),
    others=st.integers(1, 12),
)
def test_the_group_is_the_largest_that_the_budget_is_enough_for(
    confidence: float, eta: float, budget: int, others: int
) -> None:
    size = largest_sample(confidence, eta, budget, others)
    fits = [s for s in range(1, others + 1) if 1.0 - (1.0 - (1.0 - eta) ** s) ** budget >= confidence]
    least = [s for s in range(1, others + 1) if 1.0 - (1.0 - (1.0 - eta) ** s) ** budget >= confidence - 1e-9]
    assert max(fits, default=1) <= size <= max(least, default=1)


def test_without_attackers_everybody_is_one_group_and_with_nothing_else_no_group_is_free() -> None:
    assert (largest_sample(0.99, 0.0, 3, 4), samples_needed(0.99, 0.0, 4)) == (4, 1)
    assert (largest_sample(0.99, 1.0, 3, 4), samples_needed(0.99, 1.0, 1)) == (1, inf)


def test_the_formula_does_not_demand_more_groups_than_can_be_checked() -> None:
    stage = Robosac(attackers=3, budget=None, sample_size=4)
    stage.assess(attacked("a", "b", "c", "d", phantoms=9))
    assert stage.facts()["checks"] == 1000
    assert samples_needed(0.99, 0.75, 4) == 1177


@pytest.mark.parametrize("attackers", [4, 9])
def test_if_all_others_may_be_attackers_as_many_groups_are_drawn_as_can_be_checked(attackers: int) -> None:
    stage = Robosac(attackers=attackers, budget=None, sample_size=1)
    assert "ego" in (group := admitted(stage, attacked("a", "b", "c")))
    assert group == {"d", "ego"}, "the agent that agrees is drawn in the end"
    alone = Robosac(attackers=attackers, budget=None, sample_size=1)
    assert admitted(alone, attacked("a", "b", "c", "d")) == {"ego"}
    assert alone.facts()["checks"] == 1000


def test_a_group_that_is_drawn_again_is_compared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[frozenset[str]] = []
    perceived = consensus.perception

    def watched(each: Batch, members: Bools) -> ClusterBoxes:
        compared.append(frozenset(np.array(each.agents)[members].tolist()))
        return perceived(each, members)

    monkeypatch.setattr(consensus, "perception", watched)
    stage = Robosac(attackers=9, budget=None, sample_size=2)
    stage.assess(attacked("a", "b", "c", "d"))
    assert stage.facts()["checks"] == 1000
    assert len(compared) == len(set(compared)) == 1 + 6, "the ego alone, and each pair of four"


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
@settings(max_examples=60)
def test_it_admits_whom_the_transcribed_method_admits(
    number: int, agents: int, objects: int, size: int, agree: float, viewed: bool
) -> None:
    each = plain.random_batch(number, agents, objects, viewed=viewed)
    stage = Robosac(ego="agent_0", budget=4, sample_size=size, agree=agree)
    stage.bind(number, "centre")
    state = stage.assess(each).agents.state
    expected, checks = reference(each, stage, 4, min(size, agents - 1), number, "centre")
    assert {row for row in range(agents) if state[row] != SUSPENDED} == expected
    assert stage.facts()["checks"] == checks


def test_a_liar_with_many_phantoms_is_never_admitted() -> None:
    stage = Robosac()
    groups = [admitted(stage, attacked("b", frame=frame)) for frame in range(20)]
    assert all("ego" in group and "b" not in group for group in groups)
    assert {name for group in groups for name in group} == {"a", "c", "d", "ego"}, "others are drawn at random"


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


def test_a_few_phantoms_leave_the_index_above_the_limit() -> None:
    stage = Robosac(attackers=0)
    assert admitted(stage, attacked("b", phantoms=7)) == set(AGENTS), "3 of 10 boxes agree"
    assert admitted(stage, attacked("b", phantoms=8)) == {"ego"}, "3 of 11 do not"


def test_a_lying_ego_excludes_the_honest_agents() -> None:
    lies: list[Track] = [("ego", number, (20.0, -20.0 + 8.0 * number)) for number in range(2)]
    honest: list[Track] = [(name, 2 + k, (-20.0 + 5.0 * k, 0.0)) for name in "abcd" for k in range(8)]
    assert admitted(Robosac(attackers=0), batch([*lies, *honest], AGENTS)) == {"ego"}


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


def test_equal_seeds_draw_equal_groups_and_other_seeds_others() -> None:
    def drawn(seed: int) -> list[set[str]]:
        stage = Robosac()
        stage.bind(seed, "command_center")
        return [admitted(stage, attacked(frame=frame)) for frame in range(12)]

    assert drawn(3) == drawn(3)
    assert drawn(3) != drawn(4)


def test_checks_end_with_the_first_group_that_agrees() -> None:
    stage = Robosac(budget=5, sample_size=1)
    for frame in range(10):
        stage.assess(attacked(frame=frame))
    assert (stage.facts()["checks_per_batch"], stage.facts()["most_checks"]) == (1.0, 1)
    for frame in range(10, 20):
        stage.assess(attacked("a", "b", "c", "d", phantoms=9, frame=frame))
    assert stage.facts()["most_checks"] == 5, "no group agrees"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"ego": ""}, "ego: found '', expected the name of an agent"),
        ({"attackers": -1}, "attackers: found -1, expected 0 or more"),
        ({"budget": 0}, "budget: found 0, expected 1 or more"),
        ({"sample_size": 0}, "sample_size: found 0, expected 1 or more"),
        ({"budget": 2.5}, "budget: found 2.5, expected a whole number"),
        ({"sample_size": True}, "sample_size: found True, expected a whole number"),
        ({"attackers": inf}, "attackers: found inf, expected 0 or more, finite"),
        ({"budget": None}, "budget, sample_size: found None for both, expected a number for one at least"),
        ({"confidence": 1.0}, "confidence: found 1.0, expected more than 0 and less than 1"),
        ({"agree": 1.1}, "agree: found 1.1, expected 0 to 1"),
        ({"match_iou": 0.0}, "match_iou: found 0.0, expected more than 0 and at most 1"),
        ({"area_m": 0.0}, "area_m: found 0.0, expected more than 0"),
    ],
)
def test_invalid_parameters_are_refused(arguments: dict, problem: str) -> None:
    with pytest.raises(ValueError, match=problem.replace("[", r"\[")):
        Robosac(**arguments)
