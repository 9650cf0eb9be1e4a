"""A small synthetic recording."""

from pathlib import Path

import numpy as np
import pytest

from mast_zenoh.arrays.states import Detections
from mast_zenoh.scenes.agents import SceneAgent
from mast_zenoh.scenes.recording import Recording, truth_states
from mast_zenoh.sensing import Camera, LidarSensor


@pytest.fixture
def recording() -> Recording:
    """The small recording below."""
    return small_recording()


@pytest.fixture(scope="session")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same in a file."""
    path = tmp_path_factory.mktemp("saved") / "scene.npz"
    small_recording().save(path)
    return path


def small_recording() -> Recording:
    """Two frames, an ego and a pole, objects, three detections and a house."""
    agents = (
        SceneAgent("ego", "mobile", 7, LidarSensor(), Camera()),
        SceneAgent("infra_1", "static", -1, LidarSensor.infrastructure(), Camera(mount_position=np.zeros(3))),
    )
    truth = truth_states(
        {
            "id": np.array([7, 9, 7]),
            "position": np.arange(9.0).reshape(3, 3),
            "velocity": np.ones((3, 3)),
            "size": np.full((3, 3), 2.0),
            "yaw": np.array([0.0, 1.0, 2.0]),
            "class_id": np.array([1, 6, 1], np.uint8),
        }
    )
    detections = Detections(
        np.arange(9.0).reshape(3, 3),
        np.ones((3, 3)),
        np.zeros(3),
        np.array([0.9, 0.8, 0.7]),
        np.ones(3, np.uint8),
        np.zeros((3, 3, 3)),
    )
    return Recording(
        name="by hand",
        agents=agents,
        period_ns=100_000_000,
        times_ns=np.array([0, 100_000_000]),
        truth=truth,
        truth_start=np.array([0, 2, 3]),
        points=np.array([[0, 10], [20, 5], [0, 3]], np.int32),
        agent_position=np.zeros((2, 2, 3)),
        agent_rotation=np.tile(np.eye(3), (2, 2, 1, 1)),
        agent_velocity=np.zeros((2, 2, 3)),
        detections=detections,
        detection_start=np.array([0, 1, 1, 1, 3]),
        detection_truth_id=np.array([9, 7, -1]),
        buildings=(np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]]), np.array([[9.0, 9.0], [9.0, 10.0], [10.0, 10.0]])),
        building_height=np.array([12.0, 6.0]),
    )
