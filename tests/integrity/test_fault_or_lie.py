"""A pose error or a wrong clock is corrected, and the agent keeps its vote; a lie is not excused."""

import numpy as np
import pytest
from integrity_batches import CAR, STEP_NS, VARIANCE

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import Batch, FaultOrLie, NoIntegrity
from mast_zenoh.integrity.base import FAULTY, SUSPENDED
from mast_zenoh.integrity.deviations import without_fault

AGENTS = ("a", "b", "c", "d")


def seen_by(
    agents: int, place: np.ndarray, speed: np.ndarray, frame: int, random: np.random.Generator
) -> tuple[ObjectStates, np.ndarray, np.ndarray]:
    """The tracks of cars that all of some agents see, with errors of 0.15 m; the agent and the car of each."""
    cars = len(place)
    n = agents * cars
    true = np.column_stack([place + speed * 0.1 * frame, np.full(cars, 0.75)])
    labels = np.tile(np.arange(cars), agents)
    states = ObjectStates.of(
        np.tile(true, (agents, 1)) + np.column_stack([random.normal(0.0, 0.15, (n, 2)), np.zeros(n)]),
        id=labels,
        velocity=np.column_stack([np.tile(speed, (agents, 1)), np.zeros(n)]),
        size=np.tile(CAR, (n, 1)),
        covariance=np.tile(np.diag(VARIANCE), (n, 1, 1)),
    )
    return states, np.repeat(np.arange(agents), cars), labels


def judged(stage: FaultOrLie, frame: int, states: ObjectStates, agent, labels, names: tuple[str, ...]):
    """The stage's trust in agents without views."""
    states, _ = stage.correct(frame * STEP_NS, states, agent, names, {})
    return stage.assess(Batch(frame * STEP_NS, states, agent, labels, names, (None,) * len(names))).agents


def assessed(fault: tuple[float, float, float, float], lies: int = 0, frames: int = 60, standing: int = 0):
    """Four agents that all see twelve cars, most of them moving; `d` has a fault and moves some tracks by 1.5 m."""
    random = np.random.default_rng(3)
    place, speed = random.uniform(-60.0, 60.0, (12, 2)), random.uniform(-12.0, 12.0, (12, 2))
    speed[:standing] = 0.0
    stage = FaultOrLie()
    for frame in range(frames):
        states, agent, labels = seen_by(4, place, speed, frame, random)
        states = without_fault(states, agent == 3, -np.array(fault), states.position[agent == 3, :2].mean(axis=0))
        moved = states.position.copy()
        moved[(agent == 3) & (labels < lies), 0] += 1.5
        states = states.with_(position=moved)
        last = judged(stage, frame, states, agent, labels, AGENTS)
    return last


@pytest.mark.parametrize(
    "fault", [(0.6, 0.0, 0.0, 0.0), (2.0, -1.0, 0.0, 0.0), (0.0, 0.0, 0.03, 0.0), (0.0, 0.0, 0.0, 0.15)]
)
def test_a_fault_is_found_corrected_and_not_punished(fault: tuple[float, float, float, float]) -> None:
    found = assessed(fault)
    assert found.state.tolist()[3] == FAULTY
    assert SUSPENDED not in found.state
    measured = [*found.offset[3], found.turn[3], -found.delay[3]]
    assert measured == pytest.approx(fault, abs=0.15)
    assert "all its tracks" in found.reason[3]


def test_a_wrong_clock_is_found_although_most_objects_stand() -> None:
    found = assessed((0.0, 0.0, 0.0, 0.15), standing=9)
    assert found.state.tolist() == [found.state[0]] * 3 + [FAULTY]
    assert -found.delay[3] == pytest.approx(0.15, abs=0.05)


@pytest.mark.parametrize("fault", [(0.0, 0.0, 0.0, 0.0), (1.0, 0.5, 0.0, 0.0)])
def test_moving_some_objects_is_a_lie_and_a_fault_does_not_excuse_it(fault):
    found = assessed(fault, lies=2)
    assert (found.state == SUSPENDED).tolist() == [False, False, False, True]


