"""Detectors applied to lidar returns."""

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Detections, Ints, ObjectStates
from mast_zenoh.sensing import CleanDetector, DetectionModel, Detector, LidarSensor, in_view, to_world
from mast_zenoh.streams import stream

POLE = np.array([0.0, 0.0, 15.0])
DOWN = rotation_from_yaw_pitch(0.7, np.radians(30))
LIDAR = LidarSensor.infrastructure()


def objects(n: int) -> ObjectStates:
    random = np.random.default_rng(5)
    distance, bearing = random.uniform(15, 80, n), 0.7 + random.uniform(-0.7, 0.7, n)
    position = np.stack([distance * np.cos(bearing), distance * np.sin(bearing), np.full(n, 0.75)], axis=1)
    return ObjectStates.of(
        position,
        id=np.arange(100, 100 + n),
        size=np.tile([4.5, 1.8, 1.5], (n, 1)),
        yaw=random.uniform(-np.pi, np.pi, n),
        class_id=np.ones(n, np.uint8),
    )


def detected(detector: Detector, points: np.ndarray, frame: int = 0) -> tuple[Detections, Ints]:
    """Detections in the world frame, and their object ids."""
    detections, ids = detector.detect(objects(len(points)), points, LIDAR, POLE, DOWN, 0.0, stream(3, "test", frame))
    return to_world(detections, POLE, DOWN), ids


def test_the_clean_detector_reports_objects_with_five_points_exactly() -> None:
    detections, ids = detected(CleanDetector(), np.array([0, 4, 5, 500], np.int32))
    truth = objects(4)
    assert ids.tolist() == [102, 103]
    np.testing.assert_allclose(detections.position, truth.position[2:], atol=1e-9)
    np.testing.assert_allclose(detections.yaw, truth.yaw[2:], atol=1e-9)
    np.testing.assert_array_equal(detections.class_id, truth.class_id[2:])


def test_objects_with_more_points_are_detected_more_often() -> None:
    model = DetectionModel(clutter_rate=0.0, points_scale=20.0)
    points = np.repeat(np.array([4, 10, 40, 400], np.int32), 100)
    hits = np.zeros(400)
    for frame in range(50):
        _, ids = detected(model.begin("ego", "lidar", 0.1), points, frame)
        hits[ids - 100] += 1
    share = hits.reshape(4, 100).mean(axis=1) / 50
    np.testing.assert_allclose(share, [0.0, 1 - np.exp(-0.5), 1 - np.exp(-2.0), 1.0], atol=0.03)


@pytest.mark.parametrize("white", [True, False])
def test_errors_have_the_reported_covariance(white: bool) -> None:
    model, points = DetectionModel(clutter_rate=0.0, white=white), np.full(100, 300, np.int32)
    normalised = []
    for frame in range(50):
        detections, ids = detected(model.begin("ego", "lidar", 0.1), points, frame)
        error = detections.position - objects(100).position[ids - 100]
        normalised.append(error / np.sqrt(detections.covariance[:, [0, 1, 2], [0, 1, 2]]))
    np.testing.assert_allclose(np.concatenate(normalised).std(axis=0), 1.0, atol=0.05)


def test_white_errors_are_those_of_earlier_versions() -> None:
    detections, ids = detected(DetectionModel(white=True), np.array([8, 20, 50, 100], np.int32))
    assert ids.tolist() == [102, 103, -1, -1, -1]
    x = [40.912791892, 33.324039787, 17.590303596, 46.069105454, 15.007196260]
    y = [26.535496592, 1.868916906, 51.620779385, 31.799805217, 62.682602340]
    np.testing.assert_allclose(detections.position[:, 0], x, atol=1e-8)
    np.testing.assert_allclose(detections.position[:, 1], y, atol=1e-8)
    score = [0.823981238, 0.809706105, 0.741756306, 0.691379289, 0.603666002]
    np.testing.assert_allclose(detections.score, score, atol=1e-8)


def test_noise_grows_with_range_and_with_few_points() -> None:
    def sigma(points: int) -> np.ndarray:
        detections, ids = detected(DetectionModel(clutter_rate=0.0, points_scale=0.01), np.full(100, points, np.int32))
        order = np.argsort(np.linalg.norm(objects(100).position[ids - 100] - POLE, axis=1))
        return np.sqrt(detections.covariance[order, 0, 0])

    assert (np.diff(sigma(1000)) > 0).all()
    assert (sigma(6) > sigma(1000)).all()


@pytest.mark.parametrize("white", [True, False])
def test_clutter_is_poisson_in_view_and_on_the_ground(white: bool) -> None:
    model = DetectionModel(clutter_rate=2.0, clutter_range_m=60.0, white=white, white_share=0.0)
    counts, places = [], []
    for frame in range(400):
        detections, ids = detected(model.begin("ego", "lidar", 0.1), np.zeros(5, np.int32), frame)
        assert (ids == -1).all()
        counts.append(len(detections))
        places.append(detections)
    assert np.mean(counts) == pytest.approx(2.0, abs=0.2)
    assert np.var(counts) == pytest.approx(2.0, abs=0.5)
    position = np.concatenate([detections.position for detections in places])
    size = np.concatenate([detections.size for detections in places])
    assert in_view(position, POLE, DOWN, LIDAR).all()
    assert np.hypot(position[:, 0], position[:, 1]).max() <= 60.0
    np.testing.assert_allclose(position[:, 2], size[:, 2] / 2, atol=1e-9)


def test_detections_are_sorted_by_score_so_clutter_is_not_revealed_by_order() -> None:
    detections, ids = detected(DetectionModel(clutter_rate=8.0), np.full(20, 200, np.int32))
    assert (np.diff(detections.score) <= 0).all()
    assert (ids == -1).any()
    assert not (np.flatnonzero(ids == -1) >= (ids != -1).sum()).all()


def test_shares_of_the_errors_that_are_more_than_all_are_refused() -> None:
    with pytest.raises(ValueError, match=r"view_share, white_share.*0\.7"):
        DetectionModel(view_share=0.7, white_share=0.4)
