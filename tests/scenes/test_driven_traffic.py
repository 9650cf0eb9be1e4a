"""Cars with the shipped driver in the traffic of generated junctions: nobody collides, nobody leaves its lane."""

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.driving import FollowingDriver, Situation
from mast_zenoh.driving.consequences import collisions
from mast_zenoh.metrics.driving import Objects, Vehicle
from mast_zenoh.scenes import Intersection

#: Frames of 0.1 s; the first ones are driven as in the prepared scene.
FRAMES, UNDRIVEN = 300, 10
#: m, a car may leave the middle of its lane by half of what is free on either side.
LANE_M = 0.8


@pytest.mark.parametrize(
    ("scene_index", "seed"),
    [
        pytest.param(scene_index, seed, marks=() if (scene_index, seed) == (2, 0) else pytest.mark.heavy)
        for scene_index in range(4)
        for seed in range(6)
    ],
)
def test_cars_that_see_the_truth_of_a_frame_ago_hit_nothing_and_keep_to_their_lanes(
    scene_index: int, seed: int
) -> None:
    world = Intersection(scene_index=scene_index, n_infrastructure=0, n_mobile=2).world(seed, None)
    driver, known, moved = FollowingDriver(), None, 0.0
    for frame in range(FRAMES):
        present = world.now()
        truth, commands = present.truth, {}
        for row, agent in enumerate(present.agents):
            route, size = world.route(agent.name), world.size(agent.name)
            own, others = truth.id == agent.object_id, np.flatnonzero(truth.id != agent.object_id)
            car = Vehicle(truth.position[own], truth.velocity[own], truth.yaw[own], *size.tolist())
            columns = (truth.position, truth.velocity, truth.size, truth.yaw)
            objects = Objects(np.zeros(len(others), np.int64), *(column[others] for column in columns))
            hit = truth.id[others][collisions(car, objects)]
            assert len(hit) == 0, f"frame {frame}: {agent.name} hits {hit}"
            position, velocity = present.agent_position[0, row], present.agent_velocity[0, row]
            assert np.hypot(*(route.position[0] - position[:2])) < LANE_M
            moved += float(np.hypot(*velocity[:2])) * 0.1
            if known is not None:
                turn = float(heading(present.agent_rotation[0, row]))
                commands[agent.name] = driver.drive(Situation(0, position, velocity, turn, size, route, known))
        known = truth.with_(position=truth.position + 0.1 * truth.velocity)
        world.step(commands if frame >= UNDRIVEN else {})
    assert moved > 50.0
