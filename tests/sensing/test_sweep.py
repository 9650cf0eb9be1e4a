"""The free space of a lidar ends at the nearest road user or wall in each direction."""

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.sensing import LidarSensor, Walls
from mast_zenoh.sensing.raycast import SweepRays

HERE, LEVEL = np.array([0.0, 0.0, 1.8]), np.eye(3)
NO_WALLS = Walls.of_buildings((), np.zeros(0))
NO_BOXES = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)


def swept(lidar: LidarSensor, boxes=NO_BOXES, walls: Walls = NO_WALLS, own: int = -1, rotation=LEVEL) -> np.ndarray:
    rays = SweepRays.of(lidar)
    return rays.sweep(rays.background(HERE, rotation, walls), HERE, rotation, boxes, own)


def box(x: float, y: float, size: tuple[float, float, float] = (4.0, 2.0, 2.0)):
    return np.array([[x, y, size[2] / 2]]), np.array([size]), np.zeros(1)


def test_an_empty_world_is_free_to_the_end_of_the_range() -> None:
    assert (swept(LidarSensor()) == 100.0).all()


def test_a_car_ends_the_free_space_in_its_direction_only() -> None:
    free = swept(LidarSensor(), box(20.0, 0.0))
    sectors = free.shape[1]
    assert free[:, sectors // 2].min() == pytest.approx(18.0, abs=0.1)
    assert (free[:, : sectors // 4] == 100.0).all(), "behind the sensor"


def test_the_own_vehicle_does_not_count() -> None:
    assert (swept(LidarSensor(), box(0.0, 0.0), own=0) == 100.0).all()


@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_it_turns_with_the_sensor(turn: float) -> None:
    place = 20.0 * np.array([np.cos(turn), np.sin(turn)])
    free = swept(LidarSensor(), box(*place, size=(2.0, 2.0, 2.0)), rotation=rotation_from_yaw(turn))
    assert free[:, free.shape[1] // 2].min() == pytest.approx(19.0, abs=0.6)


def test_a_pitched_sector_lidar_sees_over_low_objects() -> None:
    pole = rotation_from_yaw_pitch(0.0, np.radians(30.0))
    rays, above = SweepRays.of(LidarSensor.infrastructure()), np.array([0.0, 0.0, 15.0])
    free = rays.sweep(rays.background(above, pole, NO_WALLS), above, pole, box(25.0, 0.0), -1)
    middle = free[:, free.shape[1] // 2]
    assert middle.min() == pytest.approx(27.0, abs=1.5)
    assert (middle == 100.0).sum() > len(middle) / 2, "directions over the car, and before it, are free"


def test_walls_shadow_the_same_as_a_plain_loop() -> None:
    random = np.random.default_rng(4)
    outlines = tuple(random.uniform(-60, 60, 2) + random.uniform(-9, 9, (4, 2)) for _ in range(8))
    walls = Walls.of_buildings(outlines, random.uniform(1.0, 9.0, 8))
    rays = SweepRays.of(LidarSensor(azimuth_step_deg=1.0))
    rotation = rotation_from_yaw_pitch(0.4, 0.05)
    found = rays.background(HERE, rotation, walls)
    directions = rays.directions() @ rotation.T
    for row in random.integers(0, len(directions), 200):
        d, nearest = directions[row], 100.0
        for a, b, top in zip(walls.start, walls.end, walls.top, strict=True):
            matrix = np.array([[d[0], a[0] - b[0]], [d[1], a[1] - b[1]]])
            along, share = np.linalg.solve(matrix, a - HERE[:2])
            if along > 0.0 and 0.0 <= share <= 1.0 and HERE[2] + along * d[2] <= top:
                nearest = min(nearest, along)
        assert found[row] == pytest.approx(nearest, rel=1e-9)
