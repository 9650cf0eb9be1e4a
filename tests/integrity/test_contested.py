"""What few agents report and others see through is open, and limited; what is usual in a run needs more evidence."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from crossing import CAR, Place, world

from mast_zenoh.integrity import Batch, SequentialConsistency
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.existence import CONTESTED, CONTESTED_TIMES, COUNTED_S, ExistenceVotes
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.sequential import CONTRADICTION_TAIL, EXPECTED, MOST_EVIDENCE

#: Cars that two liars of five invent where two honest agents look.
CARS: list[Place] = [(10.0, -12.0), (-8.0, -10.0), (0.0, -8.0), (-10.0, 10.0), (-10.0, 0.0)]
EVERYBODY = np.ones(5, np.bool_)


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


def test_of_what_two_of_five_report_and_two_others_see_through_few_objects_are_believed() -> None:
    contested = 4  # of the other one, only one agent has a free view
    assert withheld("ae", "bd", "bc", "bd", "bcd", "bcd").sum() == contested - CONTESTED


def test_what_two_of_five_report_and_one_sees_through_is_believed_whoever_that_is() -> None:
    """It may be one of two liars that share the objects between them."""
    assert not withheld("ae", "b", "d", "b", "c", "d").any()


def test_what_two_of_five_report_and_nobody_sees_through_is_believed() -> None:
    assert not withheld("ae", "").any()


def test_what_more_than_half_of_the_agents_report_is_not_limited() -> None:
    assert not withheld("ace", "b").any()


def test_real_objects_that_few_agents_see_are_not_limited_by_two_of_five_that_deny_them_all() -> None:
    sees = dict(zip(CARS, ("abe", "abe", "ace", "ace", "ade"), strict=True))
    cars = [CAR, *CARS]
    assert not withheld_of(world(hidden=dict.fromkeys("ae", CARS), cars=cars, sees=sees, frames=8)).any()


@pytest.mark.parametrize(("agents", "usual"), [(2, 0.0), (3, 3.0)])
def test_as_many_contested_objects_are_believed_as_the_middle_of_the_agents_has(agents: int, usual: float) -> None:
    memory = AgentMemory(suspended=False, misdescribes=False, **ExistenceVotes.COLUMNS)
    memory.meet(0, tuple("abcde"))
    memory.of.contested[:agents] = 3.0
    most = ExistenceVotes(memory)._most_contested(EVERYBODY)
    assert most.tolist() == [CONTESTED + CONTESTED_TIMES * usual] * 5


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


def test_one_object_adds_less_than_an_alarm_of_any_number_of_agents_takes() -> None:
    stage = SequentialConsistency()
    least = CONTRADICTION_TAIL.value_at(stage.false_alarms_per_hour / 4)
    assert COUNTED_S * (1.0 - stage.allowance) < least
