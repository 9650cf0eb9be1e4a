"""False objects move like what they pretend to be."""

from __future__ import annotations

import numpy as np
import pytest
from attack_worlds import at, world

from mast_zenoh.attacks import MarkovPropagation, StaticPropagation, TrajectoryPropagation
from mast_zenoh.streams import stream


def test_static_objects_stand_and_say_so():
    start = world(5)
    later = StaticPropagation().advance(start, 0.1, 3.0, stream(1))
    assert np.array_equal(later.position, start.position)
    assert np.all(later.velocity == 0.0)


def test_a_trajectory_is_straight_for_its_time_and_then_ends():
    model = TrajectoryPropagation(duration_s=10.0)
    states = at((0.0, 0.0), velocity=np.array([[3.0, -4.0, 0.0]]))
    for k in range(150):
        states = model.advance(states, 0.1, k * 0.1, stream(1))
        if k < 98:
            assert states.position[0, :2] == pytest.approx(np.array([0.3, -0.4]) * (k + 1))
            assert np.array_equal(states.velocity, [[3.0, -4.0, 0.0]])
    assert states.position[0, :2] == pytest.approx([30.0, -40.0])
    assert np.all(states.velocity == 0.0)


def test_a_markov_step_changes_the_velocity_by_sigma_times_the_time():
    start = at(*[(0.0, 0.0)] * 4000, velocity=np.tile([5.0, 0.0, 0.0], (4000, 1)))
    later = MarkovPropagation(sigma_mps2=0.5).advance(start, 0.2, 0.0, stream(1))
    change = later.velocity - start.velocity
    assert np.allclose(change[:, :2].std(axis=0), 0.5 * 0.2, rtol=0.05)
    assert np.allclose(change[:, :2].mean(axis=0), 0.0, atol=0.01)
    assert np.all(change[:, 2] == 0.0)
    assert np.allclose(later.position, start.position + later.velocity * 0.2)


def test_markov_objects_never_exceed_their_greatest_speed_and_turn_with_their_velocity():
    states = world(50)
    model = MarkovPropagation(sigma_mps2=200.0, max_speed_mps=30.0)
    for k in range(20):
        states = model.advance(states, 0.1, k * 0.1, stream(1, k))
        assert np.all(np.linalg.norm(states.velocity, axis=1) <= 30.0 + 1e-9)
        assert np.allclose(states.yaw, np.arctan2(states.velocity[:, 1], states.velocity[:, 0]))
