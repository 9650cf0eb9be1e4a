"""Disputes are settled jointly: who lies in every explanation is suspended; what stays open is limited."""

from collections.abc import Iterable

import numpy as np
import pytest
from crossing import CAR, PLACES, Place, later, world
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import Batch, FaultOrLie, SequentialConsistency
from mast_zenoh.integrity.base import STATES, SUSPENDED, TRUSTED, UNDECIDED, Assessment
from mast_zenoh.integrity.existence import ALONE, FEW, FEW_TIMES, SUDDEN
from mast_zenoh.integrity.sequential import EXPECTED, MOST_EVIDENCE

#: Places of phantoms. One alone suspends nobody, two do.
NORTH, WEST, SOUTH, SOUTHWEST = (0.0, 8.0), (-4.0, 8.0), (0.0, -8.0), (-10.0, -3.0)
TWO = [SOUTH, SOUTHWEST]


def last(stage: SequentialConsistency, batches: Iterable[Batch]) -> Assessment:
    *_, assessment = (stage.assess(each) for each in batches)
    return assessment


def suspended(assessment: Assessment) -> str:
    return "".join(np.array(sorted(PLACES))[assessment.agents.state == SUSPENDED])


def test_one_phantom_that_stays_is_withheld_and_suspends_nobody() -> None:
    stage = SequentialConsistency()
    for each in world({"a": [SOUTH]}, sees={SOUTH: "bcd"}, frames=150):
        found = stage.assess(each)
        assert suspended(found) == ""
        assert found.objects.withheld.tolist() == [False, True]


def test_two_of_five_do_not_and_the_reason_names_both_possibilities() -> None:
    found = last(SequentialConsistency(), world({"a": [SOUTH]}, sees={SOUTH: "bd"}))
    assert suspended(found) == ""
    assert found.agents.state.tolist() == [UNDECIDED, UNDECIDED, TRUSTED, UNDECIDED, TRUSTED]
    assert "either it lies" in found.agents.reason[0]
    assert not found.objects.withheld.any(), "two may be lying: then it is a real object"


def test_disputes_about_different_objects_add_up_to_a_proof() -> None:
    phantoms = [(14.0, -12.0), (-8.0, 12.0), (-8.0, -14.0), (14.0, -18.0), (-14.0, 12.0), (-14.0, -14.0)]
    one_each = dict(zip(phantoms, "bcdbcd", strict=True))
    found = last(SequentialConsistency(), world({"a": phantoms}, sees=one_each))
    assert suspended(found) == "a"


def test_two_that_claim_free_space_where_one_reports_a_car_suspend_nobody_and_hide_nothing() -> None:
    car = (0.0, -8.0)
    found = last(SequentialConsistency(), world(hidden={"a": [car], "b": [car]}, cars=[CAR, car], sees={car: "abe"}))
    assert suspended(found) == ""
    assert not found.objects.withheld.any()


@pytest.mark.parametrize("own_range_m", [100.0, 10.0], ids=["in free space", "out of view"])
def test_what_an_agents_own_sensor_cannot_have_seen_is_withheld_and_suspends_nobody(own_range_m: float) -> None:
    stage = SequentialConsistency()
    for frame in range(50):
        tracks: list[Track] = [("a", row, place) for row, place in enumerate(TWO)]
        found = stage.assess(batch(tracks, tuple(PLACES), {"a": view(PLACES["a"], max_range=own_range_m)}, frame=frame))
        assert suspended(found) == ""
        assert found.objects.withheld.all()


def test_an_anchor_is_believed_against_each_and_never_suspended() -> None:
    accused = world({"a": TWO}, sees=dict.fromkeys(TWO, "b"))
    assert suspended(last(SequentialConsistency(anchors=("b",)), accused)) == "a"
    accuser = world({"a": TWO}, sees=dict.fromkeys(TWO, "bcd"))
    assert "a" not in suspended(last(SequentialConsistency(anchors=("a",)), accuser))


def test_once_one_liar_is_known_two_accusers_prove_the_next() -> None:
    stage = SequentialConsistency()
    others = [(-12.0, -12.0), (12.0, -10.0), (-12.0, -6.0)]
    sees = dict.fromkeys(TWO, "bcd") | dict.fromkeys(others, "bc")
    assert suspended(last(stage, world({"a": TWO}, sees=sees))) == "a"
    assert suspended(last(stage, later(world({"a": TWO, "e": others}, sees=sees), 50))) == "ae"


