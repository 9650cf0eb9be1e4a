"""Cars with the shipped drivers in the traffic of generated junctions: nobody collides, nobody leaves its lane."""

from collections import defaultdict

import numpy as np
import pytest
from fuzzing import Fuzzing

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.driving import Driver, FollowingDriver, ProposalDriver, Situation
from mast_zenoh.driving.consequences import collisions
from mast_zenoh.driving.proposals import OFFSETS_M
from mast_zenoh.metrics.driving import RoadUsers, VehicleCourse
from mast_zenoh.scenes import Intersection

#: Frames of 0.1 s; the first ones are driven as in the prepared scene.
FRAMES, UNDRIVEN = 300, 10
#: m, a car may leave the middle of its lane by half of what is free on either side.
LANE_M = 0.8


def check_traffic(driver: type[Driver], scene_index: int, seed: int, frames: int) -> None:
    """Cars that see the truth of a frame ago hit nothing and keep to their lanes."""
    world = Intersection(scene_index=scene_index, n_infrastructure=0, n_mobile=2).world(seed, None)
    beside = LANE_M if driver is FollowingDriver else LANE_M + max(OFFSETS_M)
    drivers, known, moved = defaultdict(driver), None, 0.0
    for frame in range(frames):
        present = world.now()
        truth, commands = present.truth, {}
        for row, agent in enumerate(present.agents):
            route, size = world.route(agent.name), world.size(agent.name)
            own, others = truth.id == agent.object_id, np.flatnonzero(truth.id != agent.object_id)
            car = VehicleCourse(truth.position[own], truth.velocity[own], truth.yaw[own], *size.tolist())
            columns = (truth.position, truth.velocity, truth.size, truth.yaw)
            objects = RoadUsers(np.zeros(len(others), np.int64), *(column[others] for column in columns))
            hit = truth.id[others][collisions(car, objects)]
            assert len(hit) == 0, f"frame {frame}: {agent.name} hits {hit}"
            position, velocity = present.agent_position[0, row], present.agent_velocity[0, row]
            assert np.hypot(*(route.position[0] - position[:2])) < beside
            moved += float(np.hypot(*velocity[:2])) * 0.1
            if known is not None:
                turn = float(heading(present.agent_rotation[0, row]))
                at = Situation(0, position, velocity, turn, size, route, known)
                commands[agent.name] = drivers[agent.name].drive(at)
        known = truth.with_(position=truth.position + 0.1 * truth.velocity)
        world.step(commands if frame >= UNDRIVEN else {})
    assert moved > 0.15 * frames


def test_cars_hit_nothing_and_keep_to_their_lanes() -> None:
    check_traffic(FollowingDriver, 2, 0, 100)


@pytest.mark.heavy
@pytest.mark.parametrize("driver", [FollowingDriver, ProposalDriver])
@pytest.mark.parametrize("scene_index", range(2))
def test_cars_hit_nothing_and_keep_to_their_lanes_for_long(driver, scene_index: int, fuzzing: Fuzzing) -> None:
    for seed in range(scene_index, scene_index + fuzzing.draws(1, 6)):
        check_traffic(driver, scene_index, seed, FRAMES)
