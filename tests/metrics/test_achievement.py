"""Achievements of adversaries on synthetic runs: rules, shares, durations."""

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from metric_worlds import LOCAL, MISSION, NOTHING, PERIOD_S, PICTURE, Row, cars, effects, labelled, passage, recorded

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import achievement

#: Positions of the only object and of inserted ones; the ego is at the origin.
CAR, FALSE, FAR = (20.0, 0.0), (40.0, 10.0), (120.0, 0.0)
THERE, GONE = cars(CAR, id=[5]), NOTHING
ACCEPTED = cars(CAR, FALSE, id=[5, 6])
FRAMES = 40
#: Where adversaries show the car at CAR: 4 m ahead of it, and a track there.
GHOST = (CAR[0] + 4.0, CAR[1])


def achieved(
    lies: list[Row],
    picture: list[ObjectStates],
    *,
    mission: list[ObjectStates] | None = None,
    local: list[ObjectStates] | None = None,
    points: tuple[int, int] = (0, 50),
    scored: slice = slice(None),
    **wires: Any,
) -> dict[str, Any]:
    """The summary of a run with one object, seen by infra_9 (the victim); wires: see `effects`."""
    estimates = {PICTURE: picture, MISSION: mission or picture} | ({LOCAL: local} if local else {})
    record = recorded(
        [cars(CAR, id=[1])] * len(picture),
        estimates,
        agents=["ego", "infra_9"],
        points=np.array([points]),
        places=np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]),
    )
    scores, _, labels, done = labelled(record, effects(*lies, **wires))
    victims = {name: {1} for name in done.culprits}
    targets = achievement.targets(scores, labels, done, "ego", victims, 100.0, 5)
    return achievement.summary(targets, achievement.switches(scores, labels.switch_by, "ego", scored), PERIOD_S)


def lies(effect: str, frames: Any, at: tuple[float, float], more: tuple[float, float] = (0.0, 0.0), by="eve", id=7):
    return [(by, frame, effect, id, at, more) for frame in sorted(frames)]


def removed(frames: Any, name: str = "eve") -> list[Row]:
    return lies("removed", frames, CAR, by=name)


def moved(frames: Any, name: str = "eve", to: tuple[float, float] = GHOST) -> list[Row]:
    return lies("moved", frames, to, CAR, by=name)


@example(tried=set(range(20)), missed=set(range(10)))
@example(tried=set(range(19)), missed=set(range(10)))
@example(tried=set(range(9)), missed=set(range(9)))
@given(tried=st.sets(st.integers(0, FRAMES - 1), min_size=1), missed=st.sets(st.integers(0, FRAMES - 1)))
def test_an_object_is_hidden_when_missed_for_a_second_and_in_most_attempted_frames(tried, missed):
    picture = [GONE if frame in missed else THERE for frame in range(FRAMES)]
    achievements = achieved(removed(tried), picture)["eve"]
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
    believed = {frame for frame in believed if frame >= min(frames)}  # a track that was there before is no success
    picture = [ACCEPTED if frame in believed else THERE for frame in range(10)]
    achievements = achieved(lies("inserted", frames, FALSE), picture)["eve"]
    both = frames & believed
    assert (achievements["inserted"], achievements["inserted_frames"]) == (1, len(frames))
    assert achievements["inserted_share_centre"] == bool(both)
    assert achievements["inserted_time_share_centre"] == pytest.approx(len(both) / len(frames))
    assert achievements["inserted_s_centre"] == (pytest.approx(len(both) * PERIOD_S) if both else None)


def test_the_centre_and_the_ego_are_judged_separately() -> None:
    achievements = achieved(lies("inserted", range(4), FALSE), [ACCEPTED] * 4, mission=[THERE] * 4)["eve"]
    assert (achievements["inserted_share_centre"], achievements["inserted_share_ego"]) == (1.0, 0.0)
    assert (achievements["success_centre"], achievements["success_ego"]) == (True, False)


def test_objects_inserted_out_of_range_do_not_lower_the_success_of_the_adversary() -> None:
    """No track 120 m from the ego is scored, nor is it by infra_9."""
    inserted = [*lies("inserted", range(4), FALSE), *lies("inserted", range(4), FAR, id=8)]
    achievements = achieved(inserted, [ACCEPTED] * 4)["eve"]
    assert achievements["inserted"] == 2
    assert achievements["inserted_share_ego"] == achievements["inserted_time_share_ego"] == 1.0


def test_the_centre_is_judged_within_the_range_of_any_agent() -> None:
    """105 m from the ego, and 95 m from infra_9."""
    near_infra = (105.0, 0.0)
    achievements = achieved(lies("inserted", range(4), near_infra), [cars(CAR, near_infra, id=[5, 6])] * 4)["eve"]
    assert (achievements["inserted_share_centre"], achievements["inserted_share_ego"]) == (1.0, None)