CROWD = [(10.0 + 6.0 * (i % 5), -12.0 - 6.0 * (i // 5)) for i in range(15)]


def test_an_agent_alone_may_report_as_many_objects_as_honest_ones_have_at_most() -> None:
    found = last(SequentialConsistency(), world({"a": CROWD}, sees=dict.fromkeys(CROWD, ""), frames=15))
    assert suspended(found) == ""
    assert not found.objects.withheld[0], "the car that all see"
    assert found.objects.withheld.sum() == len(CROWD) - ALONE


def test_objects_that_an_agent_suddenly_reports_alone_are_fewer_if_it_had_none_before() -> None:
    stage = SequentialConsistency()
    last(stage, world())
    crowded = later(world({"a": CROWD}, sees=dict.fromkeys(CROWD, ""), frames=3), 50)
    assert last(stage, crowded).objects.withheld.sum() == len(CROWD) - SUDDEN


def test_liars_that_move_the_middle_box_of_an_object_do_not_make_honest_agents_contradict_each_other() -> None:
    stage, cars = SequentialConsistency(), [CAR, (-6.0, 12.0), (-12.0, -12.0)]
    # Two of the three that report a car report it in the air, where the other two see nothing.
    for each in world(hidden={"d": [CAR], "e": [CAR]}, cars=cars):
        position = each.states.position.copy()
        position[np.isin(each.agent, [1, 2]) & (each.labels == 0), 2] += 2.5
        lifted = each.states.with_(position=position)
        found = stage.assess(Batch(each.time_ns, lifted, each.agent, each.labels, each.agents, each.views))
    assert found.agents.state.tolist() == [TRUSTED] + 4 * [UNDECIDED], "either two lie, but not the honest reporter"


def test_of_a_suspended_agent_as_many_unseen_objects_are_believed_as_it_had_before() -> None:
    stage = SequentialConsistency()
    usual, new = (-40.0, 40.0), (-40.0, -40.0)
    sees = dict.fromkeys(TWO, "bcd") | {usual: "a", new: ""}
    last(stage, world(cars=[CAR, usual], sees=sees))
    found = last(stage, later(world({"a": [*TWO, new]}, cars=[CAR, usual], sees=sees), 50))
    assert suspended(found) == "a"
    assert found.objects.withheld.tolist() == [False, False, True, True, True], "what it alone saw before stays"


@pytest.mark.parametrize("wrong", ["a", "ab"])
def test_agents_whose_tracks_are_all_displaced_are_corrected_and_keep_their_vote(wrong: str) -> None:
    cars = [CAR, (-6.0, 12.0), (-12.0, -12.0), (12.0, -8.0)]
    stage = FaultOrLie()
    for each in world(cars=cars, frames=60):
        position = each.states.position.copy()
        position[np.isin(np.array(each.agents)[each.agent], list(wrong)), 0] += 1.2
        displaced = each.states.with_(position=position)
        views = {name: view for name, view in zip(each.agents, each.views, strict=True) if view is not None}
        states, views = stage.correct(each.time_ns, displaced, each.agent, each.agents, views)  # type: ignore[assignment]
        found = stage.assess(
            Batch(each.time_ns, states, each.agent, each.labels, each.agents, tuple(map(views.get, each.agents)))
        )
    assert [STATES[state] for state in found.agents.state.tolist()] == [
        "faulty" if name in wrong else "trusted" for name in PLACES
    ]
    assert found.agents.offset[0].tolist() == pytest.approx([1.2, 0.0], abs=0.1)
    assert found.agents.reason[0].startswith("all its tracks")
    assert states.position[each.agent == 0, 0] == pytest.approx(each.states.position[each.agent == 0, 0], abs=0.15)


def test_one_that_denies_cannot_remove_what_two_report_once_others_are_suspended() -> None:
    stage = SequentialConsistency()
    phantoms = [WEST, SOUTHWEST]
    *_, before = (
        stage.assess(each) for each in world(dict.fromkeys("ab", phantoms), sees=dict.fromkeys(phantoms, "cde"))
    )
    assert suspended(before) == "ab"
    views = {name: view(place, *([] if name == "d" else [(*CAR, 2.5)])) for name, place in PLACES.items()}
    for frame in range(50, 70):
        found = stage.assess(batch([("c", 0, CAR), ("e", 0, CAR)], tuple(PLACES), views, frame=frame))
    assert not found.objects.withheld.any()


def test_what_a_suspended_agent_denies_is_no_evidence_against_others() -> None:
    stage = SequentialConsistency()
    list(map(stage.assess, world({"a": TWO}, sees=dict.fromkeys(TWO, "bcd"))))
    *_, found = (stage.assess(each) for each in later(world(hidden={"a": [CAR]}), 50))
    assert found.agents.state[0] == SUSPENDED
    assert (found.agents.log_odds[1:] > 5.0).all()


def test_a_dispute_is_forgotten_while_an_agent_is_away() -> None:
    stage = SequentialConsistency()
    list(map(stage.assess, world({"a": [SOUTH]}, sees={SOUTH: "bd"})))
    others = {name: place for name, place in PLACES.items() if name != "a"}
    views = {name: view(place, (*CAR, 2.5)) for name, place in others.items()}
    for frame in range(50, 250):
        stage.assess(batch([(name, 0, CAR) for name in others], tuple(others), views, frame=frame))
    found = stage.assess(next(iter(later(world(), 250))))
    assert UNDECIDED not in found.agents.state


def test_the_reason_is_what_was_most_often_seen_and_not_what_is_seen_last() -> None:
    stage, sees = SequentialConsistency(), dict.fromkeys(TWO, "bcd")
    *_, found = (stage.assess(each) for each in world({"a": TWO}, sees=sees, frames=36))
    assert suspended(found) == ""
    stage.await_faults(frozenset("a"))
    *_, found = (stage.assess(each) for each in later(world({"a": TWO}, sees=sees, frames=8), 36))
    assert suspended(found) == ""
    stage.await_faults(frozenset())
    *_, found = (stage.assess(each) for each in later(world(frames=3), 44))
    assert found.agents.reason[0].startswith("reports objects that")


def test_contradictions_that_begin_all_at_once_are_judged_when_a_fault_could_have_been_found() -> None:
    places = [(-14.0 + 4.0 * column, y) for column in range(7) for y in (-12.0, -8.0)]
    batches = list(world({"a": places}, sees=dict.fromkeys(places, "bcd"), frames=22))
    stage = SequentialConsistency()
    assert 15 <= [suspended(stage.assess(each)) for each in batches].index("a") <= 18


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
