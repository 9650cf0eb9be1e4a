"""What an interposer does to a scan is measured in points, and told as the objects that it makes and hides."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mast_zenoh.arrays.geometry import NO_TURN, quaternion_from_rotation, rotation_from_yaw_pitch
from mast_zenoh.evaluation.effects import scans
from mast_zenoh.evaluation.effects.rows import ChangedMessage, changed_objects
from mast_zenoh.evaluation.effects.scans import LEAST_POINTS, SAME_RETURN_M, changed_points
from mast_zenoh.metrics.causes import INSERTED, REMOVED
from mast_zenoh.sensing.points import Points

REFERENCE = {"mount_position": np.array([0.0, 0.0, 1.8]), "mount_rotation": NO_TURN, "level_rotation": NO_TURN}


def firings(position: NDArray[Any], first: int = 0) -> Points:
    """Points of which each is of a firing of its own."""
    n = len(position)
    time = ((np.arange(n) + first) * 1e-4).astype(np.float32)
    return Points(position.astype(np.float32), np.full(n, 0.3, np.float32), time, np.zeros(n, np.uint8))


def block(x: float, y: float, n: int = 60, height: float = 1.5) -> NDArray[Any]:
    """Points of something 2 m wide, in front of a lidar."""
    k = np.arange(n)
    return np.column_stack([np.full(n, x), y - 1.0 + 2.0 * (k % 10) / 9.0, -1.5 + height * (k // 10) / (n / 10)])


def body(points: Points, **more: Any) -> dict[str, Any]:
    return points.columns() | REFERENCE | more


def effects_of(before: Points, after: Points, **more: Any) -> list[tuple[int, int, list[float]]]:
    """(effect, points, place) of each object that a message has lost or gained."""
    message = ChangedMessage(3, 0, 3, body(before, **more), body(after, **more))
    changes, _ = changed_objects("points", [message])
    place = np.where(np.isfinite(changes.before), changes.before, changes.after)
    return list(zip(changes.effect.tolist(), changes.points.tolist(), place.round(1).tolist(), strict=True))


WORLD = np.concatenate([block(12.0, 0.0), block(20.0, 8.0)])


def test_inserted_points_are_an_object_with_their_number() -> None:
    phantom = firings(block(7.0, -5.0, 83), first=1000)
    after = Points.joined([firings(WORLD), phantom])
    assert effects_of(firings(WORLD), after) == [(INSERTED, 83, [7.0, -5.0, -0.8])]


def test_an_object_whose_beams_return_nothing_is_removed() -> None:
    before = firings(WORLD)
    assert effects_of(before, before.select(slice(60, None))) == [(REMOVED, 60, [12.0, 0.0, -0.9])]


def test_moved_points_are_removed_where_they_were_and_inserted_where_they_are() -> None:
    moved = WORLD.copy()
    moved[:60, 0] -= 5.0
    assert [(effect, count) for effect, count, _ in effects_of(firings(WORLD), firings(moved))] == [
        (REMOVED, 60),
        (INSERTED, 60),
    ]


def test_noise_of_a_lidar_is_no_effect() -> None:
    noisy = WORLD + np.random.default_rng(0).normal(0.0, 0.02, WORLD.shape)
    assert effects_of(firings(WORLD), firings(noisy)) == []


def test_the_shadow_on_the_ground_is_no_object() -> None:
    ground = np.column_stack([np.linspace(5, 30, 200), np.zeros(200), np.full(200, -1.8)])
    before = Points.joined([firings(ground), firings(WORLD, 1000)])
    assert effects_of(before, before.select(slice(100, None))) == []


def test_a_lidar_that_looks_down_from_a_pole_sees_upright_objects() -> None:
    level = rotation_from_yaw_pitch(0.0, np.radians(30.0))
    tilted = firings(block(15.0, 0.0) @ level)
    effects = effects_of(Points.empty(), tilted, level_rotation=quaternion_from_rotation(level))
    assert [(effect, count) for effect, count, _ in effects] == [(INSERTED, 60)]
    np.testing.assert_allclose(level @ effects[0][2], [15.0, 0.0, -0.9], atol=0.1)


def test_recorded_points_without_firings_are_compared_by_place() -> None:
    before = Points.of(WORLD)
    assert effects_of(before, before.select(slice(60, None)))[0][:2] == (REMOVED, 60)


@pytest.mark.parametrize("lost", [True, False])
def test_a_scan_that_is_withheld_or_forged_as_a_whole_counts_with_all_objects(lost: bool) -> None:
    scans = (firings(WORLD), Points.empty()) if lost else (Points.empty(), firings(WORLD))
    assert [count for _, count, _ in effects_of(*scans)] == [60, 60]


@given(st.data())
def test_each_beam_is_unchanged_removed_or_inserted(data: st.DataObject) -> None:
    n = data.draw(st.integers(0, 40))
    random = np.random.default_rng(data.draw(st.integers(0, 1000)))
    before = firings(random.uniform(-50.0, 50.0, (n, 3)))
    kept, moved = random.random(n) < 0.7, random.random(n) < 0.3
    after = before.position.copy()
    after[moved] += np.float32(2.0 * SAME_RETURN_M)
    scan = Points(after, before.intensity, before.time_s, before.channel).select(kept)
    removed, inserted = changed_points(before, scan)
    np.testing.assert_array_equal(removed, ~kept | moved)
    np.testing.assert_array_equal(inserted, moved[kept])


def test_a_flat_plate_above_the_road_is_an_object() -> None:
    ground = np.column_stack([*(each.ravel() for each in np.mgrid[5:30:0.5, -8:8:0.5]), np.full(1600, -1.8)])
    plate = np.column_stack([*(each.ravel() for each in np.mgrid[10:14:0.2, 0:1.8:0.2]), np.full(180, -1.0)])
    before = Points.joined([firings(ground), firings(WORLD, 5000)])
    assert effects_of(before, Points.joined([before, firings(plate, 9000)]))[0][:2] == (INSERTED, 180)


def test_beams_that_only_change_their_time_or_come_twice_are_unchanged() -> None:
    before = firings(WORLD)
    later = replace(before, time_s=np.nextafter(before.time_s, np.float32(np.inf)))
    moved = replace(before, position=np.nextafter(before.position, np.float32(np.inf)))
    twice = Points.joined([moved, moved.select(slice(0, 1))])
    for after in (later, twice):
        assert not any(rows.any() for rows in changed_points(before, after))


@given(st.data())
def test_points_without_beams_are_the_same_if_any_other_is_near_however_many_are_at_one_place(
    data: st.DataObject,
) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 1000)))
    places = random.uniform(0.0, 1.5, (12, 3)).astype(np.float32)
    before, after = (Points.of(places[random.integers(0, 12, data.draw(st.integers(2, 40)))]) for _ in range(2))
    apart = np.linalg.norm(before.position[:, None].astype(float) - after.position, axis=2) >= SAME_RETURN_M
    removed, inserted = changed_points(before, after)
    np.testing.assert_array_equal(removed, apart.all(axis=1))
    np.testing.assert_array_equal(inserted, apart.all(axis=0))


def test_many_points_at_one_place_are_compared_without_each_pair_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    monkeypatch.setattr(scans, "cKDTree", lambda points: sizes.append(len(points)) or cKDTree(points))
    scan = Points.of(np.full((20_000, 3), 5.0))
    assert not any(rows.any() for rows in changed_points(scan, scan))
    assert sizes == [1, 1]


def test_a_few_points_make_no_object() -> None:
    assert (
        effects_of(Points.empty(), firings(block(7.0, 0.0, 60)[:: 60 // (LEAST_POINTS - 1)][: LEAST_POINTS - 1])) == []
    )
