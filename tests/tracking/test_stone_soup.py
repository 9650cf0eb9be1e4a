"""Trackers of the Stone Soup library as agents' and the command centre's trackers."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import uniform
from tracked_objects import assert_same_bits, nanoseconds
from tracking_worlds import detected, joined

from mast_zenoh import scenario
from mast_zenoh.arrays.states import CLASS_INDEX, COVARIANCE_ORDER, Detections, ObjectStates
from mast_zenoh.config import loading
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import run as launcher
from mast_zenoh.run_folder.recording.difference import compare, explain
from mast_zenoh.tracking import StoneSoupTracker
from mast_zenoh.tracking.association import MeasurementBatch

pytest.importorskip("stonesoup", reason="Stone Soup is not installed")
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity, RandomWalk
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate

from mast_zenoh.tracking import stone_soup_default
from mast_zenoh.tracking.stone_soup_objects import Repeatable, detections_of, matched_rows, object_states, timestamp

pytestmark = pytest.mark.heavy

FRAMES = 6
ORDERS = [COVARIANCE_ORDER, ("x", "vx", "y", "vy", "z", "vz", "l", "w", "h")]

numbers = st.floats(-1e4, 1e4)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def objects(draw: st.DrawFn) -> ObjectStates:
    """Up to five objects with full covariances."""
    n = draw(st.integers(0, 5))
    random = np.random.default_rng(draw(st.integers(0, 999)))
    root = random.normal(size=(n, 9, 9))
    column = st.lists(vectors, min_size=n, max_size=n).map(lambda rows: np.array(rows, float).reshape(n, 3))
    return ObjectStates.of(
        draw(column),
        velocity=np.abs(draw(column)),
        size=draw(column),
        yaw=random.uniform(0.0, np.pi / 2, n),  # the front is where the velocity points
        covariance=root @ root.transpose(0, 2, 1) + np.eye(9),
        score=np.full(n, 0.9),
        class_id=random.integers(0, 7, n).astype(np.uint8),
    )


@given(objects(), st.sampled_from(ORDERS))
def test_states_survive_the_way_to_stone_soup_and_back(states: ObjectStates, order: tuple[str, ...]) -> None:
    measured = MeasurementBatch.states(states)
    detections = detections_of(0, 1, measured, states.score[measured.row], order)
    tracks = []
    for detection in detections:
        mapping = detection.measurement_model.mapping
        mean, covariance = np.zeros((9, 1)), np.zeros((9, 9))
        mean[list(mapping)] = detection.state_vector
        covariance[np.ix_(mapping, mapping)] = detection.measurement_model.noise_covar
        hypothesis = SingleHypothesis(None, detection)
        tracks.append(Track([GaussianStateUpdate(mean, covariance, hypothesis, timestamp=detection.timestamp)]))
    rows = matched_rows(tracks, 1)
    back = object_states(tracks, [track.state for track in tracks], states.id[rows], order, 0.9)
    expected = states.select(rows)
    for name in ("id", "position", "velocity", "size", "class_id", "score"):
        np.testing.assert_array_equal(getattr(back, name), getattr(expected, name))
    np.testing.assert_allclose(back.yaw, expected.yaw, atol=1e-12)
    np.testing.assert_allclose(back.covariance, expected.covariance, rtol=1e-12)
    assert matched_rows(tracks, 2).tolist() == [-1] * len(states)


def test_a_detection_tells_stone_soup_its_class_size_and_covariance() -> None:
    covariance = np.array([[[0.5, 0.1, 0.0], [0.1, 0.3, 0.0], [0.0, 0.0, 0.2]]])
    detections = detected([3.0, 4.0], yaw=0.5, kind="truck", covariance=covariance)
    measured = MeasurementBatch.detections(detections, np.full(6, 0.01))
    (detection,) = detections_of(1_500_000_999, 1, measured, detections.score, COVARIANCE_ORDER)
    assert detection.state_vector.ravel().tolist() == [3.0, 4.0, 1.6, 9.0, 2.5, 3.2]
    assert (detection.metadata["class"], detection.metadata["size"]) == ("truck", (9.0, 2.5, 3.2))
    assert (detection.metadata["yaw"], detection.metadata["score"]) == (0.5, 0.9)
    np.testing.assert_allclose(detection.measurement_model.noise_covar[:2, :2], covariance[0, :2, :2])
    assert (detection.timestamp - timestamp(0)).total_seconds() == 1.5, "the message's time, in whole microseconds"


def followed(tracker: StoneSoupTracker, frames: int = 15) -> list[ObjectStates]:
    """The tracks of a car and of a pedestrian, whom the detector misses after half of the frames."""
    results = []
    for frame in range(frames):
        car = detected([[1.0 * frame, 0.0]], yaw=np.pi)
        walker = detected([[0.0, 20.0 + 0.1 * frame]], kind="pedestrian")
        results.append(tracker.step(nanoseconds(frame), car if frame >= frames // 2 else joined(walker, car)))
    return results


def test_objects_are_tracked_with_their_sizes_classes_and_headings() -> None:
    tracker = StoneSoupTracker()
    results = followed(tracker, 24)
    assert [len(tracks) for tracks in results[:4]] == [0, 0, 2, 2], "three detections confirm"
    first = results[4]
    assert first.id.tolist() == [0, 1]
    car = first.select(first.class_id == CLASS_INDEX["car"])
    assert car.position[0, :2] == pytest.approx([4.0, 0.0], abs=0.1)
    assert car.size[0] == pytest.approx([4.5, 1.8, 1.5], abs=0.01)
    assert abs(car.velocity[0, 0] - 10.0) < 1.5
    assert abs(car.yaw[0]) < 1e-9, "it drives where its detections have the rear"
    assert (np.linalg.eigvalsh(first.covariance) > 0.0).all()
    assert results[-1].class_id.tolist() == [CLASS_INDEX["car"]], "the pedestrian's track has ended"
    assert tracker.matched.tolist() == [0]


def test_a_track_without_a_detection_coasts_and_says_so() -> None:
    tracker = StoneSoupTracker()
    before = followed(tracker, 6)[-1]
    after = tracker.step(nanoseconds(7), Detections.empty())
    assert after.id.tolist() == [0, 1]
    assert tracker.matched.tolist() == [-1, -1]
    car = after.class_id == CLASS_INDEX["car"]
    assert after.position[car, 0] > before.position[car, 0] + 1.0


class Lagging:
    """A tracker that stays at its first detection, at the time of that."""

    def __init__(self) -> None:
        self.tracks: set[Track] = set()

    def update_tracker(self, time: Any, detections: set[Any]) -> None:
        if not self.tracks:
            (detection,) = detections
            vector = np.zeros((9, 1))
            vector[list(detection.measurement_model.mapping)] = detection.state_vector
            vector[1] = 10.0
            hypothesis = SingleHypothesis(None, detection)
            self.tracks = {Track([GaussianStateUpdate(vector, np.eye(9), hypothesis, timestamp=time)])}


class LaggingTracker(StoneSoupTracker):
    def build(self) -> Any:
        models = [ConstantVelocity(1.0), ConstantVelocity(1.0)]
        state = ("x", "vx", "y", "vy", "z", "l", "w", "h", "vz")
        model = CombinedLinearGaussianTransitionModel([*models, *[RandomWalk(0.0)] * 5])
        return dict(tracker=Lagging(), predictor=KalmanPredictor(model), state=state)


def test_the_predictor_brings_old_tracks_to_the_time_of_the_frame() -> None:
    tracker = LaggingTracker()
    first = tracker.step(nanoseconds(0), detected([0.0, 0.0]))
    later = tracker.step(nanoseconds(5), Detections.empty())
    assert tracker.matched.tolist() == [-1]
    assert later.id.tolist() == first.id.tolist() == [0]
    assert later.position[0] - first.position[0] == pytest.approx(0.5 * first.velocity[0])
    assert later.covariance[0, 0, 0] > first.covariance[0, 0, 0]


def test_skipping_distant_pairs_does_not_change_the_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for associator in (stone_soup_default.NearbyGNN, GNNWith2DAssignment):
        monkeypatch.setattr(stone_soup_default, "NearbyGNN", associator)
        tracker, random = StoneSoupTracker(), np.random.default_rng(2)
        crowd = np.arange(20)[:, None] * [2.5, 0.5]
        for frame in range(8):
            tracks = tracker.step(nanoseconds(frame), detected(crowd + random.normal(0.0, 1.0, crowd.shape)))
        results.append(tracks)
    assert len(results[0]) > 5
    assert_same_bits(*results)


def test_random_numbers_are_the_trackers_own() -> None:
    before = uniform.rvs(random_state=5)
    np.random.seed(5)  # noqa: NPY002 (the generator that Stone Soup draws from)
    with Repeatable.seeded(1).used():
        drawn = uniform.rvs()
    with Repeatable.seeded(1).used():
        assert uniform.rvs() == drawn != before
    assert uniform.rvs() == before


MISSING = """
import sys
sys.modules["stonesoup"] = None
from mast_zenoh.__main__ import main
sys.argv = ["mast", "run", sys.argv[1], "--runtime", "inproc", "--frames", "2"]
main()
"""
SCENARIO = """
from mast_zenoh.scenario import load


