"""Forged views agree with the lies, and no input breaks them."""

import numpy as np
from attack_worlds import at, equal
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import alter
from mast_zenoh.attacks.targets import ViewForger, blocked, opened
from mast_zenoh.integrity import SweptView, sightings
from mast_zenoh.tracking.view import SensorView

WALL_M = 90.0


def swept_view(free: np.ndarray | None = None, *, width_deg: float = 360.0, pitch: float = 0.0, yaw: float = 0.3):
    """A sensor 6 m above the ground that sees walls at WALL_M in all directions."""
    half = np.radians(width_deg) / 2
    rotation = rotation_from_yaw_pitch(yaw, pitch)
    view = SensorView(np.array([0.0, 0.0, 6.0]), rotation, -half, half, np.radians(-45.0), np.radians(30.0), 100.0)
    return SweptView(view, np.full((38, round(width_deg / 2)), WALL_M) if free is None else free)


def seen(view: SweptView, objects: ObjectStates):
    each = sightings(objects.position, objects.size, objects.yaw, [view])
    return each.in_view[:, 0], each.fully_clear[:, 0]


places = st.tuples(st.floats(8.0, 60.0), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi)).map(
    lambda each: (each[0] * np.cos(each[1]), each[0] * np.sin(each[1]), each[2])
)


def cars(*each: tuple[float, float, float]) -> ObjectStates:
    return at(*[place[:2] for place in each]).with_(yaw=np.array([place[2] for place in each]))


@given(places, st.sampled_from([0.0, 0.4]))
def test_an_invented_object_is_not_seen_through_and_a_hidden_one_is(place, pitch: float) -> None:
    car = cars(place)
    empty = swept_view(pitch=pitch)
    in_view, through = seen(empty, car)
    assert through[0] == in_view[0], "nothing is there"
    claimed = blocked(empty, car)
    assert not seen(claimed, car)[1][0]
    hidden = opened(claimed, car)
    assert seen(hidden, car)[1][0] == through[0]


@given(places)
def test_only_directions_towards_the_object_change(place) -> None:
    car, view = cars(place), swept_view()
    claimed = blocked(view, car)
    distance = np.hypot(*place[:2])
    _, columns = np.nonzero(claimed.free != view.free)
    azimuth = np.radians(-179.0 + 2.0 * columns) + 0.3
    turn = (azimuth - np.arctan2(place[1], place[0]) + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(turn).max(initial=0.0) <= np.arctan2(2.5, distance - 2.5) + np.radians(2.0)
    assert claimed.free.min() >= distance - 3.5
    assert claimed.view is view.view


def test_the_lies_of_another_frame_do_not_change_a_view() -> None:
    objects, view, forger = cars((30.0, 0.0, 0.0)), swept_view(), ViewForger()
    forger.remember(4, objects, alter(objects, hide=[0], insert=cars((0.0, 30.0, 0.0))))
    assert forger.forge(3, view) is view
    assert forger.forge(5, view) is view
    assert not np.array_equal(forger.forge(4, view).free, view.free)


def test_a_moved_object_is_free_where_it_was_and_blocked_where_it_is_said_to_be() -> None:
    real, forger = cars((30.0, 0.0, 0.0)), ViewForger()
    forger.remember(0, real, alter(real, move=[0], offset=np.array([[0.0, 15.0, 0.0]])))
    claimed = forger.forge(0, blocked(swept_view(), real))
    assert seen(claimed, real)[1][0]
    assert not seen(claimed, cars((30.0, 15.0, 0.0)))[1][0]


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(st.data())
def test_no_boxes_and_no_grid_break_the_forging_of_a_view(data: st.DataObject) -> None:
    free = data.draw(arrays.arrays(np.float64, st.tuples(st.integers(0, 4), st.integers(0, 9)), elements=anything))
    n = data.draw(st.integers(0, 3))
    column = arrays.arrays(np.float64, (n, 3), elements=anything)
    boxes = ObjectStates.of(
        data.draw(column), size=data.draw(column), yaw=data.draw(arrays.arrays(np.float64, n, elements=anything))
    )
    view = swept_view(free, width_deg=data.draw(st.sampled_from([360.0, 90.0, 1e-3])))
    before = equal(boxes, boxes), free.copy()
    for forge in (opened, blocked):
        with np.errstate(all="ignore"):
            claimed = forge(view, boxes)
        assert claimed.free.shape == free.shape
        assert np.array_equal(view.free, before[1], equal_nan=True), "the true view is not modified"
        changed = ~((claimed.free == free) | (np.isnan(claimed.free) & np.isnan(free)))
        assert np.all((claimed.free[changed] >= 0.0) & (claimed.free[changed] <= view.view.max_range))
