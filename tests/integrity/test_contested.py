"""What few agents report and others see through is open, and limited; what is usual in a run needs more evidence."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from crossing import CAR, Place, later, world

from mast_zenoh.integrity import Batch, SequentialConsistency
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.existence import FEW, FEW_TIMES
from mast_zenoh.integrity.sequential import EXPECTED, MOST_EVIDENCE

#: Cars that two liars of five invent where two honest agents look.
CARS: list[Place] = [(10.0, -12.0), (-8.0, -10.0), (0.0, -8.0), (-10.0, 10.0), (-10.0, 0.0)]


def withheld(liars: str, *lookers: str) -> np.ndarray:
    """(5,) which of CARS are withheld after some frames in which liars report them.

    lookers: agents that see through them, of all cars or of each
    """
    sees = dict(zip(CARS, lookers * (len(CARS) // len(lookers)), strict=True))
    return withheld_of(world(dict.fromkeys(liars, CARS), sees=sees, frames=8))


def withheld_of(batches: Iterable[Batch]) -> np.ndarray:
    """(5,) which of CARS are withheld after some batches."""
    stage = SequentialConsistency()
    for each in batches:
        found = stage.assess(each)
    assert SUSPENDED not in found.agents.state
    assert not found.objects.withheld[0], "the car that all see"
    return found.objects.withheld[1:]


def test_of_what_two_of_five_report_and_others_see_through_few_objects_are_believed() -> None:
    assert (~withheld("ae", "b", "d", "bd", "bc", "d")).sum() == FEW


def test_what_two_of_five_report_and_nobody_sees_through_is_believed() -> None:
    assert not withheld("ae", "").any()


def test_what_more_than_half_of_the_agents_report_is_not_limited() -> None:
    assert not withheld("ace", "b").any()


def test_real_objects_that_few_agents_see_are_not_limited_by_two_of_five_that_deny_them_all() -> None:
    sees = dict(zip(CARS, ("abe", "abe", "ace", "ace", "ade"), strict=True))
    cars = [CAR, *CARS]
    assert not withheld_of(world(hidden=dict.fromkeys("ae", CARS), cars=cars, sees=sees, frames=8)).any()


def test_what_an_agent_sees_with_few_others_is_believed_when_two_of_five_begin_to_deny_it() -> None:
    sees = dict.fromkeys(CARS, "abe")
    cars = [CAR, *CARS]
    honest = list(world(cars=cars, sees=dict.fromkeys(CARS, "b"), frames=30))
    denied = world(hidden=dict.fromkeys("ae", CARS), cars=cars, sees=sees, frames=8)
    assert not withheld_of([*honest, *later(denied, len(honest))]).any()


def test_what_an_agent_reports_with_few_others_counts_against_what_it_invents() -> None:
    sees, own = dict(zip(CARS, ("a", "a", "a", "b", "b"), strict=True)), CARS[:3]
    honest = list(world(cars=[CAR, *own], sees=sees, frames=30))
    lies = world({"a": CARS[3:]}, cars=[CAR, *own], sees=sees, frames=8)
    usual = len(own)
    found = withheld_of([*honest, *later(lies, len(honest))])
    assert not found[:usual].any()
    assert (~found).sum() == min(len(CARS), int(FEW + FEW_TIMES * usual))


def accustomed(usual: float, agents: int) -> SequentialConsistency:
    """A stage that has seen so many agents of five contradicted about `usual` objects at a time."""
    stage = SequentialConsistency()
    stage.assess(next(iter(world())))
    stage._of.usual[stage._agents.rows[:agents]] = usual
    return stage


@pytest.mark.parametrize(("usual", "times"), [(0.0, 1.0), (3 * EXPECTED, 3.0), (100.0, MOST_EVIDENCE)])
def test_alarms_widen_with_what_is_usual_among_the_agents_up_to_a_limit(usual: float, times: float) -> None:
    stage = accustomed(usual, 3)
    assert stage._evidence_factor(stage._agents.rows) == pytest.approx(times)
    stage = accustomed(usual, 2)
    assert stage._evidence_factor(stage._agents.rows) == 1.0, "two of five cannot widen them"


def test_a_liar_is_suspended_later_where_contradictions_are_usual() -> None:
    cars = CARS[:3]
    batches = list(world({"a": cars}, sees=dict.fromkeys(cars, "bcd"), frames=45))
    first = []
    for usual in (EXPECTED, 4 * EXPECTED):
        stage = accustomed(usual, 5)
        first.append([stage.assess(each).agents.state[0] for each in batches].index(SUSPENDED))
    assert first[0] < first[1] < 2.5 * first[0]
