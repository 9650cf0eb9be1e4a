"""A scan meets what a plain loop over all beams and all faces meets, while lidar and objects move."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from mast_zenoh import kernels
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.sensing import scan
from mast_zenoh.sensing.beams import MODELS, Beams
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.shapes import Parts

#: m, length width height, by class.
SIZES = np.array(
    [
        (1.0, 1.0, 1.0),
        (4.5, 1.8, 1.5),
        (8.0, 2.4, 3.0),
        (12.0, 2.5, 3.2),
        (2.0, 0.8, 1.6),
        (1.8, 0.7, 1.7),
        (0.6, 0.6, 1.75),
    ]
)
LEVEL = np.eye(3)


def at(x: float, y: float, z: float, *, velocity: tuple[float, float] = (0.0, 0.0), turn: float = 0.0) -> scan.Moving:
    return scan.Moving(np.array([[x, y, z]]), np.array([[*velocity, 0.0]]), np.zeros(1), np.array([turn]))


def traffic(seed: int, count: int = 12) -> tuple[scan.Moving, Parts]:
    draw = np.random.default_rng(seed)
    class_id = draw.integers(0, len(SIZES), count)
    size = SIZES[class_id]
    position = np.column_stack([draw.uniform(-50.0, 50.0, (count, 2)), size[:, 2] / 2])
    velocity = np.column_stack([draw.normal(0.0, 8.0, (count, 2)), np.zeros(count)])
    moving = scan.Moving(position, velocity, draw.uniform(-np.pi, np.pi, count), draw.normal(0.0, 0.5, count))
    return moving, Parts.of(class_id, size)


def turned(yaw: Floats) -> Floats:
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    rows = [(np.cos(yaw), -np.sin(yaw), zero), (np.sin(yaw), np.cos(yaw), zero), (zero, zero, one)]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def by_brute_force(
    beams: Beams, lidar: scan.Moving, mount: Floats, objects: scan.Moving, parts: Parts, walls: Walls
) -> tuple[Floats, Ints]:
    """Every beam against every face of every part, each a convex hull, and every wall."""
    time = beams.time_s
    beam = np.einsum("mij,jk,mck->mci", turned(lidar.yaw[0] + lidar.turn[0] * time), mount, beams.directions())
    origin = (lidar.position[0] + lidar.velocity[0] * time[:, None])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(beam[..., 2] < 0.0, -origin[..., 2] / beam[..., 2], np.inf)
        nearest = np.where(ground <= beams.max_range_m, ground, np.inf)
        source = np.where(np.isfinite(nearest), scan.GROUND, scan.NOTHING)
        for row in range(len(objects.yaw)):
            into = np.swapaxes(turned(objects.yaw[row] + objects.turn[row] * time), 1, 2)
            local = origin - (objects.position[row] + objects.velocity[row] * time[:, None])[:, None]
            local, direction = np.einsum("mij,mcj->mci", into, local), np.einsum("mij,mcj->mci", into, beam)
            for part in range(parts.first[row], parts.first[row + 1]):
                both = (parts.low[part], parts.high[part])
                corners = [(x, y, z) for z, *sides in both for x in sides[:2] for y in sides[2:]]
                faces = np.unique(np.round(ConvexHull(corners).equations, 12), axis=0)
                before, along = -(local @ faces[:, :3].T + faces[:, 3]), direction @ faces[:, :3].T
                distance = before / along
                enter = np.where(along < 0.0, distance, -np.inf).max(axis=-1)
                leave = np.where(along > 0.0, distance, np.inf).min(axis=-1)
                outside = ((along == 0.0) & (before < 0.0)).any(axis=-1)
                met = ~outside & (enter <= leave) & (enter >= 0.0) & (enter < nearest) & (enter <= beams.max_range_m)
                nearest, source = np.where(met, enter, nearest), np.where(met, row, source)
        for start, end, top in zip(walls.start, walls.end, walls.top, strict=True):
            span, to_start = end - start, start - origin[..., :2]
            across = beam[..., 0] * span[1] - beam[..., 1] * span[0]
            distance = (to_start[..., 0] * span[1] - to_start[..., 1] * span[0]) / across
            share = (to_start[..., 0] * beam[..., 1] - to_start[..., 1] * beam[..., 0]) / across
            met = (distance >= 0.0) & (share >= 0.0) & (share <= 1.0) & (distance < nearest)
            met &= (origin[..., 2] + distance * beam[..., 2] <= top) & (distance <= beams.max_range_m)
            nearest, source = np.where(met, distance, nearest), np.where(met, scan.WALL, source)
    return nearest, source


@pytest.mark.parametrize("compiled", [False, True])
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 1 << 20), model=st.sampled_from(sorted(MODELS)), pitch=st.sampled_from([0.0, 0.4]))
def test_a_scan_is_that_of_a_plain_loop(compiled: bool, seed: int, model: str, pitch: float) -> None:
    if compiled and kernels.USED != "compiled":
        pytest.skip("kernels are not compiled")
    draw = np.random.default_rng(seed)
    beams = MODELS[model].beams()
    every = slice(None, None, 7)
    beams = Beams(beams.azimuth[every], beams.elevation, beams.offset, beams.time_s[every], 0.0, beams.max_range_m)
    objects, parts = traffic(seed)
    mount = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    lidar = at(
        0.0, 0.0, 8.0 if pitch else 2.0, velocity=tuple(draw.normal(0.0, 6.0, 2)), turn=float(draw.normal(0.0, 0.5))
    )
    walls = Walls.of_buildings((np.array([30.0, 20.0]) + draw.uniform(-10.0, 10.0, (4, 2)),), np.array([6.0]))
    with pytest.MonkeyPatch.context() as patch:
        if not compiled:
            patch.setattr(scan, "nearest_surfaces", kernels.REFERENCES["nearest_surfaces"])
        found = scan.cast(beams, lidar, mount, objects, parts, walls=walls)
    nearest, source = by_brute_force(beams, lidar, mount, objects, parts, walls)
    assert np.array_equal(found.source, source)
    assert np.allclose(found.range_m, nearest, rtol=0.0, atol=1e-9)


def test_beams_pass_below_a_car_and_over_its_bonnet() -> None:
    size = SIZES[CLASS_INDEX["car"]][None]
    car = scan.Moving(np.array([[12.0, 0.0, 0.75]]), np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    shaped, brick = (
        scan.cast(MODELS["OS1-128"].beams(0.0), at(0.0, 0.0, 0.3), LEVEL, car, parts)
        for parts in (Parts.of(np.array([CLASS_INDEX["car"]]), size), Parts.boxes(size))
    )
    inside = (shaped.source == 0) & (brick.source != 0)
    assert not inside.any()
    assert 0.4 < (shaped.source == 0).sum() / (brick.source == 0).sum() < 0.95


def test_an_object_that_crosses_is_skewed_by_the_turn_of_the_lidar() -> None:
    """At 20 m/s, one side of what crosses is seen earlier, so nearer, than the other."""
    wall_ahead = Parts.boxes(np.array([[0.5, 30.0, 2.0]]))
    crossing = scan.Moving(np.array([[10.0, 0.0, 1.0]]), np.array([[20.0, 0.0, 0.0]]), np.zeros(1), np.zeros(1))
    beams = MODELS["VLP-16"].beams()
    found = scan.cast(beams, at(0.0, 0.0, 1.0), LEVEL, crossing, wall_ahead)
    flat = found.range_m * np.cos(beams.elevation)
    ahead = np.where(found.source == 0, flat * np.cos(beams.azimuth)[:, None], np.nan)
    left, right = (np.nanmean(ahead[np.abs(beams.azimuth - side) < 0.05]) for side in (0.9, -0.9))
    assert left - right == pytest.approx(20.0 * 2 * 0.9 * 0.1 / (2 * np.pi), abs=0.02)


def test_the_car_that_carries_the_lidar_is_not_met() -> None:
    objects, parts = traffic(3)
    assert not (scan.cast(MODELS["VLP-16"].beams(), at(0.0, 0.0, 2.0), LEVEL, objects, parts, own=4).source == 4).any()
