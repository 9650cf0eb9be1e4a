"""Detections that are noisier than the default, or than a tracker may report."""

import numpy as np
import pytest
from tracked_objects import assert_same_bits, nanoseconds
from tracking_worlds import detected, matched

from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.tracking import Innovations, KalmanBoxTracker3D
from mast_zenoh.tracking.box_tracker import DetectionNoise

FRAMES, CARS = 150, 12


def place(frame: int) -> np.ndarray:
    """(CARS, 2) m: on two roads, at 8 m/s one way or the other."""
    way = np.where(np.arange(CARS) % 2, 1.0, -1.0)
    return np.column_stack([np.linspace(-60.0, 60.0, CARS) + 0.8 * way * frame, 8.0 * way])


def world(std_m: float, reported_m: float = 0.0, seed: int = 0) -> list[Detections]:
    """Detections of the cars by frame, with their standard deviation as reported; 0: none."""
    random = np.random.default_rng(seed)
    covariance = np.tile(np.diag([reported_m**2, reported_m**2, 0.04]) * (reported_m > 0.0), (CARS, 1, 1))
    heading = np.where(np.arange(CARS) % 2, 0.0, np.pi)
    return [
        detected(place(frame) + random.normal(0.0, std_m, (CARS, 2)), heading, covariance=covariance)
        for frame in range(FRAMES)
    ]


def followed(frames: list[Detections], tracker: KalmanBoxTracker3D) -> tuple[list[ObjectStates], float, float, int]:
    """Tracks by frame; misses and false tracks per frame after the first 50, and number of ids."""
    tracks = [tracker.step(nanoseconds(frame), detections) for frame, detections in enumerate(frames)]
    pairs = [len(matched(place(frame), tracks[frame])) for frame in range(50, FRAMES)]
    false = [len(tracks[frame]) - n for frame, n in zip(range(50, FRAMES), pairs, strict=True)]
    ids = {track for states in tracks[50:] for track in states.id.tolist()}
    return tracks, CARS - float(np.mean(pairs)), float(np.mean(false)), len(ids)


def test_noise_of_a_metre_without_covariances_costs_no_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    _, missed, false, ids = followed(world(1.0), KalmanBoxTracker3D())
    assert (missed, false, ids) == pytest.approx((0.0, 0.0, CARS), abs=0.1)
    monkeypatch.setattr(DetectionNoise, "learn", lambda *_: None)
    _, missed, false, ids = followed(world(1.0), KalmanBoxTracker3D())
    assert min(missed, false) > 0.9, "without the estimate, detections far off begin tracks of their own"


@pytest.mark.parametrize("std_m", [0.8, 1.0, 1.3])
def test_the_estimate_approaches_the_true_noise(std_m: float) -> None:
    tracker = KalmanBoxTracker3D()
    followed(world(std_m), tracker)
    assert np.sqrt(tracker._noise.variance[:2]) == pytest.approx([std_m] * 2, rel=0.15)
    assert np.sqrt(tracker._noise.variance[2:]) == pytest.approx([0.2, 0.3, 0.3, 0.3])


@pytest.mark.parametrize(("std_m", "reported_m"), [(0.5, 0.0), (1.0, 0.3)])
def test_nothing_changes_near_the_default_or_where_covariances_are_reported(std_m, reported_m, monkeypatch):
    frames = world(std_m, reported_m)
    with_estimate = followed(frames, KalmanBoxTracker3D())[0]
    monkeypatch.setattr(DetectionNoise, "learn", lambda *_: None)
    for one, other in zip(with_estimate, followed(frames, KalmanBoxTracker3D())[0], strict=True):
        assert_same_bits(one, other)


def test_the_estimate_is_bounded_and_returns_to_the_default() -> None:
    tracker = KalmanBoxTracker3D()
    noise = tracker._noise
    for _ in range(300):
        noise.learn(2e13, 10)
    assert np.sqrt(noise.variance[0]) == pytest.approx(2.0)
    for _ in range(10_000):
        noise.learn(-20.0, 10)
    np.testing.assert_array_equal(noise.variance, tracker._variance)


def test_a_tracker_whose_tracks_are_all_too_uncertain_to_report_counts_these_steps() -> None:
    tracker = KalmanBoxTracker3D(max_std_m=0.3)
    tracks, *_ = followed(world(1.0, 1.0), tracker)
    assert all(len(states) == 0 for states in tracks)
    assert tracker.innovations.silent > 100
    assert Innovations.from_summary(tracker.innovations.summary()) == tracker.innovations
    certain = KalmanBoxTracker3D()
    for frame, detections in enumerate([*world(0.4), *[Detections.empty()] * 40]):
        certain.step(nanoseconds(frame), detections)
    assert certain.innovations.silent == 0
