"""Reading UrbanIng-V2X from a twin of its layout, and refusal of damaged files."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from comparison import FRAMES, assert_same, assert_seen_without_buildings, junction
from damages import GONE, Damage, assert_refused, value
from mast_datasets.urbaning import UrbanIngV2X
from urbaning_writer import SEQUENCE, SHIFT, TIME_MS, write, write_timesync

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.recording import Recording

TIMESYNC = f"dataset/{SEQUENCE}/timesync_info.csv"
CALIBRATION = f"dataset/{SEQUENCE}/calibration.json"
STATE = f"dataset/{SEQUENCE}/vehicle1_state/{TIME_MS + 200}.json"
LABELS = f"labels/{SEQUENCE}.json"
OWN = "labels_av_track_ids.json"

Edit = Callable[[Any], object]


def assert_twin(read: Recording) -> None:
    """The origin is the middle of the ego's underside in the first frame."""
    _, columns = assert_same(read, junction(), junction().agent_position[0, 0])
    assert list(columns.values()) == [0, 1, 2, 3]
    assert_seen_without_buildings(read, junction(), list(columns.values()))


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the data set; tests do not change it."""
    root = tmp_path_factory.mktemp("urbaning")
    write(root, junction())
    return root


@pytest.fixture
def root(tmp_path: Path, twin: Path) -> Path:
    """A copy of the twin, to be changed."""
    return Path(shutil.copytree(twin, tmp_path / "UrbanIng-V2X"))


def read(path: Path, frames: int | None = None, **parameters: Any) -> Recording:
    return UrbanIngV2X(path=str(path), **parameters).record(0, frames)


def change(file: Path, edit: Edit) -> None:
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


def change_cells(file: Path, edit: Edit) -> None:
    with file.open(newline="") as lines:
        rows = list(csv.reader(lines))
    edit(rows)
    write_timesync(file, rows)


def own_track(content: Any) -> dict[str, Any]:
    """The track of the ego."""
    return next(t for t in content["tracks"] if t["track_id"] == junction().agents[0].object_id)


def other_track(content: Any) -> dict[str, Any]:
    return next(t for t in content["tracks"] if t["track_id"] not in [a.object_id for a in junction().agents])


def test_a_twin_has_the_poses_boxes_ids_and_visibility_of_its_source(twin: Path) -> None:
    recording = read(twin)
    assert recording.name == SEQUENCE
    assert recording.agent_names == ("ego", "mobile_1", "infra_1", "infra_2")
    assert len(recording) == FRAMES
    assert_twin(recording)


def test_the_folder_of_a_sequence_is_found_in_its_data_set(twin: Path) -> None:
    for path, named in ((f"dataset/{SEQUENCE}", None), (f"dataset/{SEQUENCE}", SEQUENCE), ("", SEQUENCE)):
        assert read(twin / path, 1, sequence=named).name == SEQUENCE
    assert {twin / "dataset" / SEQUENCE, twin / LABELS, twin / OWN} < set(UrbanIngV2X(path=str(twin)).inputs())
    with pytest.raises(ConfigurationError, match="unknown sequence 'other'"):
        UrbanIngV2X(path=str(twin), sequence="other").inputs()


def test_one_of_several_sequences_is_chosen_by_name(root: Path) -> None:
    shutil.copytree(root / "dataset" / SEQUENCE, root / "dataset" / "other")
    with pytest.raises(ConfigurationError, match=f"sequence is not given, expected one of 2: {SEQUENCE}, other"):
        read(root)
    assert read(root, 1, sequence=SEQUENCE).name == SEQUENCE
    with pytest.raises(SceneError, match=r"labels_av_track_ids.json: \$: other is missing"):
        read(root, sequence="other")
    with pytest.raises(ConfigurationError, match="unknown sequence 'othr'; did you mean 'other'"):
        read(root, sequence="othr")
    with pytest.raises(ConfigurationError, match=r"sequence is 'other', expected '2024.*: the path is that sequence"):
        read(root / "dataset" / SEQUENCE, sequence="other")


def test_a_car_has_a_box_in_every_frame_although_its_labels_have_gaps(root: Path) -> None:
    def cut(content: Any) -> None:
        track = own_track(content)
        for name in ("timestamps", "positions", "orientations"):
            track[name] = track[name][3:7]
        track["dimensions"] = track["dimensions"][:1]

    change(root / LABELS, cut)
    assert_twin(read(root))


def test_a_car_without_labels_has_the_size_in_av_vehicle_data(root: Path) -> None:
    (root / "av_vehicle_data.json").write_text(json.dumps({"vehicle1": {"size": [5.1, 2.1, 1.9]}}))
    change(root / OWN, lambda content: content[SEQUENCE].pop("vehicle1"))
    change(root / LABELS, lambda content: content["tracks"].remove(own_track(content)))
    recording = read(root)
    own = recording.agents[0].object_id
    assert own not in junction().truth.id
    assert recording.truth.size[recording.truth.id == own].tolist() == [[5.1, 2.1, 1.9]] * FRAMES
    (root / "av_vehicle_data.json").unlink()
    recording = read(root)
    assert recording.truth.size[recording.truth.id == own].tolist() == [[4.8, 1.9, 1.7]] * FRAMES


def test_an_unknown_type_is_read_and_a_van_is_a_car(root: Path) -> None:
    change(root / LABELS, lambda content: other_track(content).update(object_type="Animal", track_id=777))
    change(root / LABELS, lambda content: own_track(content).update(object_type="Van"))
    truth = read(root, 1).truth
    own = junction().agents[0].object_id
    kinds = [CLASSES[truth.class_id[truth.id == number][0]] for number in (777, own)]
    assert kinds == ["unknown", "car"]


def cell(row: int, column: int, new: str) -> Edit:
    return lambda rows: rows[row].__setitem__(column, new)


def drop_frame(rows: list[list[str]]) -> None:
    for row in rows:
        del row[4]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (cell(1, 3, ""), "row timestamp_ms, frame 2: found '', expected `int`"),
        (cell(1, 3, "999999999999999"), "row timestamp_ms, frame 2: found '999999999999999', expected `int` <= 9"),
        (cell(1, 3, str(TIME_MS)), "row timestamp_ms: frame 2: time is not later than that of frame 1"),
        (drop_frame, "row timestamp_ms: frame 3: found a gap of 0.200 s after frame 2, expected at most 0.15 s"),
        (cell(1, 0, "timestamp"), "found no row timestamp_ms; did you mean 'timestamp'"),
        (lambda rows: rows[2].pop(), "line 3: found 12 cells, expected 13"),
        (lambda rows: rows.append(rows[2]), "line 7: found 'crossing2_11_lidar' again, expected each row once"),
        (lambda rows: rows.__delitem__(slice(4, 6)), "found no row vehicle<number>_state"),
        (lambda rows: [row.__delitem__(slice(1, None)) for row in rows], "found no frames, expected at least one"),
        (cell(4, 3, "../1.json"), r"row vehicle1_state, frame 2: found '\.\./1\.json', expected a file name"),
        (cell(4, 3, f"{TIME_MS}.json"), f"frame 2: found '{TIME_MS}.json', expected a file name .* within 50 ms of"),
    ],
)
def test_a_damaged_table_of_frames_is_refused_with_file_row_and_frame(root: Path, edit: Edit, message: str) -> None:
    change_cells(root / TIMESYNC, edit)
    with pytest.raises(SceneError, match=f"timesync_info.csv: .*{message}"):
        read(root)


def tracks(edit: Edit) -> Damage:
    """A change of the labels."""

    def changed(content: Any) -> Any:
        edit(content)
        return content

    return value(LABELS, "", changed)


def other(**values: Any) -> Damage:
    return tracks(lambda content: other_track(content).update(values))


def item(name: str, row: int, new: Any) -> Damage:
    """A value of a list of a track that is no car with a lidar."""
    return tracks(lambda content: other_track(content)[name].__setitem__(row, new))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (tracks(lambda c: c["tracks"].append(other_track(c))), "track_id: found .*, expected an id that no other"),
        (item("timestamps", 1, TIME_MS / 1000), r"timestamps\[1\]: .*expected a time after the one before"),
        (item("timestamps", 1, TIME_MS / 1000 + 0.03), r"timestamps\[1\]: .*expected the time of a frame"),
        (tracks(lambda c: other_track(c)["orientations"].pop()), "orientations: found .*, expected a list of 12"),
        (item("positions", 2, [1.0, 2.0, 1e12]), r"positions\[2\]\[2\]: found .*, expected `float` <= 100000000"),
        (other(dimensions=[[4, 2, 1.5]] * 2), "dimensions: found .*, expected a list of 12"),
        (other(dimensions=[[4, 2, 9000]]), r"dimensions\[0\]\[2\]: found .*, expected `float` <= 1000"),
        (tracks(lambda content: own_track(content)["positions"].__setitem__(2, SHIFT.tolist())), "of vehicle1 in"),
        (value(CALIBRATION, "vehicle2_middle_lidar", GONE), "found 0 sensors vehicle2_…_lidar, expected one"),
        (value(CALIBRATION, "crossing2_11_lidar.extrinsics", {}), "crossing2_11_lidar.extrinsics: gTl is missing"),
        (value(OWN, SEQUENCE, {"vehicle1": 3, "vehicle2": "3"}), "expected a different track for each vehicle"),
    ],
)
def test_a_damaged_file_is_refused_with_its_place_and_reason(root: Path, damage: Damage, message: str) -> None:
    assert_refused(read, root, damage, message)


def test_a_missing_file_is_refused_by_name(root: Path) -> None:
    for file in (TIMESYNC, CALIBRATION, STATE, LABELS, OWN):
        (root / file).rename(root / "moved")
        with pytest.raises(SceneError, match=Path(file).name):
            read(root)
        (root / "moved").rename(root / file)
    with pytest.raises(SceneError, match=r"labels/dataset/\*/timesync_info.csv: found no sequence"):
        read(root / "labels")
    (root / TIMESYNC).write_text('"timestamp_ms,1\n')
    with pytest.raises(SceneError, match=r"timesync_info.csv: not a table"):
        read(root)
