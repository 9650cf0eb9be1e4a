"""Still objects stand beside what moves, and never in its way or in a building."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon, affinity, box

from mast_zenoh.arrays.states import Floats
from mast_zenoh.sensing.clutter import KINDS, Clutter, StillObjects

EXTENT = np.array([[-100.0, -100.0], [100.0, 100.0]])


def crossing(seed: int, frames: int = 300, objects: int = 40) -> tuple[Floats, Floats]:
    """Where objects are that drive evenly along two roads."""
    draw = np.random.default_rng(seed)
    along = draw.uniform(-90.0, 90.0, objects) + np.linspace(-60.0, 60.0, frames)[:, None]
    across = np.broadcast_to(draw.choice([-2.0, 2.0], objects), along.shape)
    other = np.broadcast_to(draw.random(objects) < 0.5, along.shape)
    places = np.stack([np.where(other, across, along), np.where(other, along, across)], axis=-1)
    return places.reshape(-1, 2), np.tile(draw.uniform(0.4, 2.5, objects), frames)


def outlines(still: StillObjects) -> list[Polygon | LineString]:
    shapes: list[Polygon | LineString] = [
        affinity.translate(
            affinity.rotate(box(-length / 2, -w / 2, length / 2, w / 2), yaw, (0, 0), use_radians=True), x, y
        )
        for (x, y, _), (length, w, _), yaw in zip(still.position, still.size, still.yaw, strict=True)
    ]
    kerbs = still.kerbs
    return shapes + [LineString([start, end]) for start, end in zip(kerbs.start, kerbs.end, strict=True)]


def same(one: StillObjects, other: StillObjects) -> bool:
    columns = [(*still[:5], still.kerbs.start, still.kerbs.end, still.kerbs.top) for still in (one, other)]
    return all(np.array_equal(a, b) for a, b in zip(*columns, strict=True))


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1 << 20))
def test_nothing_touches_what_moves_or_a_building_or_leaves_the_extent(seed: int) -> None:
    occupied, radius = crossing(seed, frames=60, objects=20)
    buildings = [
        np.array([(8.0, 8.0), (30.0, 8.0), (30.0, 25.0), (8.0, 25.0)]),
        np.array([(-8.0, -9.0), (-20.0, -30.0), (-9.0, -40.0)]),
    ]
    still = Clutter(gap_m=0.3).place(occupied, radius, buildings, EXTENT, np.random.default_rng(seed))
    discs = [Point(place).buffer(size) for place, size in zip(occupied[::7], radius[::7], strict=True)]
    site = box(*EXTENT.ravel())
    for shape in outlines(still):
        assert all(shape.distance(disc) >= 0.29 for disc in discs)
        assert all(shape.distance(Polygon(building)) >= 0.29 for building in buildings)
        assert site.contains(shape)


def test_as_many_stand_there_as_are_asked_for_where_there_is_room() -> None:
    occupied, radius = crossing(1)
    still = Clutter(hedges=5, kerbs=4, signs=3, poles=2).place(occupied, radius, (), EXTENT, np.random.default_rng(0))
    counts = {name: int((still.kind == row).sum()) for row, name in enumerate(KINDS)}
    assert counts == {"hedge": 5, "sign": 3, "post": 3, "pole": 2}
    assert len(still.kerbs.top) == 4
    assert (still.reflectivity > 0.0).all()


def test_the_same_seed_places_the_same_and_another_seed_does_not() -> None:
    occupied, radius = crossing(2)
    one, again, other = (
        Clutter().place(occupied, radius, (), EXTENT, np.random.default_rng(seed)) for seed in (5, 5, 6)
    )
    assert same(one, again)
    assert not same(one, other)


def test_still_objects_stand_on_the_ground_or_hang_above_it_near_the_road() -> None:
    occupied, radius = crossing(3)
    still = Clutter().place(occupied, radius, (), EXTENT, np.random.default_rng(0), ground_m=3.0)
    bottom = still.position[:, 2] - still.size[:, 2] / 2
    signs = still.kind == KINDS.index("sign")
    assert bottom[~signs] == pytest.approx(3.0)
    assert bottom[signs] == pytest.approx(5.0)
    assert ((still.kerbs.top > 3.05) & (still.kerbs.top < 3.2)).all()
    assert all(np.hypot(*(occupied - place).T).min() < 14.0 for place in still.position[:, :2])


def test_hedges_and_kerbs_run_along_straight_roads() -> None:
    occupied = np.column_stack([np.linspace(-90.0, 90.0, 400), np.zeros(400)])
    still = Clutter().place(occupied, np.ones(400), (), EXTENT, np.random.default_rng(0))
    assert np.abs(np.sin(still.yaw[still.kind == 0])).max() < 0.2
    assert np.abs(still.kerbs.end - still.kerbs.start)[:, 1].max() < 3.0


def test_where_nothing_moves_or_there_is_no_room_nothing_stands() -> None:
    nowhere = Clutter().place(np.zeros((0, 2)), np.zeros(0), (), EXTENT, np.random.default_rng(0))
    narrow = Clutter().place(np.zeros((1, 2)), np.array([5.0]), (), EXTENT / 50.0, np.random.default_rng(0))
    for still in (nowhere, narrow):
        assert still.position.shape == still.size.shape == (0, 3)
        assert still.kerbs.start.shape == (0, 2)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"hedges": -1}, "hedges: found -1, expected 0 to 1000"),
        ({"poles": 2.5}, "poles: found 2.5, expected a whole number"),
        ({"gap_m": float("inf")}, "gap_m: found inf, expected 0 or more, finite"),
    ],
)
def test_wrong_parameters_are_refused(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Clutter(**wrong)  # type: ignore[arg-type]
