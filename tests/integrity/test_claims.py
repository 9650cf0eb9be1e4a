"""Tracks that no honest agent sends are found."""

import pytest
from integrity_batches import batch

from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.disputes import of_tracks, on_ground, repeated, reports_nearby

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