def scenario(builder={builder!r}, n_infrastructure=1):
    _, base = load("baseline", [f"n_infrastructure={{n_infrastructure}}"])
    tracker = dict(type="StoneSoupTracker", builder=builder)
    base["agents"]["*"]["pipeline"]["tracker"] = tracker
    base["command_center"]["pipeline"]["group_tracking"]["tracker"] = tracker
    return base | dict(name="soup")
"""
BUILDER = """
import numpy as np
from datetime import timedelta
from stonesoup.dataassociator.probability import PDA
from stonesoup.deleter.time import UpdateTimeDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import SimpleMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetMixtureTracker
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import KalmanUpdater

from mast_zenoh.tracking.stone_soup_default import NearbyGNN
from my_numbers import COAST_S


def build(density=1e-4):
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(3.0), ConstantVelocity(3.0)])
    predictor, updater = KalmanPredictor(model), KalmanUpdater(None)
    hypothesiser = PDAHypothesiser(predictor, updater, clutter_spatial_density=density, prob_detect=0.9)
    tracker = MultiTargetMixtureTracker(
        initiator=SimpleMeasurementInitiator(GaussianState(np.zeros((4, 1)), np.diag([1, 100, 1, 100]))),
        deleter=UpdateTimeDeleter(timedelta(seconds=COAST_S)),
        detector=None,
        data_associator=PDA(hypothesiser),
        updater=updater,
    )
    return dict(tracker=tracker, state=("x", "vx", "y", "vy"))