@pytest.mark.parametrize("shift", [(1.0, 0.5), (0.7, 0.4)])
def test_two_that_move_all_their_tracks_alike_blame_no_other(shift: tuple[float, float]) -> None:
    random = np.random.default_rng(4)
    names, cars = ("a", "b", "c", "d", "e"), 10
    place, speed = random.uniform(-60.0, 60.0, (cars, 2)), random.uniform(-12.0, 12.0, (cars, 2))
    stage = FaultOrLie()
    for frame in range(60):
        states, agent, labels = seen_by(5, place, speed, frame, random)
        states.position[agent >= 3, :2] += shift
        # An honest agent shares more of its objects with the two than with the other honest ones.
        shared = (agent > 0) | (labels < 6)
        rows = np.flatnonzero(shared & ~((agent == 1) & (labels < 4)))
        states, of_rows = states.select(rows), agent[rows]
        last = judged(stage, frame, states, of_rows, labels[rows], names)
    assert (last.state == FAULTY).tolist() == [False, False, False, True, True]
    assert SUSPENDED not in last.state


def test_agents_that_left_or_send_no_tracks_do_not_disturb_the_search_for_a_fault() -> None:
    random = np.random.default_rng(5)
    cars = 10
    place = random.uniform(-60.0, 60.0, (cars, 2))
    stage = FaultOrLie()
    for frame in range(90):
        early = frame < 40
        names = ("a", "b", "c", "d", "e", "f") if early else ("a", "d", "e", "f")
        senders = [row for row in range(len(names)) if early or names[row] != "a"]
        states, agent, labels = seen_by(len(senders), place, np.zeros((cars, 2)), frame, random)
        agent = np.array(senders)[agent]
        if not early:
            states.position[agent == names.index("f"), 0] += 1.0
        last = judged(stage, frame, states, agent, labels, names)
    assert (last.state == FAULTY).tolist() == [False, False, False, True]


def test_a_displacement_that_comes_and_goes_excuses_once_in_a_minute() -> None:
    excused: list[str] = []

    class Judge(NoIntegrity):
        def excuse(self, agent: str) -> None:
            excused.append(agent)

    random = np.random.default_rng(6)
    place, speed = random.uniform(-60.0, 60.0, (12, 2)), random.uniform(-12.0, 12.0, (12, 2))
    stage, found = FaultOrLie(stage=Judge()), []
    for frame in range(300):
        states, agent, _ = seen_by(4, place, speed * 0.0, frame, random)
        states.position[agent == 3, 0] += 1.5 * (frame // 50 % 2)
        corrected, _ = stage.correct(frame * STEP_NS, states, agent, AGENTS, {})
        found.append(corrected is not states)
    assert np.diff(np.array(found, np.int64)).tolist().count(1) >= 2, "the fault was found several times"
    assert excused == ["d"]


def test_the_order_of_the_rows_does_not_matter_where_no_views_are_known() -> None:
    random = np.random.default_rng(7)
    place, speed = random.uniform(-60.0, 60.0, (12, 2)), random.uniform(-12.0, 12.0, (12, 2))
    one, other = FaultOrLie(), FaultOrLie()
    for frame in range(40):
        states, agent, _ = seen_by(4, place, speed, frame, random)
        states.position[agent == 3, 0] += 1.5
        order = random.permutation(len(agent))
        corrected, _ = one.correct(frame * STEP_NS, states, agent, AGENTS, {})
        shuffled, _ = other.correct(frame * STEP_NS, states.select(order), agent[order], AGENTS, {})
        assert np.array_equal(corrected.position[order], shuffled.position)
    assert not np.array_equal(corrected.position, states.position), "the fault was found"


def test_faults_are_corrected_once() -> None:
    with pytest.raises(ValueError, match=r"stage.*FaultOrLie.*another"):
        FaultOrLie(stage=FaultOrLie())


def test_what_agents_say_about_whom_they_trust_reaches_the_stage_in_it() -> None:
    heard = []

    class Listening(NoIntegrity):
        def hear(self, listener: str, trusts: object) -> None:
            heard.append((listener, trusts))

    FaultOrLie(stage=Listening()).hear("a", {"b": {"c": 0.2}})
    assert heard == [("a", {"b": {"c": 0.2}})]
