"""Transforms between sensor, agent and world frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.geometry import heading, rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Detections
from mast_zenoh.sensing import Camera, sensor_pose, to_sensor, to_world


def some_detections(n: int, seed: int = 0) -> Detections:
    random = np.random.default_rng(seed)
    root = random.normal(size=(n, 3, 3))
    return Detections(
        random.uniform(-80, 80, (n, 3)),
        random.uniform(0.5, 12, (n, 3)),
        random.uniform(-np.pi, np.pi, n),
        random.random(n),
        random.integers(0, 7, n).astype(np.uint8),
        root @ root.transpose(0, 2, 1),
    )


@given(yaw=st.floats(-10, 10), pitch=st.floats(-1.2, 1.2), seed=st.integers(0, 1000))
def test_to_sensor_is_the_inverse_of_to_world(yaw: float, pitch: float, seed: int) -> None:
    position, rotation = np.array([30.0, -20.0, 15.0]), rotation_from_yaw_pitch(yaw, pitch)
    detections = some_detections(7, seed)
    back = to_sensor(to_world(detections, position, rotation), position, rotation)
    for name, values in detections.columns().items():
        np.testing.assert_allclose(getattr(back, name), values, atol=1e-9, err_msg=name)


def test_empty_detections_are_transformed_to_empty_ones() -> None:
    assert len(to_world(Detections.empty(), np.zeros(3), np.eye(3))) == 0


def test_a_pitched_sensor_adds_only_its_heading_to_a_yaw() -> None:
    detections = some_detections(1)
    rotation = rotation_from_yaw_pitch(0.3, np.radians(30))
    turned = to_world(detections, np.zeros(3), rotation)
    assert turned.yaw[0] == pytest.approx(detections.yaw[0] + heading(rotation))


def test_a_point_ahead_of_a_sensor_on_a_rotated_car_is_ahead_of_the_car() -> None:
    position, rotation = sensor_pose(
        np.array([10.0, 0.0, 0.0]), rotation_from_yaw(np.pi / 2), np.array([1.0, 0.0, 1.8]), np.eye(3)
    )
    np.testing.assert_allclose(position, [10.0, 1.0, 1.8], atol=1e-12)
    detection = Detections(
        np.array([[5.0, 0.0, -1.0]]), np.ones((1, 3)), np.zeros(1), np.ones(1), np.zeros(1, np.uint8), np.eye(3)[None]
    )
    np.testing.assert_allclose(to_world(detection, position, rotation).position, [[10.0, 6.0, 0.8]], atol=1e-12)


def test_a_camera_projects_points_ahead_to_the_centre_and_left_points_to_the_left() -> None:
    points = np.array([[10.0, 0.0, 1.6], [10.0, 10.0, 1.6], [10.0, 0.0, 11.6], [-10.0, 0.0, 1.6]])
    pixels, depth = Camera().project(points, np.zeros(3), np.eye(3))
    np.testing.assert_allclose(pixels[:3], [[400, 300], [0, 300], [400, -100]])
    np.testing.assert_allclose(depth, [10, 10, 10, -10])
    assert np.isnan(pixels[3]).all()
