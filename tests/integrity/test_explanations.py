"""Explanations of disputes agree with trying every set of agents."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import Bools
from mast_zenoh.integrity.disputes import Explanations, explained

Graph = tuple[Bools, set[int], set[int]]


def explanations(disputes: Bools, lying: set[int], honest: set[int]) -> list[set[int]]:
    """Every set of fewer than half of the agents with the liars, one of each pair that disagrees, and nobody honest."""
    a = len(disputes)
    pairs = [(i, j) for i, j in combinations(range(a), 2) if disputes[i, j]]
    sets = (set(each) for size in range((a - 1) // 2 + 1) for each in combinations(range(a), size))
    sets = (each for each in sets if lying <= each and not each & honest)
    return [each for each in sets if all(i in each or j in each for i, j in pairs)]


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    a = draw(st.integers(1, 9))
    pairs = list(combinations(range(a), 2))
    disputes = np.zeros((a, a), np.bool_)
    for i, j in draw(st.lists(st.sampled_from(pairs), max_size=14)) if pairs else []:
        disputes[i, j] = disputes[j, i] = True
    some = st.sets(st.integers(0, a - 1), max_size=2)
    lying = draw(some)
    return disputes, lying, draw(some) - lying


def graph_of(a: int, pairs: list[tuple[int, int]]) -> Bools:
    disputes = np.zeros((a, a), np.bool_)
    for one, other in pairs:
        disputes[one, other] = disputes[other, one] = True
    return disputes


def built(disputes: Bools, *known: set[int]) -> Explanations:
    lying, honest = (np.isin(np.arange(len(disputes)), list(each)) for each in (*known, set(), set())[:2])
    return Explanations(disputes, lying, honest)


@given(graphs())
def test_an_agent_lies_if_it_does_in_every_explanation(graph: Graph) -> None:
    disputes, lying, honest = graph
    every = explanations(disputes, lying, honest)
    verdict = built(disputes, lying, honest).verdict()
    expected = set.intersection(*every) if every else lying
    assert set(np.flatnonzero(verdict.lying).tolist()) == expected


@given(graphs())
def test_it_is_open_whether_an_agent_lies_that_only_some_explanations_need(graph: Graph) -> None:
    disputes, lying, honest = graph
    every = explanations(disputes, lying, honest)
    smallest = [each for each in every if not any(other < each for other in every)]  # nobody is in it without need
    certain = set.intersection(*every) if every else lying
    needed = set.union(*smallest) if smallest else set(np.flatnonzero(disputes.any(axis=0)).tolist()) - honest
    verdict = built(disputes, lying, honest).verdict()
    assert set(np.flatnonzero(verdict.undecided).tolist()) == needed - certain


@given(graphs(), st.data())
def test_a_claim_is_false_if_all_that_make_it_lie_in_every_explanation(graph: Graph, data: st.DataObject) -> None:
    disputes, lying, honest = graph
    a = len(disputes)
    claiming = data.draw(st.sets(st.integers(0, a - 1)))
    denying = data.draw(st.sets(st.integers(0, a - 1))) - claiming
    every = explanations(disputes, lying, honest)
    # One side lies in each explanation that counts here.
    wrong = any(claiming <= each for each in every)
    right = any(denying <= each and not claiming <= each for each in every)
    expected = wrong and not right if every else claiming <= lying - honest
    sides = (np.isin(np.arange(a), list(group))[None] for group in (claiming, denying))
    assert built(disputes, lying, honest).false(*sides).tolist() == [expected]


@pytest.mark.parametrize("density", [0.1, 0.2, 0.3, 0.5])
def test_the_disputes_of_many_agents_are_judged_within_the_limit(density: float) -> None:
    random = np.random.default_rng(0)
    disputes = np.triu(random.random((40, 40)) < density, 1)
    found = built(disputes | disputes.T)
    found.verdict()
    assert found.branches_left >= 0


def test_a_search_that_took_too_long_does_not_weaken_the_next_one() -> None:
    disputes = graph_of(5, [(0, 1), (0, 2), (0, 3)])
    nobody = np.zeros(5, np.bool_)
    found = Explanations(disputes, nobody, nobody, branches=3)
    claims = np.eye(5, dtype=np.bool_)[:1].repeat(20, axis=0)
    for _ in range(3):
        assert found.false(claims, np.zeros((20, 5), np.bool_)).all()
        assert found.verdict().lying.tolist() == [True, False, False, False, False]


def test_where_no_explanation_exists_the_weakest_disputes_are_left_out() -> None:
    disputes = ~np.eye(3, dtype=np.bool_)
    nobody = np.zeros(3, np.bool_)
    strength = np.array([[0.0, 3.0, 2.0], [3.0, 0.0, 1.0], [2.0, 1.0, 0.0]])
    assert not Explanations(disputes, nobody, nobody).possible()
    verdict = explained(disputes, strength, nobody, nobody).verdict()
    assert verdict.lying.tolist() == [True, False, False]
    assert verdict.undecided.tolist() == [False, True, True]  # what they disagree about is left out


def test_disputes_of_one_strength_are_left_out_together() -> None:
    """Which agents lie must not depend on their names."""
    strength = np.ones((5, 5))
    nobody = np.zeros(5, np.bool_)
    disputes = graph_of(5, [(0, 1), (3, 0), (3, 1), (3, 2), (4, 0), (4, 1), (4, 2)])
    verdict = explained(disputes, strength, nobody, nobody).verdict()
    assert not verdict.lying.any()
    assert verdict.undecided.all()
    strength[0, 1] = strength[1, 0] = 0.5
    assert np.flatnonzero(explained(disputes, strength, nobody, nobody).verdict().lying).tolist() == [3, 4]


@given(graphs(), st.data())
def test_the_names_of_agents_do_not_matter(graph: Graph, data: st.DataObject) -> None:
    disputes, lying, honest = graph
    a = len(disputes)
    order = np.array(data.draw(st.permutations(range(a))), np.int64)
    strength = np.array(data.draw(st.lists(st.integers(0, 3), min_size=a * a, max_size=a * a))).reshape(a, a)
    strength = np.maximum(strength, strength.T).astype(np.float64)
    flags = [np.isin(np.arange(a), list(each)) for each in (lying, honest)]
    verdict = explained(disputes, strength, *flags).verdict()
    renamed = np.ix_(order, order)
    other = explained(disputes[renamed], strength[renamed], *(each[order] for each in flags)).verdict()
    assert other.lying.tolist() == verdict.lying[order].tolist()
    assert other.undecided.tolist() == verdict.undecided[order].tolist()


@given(graphs())
def test_the_strongest_disputes_have_an_explanation_unless_half_of_the_agents_are_known_to_lie(graph: Graph) -> None:
    disputes, lying, honest = graph
    flags = [np.isin(np.arange(len(disputes)), list(each)) for each in (lying, honest)]
    found = explained(disputes, np.ones(disputes.shape), *flags)
    assert found.possible() == bool(explanations(np.zeros_like(disputes), lying, honest))


def test_a_search_that_would_take_too_long_finds_nobody_guilty() -> None:
    a = 60
    random = np.random.default_rng(0)
    disputes = np.triu(random.random((a, a)) < 0.05, 1)
    nobody = np.zeros(a, np.bool_)
    short, long = (Explanations(disputes | disputes.T, nobody, nobody, **more) for more in ({}, {"branches": 10**6}))
    assert not short.verdict().lying.any()
    assert short.branches_left < 0
    assert long.verdict().lying.any()
