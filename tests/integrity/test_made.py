"""`Made`: agents whose boxes match the ego's too badly are left out."""

from collections.abc import Sequence
from itertools import permutations
from math import pi

import numpy as np
import plain_boxes as plain
import pytest
from hypothesis import given
from hypothesis import strategies as st
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import Batch, Made
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.calibration import MATCH_LOSSES
from mast_zenoh.integrity.made import conformal, discovered, enclosing_area, giou_loss, match_loss, match_losses

AGENTS = ("a", "b", "c", "d", "ego")
CARS = ((9.0, 9.0), (-9.0, 9.0), (9.0, -9.0))


def enclosing(one: plain.Box, other: plain.Box, turns: int = 20_000) -> float:
    """m² of the smallest rectangle around two outlines, of a great many that are turned."""
    points = np.array([*plain.outline(one), *plain.outline(other)])
    angle = np.arange(turns) * (0.5 * pi / turns)
    along = points @ np.array([np.cos(angle), np.sin(angle)])
    across = points @ np.array([-np.sin(angle), np.cos(angle)])
    return float((np.ptp(along, axis=0) * np.ptp(across, axis=0)).min())


def plain_loss(one: plain.Box, other: plain.Box, around: float | None = None) -> float:
    """1 - IoU + share of the enclosing box in neither box."""
    top, bottom = ([box[2] + sign * 0.5 * box[5] for box in (one, other)] for sign in (1, -1))
    common = plain.intersection(one, other) * max(min(top) - max(bottom), 0.0)
    union = one[3] * one[4] * one[5] + other[3] * other[4] * other[5] - common
    hull = (enclosing(one, other) if around is None else around) * (max(top) - min(bottom))
    return 1.0 - common / union + (hull - union) / hull


@given(one=plain.boxes, other=plain.boxes)
def test_the_enclosing_rectangle_is_the_smallest_of_all_turned_ones(one: plain.Box, other: plain.Box) -> None:
    a, b = plain.boxes_of([one]), plain.boxes_of([other])
    (found,) = enclosing_area(a, b, (b.position - a.position)[:, :2]).tolist()
    best = enclosing(one, other)
    assert found <= best * (1.0 + 1e-9)
    assert found == pytest.approx(best, rel=2e-3)


@given(one=plain.boxes, other=plain.boxes)
def test_the_loss_of_a_pair_is_the_formula(one: plain.Box, other: plain.Box) -> None:
    (found,) = giou_loss(plain.boxes_of([one]), plain.boxes_of([other])).tolist()
    assert found == pytest.approx(plain_loss(one, other), abs=4e-3)
    assert -1e-9 <= found <= 2.0


scored = st.lists(st.tuples(plain.boxes, st.floats(0.0, 1.0)), max_size=4)


def transcribed(theirs: Sequence[tuple[plain.Box, float]], mine: Sequence[tuple[plain.Box, float]]) -> float:
    """The match loss, with all matchings tried: `mine` are the targets."""
    m, n = len(theirs), len(mine)
    size = max(m, n)
    around = [
        [enclosing_area(plain.boxes_of([box]), plain.boxes_of([to]), np.array([[to[0] - box[0], to[1] - box[1]]]))[0]
         for to, _ in mine]
        for box, _ in theirs
    ]  # fmt: skip

    def cost(i: int, j: int) -> float:
        if j >= n:
            return 0.0
        target, target_score = mine[j]
        if i >= m:
            return target_score + 1.0
        box, score = theirs[i]
        return max(0.0, target_score - score) + plain_loss(box, target, around[i][j])

    return min(sum(cost(i, j) for i, j in enumerate(to)) for to in permutations(range(size))) / n


@given(theirs=scored, mine=st.lists(st.tuples(plain.boxes, st.floats(0.0, 1.0)), min_size=1, max_size=4))
def test_the_match_loss_is_the_least_of_all_matchings(theirs, mine):
    sets = [(plain.boxes_of([box for box, _ in each]), np.array([s for _, s in each])) for each in (theirs, mine)]
    assert match_loss(*sets[0], *sets[1]) == pytest.approx(transcribed(theirs, mine), abs=1e-6)


@given(
    values=st.lists(st.floats(0.0, 3.0), max_size=8),
    calibration=st.lists(st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0]), min_size=1, max_size=30),
)
def test_the_p_value_counts_calibration_losses_that_are_as_great(values: list[float], calibration: list[float]) -> None:
    expected = [(sum(loss >= x for loss in calibration) + 1) / (len(calibration) + 1) for x in values]
    assert conformal(np.array(values), np.sort(calibration)).tolist() == pytest.approx(expected)


