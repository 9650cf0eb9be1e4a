"""Achievements of adversaries on synthetic runs: rules, shares, durations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from measured import PERIOD_S, Row, effects, labelled
from metric_oracles import cars

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Record, Series, achievement
from mast_zenoh.metrics.record import Snapshot

#: Positions of the only object and of inserted ones; the ego is at the origin.
CAR, FALSE, FAR = (20.0, 0.0), (40.0, 10.0), (120.0, 0.0)


def achieved(
    lies: list[Row], picture: list[ObjectStates], mission: list[ObjectStates] | None = None, seen_by_others: int = 0
) -> dict[str, Any]:
    """The summary of a run with one object, seen by infra_9 (the victim)."""
    record = Record(["ego", "infra_9"])
    for frame, believed in enumerate(picture):
        points = [[seen_by_others, 50]]
        record.add_truth(
            frame, cars(CAR, id=[1]), np.array(points), np.array([[0.0] * 3, [10.0, 0.0, 0.0]]), np.array([-1, -1])
        )
        record.add(frame, [Series("", "picture")], Snapshot.of(believed))
        record.add(frame, [Series("ego", "mission")], Snapshot.of((mission or picture)[frame]))
    scores, _, labels, done = labelled(record, effects(*lies))
    truth = record.truth(scores.frames)
    victims = {name: {1} for name in done.culprits}
    achievements = achievement.targets(
        scores, labels.cause, labels.by, done, truth, record.agents, "ego", victims, 100.0, 5
    )
    return achievement.summary(achievements, done.culprits, scores, labels.switch_by, "ego", PERIOD_S)


def removed(frames: list[int], name: str = "eve") -> list[Row]:
    return [(name, frame, "removed", 0, CAR, (0.0, 0.0)) for frame in frames]


THERE, GONE = cars(CAR, id=[5]), ObjectStates.empty()
FRAMES = 40


@example(tried=set(range(20)), missed=set(range(10)))
@example(tried=set(range(19)), missed=set(range(10)))
@example(tried=set(range(9)), missed=set(range(9)))
@given(tried=st.sets(st.integers(0, FRAMES - 1), min_size=1), missed=st.sets(st.integers(0, FRAMES - 1)))
def test_an_object_is_hidden_when_missed_for_a_second_and_in_most_attempted_frames(
    tried: set[int], missed: set[int]
) -> None:
    picture = [GONE if frame in missed else THERE for frame in range(FRAMES)]
    achievements = achieved(removed(sorted(tried)), picture)["eve"]
    both = tried & missed
    success = len(both) >= 10 and 2 * len(both) > len(tried)
    assert (achievements["hidden"], achievements["hidden_frames"]) == (1, len(tried))
    for judge in ("centre", "ego"):
        assert achievements[f"hidden_share_{judge}"] == success
        assert achievements[f"hidden_time_share_{judge}"] == pytest.approx(len(both) / len(tried))
        assert achievements[f"success_{judge}"] == success
        first = (min(both) - min(tried)) * PERIOD_S if success else None
        assert achievements[f"first_success_s_{judge}"] == (None if first is None else pytest.approx(first))


@given(frames=st.sets(st.integers(0, 9), min_size=1), believed=st.sets(st.integers(0, 9)))
def test_an_inserted_object_is_accepted_when_tracked_in_any_frame(frames: set[int], believed: set[int]) -> None:
    lies = [("eve", frame, "inserted", 7, FALSE, (0.0, 0.0)) for frame in sorted(frames)]
    picture = [cars(CAR, FALSE, id=[5, 6]) if frame in believed else THERE for frame in range(10)]
    achievements = achieved(lies, picture)["eve"]
    both = frames & believed
    assert (achievements["inserted"], achievements["inserted_frames"]) == (1, len(frames))
    assert achievements["inserted_share_centre"] == bool(both)
    assert achievements["inserted_time_share_centre"] == pytest.approx(len(both) / len(frames))
    assert achievements["inserted_s_centre"] == (pytest.approx(len(both) * PERIOD_S) if both else None)


def test_the_centre_and_the_ego_are_judged_separately() -> None:
    lies = [("eve", frame, "inserted", 7, FALSE, (0.0, 0.0)) for frame in range(4)]
    achievements = achieved(lies, [cars(CAR, FALSE, id=[5, 6])] * 4, [THERE] * 4)["eve"]
    assert (achievements["inserted_share_centre"], achievements["inserted_share_ego"]) == (1.0, 0.0)
    assert (achievements["success_centre"], achievements["success_ego"]) == (True, False)


def test_objects_inserted_out_of_range_do_not_lower_the_success_of_the_adversary() -> None:
    """No track 120 m from the ego is scored; infra_9 has no picture in this run."""
    lies = [
        ("eve", frame, "inserted", k, place, (0.0, 0.0)) for frame in range(4) for k, place in ((7, FALSE), (8, FAR))
    ]
    achievements = achieved(lies, [cars(CAR, FALSE, id=[5, 6])] * 4)["eve"]
    assert achievements["inserted"] == 2
    assert achievements["inserted_share_ego"] == achievements["inserted_time_share_ego"] == 1.0


def test_removing_a_false_detection_hides_no_object() -> None:
    lies = [("eve", frame, "removed", 0, (70.0, 30.0), (0.0, 0.0)) for frame in range(4)]
    assert achieved(lies, [THERE] * 4)["eve"]["hidden"] == 0


def test_an_object_hidden_by_two_adversaries_counts_once_overall() -> None:
    lies = [*removed([*range(20)], "eve"), *removed([*range(5, 25)], "mallory")]
    achievements = achieved(lies, [GONE] * 25)
    assert [achievements[name]["hidden"] for name in ("eve", "mallory", "all")] == [1, 1, 1]
    assert [achievements[name]["hidden_frames"] for name in ("eve", "mallory", "all")] == [20, 20, 25]
    assert achievements["all"]["hidden_share_centre"] == 1.0


@pytest.mark.parametrize(("points", "share"), [(0, 0.0), (4, 0.0), (5, 1.0)])
def test_results_include_whether_other_agents_see_a_hidden_object(points: int, share: float) -> None:
    assert achieved(removed([0, 1]), [THERE] * 2, seen_by_others=points)["eve"]["hidden_seen_by_others"] == share


@pytest.mark.parametrize(("error", "displaced"), [(0.9, False), (1.1, True), (3.0, True)])
def test_a_moved_object_is_displaced_when_its_track_is_off_or_missing(error: float, displaced: bool) -> None:
    x, y = CAR
    lies = [("eve", frame, "moved", 0, (x, y + 5.0), CAR) for frame in range(20)]
    achievements = achieved(lies, [cars((x, y + error), id=[5])] * 20)["eve"]
    assert achievements["moved"] == 1
    assert achievements["moved_share_centre"] == displaced
    assert achievements["moved_error_m_centre"] == pytest.approx(error)  # at 3.0 m matched to a false track


#: Where adversaries show the car at CAR: 4 m ahead of it, and a track there.
GHOST = (CAR[0] + 4.0, CAR[1])


def moved(frames: range, name: str = "eve", to: tuple[float, float] = GHOST) -> list[Row]:
    return [(name, frame, "moved", 0, to, CAR) for frame in frames]


def test_a_displaced_track_beside_the_true_one_is_a_success() -> None:
    """The true track stays 0.1 m off; from frame 5 the displaced object has one."""
    honest, ghost = (CAR[0] + 0.1, CAR[1]), (GHOST[0] - 0.5, GHOST[1])
    picture = [cars(honest, ghost, id=[5, 6]) if frame >= 5 else cars(honest, id=[5]) for frame in range(25)]
    achievements = achieved(moved(range(25)), picture)["eve"]
    assert (achievements["moved"], achievements["moved_frames"]) == (1, 25)
    for judge in ("centre", "ego"):
        assert achievements[f"success_{judge}"] is True
        assert achievements[f"moved_share_{judge}"] == 1.0
        assert achievements[f"moved_time_share_{judge}"] == pytest.approx(20 / 25)
        assert achievements[f"first_success_s_{judge}"] == pytest.approx(5 * PERIOD_S)
        assert achievements[f"moved_error_m_{judge}"] == pytest.approx((20 * 3.5 + 5 * 0.1) / 25)


def test_a_displaced_object_tracked_for_less_than_a_second_is_no_success() -> None:
    picture = [cars(CAR, GHOST, id=[5, 6]) if frame < 9 else THERE for frame in range(12)]
    assert achieved(moved(range(12)), picture)["eve"]["success_centre"] is False


def test_a_displacement_by_one_adversary_is_no_success_of_another() -> None:
    """Mallory also shows the car 9 m to the other side, where no track follows."""
    lies = [*moved(range(20)), *moved(range(20), "mallory", (CAR[0] - 9.0, CAR[1]))]
    achievements = achieved(lies, [cars(CAR, GHOST, id=[5, 6])] * 20)
    assert [achievements[name]["success_centre"] for name in ("eve", "mallory", "all")] == [True, False, True]
    assert [achievements[name]["moved_frames"] for name in ("eve", "mallory", "all")] == [20, 20, 20]
    reversed_names = achieved(
        [*moved(range(20), "zoe"), *moved(range(20), "mallory", (CAR[0] - 9.0, CAR[1]))],
        [cars(CAR, GHOST, id=[5, 6])] * 20,
    )
    assert reversed_names["all"]["moved_share_centre"] == 1.0, "whichever comes first by name"


def test_a_false_track_closer_to_the_true_position_follows_no_displacement() -> None:
    beside = (CAR[0] + 1.9, CAR[1])
    achievements = achieved(moved(range(20)), [cars(CAR, beside, id=[5, 6])] * 20)["eve"]
    assert (achievements["success_centre"], achievements["moved_error_m_centre"]) == (False, 0.0)


def test_an_object_altered_in_place_does_not_count_as_moved() -> None:
    achievements = achieved([("eve", frame, "altered", 0, CAR, (0.0, 0.0)) for frame in range(20)], [THERE] * 20)["eve"]
    assert (achievements["moved"], achievements["altered"], achievements["altered_frames"]) == (0, 1, 20)
    assert achievements["altered_share_centre"] == 0.0


def test_without_adversaries_there_are_no_results() -> None:
    assert achieved([], [THERE]) == {}
