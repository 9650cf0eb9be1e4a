"""Which sensors would see an object that is not there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.sensing import LidarSensor, Walls, lidar_points
from mast_zenoh.sensing.raycast import PlacedSensor, has_returns, observable

ROOF = PlacedSensor(LidarSensor(), np.array([0.0, 0.0, 1.8]), np.eye(3))
CAR = np.array([[4.5, 1.8, 1.5]])
NO_WALLS = Walls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


def objects(*places: tuple[float, float], size: tuple[float, float, float] = (4.5, 1.8, 1.5)) -> ObjectStates:
    """Real objects on the ground, with ids from 1."""
    n = len(places)
    position = np.array([(*place, size[2] / 2) for place in places]).reshape(n, 3)
    sizes = np.tile(size, (n, 1))
    return ObjectStates.of(position, id=np.arange(1, n + 1), size=sizes, yaw=np.zeros(n), velocity=np.zeros((n, 3)))


def returns(
    x: float, y: float, *, walls: Walls | None = None, others: ObjectStates | None = None, sensor: PlacedSensor = ROOF
) -> int:
    """The returns from a car that is not there."""
    place = np.array([[x, y, 0.75]])
    return int(observable(place, CAR, np.zeros(1), [sensor], walls, objects() if others is None else others)[0, 0])


def test_a_phantom_behind_a_wall_is_not_observable() -> None:
    wall = Walls(np.array([[10.0, -20.0]]), np.array([[10.0, 20.0]]), np.array([8.0]))
    assert returns(20.0, 0.0, walls=wall) == 0
    assert returns(5.0, 0.0, walls=wall) > 100
    assert returns(-20.0, 0.0, walls=wall) > 100


def test_the_vehicle_that_carries_the_sensor_hides_nothing() -> None:
    own = objects((0.0, 0.0), size=(4.5, 1.8, 2.5))
    assert returns(20.0, 0.0, others=own, sensor=ROOF._replace(own=1)) == returns(20.0, 0.0)
    assert returns(20.0, 0.0, others=own) == 0, "another box in its place hides everything"


def test_phantoms_do_not_hide_each_other() -> None:
    position = np.array([[10.0, 0.0, 0.75], [18.0, 0.0, 0.75]])
    both = observable(position, np.tile(CAR, (2, 1)), np.zeros(2), [ROOF], None, objects())
    assert both[:, 0].tolist() == [returns(10.0, 0.0), returns(18.0, 0.0)]


@pytest.mark.parametrize("seed", range(2))
def test_returns_equal_those_of_the_scene_with_the_phantom_in_it(seed: int) -> None:
    """Leaving out the objects that cannot be in the way changes nothing."""
    random = np.random.default_rng(seed)
    n = 40
    position = np.column_stack([random.uniform(-60, 60, (n, 2)), np.full(n, 0.8)])
    size, yaw = random.uniform((3, 1.5, 1.4), (12, 2.6, 3.5), (n, 3)), random.uniform(-3, 3, n)
    others = ObjectStates.of(position, id=np.arange(n), size=size, yaw=yaw, velocity=np.zeros((n, 3)))
    pole = PlacedSensor(
        LidarSensor.infrastructure(), np.array([-20.0, 15.0, 12.0]), rotation_from_yaw_pitch(-0.5, np.radians(30.0))
    )
    false = np.column_stack([random.uniform(-50, 50, (10, 2)), np.full(10, 0.75)])
    sizes, yaws = np.tile(CAR, (10, 1)), random.uniform(-3, 3, 10)
    found = observable(false, sizes, yaws, [ROOF, pole], NO_WALLS, others)
    for row in range(10):
        boxes = (
            np.concatenate([false[None, row], position]),
            np.concatenate([sizes[None, row], size]),
            np.concatenate([yaws[None, row], yaw]),
        )
        for column, sensor in enumerate((ROOF, pole)):
            expected = lidar_points(sensor.lidar, sensor.position, sensor.rotation, *boxes)[0]
            assert found[row, column] == expected
    assert (found > 0).any()
    assert (found == 0).any()


def street(random: np.random.Generator, snap: bool) -> tuple[PlacedSensor, Walls | None, ObjectStates, int]:
    """A sensor, walls and objects around it, on a grid where many edges meet if `snap`; and how many are false."""
    n, false, many = random.integers(0, 30), random.integers(1, 12), random.integers(0, 9)
    place = random.uniform(-50, 50, (n + false, 2)) * random.choice([0.1, 1.0, 3.0])
    size, yaw = random.uniform((0.5, 0.5, 1.0), (12, 2.6, 3.5), (n + false, 3)), random.uniform(-4, 4, n + false)
    start = random.uniform(-60, 60, (many, 2))
    end = start + random.normal(0, 20, (many, 2))
    if snap:
        place, size, yaw = np.round(place / 5) * 5, np.ceil(size), np.round(yaw) * np.pi / 2
        start, end = np.round(start / 10) * 10, np.round(end / 10) * 10
    top = random.choice([1.0, 2.0, 8.0], many)
    position = np.column_stack([place, size[:, 2] / 2])
    numbers = random.permutation(n + false)
    states = ObjectStates.of(position, id=numbers, size=size, yaw=yaw, velocity=np.zeros_like(position))
    lidar = LidarSensor() if random.random() < 0.5 else LidarSensor.infrastructure()
    lidar = LidarSensor(azimuth_step_deg=0.7, channels=9) if random.random() < 0.8 else lidar
    turned = rotation_from_yaw_pitch(random.uniform(-4, 4), random.uniform(-0.2, 0.6))
    height = random.choice([1.0, 1.8, 6.0])
    own = int(random.integers(-1, n + 1))
    sensor = PlacedSensor(lidar, np.array([0.0, 0.0, height]), np.eye(3) if snap else turned, own)
    return sensor, Walls(start, end, top) if random.random() < 0.8 else None, states, int(false)


@given(st.integers(0, 2**32), st.booleans(), st.sampled_from([1, 5, 40]))
def test_an_object_has_enough_returns_exactly_if_casting_all_beams_says_so(seed: int, snap: bool, least: int) -> None:
    sensor, walls, states, false = street(np.random.default_rng(seed), snap)
    boxes, others = states.select(slice(None, false)), states.select(slice(false, None))
    every = observable(boxes.position, boxes.size, boxes.yaw, [sensor], walls, others)[:, 0]
    enough = has_returns(boxes.position, boxes.size, boxes.yaw, sensor, walls, others, least)
    assert enough.dtype == np.bool_
    assert enough.tolist() == (every >= least).tolist()
