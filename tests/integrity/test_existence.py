"""What was refuted, or hung on to another object, is doubted for a while when the evidence becomes weaker; and liars
cannot turn that against honest agents."""

import numpy as np
import pytest
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import SequentialConsistency
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.disputes import Evidence, Explanations
from mast_zenoh.integrity.existence import ExistenceVotes
from mast_zenoh.integrity.memory import AgentMemory, ObjectMemory

AGENTS = tuple("abcde")
PLACES = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0), "d": (0.0, -20.0), "e": (15.0, 15.0)}
PERSON = (0.6, 0.6, 1.7)
AT_BUMPER = (3.0, 0.0)


def car_and_person(frame: int, speed_mps: float, reporting: str) -> Batch:
    """A car that four of five agents report, and a person at its bumper; nobody sees through anything."""
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in "abcd"] + [(name, 1, AT_BUMPER) for name in reporting]
    return batch(tracks, AGENTS, velocity=dict.fromkeys((0, 1), (speed_mps, 0.0)), size={1: PERSON}, frame=frame)


@pytest.mark.parametrize(("speed_mps", "believed"), [(8.0, False), (0.0, True)])
def test_who_reported_a_person_that_drives_along_is_not_believed_about_one_at_a_car_that_stands(speed_mps, believed):
    stage = SequentialConsistency()
    for frame in range(5):
        stage.assess(car_and_person(frame, speed_mps, "e"))
    for frame in range(5, 100):
        assert stage.assess(car_and_person(frame, 0.0, "e")).objects.withheld.tolist() == [False, not believed]
    assert not stage.assess(car_and_person(100, 0.0, "ae")).objects.withheld.any(), "another agent sees it, too"


@pytest.mark.parametrize(
    ("reporting", "sensor", "denying", "certain"),
    [
        ("be", (0.0, 0.0), "", True),
        ("be", (0.0, 4.0), "", False),
        ("e", (0.0, 0.0), "", True),
        ("e", (0.0, 0.0), "d", False),
        ("be", (0.0, 0.0), "d", True),
        ("ae", (0.0, 0.0), "", False),
    ],
)
def test_a_car_under_a_sensor_is_certain_if_another_agent_reports_it_and_nobody_denies_it(
    reporting: str, sensor: tuple[float, float], denying: str, certain: bool
) -> None:
    """Nobody reports the car under its own sensor. Where three of five vouch for a car, a denial changes nothing."""
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in reporting] + [("e", 1, AT_BUMPER)]
    drives = dict.fromkeys((0, 1), (8.0, 0.0))
    views = {"a": view(sensor)} | {name: view(PLACES[name]) for name in denying}
    given = batch(tracks, AGENTS, views, velocity=drives, size={1: PERSON})
    assert Evidence.of(given, np.ones(5, np.bool_)).attached.tolist() == [False, certain]


def test_what_three_of_five_refuted_is_doubted_for_ten_seconds_unless_another_agent_reports_it() -> None:
    def ghost(frame: int, looking: str, reporting: str = "e") -> Batch:
        views = {name: view(PLACES[name]) for name in looking}
        return batch([(name, 0, (0.0, 0.0)) for name in reporting], AGENTS, views, frame=frame)

    open_dispute, refuted = SequentialConsistency(), SequentialConsistency()
    for frame in range(10):
        assert not open_dispute.assess(ghost(frame, "a")).objects.withheld[0]
        assert refuted.assess(ghost(frame, "abc")).objects.withheld[0]
    for frame in range(10, 100):
        assert not open_dispute.assess(ghost(frame, "a")).objects.withheld[0]
        assert refuted.assess(ghost(frame, "a")).objects.withheld[0]
    assert not refuted.assess(ghost(100, "a", "de")).objects.withheld[0]
    for frame in range(101, 112):
        found = refuted.assess(ghost(frame, "a"))
    assert not found.objects.withheld[0]


def test_what_is_refuted_for_a_moment_is_not_doubted() -> None:
    stage = SequentialConsistency()
    for frame in range(60):
        views = {name: view(PLACES[name]) for name in ("abc" if frame % 10 == 0 else "a")}
        found = stage.assess(batch([("e", 0, (0.0, 0.0))], AGENTS, views, frame=frame))
    assert not found.objects.withheld[0]


def test_a_box_above_an_object_does_not_take_its_number() -> None:
    memory = ObjectMemory()
    place = np.array([[0.0, 0.0, 0.75]])
    memory.follow(0, place, np.zeros((1, 3)))
    both = np.array([[0.0, 0.0, 6.75], [0.5, 0.0, 0.75]])
    rows = memory.follow(10**8, both, np.zeros((2, 3)))
    assert memory.of.number[rows].tolist() == [1, 0]


@pytest.mark.parametrize("misdescribes", [True, False])
def test_who_is_suspended_for_how_objects_look_is_heard_about_whether_they_exist(misdescribes: bool) -> None:
    agents = AgentMemory(suspended=False, misdescribes=False, **ExistenceVotes.COLUMNS)
    votes = ExistenceVotes(agents)
    given = batch([("e", 0, (0.0, 0.0)), ("a", 1, AT_BUMPER), ("e", 1, AT_BUMPER)], AGENTS)
    rows, suspended = agents.meet(given.time_ns, given.agents), np.arange(5) == 4
    agents.of.suspended[rows], agents.of.misdescribes[rows] = suspended, suspended & misdescribes
    evidence = Evidence.of(given, ~suspended)
    votes.follow(given.time_ns, evidence.boxes)
    found, weights = votes.settle(evidence, Explanations(np.zeros((5, 5), np.bool_), *np.zeros((2, 5), np.bool_)))
    assert found.withheld.tolist() == [not misdescribes, False]
    assert (weights > 0.0).tolist() == [True, True, False], "tracks of others are better, where there are any"
