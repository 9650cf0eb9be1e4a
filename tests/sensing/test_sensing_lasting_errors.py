"""Errors of a detector that last: over time like real ones, in one frame like those of the model."""

import itertools

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.scenes.generated.intersection import Intersection
from mast_zenoh.sensing import DetectionModel, Detector, LastingErrors, LidarSensor, to_world
from mast_zenoh.streams import stream

LIDAR, POSE = LidarSensor(), (np.array([0.0, 0.0, 1.8]), np.eye(3))
OBJECTS = 400
RETURNS = np.full(OBJECTS, 20, np.int32)


def cars(ids: np.ndarray) -> ObjectStates:
    """Cars on a circle of 30 m, which do not move."""
    n = len(ids)
    angle = ids * 2 * np.pi / OBJECTS
    position = np.stack([30 * np.cos(angle), 30 * np.sin(angle), np.full(n, 0.75)], axis=1)
    size, zero = np.tile([4.5, 1.8, 1.5], (n, 1)), np.zeros(n)
    return ObjectStates(
        ids, position, np.zeros((n, 3)), size, zero, np.zeros((n, 9, 9)), np.ones(n), np.ones(n, np.uint8)
    )


def watched(detector: Detector, frames: int, period_s: float = 0.1, seed: int = 0):
    """(frames, objects) errors along x, NaN where missed, and scores; and the clutter of each frame, world frame."""
    mine = detector.begin("ego", "lidar", period_s)
    error, score = np.full((2, frames, OBJECTS), np.nan)
    clutter = []
    truth = cars(np.arange(OBJECTS))
    for frame in range(frames):
        detections, ids = mine.detect(truth, RETURNS, LIDAR, *POSE, 0.0, stream(seed, "test", frame))
        placed = to_world(detections, *POSE)
        real = ids >= 0
        error[frame, ids[real]] = placed.position[real, 0] - truth.position[ids[real], 0]
        score[frame, ids[real]] = placed.score[real]
        clutter.append(placed.select(~real))
    return error, score, clutter


def correlation(values: np.ndarray, lag: int) -> float:
    one, other = values[:-lag].ravel(), values[lag:].ravel()
    both = np.isfinite(one) & np.isfinite(other)
    return float(np.corrcoef(one[both], other[both])[0, 1])


def test_errors_follow_their_time_constant() -> None:
    error, score, _ = watched(LastingErrors(error_s=1.0, white_share=0.4), 60)
    for lag in (1, 5, 10):
        assert correlation(error, lag) == pytest.approx(0.6 * np.exp(-0.1 * lag), abs=0.05)
    assert correlation(score, 1) > 0.8
    independent, _, _ = watched(DetectionModel(white=True), 60)
    assert correlation(independent, 1) == pytest.approx(0.0, abs=0.05)


def test_in_one_frame_errors_and_misses_are_those_of_the_model() -> None:
    lasting, _, _ = watched(LastingErrors(points_scale=25.0), 60)
    model, _, _ = watched(DetectionModel(white=True), 60)
    assert np.nanstd(lasting) == pytest.approx(np.nanstd(model), rel=0.05)
    assert np.isfinite(lasting).mean() == pytest.approx(np.isfinite(model).mean(), abs=0.02)


def test_misses_come_in_episodes() -> None:
    def mean_length(error: np.ndarray) -> float:
        missed = np.isnan(error)
        return float(missed.sum() / (missed[1:] & ~missed[:-1]).sum())

    lasting, _, _ = watched(LastingErrors(points_scale=25.0), 100)
    independent, _, _ = watched(DetectionModel(white=True), 100)
    assert mean_length(lasting) > 1.8 * mean_length(independent)


def test_clutter_stays_in_its_place_for_its_mean_duration() -> None:
    detector = LastingErrors(clutter_rate=20.0, clutter_s=0.5, white_share=0.0)
    _, _, clutter = watched(detector, 300)
    assert np.mean([len(each) for each in clutter]) == pytest.approx(20.0, rel=0.1)
    lasted = births = 0
    for before, after in itertools.pairwise(clutter):
        distance = np.abs(after.position[:, None] - before.position[None]).max(axis=2)
        again = (distance < 1e-9).any(axis=1)
        lasted, births = lasted + again.sum(), births + (~again).sum()
    assert lasted / births == pytest.approx(1 / np.expm1(0.1 / 0.5), rel=0.15)


def test_true_objects_score_higher_than_clutter_and_more_returns_help() -> None:
    _, score, clutter = watched(LastingErrors(), 20)
    assert np.nanmedian(score) > np.median(np.concatenate([each.score for each in clutter])) + 0.2
    model = LastingErrors()
    few, many = (model._scores(np.array([returns]), np.array([0.5])) for returns in (8.0, 80.0))
    assert many > few


def test_an_object_that_was_out_of_view_begins_anew() -> None:
    mine = LastingErrors().begin("ego", "lidar", 0.1)

    def errors(returns: np.ndarray, name: str) -> np.ndarray:
        """(objects, 2) errors of those with returns, always detected."""
        truth = cars(np.arange(OBJECTS))
        detections, ids = mine.detect(truth, returns, LIDAR, *POSE, 0.0, stream(0, name))
        error = np.full((OBJECTS, 2), np.nan)
        real = ids >= 0
        error[ids[real]] = to_world(detections, *POSE).position[real, :2] - truth.position[ids[real], :2]
        return error

    many = np.full(OBJECTS, 10_000, np.int32)
    first = errors(many, "a")
    errors(np.where(np.arange(OBJECTS) % 2, 0, many), "b")
    third = errors(many, "c")
    assert np.corrcoef(first[::2, 0], third[::2, 0])[0, 1] > 0.3
    assert abs(np.corrcoef(first[1::2, 0], third[1::2, 0])[0, 1]) < 0.2


def test_every_sensor_has_a_memory_of_its_own_and_a_shorter_scene_is_the_beginning_of_a_longer_one() -> None:
    def scene(frames: int, poles: int):
        return Intersection(scene_index=0, n_infrastructure=poles, detector=LastingErrors()).record(5, frames)

    short, long, fewer = scene(4, 2), scene(8, 2), scene(4, 1)
    for frame in range(4):
        for agent in range(3):
            one, other = short.detections_at(frame, agent), long.detections_at(frame, agent)
            np.testing.assert_array_equal(one.position, other.position)
            if agent < 2:
                np.testing.assert_array_equal(one.position, fewer.detections_at(frame, agent).position)
