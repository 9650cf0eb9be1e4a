"""A scan shows how far each direction is free: to what stands there, and along the ground before it."""

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw_pitch
from mast_zenoh.sensing import MODELS, Moving, Parts, Points, cast
from mast_zenoh.sensing.free_space import swept
from mast_zenoh.sensing.raycast import SweepRays
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns

MODEL = MODELS["OS1-128"]
LEVEL = np.eye(3)
LIDAR = MODEL.sensor((0.0, 0.0, 1.8), LEVEL)


def scan(car_m: float | None = 20.0, pitch_rad: float = 0.0) -> tuple[Points, np.ndarray]:
    """The points of a lidar 1.8 m above a flat ground, with a car ahead of it, and the rotation that levels it."""
    level = rotation_from_yaw_pitch(0.0, pitch_rad)
    here = Moving(np.array([[0.0, 0.0, 1.8]]), np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    place = np.array([[1e4 if car_m is None else car_m, 0.0, 0.75]])
    car = Moving(place, np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    beams, shape = MODEL.beams(), Parts.of(np.array([1]), np.array([[4.5, 1.8, 1.5]]))
    cast_scan = cast(beams, here, level, car, shape, 0.0)
    random = np.random.default_rng(0)
    return Returns(dropout=0.0).measure(cast_scan, beams, here, level, REFLECTIVITY[[1]], random)[0], level


def free(points: Points, level: np.ndarray = LEVEL) -> np.ndarray:
    return swept(points.columns() | {"level_rotation": quaternion_from_rotation(level)}, LIDAR)["free"]


def ahead(cells: np.ndarray, elevation_deg: float) -> float:
    """m that is free straight ahead."""
    height = LIDAR.elevation_max_deg - LIDAR.elevation_min_deg
    band = int((elevation_deg - LIDAR.elevation_min_deg) * len(cells) / height)
    return float(cells[band, cells.shape[1] // 2])


def test_a_car_ends_the_free_space_in_its_direction_only() -> None:
    with_car, without = free(scan()[0]), free(scan(None)[0])
    assert ahead(with_car, -3.0) == pytest.approx(17.75, abs=0.5)
    assert ahead(without, -3.0) > 25.0, "along the ground"
    quarter = with_car.shape[1] // 4
    np.testing.assert_allclose(with_car[:, :quarter], without[:, :quarter], atol=0.2)


def test_where_nothing_comes_back_nothing_is_known() -> None:
    points = scan()[0]
    assert ahead(free(points), 10.0) == 0.0, "the sky"
    blind = points.select(np.abs(np.arctan2(points.position[:, 1], points.position[:, 0])) > 0.2)
    assert ahead(free(blind), -3.0) == 0.0
    assert (free(Points.empty()) == 0.0).all()


def test_what_is_injected_ends_it_too() -> None:
    points = scan()[0]
    phantom = Points.of(np.array([[8.0, 0.1, -0.5], [8.0, 0.1, -0.6]]))
    assert ahead(free(Points.joined([points, phantom])), -4.0) == pytest.approx(8.0, abs=0.1)


@pytest.mark.parametrize("pitch_rad", [-0.05, 0.05])
def test_a_slope_of_the_road_is_no_obstacle(pitch_rad: float) -> None:
    cells = free(*scan(None, pitch_rad))
    assert cells[: len(cells) // 4].min() > 4.0, "the ground near a tilted lidar"


def test_it_is_the_nearest_return_that_stands_and_else_the_farthest_of_the_ground_as_in_a_plain_loop() -> None:
    points, rays = scan()[0], SweepRays.of(LIDAR)
    expected, standing = np.zeros((rays.bands, rays.sectors)), np.zeros((rays.bands, rays.sectors), bool)
    low, high = np.radians([LIDAR.elevation_min_deg, LIDAR.elevation_max_deg])
    for x, y, z in np.round(points.position.astype(np.float64), 3):
        if max(abs(x), abs(y)) >= 99.9:
            continue
        away, plan = float(np.hypot(np.hypot(x, y), z)), float(np.hypot(x, y))
        sector = int(np.mod(np.arctan2(y, x) + np.pi, 2 * np.pi) / (2 * np.pi) * rays.sectors)
        band = int(np.clip((np.arctan2(z, plan) - low) / (high - low) * rays.bands, 0, rays.bands - 1))
        cell, stands = (band, min(sector, rays.sectors - 1)), z > -1.8 + 0.25
        if stands:
            expected[cell] = min(expected[cell], away) if standing[cell] else away
            standing[cell] = True
        elif not standing[cell]:
            expected[cell] = max(expected[cell], away)
    different = np.abs(free(points) - expected) > 0.01
    assert different.mean() < 0.01, "but for returns at the height that divides, and at edges of cells"
