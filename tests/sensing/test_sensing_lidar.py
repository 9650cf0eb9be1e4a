"""Field of view and ray casting of a lidar."""

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch, to_world
from mast_zenoh.sensing import LidarSensor, Walls, in_view, lidar_points

EYE = np.eye(3)
ROOF = np.array([0.0, 0.0, 1.8])
CAR = np.array([4.5, 1.8, 1.5])


def cars(*places: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    position = np.array([[x, y, 0.75] for x, y in places])
    return position, np.tile(CAR, (len(places), 1)), np.zeros(len(places))


def every_beam(lidar: LidarSensor, origin: np.ndarray, rotation: np.ndarray, boxes: tuple, walls: Walls) -> np.ndarray:
    """Returns per box, by a slab test of every beam against every box and wall."""
    azimuth, elevation = np.meshgrid(lidar.azimuths, lidar.elevations)
    local = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    beams = to_world(local.reshape(-1, 3), np.zeros(3), rotation)
    nearest, hit = np.full(len(beams), lidar.max_range_m), np.full(len(beams), -1)
    for k, (centre, size, yaw) in enumerate(zip(*boxes, strict=True)):
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        start, along = turn @ (origin - centre), beams @ turn.T
        with np.errstate(divide="ignore"):
            one, other = (-size / 2 - start) / along, (size / 2 - start) / along
        enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
        closer = (enter <= leave) & (leave > 0) & (enter <= nearest)
        nearest[closer], hit[closer] = enter[closer], k
    for start, end, top in zip(walls.start, walls.end, walls.top, strict=True):
        normal = np.array([start[1] - end[1], end[0] - start[0]])
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = normal @ (start - origin[:2]) / (beams[:, :2] @ normal)
            point = origin + beams * distance[:, None]
            along = (point[:, :2] - start) @ (end - start) / np.sum((end - start) ** 2)
        blocked = (distance > 0) & (distance < nearest) & (along >= 0) & (along <= 1) & (point[:, 2] <= top)
        hit[blocked] = -1
    return np.bincount(hit[hit >= 0], minlength=len(boxes[0]))


@pytest.mark.parametrize("seed", range(6))
def test_ray_casting_equals_a_brute_force_test_of_every_beam(seed: int) -> None:
    random = np.random.default_rng(seed)
    n = 25
    boxes = (
        np.concatenate([random.uniform(-60, 60, (n, 2)), np.full((n, 1), 0.9)], axis=1),
        np.stack([random.uniform(0.5, 12, n), random.uniform(0.5, 2.5, n), random.uniform(1.5, 1.8, n)], axis=1),
        random.uniform(-np.pi, np.pi, n),
    )
    house = np.array([[0, 0], [12, 0], [12, 8], [0, 8]])
    outlines = tuple(house + place for place in random.uniform(-70, 70, (4, 2)))
    walls = Walls.of_buildings(outlines, random.uniform(3, 20, 4))
    if seed % 2:
        lidar, origin = LidarSensor(azimuth_step_deg=1.0), np.array([1.0, 2.0, 1.8])
        rotation = rotation_from_yaw_pitch(random.uniform(-3, 3), 0.05)
    else:
        lidar, origin = LidarSensor.infrastructure(), np.array([-30.0, 20.0, 15.0])
        rotation = rotation_from_yaw_pitch(random.uniform(-3, 3), np.radians(30))
    points = lidar_points(lidar, origin, rotation, *boxes, walls)
    np.testing.assert_array_equal(points, every_beam(lidar, origin, rotation, boxes, walls))
    assert points.sum() > 0


@pytest.mark.parametrize("seed", range(4))
def test_in_dense_traffic_every_beam_has_its_nearest_box(seed: int) -> None:
    random = np.random.default_rng(seed)
    lane, along = np.repeat([-3.5, 0.0, 3.5, 7.0], 8), np.tile(np.arange(-28.0, 28.0, 7.0), 4)
    size = random.uniform([3.8, 1.7, 1.3], [6.0, 2.4, 2.9], (len(lane), 3))
    position = np.stack([along + random.uniform(-0.4, 0.4, len(lane)), lane, size[:, 2] / 2.0], axis=1)
    boxes = position, size, random.normal(0.0, 0.02, len(lane))
    own = int(np.abs(position[:, :2]).sum(axis=1).argmin())
    lidar, roof = LidarSensor(azimuth_step_deg=1.0), position[own] + [0.0, 0.0, size[own, 2] / 2.0 + 0.2]
    rotation = rotation_from_yaw_pitch(random.uniform(-3, 3), 0.0)
    rest = tuple(np.delete(part, own, axis=0) for part in boxes)
    expected = every_beam(lidar, roof, rotation, rest, Walls.of_buildings((), np.zeros(0)))
    np.testing.assert_array_equal(np.delete(lidar_points(lidar, roof, rotation, *boxes, own=own), own), expected)
    assert (expected > 0).sum() > 10


def test_returns_of_some_beams_add_up_to_those_of_all() -> None:
    boxes = cars((10.0, 0.0), (16.0, 1.0), (-20.0, 4.0))
    lidar = LidarSensor(azimuth_step_deg=0.5, channels=24)
    azimuth, channel = (each.ravel() for each in np.indices((len(lidar.azimuths), 24)))
    parts = [
        lidar_points(lidar, ROOF, EYE, *boxes, beams=(azimuth[part], channel[part]))
        for part in np.array_split(np.random.default_rng(0).permutation(len(azimuth)), 5)
    ]
    np.testing.assert_array_equal(np.sum(parts, axis=0), lidar_points(lidar, ROOF, EYE, *boxes))


def test_the_sensors_own_car_occludes_nothing_and_has_no_returns() -> None:
    boxes = cars((0.0, 0.0), (20.0, 0.0))
    inside = np.array([0.0, 0.0, 1.0])
    assert lidar_points(LidarSensor(), inside, EYE, *boxes, own=0)[0] == 0
    assert lidar_points(LidarSensor(), inside, EYE, *boxes, own=0)[1] > 100
    assert lidar_points(LidarSensor(), inside, EYE, *boxes)[1] == 0


def test_in_view_is_sector_channels_and_range() -> None:
    points = np.array([[50.0, 0.0, 1.8], [-50.0, 0.0, 1.8], [50.0, 51.0, 1.8], [2.0, 0.0, 0.0], [101.0, 0.0, 1.8]])
    whole, sector = LidarSensor(), LidarSensor.infrastructure()
    assert in_view(points, ROOF, EYE, whole).tolist() == [True, True, True, False, False]
    assert in_view(points, ROOF, EYE, sector).tolist() == [True, False, False, False, False]


def test_objects_with_returns_are_in_view() -> None:
    random = np.random.default_rng(1)
    position, size, yaw = cars(*random.uniform(-90, 90, (60, 2)))
    pole, down = np.array([-20.0, 5.0, 15.0]), rotation_from_yaw_pitch(0.4, np.radians(30))
    lidar = LidarSensor.infrastructure()
    points = lidar_points(lidar, pole, down, position, size, yaw)
    seen = in_view(position, pole, down, lidar)
    # At the edge of the view a box may be partly visible without its centre.
    assert (points[~seen] > 0).sum() <= 0.1 * (points > 0).sum()
    assert (points[seen] > 0).mean() > 0.7
