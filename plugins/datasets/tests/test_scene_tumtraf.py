"""Reading TUMTraf-V2X from a twin of its layout, and refusal of damaged files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import FRAMES, assert_same, assert_seen_without_buildings, junction
from mast_datasets.tumtraf import TUMTrafV2X
from tumtraf_writer import CAR, LABELS, POLE, write

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.recording import Recording

OpenLabel = dict[str, Any]


def assert_twin(read: Recording) -> None:
    """The origin is the middle of the ego's underside in the first frame."""
    _, columns = assert_same(read, junction(), junction().agent_position[0, 0])
    assert list(columns.values()) == [0, 2]
    assert_seen_without_buildings(read, junction(), list(columns.values()))


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a split; tests do not change it."""
    folder = tmp_path_factory.mktemp("tumtraf") / "train"
    write(folder, junction())
    return folder


@pytest.fixture
def split(tmp_path: Path, twin: Path) -> Path:
    """The first frames of the twin, to be changed."""
    (tmp_path / "train" / LABELS).mkdir(parents=True)
    for file in sorted((twin / LABELS).iterdir())[:4]:
        (tmp_path / "train" / LABELS / file.name).write_bytes(file.read_bytes())
    return tmp_path / "train"


def read(path: Path, **parameters: Any) -> Recording:
    return TUMTrafV2X(path=str(path), **parameters).record(0, None)


def files(split: Path) -> list[Path]:
    return sorted((split / LABELS).iterdir())


def change(file: Path, edit: Callable[[OpenLabel], object]) -> None:
    content = json.loads(file.read_text())
    edit(content["openlabel"])
    file.write_text(json.dumps(content))


def frame(content: OpenLabel) -> dict[str, Any]:
    (only,) = content["frames"].values()
    return only


def objects(content: OpenLabel) -> dict[str, Any]:
    return frame(content)["objects"]


def first(content: OpenLabel) -> dict[str, Any]:
    """The data of the first object of a frame."""
    return next(iter(objects(content).values()))["object_data"]


def transform(content: OpenLabel) -> dict[str, Any]:
    return frame(content)["frame_properties"]["transforms"][f"{CAR}_to_{POLE}"]


def pole(content: OpenLabel) -> dict[str, Any]:
    return content["coordinate_systems"][POLE]


def without_own(content: OpenLabel) -> None:
    del objects(content)[str(junction().agents[0].object_id)]


def test_a_twin_has_the_poses_boxes_ids_and_visibility_of_its_source(twin: Path) -> None:
    recording = read(twin)
    assert recording.agent_names == ("ego", "infra_1")
    assert len(recording) == FRAMES
    assert_twin(recording)


def test_the_label_folder_itself_and_the_older_name_of_its_parent_are_found(twin: Path, tmp_path: Path) -> None:
    assert read(twin / LABELS).agent_names == ("ego", "infra_1")
    assert TUMTrafV2X(path=str(twin)).inputs() == (twin / LABELS,)
    with pytest.raises(SceneError, match="nowhere: no such folder"):
        TUMTrafV2X(path=str(tmp_path / "nowhere")).inputs()
    (tmp_path / "val").mkdir()
    (tmp_path / "val" / "_labels_point_clouds").symlink_to(twin / "labels_point_clouds")
    assert len(read(tmp_path / "val")) == FRAMES


def test_one_file_may_have_all_frames(split: Path) -> None:
    whole = json.loads(files(split)[0].read_text())
    for file in files(split)[1:]:
        whole["openlabel"]["frames"] |= json.loads(file.read_text())["openlabel"]["frames"]
        file.unlink()
    whole["openlabel"]["frames"] = dict(reversed(whole["openlabel"]["frames"].items()))
    files(split)[0].write_text(json.dumps(whole))
    assert len(read(split)) == 4
    assert_twin(read(split))


def test_sequences_and_lidars_that_are_not_there_are_refused(twin: Path) -> None:
    with pytest.raises(ConfigurationError, match="sequence is 1, expected 0 to 0"):
        read(twin, sequence=1)
    with pytest.raises(ConfigurationError, match="expected each of them once"):
        read(twin, lidars=[CAR, CAR])


def test_a_gap_divides_sequences_and_one_is_chosen(twin: Path, tmp_path: Path) -> None:
    (tmp_path / LABELS).mkdir(parents=True)
    for k, file in enumerate(files(twin)):
        if k != 4:
            (tmp_path / LABELS / file.name).write_bytes(file.read_bytes())
    with pytest.raises(SceneError, match=r"found 2 sequences, .* a gap of 0\.2 s before 16886257.*json, .*sequence=0"):
        read(tmp_path)
    assert [len(read(tmp_path, sequence=k)) for k in (0, 1)] == [4, 7]
    assert len(read(tmp_path, max_gap_s=0.25)) == FRAMES - 1


def test_a_car_without_a_label_gets_a_box_below_its_lidar(split: Path) -> None:
    for file in files(split):
        change(file, without_own)
    recording = read(split)
    own = recording.agents[0].object_id
    assert own not in junction().truth.id
    boxes = recording.truth.select(np.flatnonzero(recording.truth.id == own))
    np.testing.assert_allclose(boxes.position[:, :2], recording.agent_position[:, 0, :2], atol=1e-9)
    assert boxes.size.tolist() == [[4.8, 1.9, 1.7]] * 4
    assert {CLASSES[kind] for kind in boxes.class_id} == {"car"}


def test_a_car_that_is_labelled_at_times_gets_a_box_of_its_own_throughout(split: Path) -> None:
    change(files(split)[2], without_own)
    recording = read(split)
    assert junction().agents[0].object_id not in recording.truth.id
    assert np.count_nonzero(recording.truth.id == recording.agents[0].object_id) == 4


def test_labels_may_name_their_coordinate_system_and_cuboids_may_be_listed(split: Path) -> None:
    def edit(content: OpenLabel) -> None:
        for entry in objects(content).values():
            entry["object_data"]["cuboid"]["coordinate_system"] = POLE
            entry["object_data"]["cuboid"] = [entry["object_data"]["cuboid"]]

    expected = read(split)
    for file in files(split):
        change(file, edit)
    np.testing.assert_allclose(read(split, label_system=CAR).truth.position, expected.truth.position)


def test_a_cuboid_is_its_middle_then_a_quaternion_with_the_scalar_last_then_l_w_h(split: Path) -> None:
    half = float(np.sqrt(0.5))
    val = [691_000.0, 5_335_010.0, 480.75, 0.0, 0.0, half, half, 4.0, 2.0, 1.5]
    cuboid = {"val": val, "coordinate_system": "s110_base"}
    change(files(split)[0], lambda content: first(content).update(cuboid=cuboid))
    number = int(next(iter(objects(json.loads(files(split)[0].read_text())["openlabel"]))))
    truth = read(split).truth_at(0)
    row = truth.id.tolist().index(number)
    expected = np.array([0.0, 10.0, 0.75]) - junction().agent_position[0, 0]
    np.testing.assert_allclose(truth.position[row], expected, atol=1e-6)
    np.testing.assert_allclose(truth.yaw[row], np.pi / 2)
    assert truth.size[row].tolist() == [4.0, 2.0, 1.5]


def test_types_that_are_not_road_users_are_unknown(split: Path) -> None:
    change(files(split)[0], lambda content: first(content).update(type="EMERGENCY_VEHICLE"))
    assert CLASSES[read(split).truth_at(0).class_id[0]] == "unknown"


def put(place: Callable[[OpenLabel], dict[str, Any]], **values: Any) -> Callable[[OpenLabel], object]:
    return lambda content: place(content).update(values)


def value(index: int, number: Any) -> Callable[[OpenLabel], object]:
    """One of the ten numbers of the first cuboid."""
    return lambda content: first(content)["cuboid"]["val"].__setitem__(index, number)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda content: content.update(frames={"a": frame(content)}), "openlabel.frames: found 'a', expected `int`"),
        (
            lambda content: frame(content)["frame_properties"].update(timestamp=7),
            "time is not later than that of frame 16886",
        ),
        (lambda content: frame(content)["frame_properties"].pop("transforms"), f"found no coordinate system '{CAR}'"),
        (lambda content: content.pop("coordinate_systems"), f"the root above {CAR} is '{POLE}', expected 's110_base'"),
        (put(pole, pose_wrt_parent={}), "s110_lidar_ouster_south.pose_wrt_parent: matrix4x4 is missing"),
        (put(pole, pose_wrt_parent={"matrix4x4": np.eye(4).tolist()}), f"{POLE} is at .*: poles do not move"),
        (put(pole, parent=CAR), "expected a tree of coordinate systems"),
        (put(transform, src=POLE, dst=CAR), f"the root above {CAR} is '{CAR}', expected 's110_base'"),
        (put(transform, transform_src_to_dst={"matrix4x4": [0.0] * 15}), "matrix4x4: found .*, expected 4 rows of 4"),
        (put(first, cuboid=[1, 2]), r"cuboid: found \[1, 2\], expected one box"),
        (put(first, coordinate_system="s110_bas"), "coordinate system 's110_bas', .*did you mean 's110_base'"),
        (put(first, cuboid={"val": [0.0] * 9}), "cuboid.val: found .*, expected `array` of length 10"),
        (value(2, 1e9), r"cuboid.val\[2\]: found .*, expected `float` <= 100000000"),
        (value(6, 2.0), r"cuboid.val: found .*, expected a quaternion x, y, z, w of length 1"),
        (value(8, 1e4), r"cuboid.val\[8\]: found .*, expected `float` <= 1000"),
    ],
)
def test_a_damaged_frame_is_refused_with_file_place_and_reason(
    split: Path, edit: Callable[[OpenLabel], object], message: str
) -> None:
    file = files(split)[2]
    change(file, edit)
    with pytest.raises(SceneError, match=f"{file.name}: .*{message}"):
        read(split)


def test_missing_folders_and_labels_are_refused_by_name(split: Path, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"found no label files \*.json, expected them there or in"):
        read(tmp_path)
    (split / LABELS).rename(split / "labels")
    with pytest.raises(ConfigurationError, match=r"labels: the folder is not named .*_registered"):
        read(split / "labels")
    assert read(split / "labels", lidars=[CAR, POLE], label_system=POLE).agent_names == ("ego", "infra_1")
    with pytest.raises(SceneError, match="expected at least one of a car"):
        read(split / "labels", lidars=[POLE])


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda content: content.update(frames={}), "found no frames in 4"),
        (put(transform, src=POLE, dst=CAR), f"the root above {CAR} is '{CAR}', which moves"),
    ],
)
def test_damages_of_all_files_are_refused(split: Path, edit: Callable[[OpenLabel], object], message: str) -> None:
    for file in files(split):
        change(file, edit)
    with pytest.raises(SceneError, match=message):
        read(split)
