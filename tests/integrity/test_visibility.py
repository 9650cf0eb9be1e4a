"""Sensors see through free places, and not through objects, beyond walls or out of their range."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import CAR, Track, batch, view

from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.views import SweptView, check_view, collated_columns, view_columns, views_of
from mast_zenoh.integrity.visibility import (
    FAR_M,
    MAX_AGE_S,
    better_known,
    clear_in_view,
    current,
    lenient_sightings,
    out_of_view,
    passed_nearby,
    passed_to_others,
    rays_at,
    sightings,
)


def seen(place: tuple[float, float], *views: SweptView | None, error: float = 0.0):
    return sightings(np.array([[*place, 0.75]]), np.array([CAR]), np.zeros(1), views, np.array([error]))


HERE = (0.0, 0.0)
OLD = SweptView(view(HERE).view, view(HERE).free, age_s=2 * MAX_AGE_S)
CASES = {
    "a free place": ((20.0, 0.0), view(HERE), 0.0, (True, True)),
    "an object": ((20.0, 0.0), view(HERE, (20.0, 0.0, 2.3)), 0.0, (True, False)),
    "behind a wall": ((20.0, 0.0), view(HERE, (10.0, 0.0, 5.0)), 0.0, (False, False)),
    "an object that is a little displaced": ((20.0, 1.5), view(HERE, (20.0, 0.0, 1.0)), 0.0, (None, False)),
    "an object that is displaced": ((20.0, 6.0), view(HERE, (20.0, 0.0, 1.0)), 0.0, (None, True)),
    "beside an object": ((20.0, 4.0), view(HERE, (20.0, 0.0, 1.0)), 0.0, (None, True)),
    "beside an object, at an uncertain position": ((20.0, 4.0), view(HERE, (20.0, 0.0, 1.0)), 3.0, (None, False)),
    "far away": ((FAR_M + 5.0, 0.0), view(HERE), 0.0, (None, False)),
    "the own carrier": ((1.0, 0.0), view(HERE), 0.0, (None, False)),
    "in an old view": ((20.0, 0.0), OLD, 0.0, (False, False)),
    "without a view": ((20.0, 0.0), None, 0.0, (False, False)),
}


@pytest.mark.parametrize(("place", "swept", "error", "expected"), CASES.values(), ids=CASES)
def test_what_a_view_shows_of_a_place(place, swept: SweptView | None, error: float, expected) -> None:
    found = seen(place, swept, error=error)
    in_view, fully_clear = expected
    assert found.fully_clear.tolist() == [[fully_clear]]
    assert in_view is None or found.in_view.tolist() == [[in_view]]


def clear(place: tuple[float, float], swept: SweptView, speed: float = 0.0, height: float = 0.75) -> bool:
    box = ClusterBoxes(np.array([[*place, height]]), np.array([[speed, 0.0, 0.0]]), np.array([CAR]), np.zeros(1))
    return bool(clear_in_view(box, swept)[0])


def on_car(*discs: tuple[float, float, float]) -> SweptView:
    """The view of a sensor 2 m above the road, which sees nothing of the road nearer than 4 m."""
    swept = view(HERE, *discs)
    low = replace(swept.view, position=np.array([0.0, 0.0, 2.0]), elevation_min=-0.44, elevation_max=0.25)
    return replace(swept, view=low)


CLEAR = {
    "a free place": (((20.0, 0.0), on_car()), True),
    "a free place beside the carrier": (((4.4, 0.0), on_car()), True),
    "an object": (((20.0, 0.0), on_car((20.0, 0.0, 2.3))), False),
    "an object beside the carrier": (((4.4, 0.0), on_car((4.4, 0.0, 2.0))), False),
    "behind a wall": (((20.0, 0.0), on_car((10.0, 0.0, 5.0))), False),
    "far away": (((FAR_M + 5.0, 0.0), on_car()), False),
    "out of the field of view": (((20.0, 0.0), on_car(), 0.0, 30.0), False),
    "where an object was": (((20.0, 0.0), replace(on_car((15.0, 0.0, 2.3)), age_s=0.5), 10.0), False),
    "without a sweep": (((20.0, 0.0), replace(on_car(), free=np.zeros((0, 0)))), False),
}


@pytest.mark.parametrize(("case", "expected"), CLEAR.values(), ids=CLEAR)
def test_a_place_is_clear_if_the_rays_in_view_pass_through_it(case, expected: bool) -> None:
    assert clear(*case) is expected


AHEAD = replace(view(HERE, max_range=50.0).view, azimuth_min=-0.5, azimuth_max=0.5)
OUTSIDE = {
    "ahead": ((20.0, 0.0), view(HERE), False),
    "hidden behind a wall": ((20.0, 0.0), view(HERE, (10.0, 0.0, 5.0)), False),
    "behind the sensor": ((-20.0, 0.0), replace(view(HERE), view=AHEAD), True),
    "at the edge of the view": ((20.0, 11.5), replace(view(HERE), view=AHEAD), False),
    "out of range": ((60.0, 0.0), replace(view(HERE), view=AHEAD), True),
    "the own carrier": ((-1.0, 0.0), replace(view(HERE), view=AHEAD), False),
    "without a view": ((-20.0, 0.0), None, False),
    "outside an old view": ((-20.0, 0.0), replace(view(HERE), view=AHEAD, age_s=2 * MAX_AGE_S), False),
}


@pytest.mark.parametrize(("place", "swept", "expected"), OUTSIDE.values(), ids=OUTSIDE)
def test_a_track_is_out_of_view_where_its_agents_sensor_does_not_look(place, swept, expected: bool) -> None:
    views = {"b": view((0.0, 30.0))} | ({"a": swept} if swept else {})
    assert out_of_view(batch([("a", 0, place), ("b", 1, (0.0, 0.0))], "ab", views)).tolist() == [expected, False]


NEIGHBOUR, PERSON = (20.0, 0.0), (0.6, 0.6, 1.5)
BEFORE, BEHIND = (17.0, 0.0), (23.0, 0.0)
ON_NEIGHBOUR = view(HERE, (*NEIGHBOUR, 1.0))
#: Where `a` reports a person, what `v` sees, which agents report the car beside it, whether `v` refutes the person.
BESIDE = {
    "rays go on to the neighbour": (BEFORE, ON_NEIGHBOUR, "bc", True),
    "rays end at the person": (BEFORE, view(HERE, (*BEFORE, 1.0)), "bc", False),
    "behind the neighbour": (BEHIND, ON_NEIGHBOUR, "bc", False),
    "far before it": ((10.0, 0.0), ON_NEIGHBOUR, "bc", False),
    "no more agents report the neighbour": (BEFORE, ON_NEIGHBOUR, "b", False),
    "nothing is where the neighbour is said to be": (BEFORE, view(HERE), "bc", False),
    "its own track shows that it sees the neighbour": (BEFORE, view(HERE), "bv", True),
    "in an old view": (BEFORE, replace(ON_NEIGHBOUR, age_s=2 * MAX_AGE_S), "bc", False),
}


def refuted_by(place: tuple[float, float], swept: SweptView, of_neighbour: str, person: str = "a", voter: str = "abcv"):
    """(a,) which of the agents a, b, c and v refute a person at a place beside a car."""
    tracks: list[Track] = [(name, 0, place) for name in person] + [(name, 1, NEIGHBOUR) for name in of_neighbour]
    given = batch(tracks, "abcv", {"v": swept}, size={0: PERSON})
    boxes, voters = ClusterBoxes.of(given), np.array([name in voter for name in given.agents])
    beside = better_known(boxes, (given.reported & voters).sum(axis=1))
    refuted = passed_to_others(given, boxes, rays_at(given, boxes, current(given.views)), voters, beside)
    assert not refuted[1].any(), "the car"
    return refuted[0].tolist()


@pytest.mark.parametrize(("place", "swept", "of_neighbour", "expected"), BESIDE.values(), ids=BESIDE)
def test_rays_that_go_on_to_a_neighbour_refute_what_is_said_to_be_before_it(place, swept, of_neighbour, expected):
    assert refuted_by(place, swept, of_neighbour) == [False, False, False, expected]


def test_neither_suspended_agents_nor_those_that_report_it_refute_an_object_beside_another_one() -> None:
    assert not any(refuted_by(BEFORE, ON_NEIGHBOUR, "bc", voter="abc"))
    assert not any(refuted_by(BEFORE, ON_NEIGHBOUR, "abc", person="av"))


AT_BUMPER = (3.2, 0.0)
#: What `v`, a car, sees, where which agents report a person, and whether it refutes the person.
NEARBY = {
    "a free place at the bumper": (on_car(), AT_BUMPER, "a", True),
    "a person at the bumper": (on_car((*AT_BUMPER, 0.6)), AT_BUMPER, "a", False),
    "one that it reports, too": (on_car(), AT_BUMPER, "av", False),
    "at the sensor": (on_car(), (0.2, 0.0), "a", False),
    "farther away": (on_car(), (12.0, 0.0), "a", False),
    "in an old view": (replace(on_car(), age_s=2 * MAX_AGE_S), AT_BUMPER, "a", False),
}


@pytest.mark.parametrize(("swept", "place", "reporting", "expected"), NEARBY.values(), ids=NEARBY)
def test_a_sensor_refutes_what_is_said_to_stand_beside_it_by_the_part_that_it_sees(swept, place, reporting, expected):
    given = batch([(name, 0, place) for name in reporting], "abv", {"v": swept}, size={0: PERSON})
    boxes = ClusterBoxes.of(given)
    seen, _ = lenient_sightings(given, boxes)
    for voter in (True, False):
        refuted = passed_nearby(given, boxes, seen, np.array([True, True, voter]))
        assert refuted[0].tolist() == [False, False, expected and voter]


def test_views_are_unchanged_by_their_messages() -> None:
    views = {"a": view((1.0, 2.0), (10.0, 0.0, 2.0)), "b": view((-5.0, 0.0))}
    bodies = [view_columns(each.view, each.free) for each in views.values()]
    for body in bodies:
        check_view(body)
    columns = collated_columns(bodies)
    names = np.array(list(views), object)
    received = views_of({**columns, "agents": names, "age_ns": np.array([0, 100_000_000])})
    assert received["b"].age_s == pytest.approx(0.1)
    for name, each in views.items():
        assert np.array_equal(received[name].free, each.free)
        assert received[name].view.rotation == pytest.approx(each.view.rotation)
        assert np.array_equal(received[name].view.position, each.view.position)


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        ("azimuth", [1.0, 1.0], r"azimuth.*1.*1"),
        ("azimuth", [-4.0, 4.0], r"azimuth.*-4.*4"),
        ("elevation", [0.5, -0.5], r"elevation.*0.5.*-0.5"),
        ("max_range", [0.0], "max_range: found 0"),
        ("free", [[-1.0]], "free: found -1"),
    ],
)
def test_a_view_that_covers_nothing_is_refused(column: str, value: list, problem: str) -> None:
    body = view_columns(view((0.0, 0.0)).view, np.ones((2, 2))) | {column: np.array(value)}
    with pytest.raises(ValueError, match=problem):
        check_view(body)


def test_a_collation_whose_grids_do_not_fit_is_refused() -> None:
    body = collated_columns([view_columns(view((0.0, 0.0)).view, np.ones((2, 3)))])
    body |= {"agents": np.array(["a"], object), "age_ns": np.zeros(1, np.int64), "grid": np.array([[5, 5]])}
    with pytest.raises(ValueError, match="25 directions, expected 6"):
        views_of(body)
