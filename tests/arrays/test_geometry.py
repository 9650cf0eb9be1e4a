"""Frames, rotations and boxes: transforms and their inverses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from mast_zenoh.arrays import geometry
from mast_zenoh.arrays.states import ObjectStates

angles = st.floats(-50.0, 50.0)
coordinates = st.floats(-500.0, 500.0)
points = arrays(np.float64, st.tuples(st.integers(0, 6), st.just(3)), elements=coordinates)
vectors = arrays(np.float64, 3, elements=coordinates)
quaternions = arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 0.1)


@given(angles)
def test_a_wrapped_angle_keeps_its_direction_and_lies_within_half_a_turn(angle: float) -> None:
    wrapped = float(geometry.wrap_angle(np.array(angle)))
    assert -np.pi <= wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_yaw_is_counter_clockwise_and_a_pitched_sensor_looks_down() -> None:
    np.testing.assert_allclose(geometry.rotation_from_yaw(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    looking = geometry.rotation_from_yaw_pitch(np.pi / 2, np.pi / 6) @ [1, 0, 0]
    np.testing.assert_allclose(looking, [0, np.cos(np.pi / 6), -0.5], atol=1e-12)
    assert geometry.heading(geometry.rotation_from_yaw_pitch(0.7, 0.5)) == pytest.approx(0.7)


@given(angles, st.floats(-1.5, 1.5))
def test_rotation_matrices_are_orthonormal(yaw: float, pitch: float) -> None:
    rotation = geometry.rotation_from_yaw_pitch(yaw, pitch)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(quaternions)
def test_a_quaternion_and_its_rotation_matrix_agree(quaternion: np.ndarray) -> None:
    rotation = geometry.rotation_from_quaternion(quaternion)
    w, x, y, z = quaternion
    np.testing.assert_allclose(rotation, Rotation.from_quat([x, y, z, w]).as_matrix(), atol=1e-9)
    back = geometry.quaternion_from_rotation(rotation)
    assert back[0] >= 0.0
    assert np.linalg.norm(back) == pytest.approx(1.0)
    np.testing.assert_allclose(geometry.rotation_from_quaternion(back), rotation, atol=1e-9)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,)])
def test_many_quaternions_are_converted_at_once(shape: tuple[int, ...]) -> None:
    quaternion = np.random.default_rng(0).normal(size=(*shape, 4))
    rotation = geometry.rotation_from_quaternion(quaternion)
    assert rotation.shape == (*shape, 3, 3)
    assert geometry.quaternion_from_rotation(rotation).shape == (*shape, 4)
    for index in np.ndindex(*shape):
        one = geometry.rotation_from_quaternion(quaternion[index])
        np.testing.assert_allclose(rotation[index], one, atol=1e-15)


def test_a_point_ahead_of_a_body_is_on_its_x_axis() -> None:
    rotation = geometry.rotation_from_yaw(np.pi / 2)
    ahead = np.array([[5.0, 12.0, 1.0]])
    np.testing.assert_allclose(geometry.to_local(ahead, np.array([5.0, 2.0, 0.0]), rotation), [[10, 0, 1]], atol=1e-12)


def some_states(n: int) -> ObjectStates:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, 9, 9))
    return ObjectStates.of(
        rng.normal(size=(n, 3)) * 30,
        velocity=rng.normal(size=(n, 3)) * 10,
        size=rng.uniform(1, 5, (n, 3)),
        yaw=rng.uniform(-3, 3, n),
        covariance=root @ np.swapaxes(root, 1, 2) + np.eye(9),
    )


@given(st.integers(0, 5), vectors, quaternions)
def test_states_survive_a_round_trip_to_the_world_frame(n: int, origin: np.ndarray, quaternion: np.ndarray) -> None:
    states = some_states(n)
    back = geometry.states_to_local(geometry.states_to_world(states, origin, quaternion), origin, quaternion)
    for name in ("position", "velocity", "covariance", "size"):
        np.testing.assert_allclose(getattr(back, name), getattr(states, name), atol=1e-7, err_msg=name)


@given(vectors, angles)
def test_on_level_ground_states_rotate_with_their_frame(origin: np.ndarray, yaw: float) -> None:
    states = some_states(4)
    turn = geometry.rotation_from_yaw(yaw)
    world = geometry.states_to_world(states, origin, geometry.quaternion_from_rotation(turn))
    np.testing.assert_allclose(world.position, states.position @ turn.T + origin, atol=1e-9)
    np.testing.assert_allclose(world.velocity, states.velocity @ turn.T, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * world.yaw), np.exp(1j * (states.yaw + yaw)), atol=1e-9)
    np.testing.assert_array_equal(world.size, states.size)
    for block in (slice(0, 3), slice(6, 9)):
        np.testing.assert_allclose(
            world.covariance[:, block, block], turn @ states.covariance[:, block, block] @ turn.T, atol=1e-9
        )
    np.testing.assert_allclose(world.covariance[:, 3:6, 3:6], states.covariance[:, 3:6, 3:6], atol=1e-12)


def test_states_in_the_world_frame_are_returned_as_the_same_object() -> None:
    states = some_states(3)
    assert geometry.states_to_world(states, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])) is states


@given(vectors, arrays(np.float64, 3, elements=st.floats(0.1, 20.0)), angles)
def test_box_corners_match_length_width_and_height(position: np.ndarray, size: np.ndarray, yaw: float) -> None:
    (corners,) = geometry.box_corners(position[None], size[None], np.array([yaw]))
    np.testing.assert_allclose(corners.mean(axis=0), position, atol=1e-9)
    local = geometry.to_local(corners, position, geometry.rotation_from_yaw(yaw))
    np.testing.assert_allclose(np.abs(local), np.tile(size / 2, (8, 1)), atol=1e-9)
    assert len({tuple(np.sign(corner)) for corner in local.round(6)}) == 8


def test_lower_corners_come_first_and_each_face_is_in_order() -> None:
    (corners,) = geometry.box_corners(np.zeros((1, 3)), np.array([[4.0, 2.0, 1.0]]), np.zeros(1))
    assert corners[:, 2].tolist() == [-0.5] * 4 + [0.5] * 4
    for ring in (corners[:4], corners[4:]):
        steps = np.linalg.norm(np.diff(np.vstack([ring, ring[:1]])[:, :2], axis=0), axis=1)
        assert steps.tolist() == [4.0, 2.0, 4.0, 2.0]


def test_no_boxes_have_no_corners() -> None:
    assert geometry.box_corners(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0, 8, 3)


@given(points, vectors, st.floats(0.0, 300.0))
def test_range_is_horizontal_and_inclusive(position: np.ndarray, centre: np.ndarray, radius: float) -> None:
    near = geometry.within_range(position, centre, radius)
    above = geometry.within_range(position + np.array([0.0, 0.0, 1e4]), centre, radius)
    np.testing.assert_array_equal(near, above)
    distance = np.hypot(*(position - centre)[:, :2].T)
    sure = np.abs(distance - radius) > 1e-6
    np.testing.assert_array_equal(near[sure], (distance <= radius)[sure])
    assert geometry.within_range(np.array([[3.0, 4.0, 9.0]]), np.zeros(3), 5.0).tolist() == [True]