@given(p=st.lists(st.floats(1e-6, 1.0), max_size=9), alpha=st.sampled_from([0.01, 0.05, 0.3]), dependent=st.booleans())
def test_the_rejected_are_those_up_to_the_last_below_its_limit(p: list[float], alpha: float, dependent: bool) -> None:
    n = len(p)
    constant = sum(1.0 / k for k in range(1, n + 1)) if dependent else 1.0
    passed = [k for k in range(1, n + 1) if sorted(p)[k - 1] <= alpha * k / (n * constant) * (1.0 - 1e-12)]
    near = [k for k in range(1, n + 1) if sorted(p)[k - 1] <= alpha * k / (n * constant) * (1.0 + 1e-12)]
    found = discovered(np.array(p), alpha, dependent=dependent)
    limits = {sorted(p)[each[-1] - 1] if each else -1.0 for each in (passed, near)}
    assert found.tolist() in [[value <= limit for value in p] for limit in limits]


@given(number=st.integers(0, 10_000), agents=st.integers(1, 5), objects=st.integers(0, 4))
def test_the_losses_of_a_batch_without_views_are_those_of_all_boxes(number: int, agents: int, objects: int) -> None:
    each = plain.random_batch(number, agents, objects, viewed=False)
    found = match_losses(each, 0, 32.0)

    def tracks(agent: int) -> list[tuple[plain.Box, float]]:
        states, rows = each.states, np.flatnonzero(each.agent == agent)
        columns = np.column_stack([states.position, states.size, states.yaw])[rows].tolist()
        return [(tuple(row), float(score)) for row, score in zip(columns, states.score[rows], strict=True)]

    assert np.isnan(found[0]), "the ego is not compared with itself"
    for agent in range(1, agents):
        if tracks(0):
            assert found[agent] == pytest.approx(transcribed(tracks(agent), tracks(0)), abs=1e-6)
        else:
            assert np.isnan(found[agent])


def given_tracks(shift_m: float, *, silent: bool = False, phantoms: int = 0) -> Batch:
    """Five agents that report three cars; b displaces them, or reports none of them, and adds phantoms."""
    tracks: list[Track] = [(name, number, car) for name in AGENTS if name != "b" for number, car in enumerate(CARS)]
    if not silent:
        tracks += [("b", number, (x + shift_m, y)) for number, (x, y) in enumerate(CARS)]
    tracks += [("b", 3 + k, (-25.0 + 6.0 * k, 20.0)) for k in range(phantoms)]
    return batch(tracks, AGENTS, {name: view((0.0, 0.0)) for name in AGENTS})


def left_out(stage: Made, each: Batch) -> set[str]:
    state = stage.assess(each).agents.state
    return {name for name, value in zip(each.agents, state.tolist(), strict=True) if value == SUSPENDED}


CALIBRATION = tuple(np.linspace(0.0, 0.6, 250).tolist())


def test_displaced_or_silent_agents_are_left_out_and_honest_ones_are_not() -> None:
    assert left_out(Made(calibration=CALIBRATION), given_tracks(0.0)) == set()
    assert left_out(Made(calibration=CALIBRATION), given_tracks(3.0)) == {"b"}
    assert left_out(Made(calibration=CALIBRATION), given_tracks(0.0, silent=True)) == {"b"}


def test_phantoms_cost_nothing() -> None:
    assert left_out(Made(calibration=CALIBRATION), given_tracks(0.0, phantoms=9)) == set()


def test_few_calibration_losses_can_reject_nobody() -> None:
    assert left_out(Made(calibration=CALIBRATION[::10]), given_tracks(3.0)) == set(), "1 / 26 is the least p-value"
    assert left_out(Made(calibration=CALIBRATION[::10], dependent=False, alpha=0.2), given_tracks(3.0)) == {"b"}


def test_objects_that_an_agent_does_not_have_in_view_do_not_count_against_it() -> None:
    tracks: list[Track] = [("ego", number, car) for number, car in enumerate(CARS)]
    behind = [(x, y, 4.0) for x, y in ((4.5, 4.5), (-4.5, 4.5), (4.5, -4.5))]
    seeing = {"a": view((0.0, 0.0)), "b": view((0.0, 0.0), *behind), "ego": view((0.0, 0.0))}
    losses = match_losses(batch(tracks, ("a", "b", "ego"), seeing), 2, 32.0)
    assert losses[0] == pytest.approx(2.0), "score 1 and 1 for each box without a partner"
    assert np.isnan(losses[1])
    assert losses[1:].tolist() != losses[:2].tolist()


def test_the_checks_are_the_agents_that_were_compared() -> None:
    stage = Made()
    stage.assess(given_tracks(0.0))
    stage.assess(batch([], AGENTS))
    stage.assess(batch([("a", 0, (0.0, 0.0))], ("a", "b")))
    facts = stage.facts()
    assert (facts["checks"], facts["batches"], facts["batches_without_reference"]) == (4, 2, 1)


def test_the_shipped_losses_can_reject_one_of_five_other_agents_and_not_one_of_six() -> None:
    rarest = conformal(np.array([9.0]), np.sort(MATCH_LOSSES))
    assert discovered(np.append(rarest, np.ones(4)), 0.05, dependent=True)[0]
    assert not discovered(np.append(rarest, np.ones(5)), 0.05, dependent=True).any()
