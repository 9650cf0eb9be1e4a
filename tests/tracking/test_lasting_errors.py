"""What trackers know of errors that last."""

import numpy as np
import pytest
from tracked_objects import assert_same_bits, nanoseconds
from tracking_worlds import detected

from mast_zenoh.arrays.states import Detections
from mast_zenoh.tracking import InteractingModelsTracker3D, KalmanBoxTracker3D

STD_M, STEP_S = 0.4, 0.1
NOTHING = Detections.empty()


def wandering(random: np.random.Generator, n: int, frames: int, time_s: float, white_share: float) -> np.ndarray:
    """Errors (frames, n, 2) m: a stationary first-order Gauss-Markov process, and a share that is new in each frame."""
    keep = np.exp(-STEP_S / time_s)
    state, errors = random.normal(size=(n, 2)), []
    for _ in range(frames):
        state = keep * state + np.sqrt(1.0 - keep**2) * random.normal(size=(n, 2))
        errors.append(np.sqrt(1.0 - white_share) * state + np.sqrt(white_share) * random.normal(size=(n, 2)))
    return STD_M * np.array(errors)


def position_nees(lasting_share: float, covariance: bool) -> float:
    """Mean of parked cars after 3 s, 2 expected, of errors of which 0.6 last for 3 s."""
    random = np.random.default_rng(0)
    places = np.array([[20.0 * x, 20.0 * y] for x in range(8) for y in range(8)])
    errors, values = wandering(random, len(places), 90, 3.0, 0.4), []
    known = np.diag([STD_M**2, STD_M**2, 0.04])
    tracker = KalmanBoxTracker3D(lasting_share=lasting_share)
    for frame, error in enumerate(errors):
        sent = np.tile(known, (len(places), 1, 1)) if covariance else None
        tracks = tracker.step(nanoseconds(frame), detected(places + error, covariance=sent))
        if frame >= 30 and frame % 10 == 0:
            off = tracks.position[:, None, :2] - places
            nearest = np.square(off).sum(2).argmin(1)
            off = off[np.arange(len(tracks)), nearest]
            P = tracks.covariance[:, :2, :2]
            values.append(np.vecdot(off, np.linalg.solve(P, off[:, :, None])[:, :, 0]).mean())
    return float(np.mean(values))


@pytest.mark.parametrize("covariance", [True, False], ids=["with covariances", "without covariances"])
def test_a_tracker_that_knows_how_much_of_the_errors_lasts_is_as_certain_as_it_is_exact(covariance):
    assert position_nees(0.0, covariance) > 2.5
    assert 1.0 < position_nees(0.6, covariance) < 2.2


def test_the_positions_are_those_of_a_tracker_that_does_not_know():
    random = np.random.default_rng(1)
    plain, knowing = KalmanBoxTracker3D(lasting_share=0.0), KalmanBoxTracker3D(lasting_share=0.5)
    for frame in range(20):
        seen = detected(np.array([20.0, 5.0]) + random.normal(0.0, STD_M, 2))
        a, b = (tracker.step(nanoseconds(frame), seen) for tracker in (plain, knowing))
        assert_same_bits(a, b.with_(covariance=a.covariance))
    added = b.covariance - a.covariance
    assert np.allclose(added[0, [0, 1], [0, 1]], 0.5 * STD_M**2)
    assert np.count_nonzero(added.round(12)) == 2


@pytest.mark.parametrize("kind", [KalmanBoxTracker3D, InteractingModelsTracker3D])
def test_a_coasting_track_keeps_what_lasts_of_its_errors(kind):
    plain, knowing = kind(lasting_share=0.0), kind(lasting_share=0.5)
    for frame in range(14):
        seen = detected([20.0, 5.0]) if frame < 10 else NOTHING
        a, b = (tracker.step(nanoseconds(frame), seen) for tracker in (plain, knowing))
        if len(a):
            assert np.allclose(b.covariance[0, 0, 0] - a.covariance[0, 0, 0], 0.5 * STD_M**2)