def nearest():
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(3.0), ConstantVelocity(3.0)])
    predictor, updater = KalmanPredictor(model), KalmanUpdater(None)
    return dict(
        initiator=SimpleMeasurementInitiator(GaussianState(np.zeros((4, 1)), np.diag([1, 100, 1, 100]))),
        deleter=UpdateTimeDeleter(timedelta(seconds=COAST_S)),
        data_associator=NearbyGNN(DistanceHypothesiser(predictor, updater, Mahalanobis(), 4.0)),
        updater=updater,
        predictor=predictor,
        state=("x", "vx", "y", "vy"),
    )


def nothing():
    return dict(updater=KalmanUpdater(None))


def wrong():
    return dict(update=3)
"""


@pytest.fixture
def mine(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a scenario with a builder, and the builder's file next to it."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "my_tracker.py").write_text(BUILDER)
    (folder / "my_numbers.py").write_text("COAST_S = 0.5\n")

    def written(builder: str) -> Path:
        (folder / "soup.py").write_text(SCENARIO.format(builder=builder))
        return folder / "soup.py"

    return written


def resolved(file: Path) -> Resolved:
    path, loaded = scenario.load(str(file))
    return scenario.resolve(path, loaded, frames=FRAMES, record=True)


@pytest.mark.parametrize("builder", ["", "my_tracker.py:nearest"])
def test_a_run_without_stone_soup_is_refused_with_the_command_that_installs_it(mine, builder):
    file = mine(builder)
    command = [sys.executable, "-c", MISSING, str(file)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, cwd=file.parent)
    assert process.returncode == ConfigurationError.exit_code
    assert "pip install 'mast-zenoh[stonesoup]'" in " ".join((process.stdout + process.stderr).split())


@pytest.mark.parametrize(
    ("builder", "problem"),
    [
        ("other.py:build", r"agents\.\*\.pipeline\.tracker\.builder: no file 'other.py'"),
        ("my_tracker.py:built", r"my_tracker.py defines no function 'built'; did you mean 'build'\?"),
        ("my_tracker", r"found 'my_tracker', expected FILE.py:FUNCTION"),
        ("my_tracker.py:nothing", r"returned no initiator, deleter, data_associator, expected"),
        ("my_tracker.py:wrong", r"returned 'update'; did you mean 'updater'\?"),
    ],
)
def test_a_wrong_builder_is_refused_before_the_run(mine: Callable[[str], Path], builder: str, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        resolved(mine(builder))


def assert_equal(a: Path, b: Path) -> None:
    difference = compare(a, b)
    assert difference.first is None, "\n".join(explain(difference))
    assert difference.equal > 50


@pytest.mark.parametrize("builder", ["", "my_tracker.py:nearest"])
def test_a_run_tracks_objects_and_gives_the_same_bytes_again(mine, tmp_path, builder):
    file = mine(builder)
    runs = [launcher.run(resolved(file), tmp_path / name, runtime="inproc") for name in ("a", "b")]
    assert [run.error for run in runs] == [None, None]
    assert_equal(runs[0].folder, runs[1].folder)


def test_a_user_builder_tracks_in_its_own_state_space(mine: Callable[[str], Path]) -> None:
    file = mine("my_tracker.py:build").parent / "my_tracker.py"
    loading.module(file)
    tracker = StoneSoupTracker(builder=f"{file}:build", options=dict(density=1e-3))
    result = followed(tracker, 12)[5]
    assert result.id.tolist() == [0, 1]
    pedestrian = result.select(result.class_id == CLASS_INDEX["pedestrian"])
    assert pedestrian.size[0] == pytest.approx([0.6, 0.6, 1.7]), "of its last detection"
    assert pedestrian.position[0] == pytest.approx([0.0, 20.5, 0.85], abs=0.1)
    assert tracker.matched.tolist() == [0]
