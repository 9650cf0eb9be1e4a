"""The default detector errs over time as those of two real cars do, counted by tools/realism.py."""

import numpy as np
import pytest
from realism import detector, main, measure, miss_lengths

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.scenes import Intersection
from mast_zenoh.sensing import DetectionModel, LidarSensor, to_world
from mast_zenoh.streams import stream


@pytest.mark.heavy
def test_errors_last_as_real_ones_do() -> None:
    measured = measure([Intersection(scene_index=junction).record(0, 120) for junction in range(5)])
    for name, low, high in (
        ("life of a false detection, frames", 2.2, 2.3),
        ("share of them in runs of 5 and more", 39.0, 42.0),
        ("length of a miss, frames", 3.1, 3.6),
        ("its 95th percentile, frames", 10.0, 11.0),
        ("correlation of position errors after 1 s", 0.4, 0.6),
        ("correlation of position errors after 3 s", 0.3, 0.5),
        ("precision", 0.8, 0.9),
        ("recall", 0.65, 0.75),
        ("position error per axis, m", 0.3, 0.6),
    ):
        assert low <= measured[name] <= high, (name, measured[name])


def test_a_miss_is_between_two_matches_of_an_object_that_is_there_all_the_time() -> None:
    there, matched = np.ones(12, bool), np.zeros(12, bool)
    there[8] = False
    matched[[2, 3, 6, 10]] = True
    assert list(miss_lengths(there, matched)) == [2]


def test_the_detector_of_a_command_line_has_its_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    chosen = detector("DetectionModel,white=True,clutter_rate=1.5")
    assert isinstance(chosen, DetectionModel)
    assert chosen.clutter_rate == 1.5
    main(["--scenes", "0", "--frames", "40", "--detector", "DetectionModel,white=True"])
    assert "false detection, frames" in capsys.readouterr().out


def test_an_error_turns_with_its_object_and_stays_when_both_are_turned() -> None:
    """A car is seen from one side, then car and sensor turn about it by 90 degrees."""
    model = DetectionModel(view_share=1.0, white_share=0.0, clutter_rate=0.0).begin("ego", "lidar", 0.1)

    def error(bearing: float, yaw: float) -> np.ndarray:
        """(2,) m, in the frame of the car."""
        car = ObjectStates.of(np.array([[0.0, 0.0, 0.75]]), size=np.array([[4.5, 1.8, 1.5]]), yaw=np.array([yaw]))
        pose = np.array([30 * np.cos(bearing), 30 * np.sin(bearing), 1.8]), np.eye(3)
        detections, _ = model.detect(car, np.array([10_000], np.int32), LidarSensor(), *pose, 0.0, stream(0, "frame"))
        x, y = to_world(detections, *pose).position[0, :2]
        return np.array([x * np.cos(yaw) + y * np.sin(yaw), y * np.cos(yaw) - x * np.sin(yaw)])

    first = error(0.3, 0.0)
    np.testing.assert_allclose(error(0.3 + np.pi / 2, np.pi / 2), first, atol=1e-9)
    assert np.abs(error(0.3 + np.pi, 0.0) - first).max() > 0.05