def test_a_false_track_that_an_agent_has_anyway_is_no_success() -> None:
    achievements = achieved(lies("inserted", range(4), FALSE), [ACCEPTED] * 4, local=[ACCEPTED] * 4)["eve"]
    assert achievements["success_centre"] is False


def test_only_objects_that_are_evaluated_can_be_hidden() -> None:
    assert achieved(lies("removed", range(4), (70.0, 30.0)), [THERE] * 4)["eve"]["hidden"] == 0, "a false detection"
    unseen = achieved(removed(range(20)), [GONE] * 20, points=(0, 4))["eve"]
    assert (unseen["hidden"], unseen["hidden_share_centre"], unseen["success_centre"]) == (1, None, False)


def test_an_object_with_an_inaccurate_track_is_not_hidden() -> None:
    assert achieved(removed(range(20)), [cars((CAR[0] + 1.5, 0.0), id=[5])] * 20)["eve"]["success_centre"] is False


def test_an_object_hidden_by_two_adversaries_or_twice_counts_once() -> None:
    achievements = achieved([*removed(range(20), "eve"), *removed(range(5, 25), "mallory")], [GONE] * 25)
    assert [achievements[name]["hidden"] for name in ("eve", "mallory", "all")] == [1, 1, 1]
    assert [achievements[name]["hidden_frames"] for name in ("eve", "mallory", "all")] == [20, 20, 25]
    assert achievements["all"]["hidden_share_centre"] == 1.0
    wires = [passage("eve", "detections"), passage("eve", "tracks")]
    twice = achieved(removed([*range(20), *range(20)]), [GONE] * 20, passages=wires, of=[0] * 20 + [1] * 20)
    assert twice["eve"]["hidden_frames"] == 20


@pytest.mark.parametrize(("points", "share"), [(0, 0.0), (4, 0.0), (5, 1.0)])
def test_results_include_whether_other_agents_see_a_hidden_object(points: int, share: float) -> None:
    assert achieved(removed([0, 1]), [THERE] * 2, points=(points, 50))["eve"]["hidden_seen_by_others"] == share


@pytest.mark.parametrize(("error", "displaced"), [(0.9, False), (1.1, True), (3.0, True)])
def test_a_moved_object_is_displaced_when_its_track_is_off_or_missing(error: float, displaced: bool) -> None:
    x, y = CAR
    achievements = achieved(moved(range(20), to=(x, y + 5.0)), [cars((x, y + error), id=[5])] * 20)["eve"]
    assert achievements["moved"] == 1
    assert achievements["moved_share_centre"] == displaced
    assert achievements["moved_error_m_centre"] == pytest.approx(error)  # at 3.0 m matched to a false track


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


@pytest.mark.parametrize("other", [(CAR[0] - 9.0, CAR[1]), (GHOST[0] + 2.5, GHOST[1])], ids=["apart", "beside"])
@pytest.mark.parametrize(("first", "second"), [("eve", "mallory"), ("zoe", "mallory")])
def test_a_displacement_by_one_adversary_is_no_success_of_another(other, first: str, second: str) -> None:
    """The second one also shows the car elsewhere, where no track follows."""
    done = [*moved(range(20), first), *moved(range(20), second, other)]
    achievements = achieved(done, [cars(CAR, GHOST, id=[5, 6])] * 20)
    assert [achievements[name]["success_centre"] for name in (first, second, "all")] == [True, False, True]
    assert [achievements[name]["moved_frames"] for name in (first, second, "all")] == [20, 20, 20]
    assert [achievements[name]["moved_error_m_centre"] for name in (first, second, "all")] == [4.0, 0.0, 4.0]
    assert achievements["all"]["moved_share_centre"] == 1.0


def test_a_false_track_closer_to_the_true_position_follows_no_displacement() -> None:
    achievements = achieved(moved(range(20)), [cars(CAR, (CAR[0] + 1.9, CAR[1]), id=[5, 6])] * 20)["eve"]
    assert (achievements["success_centre"], achievements["moved_error_m_centre"]) == (False, 0.0)


def test_an_object_altered_in_place_does_not_count_as_moved() -> None:
    achievements = achieved(lies("altered", range(20), CAR), [THERE] * 20)["eve"]
    assert (achievements["moved"], achievements["altered"], achievements["altered_frames"]) == (0, 1, 20)
    assert achievements["altered_share_centre"] == 0.0


@pytest.mark.parametrize(("scored", "switches"), [(slice(None), 1), (slice(0, 6), 0)])
def test_identity_switches_due_to_an_adversary_count_in_scored_frames(scored: slice, switches: int) -> None:
    picture = [cars(CAR, id=[5 if frame < 6 else 6]) for frame in range(12)]
    achievements = achieved(removed(range(4, 8)), picture, scored=scored)
    for name in ("eve", "all"):
        assert [achievements[name][f"id_switches_{judge}"] for judge in ("centre", "ego")] == [switches] * 2
