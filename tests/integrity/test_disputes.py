"""Who contradicts whom about an object, and which tracks no honest agent sends."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import disputes
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.disputes import of_tracks, on_ground, repeated, reports_nearby

EVERYBODY = np.ones(3, np.bool_)
CORNERS = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0)}


def statements(
    tracks: list[Track],
    blocked: dict[str, list[tuple[float, float, float]]],
    corners: dict[str, tuple[float, float]] = CORNERS,
    suspended: str = "",
) -> disputes.Testimonies:
    """What the agents at some corners say; blocked: what each sees; suspended: the name of one, or none."""
    views = {name: view(place, *blocked.get(name, [])) for name, place in corners.items()}
    given = batch(tracks, tuple(corners), views)
    voter = np.array([name != suspended for name in given.agents])
    return disputes.Evidence.of(given, voter).testimonies


CAR_AT_ORIGIN = (0.0, 0.0, 2.3)


def contradictions(found: disputes.Testimonies) -> list[list[int]]:
    """By two agents, about how many objects they contradict each other."""
    return found.between(np.ones_like(found.claims)).tolist()


def test_each_that_sees_through_an_object_contradicts_the_one_that_reports_it() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]})
    assert contradictions(found) == [[0, 1, 1], [1, 0, 0], [1, 0, 0]]
    assert found.accusations(EVERYBODY)[0].tolist() == [[True, False, False]]
    assert not found.accusations(EVERYBODY)[disputes.OF_ITSELF].any()


@pytest.mark.parametrize(("word", "expected"), [((0.0, 0.5, 0.0), 0.5), ((0.0, 0.5, 0.5), 1.0), ((0.0, 1.0, 0.5), 1.0)])
def test_an_object_is_contradicted_as_much_as_the_words_of_those_that_see_through_it_count(word, expected):
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]})
    assert found.accusations(np.array(word))[0].tolist() == [[expected, 0.0, 0.0]]


def test_an_agent_that_sees_through_what_two_report_is_contradicted_and_not_accused() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0))]
    found = statements(tracks, {"a": [CAR_AT_ORIGIN], "b": [CAR_AT_ORIGIN]})
    assert contradictions(found) == [[0, 0, 1], [0, 0, 1], [1, 1, 0]]
    assert not found.accusations(EVERYBODY)[:, :, 2].any()


def test_an_agent_that_lies_in_any_case_accuses_nobody_and_is_contradicted() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN], "c": [CAR_AT_ORIGIN]})
    assert found.accusations(EVERYBODY)[0].tolist() == [[True, False, False]]
    assert not found.accusations(np.array([True, False, True])).any()
    assert contradictions(found) == [[0, 1, 0], [1, 0, 0], [0, 0, 0]]


def test_what_a_suspended_agent_sees_through_contradicts_nobody() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]}, suspended="b")
    assert contradictions(found) == [[0, 0, 1], [0, 0, 0], [1, 0, 0]]
    alone = {"a": [CAR_AT_ORIGIN], "c": [CAR_AT_ORIGIN]}
    both: list[Track] = [("a", 0, (0.0, 0.0)), ("c", 0, (0.0, 0.0))]
    assert not statements(both, alone, suspended="b").accusations(EVERYBODY).any()


def test_silence_about_a_visible_object_contradicts_two_that_report_it() -> None:
    seen = {name: [CAR_AT_ORIGIN] for name in CORNERS}
    elsewhere: Track = ("c", 1, (60.0, 60.0))
    assert not statements([("a", 0, (0.0, 0.0)), elsewhere], seen).silent.any(), "one may be wrong"
    two: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0)), elsewhere]
    assert statements(two, seen).silent[0].tolist() == [False, False, True]


@pytest.mark.parametrize(("hidden_by", "noted"), [(CAR_AT_ORIGIN, True), ((2.2, -1.5, 1.6), False)])
def test_silence_counts_only_where_the_rays_end(hidden_by: tuple[float, float, float], noted: bool) -> None:
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in "abd"]
    # Something beside the object hides part of it from `c`, which thus neither sees through it nor sees it.
    blocked = {name: [CAR_AT_ORIGIN] for name in "abd"} | {"c": [hidden_by]}
    found = statements(tracks, blocked, CORNERS | {"d": (0.0, -20.0)})
    assert found.silent[0].tolist() == [False, False, noted, False]
    assert not found.denies.any()


def test_two_that_report_a_small_object_as_a_large_one_do_not_make_others_silent_about_it() -> None:
    seen = {name: [CAR_AT_ORIGIN] for name in CORNERS}
    agents = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0)), ("c", 1, (60.0, 60.0))]
    views = {name: view(place, *seen[name]) for name, place in CORNERS.items()}
    given = batch(agents, tuple(CORNERS), views)
    for smallest, silent in ((1.5, True), (0.3, False)):
        size = given.states.size.copy()
        size[0] = smallest
        smaller = replace(given, states=given.states.with_(size=size))
        assert disputes.Evidence.of(smaller, EVERYBODY).testimonies.silent[0, 2] == silent


def test_a_report_that_its_own_sensor_sees_through_is_no_claim_and_no_accusation() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {})
    assert found.denies.tolist() == [[False, True, True]]
    assert not found.claims.any()
    assert not found.contradicted.any()
    assert not found.accusations(EVERYBODY).any()
    assert not np.any(contradictions(found))


def test_a_report_outside_the_own_field_of_view_is_no_claim() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0))]
    looking_away = view(CORNERS["a"], CAR_AT_ORIGIN, max_range=10.0)
    views = {name: view(place) for name, place in CORNERS.items()} | {"a": looking_away}
    found = disputes.Evidence.of(batch(tracks, tuple(CORNERS), views), EVERYBODY)
    assert found.out_of_view.tolist() == [[True, False, False]]
    assert not found.testimonies.claims.any()
    assert not found.testimonies.accusations(EVERYBODY).any()
    assert not np.any(contradictions(found.testimonies))


def test_only_fresh_reports_contradict_others() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]})
    assert found.contradicted.tolist() == [[True, False, False]]
    assert not found.between(~found.contradicted).any()


#: Where a person is beside a car that two of five report, how fast both drive, who reports the person, whether it is
#: taken for something that hangs on to the car.
ATTACHED = {
    "at the bumper of a car that drives": ((3.0, 0.0), (8.0, 8.0), "a", True),
    "at the bumper of a car that stands": ((3.0, 0.0), (0.0, 0.0), "a", False),
    "close beside it": ((0.0, 1.7), (8.0, 8.0), "a", False),
    "overtaken by it": ((3.0, 0.0), (8.0, 4.0), "a", False),
    "far ahead of it": ((8.0, 0.0), (8.0, 8.0), "a", False),
    "reported by more than half": ((3.0, 0.0), (8.0, 8.0), "abc", False),
}


@pytest.mark.parametrize(("place", "speeds", "reporting", "expected"), ATTACHED.values(), ids=ATTACHED)
def test_what_few_report_and_drives_as_one_with_a_car_is_no_object_of_its_own(place, speeds, reporting, expected):
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in "abcd"] + [(name, 1, place) for name in reporting]
    given = batch(
        tracks, tuple("abcde"), velocity={k: (speed, 0.0) for k, speed in enumerate(speeds)}, size={1: (0.6, 0.6, 1.7)}
    )
    assert disputes.Evidence.of(given, np.ones(5, np.bool_)).attached.tolist() == [False, expected]


AGENTS = ("a", "b")


def test_the_ground_is_where_most_agents_boxes_stand_however_many_one_sends() -> None:
    tracks = [(name, i, (5.0 * i, 0.0)) for name in "ac" for i in range(3)] + [
        ("b", i, (5.0 * i, 0.0)) for i in range(12)
    ]
    given = batch(tracks, ("a", "b", "c"))
    position = given.states.position.copy()
    position[given.agent == 1, 2] += 10.0
    lifted = given.states.with_(position=position)
    assert on_ground(lifted, given.agent, 3).tolist() == (given.agent != 1).tolist()


@pytest.mark.parametrize("silent", ["", "e"])
def test_two_of_five_cannot_lift_the_ground_off_the_others_even_if_one_reports_nothing(silent: str) -> None:
    honest = [name for name in "cde" if name != silent]
    given = batch([(name, i, (5.0 * i, 0.0)) for name in ["a", "b", *honest] for i in range(3)], tuple("abcde"))
    position = given.states.position.copy()
    position[given.agent < 2, 2] += 6.0
    possible = on_ground(given.states.with_(position=position), given.agent, 5)
    assert possible[given.agent >= 2].all()
    assert possible[given.agent < 2].any() == bool(silent), "it is open then who is right"


def test_one_object_in_two_tracks_of_one_agent_counts_as_repeated_once() -> None:
    given = batch([("a", 0, (0.0, 0.0)), ("a", 1, (0.4, 0.0)), ("b", 0, (0.1, 0.0)), ("a", 2, (9.0, 0.0))], AGENTS)
    assert repeated(given).tolist() == [False, True, False, False]
    assert of_tracks(given, repeated(given)).tolist() == [[False, False], [True, False], [False, False]]


def test_cars_side_by_side_are_two_objects() -> None:
    assert not repeated(batch([("a", 0, (0.0, 0.0)), ("a", 1, (0.0, 2.0))], AGENTS)).any()


def test_an_agent_with_a_track_in_a_neighbouring_cluster_reports_about_the_object() -> None:
    given = batch([("a", 0, (0.0, 0.0)), ("b", 1, (1.0, 0.0)), ("a", 2, (30.0, 0.0))], AGENTS)
    assert reports_nearby(given, ClusterBoxes.of(given)).tolist() == [[True, True], [True, True], [True, False]]
