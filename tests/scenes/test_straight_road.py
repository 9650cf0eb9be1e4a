"""The road of PosePert's closed loop: what is where, and an ego that can be driven."""

from typing import Any

import numpy as np
import pytest

from mast_zenoh.driving import Command
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import StraightRoad
from mast_zenoh.scenes.generated.road import BEGINS_S, COLLABORATOR, EGO, TARGET


@pytest.mark.parametrize("case", ["cut_in", "leader"])
def test_without_commands_it_is_the_prepared_road_bit_by_bit(case: str) -> None:
    road = StraightRoad(case=case)  # type: ignore[arg-type]
    recording, world = road.record(3, 20), road.world(3, 20)
    for frame in range(20):
        present, truth = world.now(), recording.truth_at(frame)
        for name in ("id", "position", "velocity", "size", "yaw", "class_id"):
            assert np.array_equal(getattr(present.truth, name), getattr(truth, name)), (frame, name)
        assert np.array_equal(present.agent_position[0], recording.agent_position[frame])
        world.step({})


@pytest.mark.parametrize(
    ("case", "ahead_m", "behind_m", "aside_m", "speed"),
    [("cut_in", 16.0, 8.0, 3.5, 2.5), ("leader", 45.0, None, 1.0, 0.0)],
)
def test_the_vehicle_is_where_the_case_says_when_it_begins(
    case: Any, ahead_m: float, behind_m: float | None, aside_m: float, speed: float
) -> None:
    places = []
    for seed in range(12):
        world = StraightRoad(case=case).world(seed, None)
        for _ in range(round(BEGINS_S * 10)):
            world.step({})
        truth = world.now().truth
        offset = truth.position[TARGET] - truth.position[EGO]
        places.append(offset[:2])
        assert abs(offset[0] - ahead_m) <= 5.0
        assert abs(abs(offset[1]) - aside_m) <= 0.15
        assert truth.velocity[TARGET, 0] == speed
        collaborator = truth.position[COLLABORATOR]
        if behind_m is not None:
            assert truth.position[TARGET, 0] - collaborator[0] == pytest.approx(behind_m)
        assert np.sign(collaborator[1]) == np.sign(offset[1])
    assert {float(side) for side in np.sign(np.array(places)[:, 1])} == {-1.0, 1.0}


def test_a_commanded_ego_brakes_and_steers_and_the_others_keep_their_speed() -> None:
    world = StraightRoad(case="leader").world(0, None)
    for _ in range(10):
        world.step({"ego": Command(-2.0, 0.01)})
    truth = world.now().truth
    assert np.hypot(*truth.velocity[EGO, :2]) == pytest.approx(25.0 / 3.6 - 2.0)
    assert truth.position[EGO, 0] == pytest.approx(25.0 / 3.6 - 1.0, abs=0.05)
    assert truth.position[EGO, 1] == pytest.approx(0.5 * 0.01 * (25.0 / 3.6 - 1.0) ** 2, rel=0.02)
    assert not truth.velocity[[TARGET, COLLABORATOR]].any()


def test_another_case_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="case"):
        StraightRoad(case="leadre")  # type: ignore[arg-type]
