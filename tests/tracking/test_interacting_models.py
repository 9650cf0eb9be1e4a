"""The box tracker with interacting models, and filterpy's estimator as its reference."""

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.linalg import expm
from test_tracking_parts import some_tracks
from test_tracking_traffic import junction
from tracked_objects import nanoseconds
from tracking_worlds import detected, watch

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.streams import stream
from mast_zenoh.tracking import InteractingModelsTracker3D, KalmanBoxTracker3D, Tracker
from mast_zenoh.tracking.interacting_models import InteractingModels
from mast_zenoh.tracking.kalman import process_noise
from mast_zenoh.tracking.tracks import COVARIANCE, ID, MEAN, XX, classes_of, covariances

RATE, STRAIGHT_S, TURN_S, DT = 0.6, 10.0, 3.0, 0.1
NOISE = process_noise(DT, np.full(7, 2.0), 0.2, 1e-3)


def transition(rate: float) -> np.ndarray:
    """Motion at a turn rate, as a matrix exponential: an acceleration of `rate` times the speed, to the left."""
    change = np.zeros((9, 9))
    change[0:3, 6:9] = np.eye(3)
    change[6, 7], change[7, 6] = -rate, rate
    return expm(change * DT)


def reference(row: np.ndarray) -> IMMEstimator:
    """filterpy's estimator for one row of a table of tracks."""
    filters = []
    for rate in (0.0, RATE, -RATE):
        one = KalmanFilter(dim_x=9, dim_z=6)
        one.x, one.P = row[MEAN].copy(), row[COVARIANCE].reshape(9, 9).copy()
        one.F, one.H, one.Q = transition(rate), np.eye(9)[:6], NOISE[int(classes_of(row[None])[0])]
        filters.append(one)
    begin, end = 0.5 / STRAIGHT_S, 1.0 / TURN_S
    switching = expm(DT * np.array([[-2 * begin, begin, begin], [end, -end, 0.0], [end, 0.0, -end]]))
    return IMMEstimator(filters, np.array([STRAIGHT_S, TURN_S / 2, TURN_S / 2]) / (STRAIGHT_S + TURN_S), switching)


def test_the_batched_models_equal_filterpy():
    random, t = some_tracks(8)
    t[:, ID] = np.arange(8)
    expected = [reference(row) for row in t]
    models = InteractingModels(RATE, STRAIGHT_S, TURN_S)
    for _ in range(30):
        models.predict(t, DT, NOISE)
        measured, R = random.normal(size=(8, 6)), np.tile(0.3 * np.eye(6), (8, 1, 1))
        models.correct(t, measured, R)
        for one, z in zip(expected, measured, strict=True):
            one.predict()
            for each in one.filters:
                each.R = R[0]
            one.update(z)
        np.testing.assert_allclose(t[:, MEAN], [one.x for one in expected], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances(t), [one.P for one in expected], rtol=0, atol=1e-9)
        np.testing.assert_allclose(models.probability, [one.mu for one in expected], rtol=0, atol=1e-9)


def test_every_model_takes_on_what_else_changes_a_track():
    _, t = some_tracks(3)
    t[:, ID] = 0, 1, 2
    models = InteractingModels(RATE, STRAIGHT_S, TURN_S)
    models.predict(t, DT, NOISE)
    before = models.covariance.copy()
    t[1, XX] += 2.0
    part = t[1:].copy()
    models.correct(part, part[:, :6].copy(), np.tile(1e9 * np.eye(6), (2, 1, 1)))
    difference = models.covariance - before
    np.testing.assert_allclose(difference[1, :, 0, 0], 2.0, atol=1e-6)
    np.testing.assert_allclose(difference[[0, 2]], 0.0, atol=1e-6)


def test_a_turning_car_is_known_to_turn_and_a_straight_one_not():
    models_of = []
    for rate in (0.5, 0.0, -0.5):
        tracker, yaw, xy = InteractingModelsTracker3D(), 0.0, np.zeros(2)
        for frame in range(30):
            tracker.step(nanoseconds(frame), detected(xy, yaw))
            yaw += rate * 0.1
            xy = xy + 0.9 * np.array([np.cos(yaw), np.sin(yaw)])
        models_of.append(int(tracker.filter.probability[0].argmax()))
    assert models_of == [1, 0, 2]


def test_turns_are_tracked_more_exactly_than_with_one_model():
    def rmse(tracker: Tracker, seed: int) -> float:
        random = stream(seed, "turns")
        result = watch(tracker, junction(random), 150, random)
        assert result["switches"] == 0
        return result["rmse_m"]

    errors = [(rmse(InteractingModelsTracker3D(), seed), rmse(KalmanBoxTracker3D(), seed)) for seed in range(3)]
    assert np.mean(errors, axis=0) @ [1.0, -0.95] < 0


def test_states_of_others_are_tracked_too():
    tracker = InteractingModelsTracker3D()
    source = KalmanBoxTracker3D()
    for frame in range(20):
        states = source.step(nanoseconds(frame), detected([0.8 * frame, 2.0]))
        fused: ObjectStates = tracker.step_states(nanoseconds(frame), states)
    np.testing.assert_allclose(fused.position[0, :2], [15.2, 2.0], atol=0.2)
