"""Prepared scenes: slices, files and refusals."""

import contextlib
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.inspection import contents, problems
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.recording_file import RecordingFile


def test_a_frame_is_a_slice(recording: Recording) -> None:
    assert len(recording) == 2
    assert recording.agent_names == ("ego", "infra_1")
    assert recording.truth_at(0).id.tolist() == [7, 9]
    assert recording.truth_at(1).id.tolist() == [7]
    assert recording.points_at(1).tolist() == [[0, 3]]
    assert [len(recording.detections_at(f, a)) for f in (0, 1) for a in (0, 1)] == [1, 0, 0, 2]
    assert recording.detection_truth_id_at(1, 1).tolist() == [7, -1]
    assert np.shares_memory(recording.truth_at(0).position, recording.truth.position)


def test_a_recording_survives_a_round_trip(recording: Recording, tmp_path: Path) -> None:
    recording.save(tmp_path / "scene.npz")
    loaded = Recording.load(tmp_path / "scene.npz")
    assert (loaded.name, loaded.period_ns, loaded.agent_names) == ("by hand", 100_000_000, ("ego", "infra_1"))
    for part in ("truth", "detections"):
        for name, values in getattr(recording, part).columns().items():
            np.testing.assert_array_equal(getattr(getattr(loaded, part), name), values)
    np.testing.assert_array_equal(loaded.points, recording.points)
    np.testing.assert_array_equal(loaded.buildings[1], recording.buildings[1])
    pole = loaded.agents[1]
    assert (pole.kind, pole.object_id, pole.sensor.azimuth_max_deg, pole.camera.width) == ("static", -1, 45.0, 800)
    np.testing.assert_array_equal(pole.sensor.mount_position, np.zeros(3))


def test_a_scene_without_buildings_is_saved_and_loaded(recording: Recording, tmp_path: Path) -> None:
    replace(recording, buildings=(), building_height=np.zeros(0)).save(tmp_path / "scene.npz")
    assert Recording.load(tmp_path / "scene.npz").buildings == ()


@pytest.mark.parametrize("damage", ["missing", "empty", "text", "cut"])
def test_a_broken_file_is_refused_by_name(recording: Recording, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "scene.npz"
    recording.save(path)
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "text": b"not a scene", "cut": path.read_bytes()[:-300]}[damage])
    with pytest.raises(SceneError, match=r"scene\.npz.*prepared scene"):
        Recording.load(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"period_ns": 0}, r"period_ns.*0.*positive"),
        ({"points": np.zeros((3, 1), np.int32)}, r"shape \(3, 1\)"),
        ({"detection_start": np.array([0, 2, 1, 1, 3])}, "offsets of detections"),
        ({"agent_position": np.full((2, 2, 3), np.nan)}, r"agent_position\[0.*0\].*nan"),
        ({"buildings": (np.zeros((2, 2)), np.zeros((3, 2)))}, r"buildings\[0\] has shape"),
        ({"agents": ()}, r"2 frames.*agents"),
    ],
)
def test_an_invalid_recording_is_refused_with_the_reason(recording: Recording, change: dict, reason: str) -> None:
    with pytest.raises(SceneError, match=rf"by hand: .*{reason}"):
        replace(recording, **change).validate()


def test_a_prepared_scene_that_claims_more_rows_than_memory_holds_is_refused(recording, tmp_path):
    recording.save(tmp_path / "scene.npz")
    content = (tmp_path / "scene.npz").read_bytes()
    shape = b"'shape': (2,), }"
    assert shape in content
    many = b"'shape': (%d,), }" % 10**15
    with zipfile.ZipFile(tmp_path / "scene.npz") as sound, zipfile.ZipFile(tmp_path / "huge.npz", "w") as huge:
        for info in sound.infolist():
            array = sound.read(info)
            if shape in array:
                array = array.replace(shape + b" " * (len(many) - len(shape)), many)
            huge.writestr(info.filename, array)
    with pytest.raises(SceneError, match=r"huge\.npz.*prepared scene"):
        Recording.load(tmp_path / "huge.npz")


SIMPLE = st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=4)
ANY_JSON = SIMPLE | st.lists(SIMPLE, max_size=3) | st.just({})
ANY_ARRAY = npst.arrays(
    st.sampled_from([np.float64, np.int64, np.uint8, np.bool_, np.dtype("U3"), np.complex64]),
    npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
)


@given(data=st.data())
def test_any_change_of_a_saved_file_is_read_or_refused(data, saved, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    name = data.draw(st.sampled_from(sorted(arrays)))
    if name == "head":
        header = json.loads(str(arrays["head"]))
        parent = data.draw(st.sampled_from([header, header["agents"][0], header["agents"][1]["sensor"]]))
        parent[data.draw(st.sampled_from(sorted(parent)))] = data.draw(ANY_JSON)
        arrays["head"] = np.array(json.dumps(header))
    else:
        arrays[name] = data.draw(ANY_ARRAY)
    np.savez(path, **arrays)
    with contextlib.suppress(SceneError), np.errstate(all="ignore"):
        played = RecordingFile(path=str(path)).record(0, None)
        for frame in range(len(played)):
            played.truth_at(frame)
            for agent in range(len(played.agents)):
                played.detections_at(frame, agent)
        contents(played)
        problems(played)


def test_positions_whose_squares_are_not_numbers_are_read_and_named(saved: Path, tmp_path: Path) -> None:
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    arrays["truth.position"] = arrays["truth.position"].copy()
    arrays["truth.position"][0, 0] = 1.4e154
    np.savez(tmp_path / "far.npz", **arrays)
    with np.errstate(all="ignore"):
        assert problems(RecordingFile(path=str(tmp_path / "far.npz")).record(0, None))
