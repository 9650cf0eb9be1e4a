"""False objects move like real ones."""

import numpy as np
import pytest
from attack_worlds import at, world
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.attacks.campaign import (
    MAX_ACCELERATION_MPS2,
    MAX_YAW_RATE,
    MarkovPropagation,
    StaticPropagation,
    TrajectoryPropagation,
)
from mast_zenoh.streams import stream


def test_a_trajectory_is_straight_and_then_brakes_to_a_stop():
    model = TrajectoryPropagation(duration_s=10.0, braking_mps2=2.0)
    states = at((0.0, 0.0), velocity=np.array([[3.0, -4.0, 0.0]]))
    for k in range(150):
        states = model.advance(states, 0.1, k * 0.1, stream(1))
        if k < 99:
            assert states.position[0, :2] == pytest.approx(np.array([0.3, -0.4]) * (k + 1))
            assert states.velocity[0] == pytest.approx([3.0, -4.0, 0.0])
    # braking from 5 m/s takes 2.5 s and 6.25 m
    assert np.hypot(*states.position[0, :2]) == pytest.approx(50.0 + 6.25)
    assert np.all(states.velocity == 0.0)
    assert states.yaw[0] == pytest.approx(np.arctan2(-4.0, 3.0))


@given(
    st.sampled_from([TrajectoryPropagation(duration_s=1.0), MarkovPropagation(sigma_mps2=20.0), StaticPropagation()]),
    st.integers(0, 1000),
    st.floats(0.02, 0.3),
)
def test_objects_move_like_vehicles(model, seed, dt):
    states = world(6, seed=seed)
    states = model.advance(states, 0.0, 0.0, stream(seed))
    for k in range(30):
        before, states = states, model.advance(states, dt, k * dt, stream(seed, k))
        speed = [np.hypot(each.velocity[:, 0], each.velocity[:, 1]) for each in (before, states)]
        yaw_change = np.abs(wrap_angle(states.yaw - before.yaw))
        assert np.all(np.abs(speed[1] - speed[0]) <= MAX_ACCELERATION_MPS2 * dt + 1e-9)
        assert np.all(yaw_change <= MAX_YAW_RATE * dt + 1e-9)
        step = (states.position - before.position)[:, :2]
        assert np.all(np.linalg.norm(step, axis=1) <= np.maximum(*speed) * dt + 1e-9)
        sideways = step[:, 1] * np.cos(states.yaw) - step[:, 0] * np.sin(states.yaw)
        assert np.allclose(sideways, 0.0, atol=1e-9), "they move along their heading"


def test_a_markov_velocity_change_has_standard_deviation_sigma_times_dt():
    start = at(*[(0.0, 0.0)] * 4000, velocity=np.tile([5.0, 0.0, 0.0], (4000, 1)))
    later = MarkovPropagation(sigma_mps2=0.5).advance(start, 0.2, 0.0, stream(1))
    change = later.velocity - start.velocity
    assert np.allclose(change[:, :2].std(axis=0), 0.5 * 0.2, rtol=0.05)
    assert np.allclose(change[:, :2].mean(axis=0), 0.0, atol=0.01)
    assert np.all(change[:, 2] == 0.0)
    assert np.allclose(later.position, start.position + later.velocity * 0.2)


def test_markov_objects_stay_below_their_maximum_speed_and_head_along_their_velocity():
    states = world(50)
    model = MarkovPropagation(sigma_mps2=200.0, max_speed_mps=30.0)
    for k in range(20):
        states = model.advance(states, 0.1, k * 0.1, stream(1, k))
        assert np.all(np.linalg.norm(states.velocity, axis=1) <= 30.0 + 1e-9)
        assert np.allclose(states.yaw, np.arctan2(states.velocity[:, 1], states.velocity[:, 0]))
