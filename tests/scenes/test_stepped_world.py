"""A stepped world is the prepared scene until somebody drives; then only what depends on that changes."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import shapely

from mast_zenoh.driving import Command
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import Intersection, OwnDetections
from mast_zenoh.scenes.making.observe import World

FRAMES = 60
FIRST = 30  # by then the ego drives
SMALL = dict(n_infrastructure=1, n_mobile=1, n_vehicles=8, n_bicycles=1, n_pedestrians=2, dense=False)


@cache
def scene(scene_index: int = 0, **options) -> Intersection:
    return Intersection(scene_index=scene_index, **(SMALL | options))


def stepped(commands: dict[str, Command], first: int = 0, frames: int = FRAMES) -> list[World]:
    """The world of each frame, with the same commands from the first of them on."""
    world, found = scene().world(3, FRAMES), []
    for frame in range(frames):
        found.append(world.now())
        world.step(commands if frame >= first else {})
    return found


@pytest.mark.parametrize(
    ("scene_index", "rate_hz"),
    [(0, 10.0), *(pytest.param(*other, marks=pytest.mark.heavy) for other in ((0, 4.0), (1, 10.0)))],
)
def test_without_commands_it_is_the_prepared_scene_bit_by_bit(scene_index: int, rate_hz: float) -> None:
    junction = scene(scene_index, rate_hz=rate_hz, n_infrastructure=0, dense=True)
    recording, world = junction.record(3, 20), junction.world(3, 20)
    for frame in range(20):
        present, truth = world.now(), recording.truth_at(frame)
        for name in ("id", "position", "velocity", "size", "yaw", "class_id"):
            assert np.array_equal(getattr(present.truth, name), getattr(truth, name)), (frame, name)
        assert np.array_equal(present.agent_position[0], recording.agent_position[frame])
        assert np.array_equal(present.agent_rotation[0], recording.agent_rotation[frame])
        world.step({})


def test_a_commanded_car_does_what_it_is_told_and_those_that_do_not_see_it_drive_on_as_before() -> None:
    honest, braking = stepped({}), stepped({"ego": Command(-6.0, 0.0)}, first=FIRST)
    row = honest[0].agents[0].object_id
    speed = [float(np.hypot(*present.truth.velocity[row, :2])) for present in braking]
    for before, after in pairwise(speed[FIRST:]):
        assert after == pytest.approx(max(before - 0.6, 0.0), abs=1e-9)
    assert speed[-1] == 0.0
    others = np.arange(len(honest[0].truth)) != row
    same = [
        np.array_equal(a.truth.position[others], b.truth.position[others]) for a, b in zip(honest, braking, strict=True)
    ]
    assert all(same[: FIRST + 1])
    moved = np.abs(honest[-1].truth.position - braking[-1].truth.position).max(axis=1)
    assert speed[FIRST] > 2.0
    assert moved[row] > 5.0
    assert np.count_nonzero(moved[others] == 0.0) >= 3, "most road users do not meet the ego"


def test_a_car_with_the_curvature_of_its_choice_leaves_its_lane() -> None:
    world = scene().world(3, FRAMES)
    for _ in range(FIRST):
        world.step({})
    position = world.now().agent_position[0, 0]
    route = world.route("ego").position
    for _ in range(15):
        world.step({"ego": Command(2.0, 0.03)})
    gone = world.now().agent_position[0, 0]
    way = float(np.hypot(*(gone - position)[:2]))
    away = shapely.LineString(route).distance(shapely.Point(gone[:2]))
    assert way > 4.0
    assert away == pytest.approx(0.03 * way**2 / 2.0, rel=0.1)


def test_the_route_begins_at_the_car_and_its_points_are_a_metre_apart() -> None:
    world = scene().world(3, FRAMES)
    route = world.route("ego")
    assert route.position[0] == pytest.approx(world.now().agent_position[0, 0, :2], abs=1e-9)
    step = np.hypot(*np.diff(route.position, axis=0).T)
    assert step == pytest.approx(1.0, abs=0.02)
    assert len(route.position) == len(route.speed)
    assert (route.speed > 0.0).all()


def test_a_line_is_told_as_long_as_the_car_must_stop_there() -> None:
    """Some car waits at a red light in every junction: with it as the ego, the line is before its front."""
    world = Intersection(scene_index=0, n_infrastructure=0, n_mobile=19, n_vehicles=20).world(0, 150)
    stops = []
    for _ in range(60):
        stops += [world.route(car).stop_m for car in world.cars]
        world.step({})
    told = np.array(stops)[np.isfinite(stops)]
    assert len(told) > 0
    assert np.count_nonzero(np.isinf(stops)) > 0
    assert (told > 0.0).all(), "nobody stops behind the line"


def test_a_scene_that_cannot_be_stepped_says_so() -> None:
    recorded = object.__new__(OwnDetections)
    with pytest.raises(ConfigurationError, match=r"OwnDetections.*stepped.*Intersection"):
        recorded.world(0, None)
