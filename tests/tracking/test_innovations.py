"""Trackers tell how far measurements are from where they expected them: NIS, without any truth."""

import json
import math
from typing import Any

import numpy as np
import pytest
from tracked_objects import STEP_S, centre, nanoseconds
from tracking_worlds import detected

from mast_zenoh.arrays.states import Detections, Floats, ObjectStates
from mast_zenoh.fusion import CovarianceIntersectionFusion, GroupTrackerWrapper
from mast_zenoh.tracking import Innovations, KalmanBoxTracker3D, Tracker
from mast_zenoh.tracking.association import GATE

STANDARD_M = KalmanBoxTracker3D.__init__.__kwdefaults__["position_std_m"]


class SilentTracker(Tracker):
    """A user's tracker that does not tell."""

    matched = np.zeros(0, np.int64)

    def step(self, time_ns: int, detections: Detections, view: object = None) -> ObjectStates:
        return ObjectStates.empty()

    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        return ObjectStates.empty()

    def reset(self) -> None:
        pass


def played(tracker: Tracker, std_m: float, covariance: float | None = None, frames: int = 60, seed: int = 0) -> Tracker:
    """A tracker after some seconds of parked and driving cars, 40 m apart, detected with a standard deviation.

    covariance: m^2, variance of each axis that the detector reports, None: it reports none
    """
    random = np.random.default_rng(seed)
    place = np.array([[40.0 * i, 40.0 * j] for i in range(5) for j in range(5)])
    speed = np.tile([[0.0, 0.0], [8.0, 0.0], [0.0, 5.0], [-6.0, 0.0], [0.0, -3.0]], (5, 1))
    yaw = np.arctan2(speed[:, 1], speed[:, 0])
    for frame in range(frames):
        at = place + STEP_S * frame * speed + random.normal(0.0, std_m, place.shape)
        reported = None if covariance is None else np.tile(covariance * np.eye(3), (len(at), 1, 1))
        tracker.step(nanoseconds(frame), detected(at, yaw, covariance=reported))
    return tracker


def summary(tracker: Tracker) -> dict[str, Any]:
    assert tracker.innovations is not None
    found = tracker.innovations.summary()
    json.dumps(found, allow_nan=False)
    return found


def test_detections_as_noisy_as_assumed_come_out_near_one() -> None:
    """The model also expects cars to accelerate, so constant speed comes out a little below."""
    for covariance in (None, STANDARD_M**2):
        found = summary(played(KalmanBoxTracker3D(), STANDARD_M, covariance))
        assert 0.85 < found["factor"] < 1.05
        assert found["factor_low"] < found["factor"] < found["factor_high"]
        assert found["verdict"] is None
        assert found["pairs"] == pytest.approx(25 * 59, abs=10)


@pytest.mark.parametrize(
    ("std_m", "verdict"), [(3.0 * STANDARD_M, "overconfident"), (0.3 * STANDARD_M, "overcautious")]
)
def test_detections_with_other_noise_than_reported_are_found(std_m: float, verdict: str) -> None:
    assert summary(played(KalmanBoxTracker3D(), std_m, STANDARD_M**2))["verdict"] == verdict


def test_a_tracker_adapts_to_noise_that_is_not_reported() -> None:
    assert summary(played(KalmanBoxTracker3D(), 3.0 * STANDARD_M))["factor"] < 1.6


def test_sudden_displacements_are_counted_apart() -> None:
    tracker = KalmanBoxTracker3D()
    for frame in range(20):
        tracker.step(nanoseconds(frame), detected([[8.0 * STEP_S * frame, 2.4 * (frame >= 15)]], 0.0))
    found = summary(tracker)
    assert found["sudden"] == 1
    assert found["nis"] < 2.0


def test_states_of_other_filters_give_an_upper_bound_only() -> None:
    tracker = KalmanBoxTracker3D()
    states = ObjectStates.of(np.array([[5.0, 5.0, 0.8]]), covariance=np.tile(0.1 * np.eye(9), (1, 1, 1)))
    for frame in range(50):
        tracker.step_states(nanoseconds(frame), states)
    found = summary(tracker)
    assert (found["at_most"], found["low"], found["verdict"]) == (True, 0.0, None)
    assert found["nis"] == pytest.approx(0.0, abs=1e-9)


def test_the_command_centre_passes_on_what_its_tracker_tells() -> None:
    tracker = KalmanBoxTracker3D()
    for each, expected in ((tracker, tracker.innovations), (SilentTracker(), None)):
        wrapper = GroupTrackerWrapper(fusion=CovarianceIntersectionFusion(), tracker=each)
        assert centre(wrapper).innovations is expected


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.0, 4.0])
def test_the_factor_takes_into_account_what_is_beyond_the_gate(factor: float) -> None:
    values: Floats = np.random.default_rng(1).exponential(2.0 * factor**2, 20_000)
    steady = values[values < GATE.steady]
    sums = Innovations(float(steady.sum()), len(steady), len(values) - len(steady))
    found = sums.summary()
    assert found["factor"] == pytest.approx(factor, rel=0.03)
    assert found["factor_low"] < factor < found["factor_high"]


def test_a_summary_is_read_back_from_its_counts() -> None:
    sums = Innovations(41.0, 20, 3, True)
    assert Innovations.from_summary(sums.summary()) == sums
    assert Innovations.from_summary(Innovations().summary()) == Innovations()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pairs", -1),
        ("pairs", 2.0),
        ("pairs", True),
        ("sudden", None),
        ("nis", math.nan),
        ("nis", math.inf),
        ("nis", "2"),
    ],
)
def test_a_summary_that_is_none_is_refused(name: str, value: object) -> None:
    assert Innovations.from_summary(Innovations(4.0, 2).summary() | {name: value}) is None
    assert Innovations.from_summary("a text") is None
