"""Scenes from arrays: what is made of them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import mast_zenoh as mast
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError, MastError, SceneError
from mast_zenoh.scenes import from_arrays
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.recording_file import RecordingFile
from mast_zenoh.sensing import CleanDetector

TIMES = np.arange(5) / 10


def road(**changes):
    """A car behind a truck; both drive north at 10 m/s."""
    position = np.zeros((5, 2, 2))
    position[:, :, 1] = 10.0 * TIMES[:, None] + [0.0, 15.0]
    arguments = dict(times_s=TIMES, position=position, size=[(4.5, 1.8, 1.5), (12.0, 2.5, 3.8)])
    return from_arrays(**arguments | dict(kinds=["car", "truck"], detector=CleanDetector(), name="road") | changes)


def test_boxes_stand_on_the_ground_and_head_where_they_move() -> None:
    truth = road().truth_at(2)
    np.testing.assert_allclose(truth.position, [[0.0, 2.0, 0.75], [0.0, 17.0, 1.9]])
    np.testing.assert_allclose(truth.velocity, [[0.0, 10.0, 0.0]] * 2, atol=1e-9)
    np.testing.assert_allclose(truth.yaw, np.pi / 2)
    assert [CLASSES[k] for k in truth.class_id] == ["car", "truck"]


def test_agents_are_named_in_order_and_poles_come_last() -> None:
    recording = road(agents=[1, 0], poles=[(10.0, 0.0, np.pi)])
    assert recording.agent_names == ("ego", "mobile_1", "infra_1")
    assert [agent.object_id for agent in recording.agents] == [1, 0, -1]
    np.testing.assert_allclose(recording.agent_position[0, 2], [10.0, 0.0, 15.0])
    assert recording.points_at(0)[1, 1] > 50  # the car sees the truck


def test_given_returns_replace_the_rays() -> None:
    points = np.zeros((5, 2, 1))
    points[2, 1, 0] = 9
    recording = road(points=points)
    assert recording.points.sum() == 9
    assert [len(recording.detections_at(frame, 0)) for frame in range(5)] == [0, 0, 1, 0, 0]


def test_an_object_that_is_not_there_has_no_row() -> None:
    position = np.zeros((5, 2, 3))
    position[:, 1, 0] = 20.0
    position[1:3, 1] = np.nan
    recording = road(position=position)
    assert [len(recording.truth_at(frame)) for frame in range(5)] == [2, 1, 1, 2, 2]


def test_an_object_that_stands_keeps_its_heading() -> None:
    position = np.zeros((5, 1, 2))
    position[:, 0, 1] = [0.0, 0.0, 1.0, 2.0, 2.0]
    recording = road(position=position, size=(4, 2, 1.5), kinds="car")
    np.testing.assert_allclose(recording.truth.yaw, np.pi / 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(times_s=[[0.0]]), r"times_s.*\(1, 1\)"),
        (dict(times_s=[]), r"\(5, 2, 2\)"),
        (dict(times_s=[0, 1, 2, 2, 3]), r"frame 3.*2"),
        (dict(times_s=[0, 1, np.nan, 2, 3]), r"times_s\[2\].*finite number"),
        (dict(position=np.zeros((5, 2, 4))), r"position.*5.*4"),
        (dict(position=np.full((5, 2, 2), np.inf)), r"position\[0.*0\].*inf"),
        (dict(position="x"), r"position.*array.*numbers"),
        (dict(size=(1.0, 2.0)), r"shape \(2,\).*\(3\)"),
        (dict(size=(1.0, 0.0, 1.0)), "finite numbers above"),
        (dict(yaw=np.zeros(5)), r"expected \(5, 2\)"),
        (dict(kinds="lorry"), r"kinds.*'lorry'.*class"),
        (dict(kinds=["car"]), r"kinds.*1 classes"),
        (dict(agents=[2]), r"agents\[0\].*object.*frames"),
        (dict(poles=[(1.0, 2.0)]), r"shape \(1, 2\)"),
        (dict(points=np.zeros((5, 2, 3))), r"\(5, 2, 1\)"),
        (dict(points=np.full((5, 2, 1), -1)), r"points.*number below"),
        (dict(agents=[]), r"agents.*ego.*least"),
        (dict(agents=[0, 0, 0], frames=None, buildings=[[(0, 0), (1, 1)]]), r"buildings\[0\].*\(2, 2\)"),
    ],
)
def test_an_impossible_array_is_refused_by_name(changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=f"road: .*{message}"):
        road(**changes)


@given(
    position=arrays.arrays(np.float64, st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 4))),
    size=arrays.arrays(np.float64, st.just((3,))),
    agents=st.lists(st.integers(-2, 4), max_size=3),
)
def test_any_arrays_make_a_recording_or_are_refused(position, size, agents) -> None:
    try:
        with np.errstate(all="ignore"):
            recording = from_arrays(times_s=np.arange(len(position)), position=position, size=size, agents=agents)
    except MastError:
        return
    recording.validate()


def test_a_saved_scene_is_played_with_fewer_agents_and_frames(tmp_path: Path) -> None:
    whole = road(agents=[0, 1], poles=[(10.0, 0.0, np.pi), (-10.0, 0.0, 0.0)])
    whole.save(tmp_path / "road.npz")
    file = str(tmp_path / "road.npz")
    same = RecordingFile(path=file).record(0, None)
    np.testing.assert_array_equal(same.detections.position, whole.detections.position)
    part = RecordingFile(path=file, n_mobile=0, n_infrastructure=1).record(0, 3)
    part.validate()
    assert part.agent_names == ("ego", "infra_1")
    assert len(part) == 3
    for frame in range(3):
        np.testing.assert_array_equal(part.points_at(frame), whole.points_at(frame)[:, [0, 2]])
        for column, row in ((0, 0), (1, 2)):
            ours, theirs = part.detections_at(frame, column), whole.detections_at(frame, row)
            np.testing.assert_array_equal(ours.position, theirs.position)
            np.testing.assert_array_equal(
                part.detection_truth_id_at(frame, column), whole.detection_truth_id_at(frame, row)
            )
    with pytest.raises(ConfigurationError, match=r"n_mobile.*2.*1"):
        RecordingFile(path=file, n_mobile=2).record(0, None)
    with pytest.raises(ConfigurationError, match=r"frames requested.*scene"):
        RecordingFile(path=file).record(0, 9)


def test_the_public_api_names_a_missing_or_unknown_argument(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"position.*times_s.*position"):
        mast.scene(times_s=TIMES)
    with pytest.raises(ConfigurationError, match=r"parameter 'sizes'.*'size'"):
        mast.scene(times_s=TIMES, position=np.zeros((5, 1, 2)), sizes=1)
    scene = mast.scene(times_s=TIMES, position=np.zeros((5, 1, 2)), frames=2)
    assert isinstance(scene.recording, Recording)
    assert len(scene) == 2
    with pytest.raises(SceneError, match="cannot be written"):
        scene.save(tmp_path / "nosuch" / "scene.npz")
