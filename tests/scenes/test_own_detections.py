"""Detections of a user's own detector are replayed in any scene, whatever their format."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from mast_zenoh import scenario
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.config import registry
from mast_zenoh.errors import MastError, SceneError
from mast_zenoh.scenes import OwnDetections, Recording, RecordingFile, Scene, from_arrays
from mast_zenoh.scenes.own_detections import DetectionRows, read_kitti, write_detections
from mast_zenoh.sensing import DetectionModel

FRAMES = 4
AGENTS = ("ego", "mobile_1")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cars in a row, the first two with lidars; detections with errors and clutter."""
    times = np.arange(FRAMES) / 10
    position = np.zeros((FRAMES, 3, 2))
    position[:, :, 0] = 10.0 * times[:, None] + [0.0, 15.0, 30.0]
    detector = DetectionModel(clutter_rate=2.0)
    path = tmp_path_factory.mktemp("scene") / "cars.npz"
    from_arrays(times_s=times, position=position, agents=[0, 1], detector=detector, seed=3).save(path)
    return path


@pytest.fixture(scope="module")
def whole(saved: Path) -> Recording:
    return Recording.load(saved)


def rows_of(recording: Recording, agent: int) -> DetectionRows:
    parts = [recording.detections_at(frame, agent) for frame in range(len(recording))]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in parts[0].columns()}
    frame = np.repeat(np.arange(len(recording)), [len(part) for part in parts])
    n = len(frame)
    return DetectionRows([""] * n, frame, np.full(n, agent), truth_id=np.full(n, -1), **columns)


def write_lines(path: Path, recording: Recording) -> Path:
    lines = []
    for frame in range(len(recording)):
        for agent, name in enumerate(AGENTS):
            each = recording.detections_at(frame, agent)
            boxes = [
                dict(
                    zip("xyzlwh", [*position, *size], strict=True),
                    **{"yaw": yaw, "score": score, "class": CLASSES[kind], "covariance": covariance, "gt": int(truth)},
                )
                for position, size, yaw, score, kind, covariance, truth in zip(
                    *(values.tolist() for values in each.columns().values()),
                    recording.detection_truth_id_at(frame, agent),
                    strict=True,
                )
            ]
            lines.append(json.dumps({"frame": frame, "agent": name, "detections": boxes}))
    path.write_text("\n".join(lines))
    return path


def write_table(path: Path, recording: Recording, **changes: object) -> Path:
    both = [rows_of(recording, agent) for agent in range(2)]
    columns = {}
    for index, name in enumerate("xyz"):
        columns[name] = np.concatenate([rows.position[:, index] for rows in both])
    for index, name in enumerate("lwh"):
        columns[name] = np.concatenate([rows.size[:, index] for rows in both])
    for name in ("frame", "yaw", "score"):
        columns[name] = np.concatenate([getattr(rows, name) for rows in both])
    columns["agent"] = np.repeat(AGENTS, [len(rows.frame) for rows in both])
    columns["class"] = [CLASSES[kind] for rows in both for kind in rows.class_id]
    for i, j, name in ((0, 0, "xx"), (0, 1, "xy"), (0, 2, "xz"), (1, 1, "yy"), (1, 2, "yz"), (2, 2, "zz")):
        columns[name] = np.concatenate([rows.covariance[:, i, j] for rows in both])
    kept = {name: values for name, values in (columns | changes).items() if values is not None}
    parquet.write_table(pyarrow.table({name: pyarrow.array(list(values)) for name, values in kept.items()}), path)
    return path


def write_folder(folder: Path, recording: Recording) -> Path:
    folder.mkdir(exist_ok=True)
    for agent, name in enumerate(AGENTS):
        write_detections(folder, name, recording, agent)
    return folder


def replayed(saved: Path, path: Path, **options: int) -> Recording:
    return OwnDetections(scene=RecordingFile(path=str(saved)), path=str(path), **options).record(0, None)


@pytest.mark.parametrize("write", [write_lines, write_table, write_folder])
def test_detections_come_back_from_every_format(write, saved: Path, whole: Recording, tmp_path: Path) -> None:
    target = tmp_path / {"write_lines": "d.jsonl", "write_table": "d.parquet", "write_folder": "d"}[write.__name__]
    recording = replayed(saved, write(target, whole))
    assert len(whole.detections) > 8
    assert recording.detection_start.tolist() == whole.detection_start.tolist()
    for name in ("position", "size", "score"):
        np.testing.assert_allclose(getattr(recording.detections, name), getattr(whole.detections, name), atol=2e-6)
    turn = recording.detections.yaw - whole.detections.yaw
    np.testing.assert_allclose(np.sin(turn), 0.0, atol=2e-6)
    if write is not write_folder:  # its lines have neither a covariance nor all classes
        np.testing.assert_allclose(recording.detections.covariance, whole.detections.covariance, atol=1e-9)
        np.testing.assert_array_equal(recording.detections.class_id, whole.detections.class_id)
    if write is write_lines:
        np.testing.assert_array_equal(recording.detection_truth_id, whole.detection_truth_id)
    np.testing.assert_array_equal(recording.points, whole.points)


def test_a_line_of_the_kitti_benchmark_is_in_camera_axes(tmp_path: Path) -> None:
    line = "7 3 Pedestrian 0 0 0.1 1 2 3 4 1.8 0.6 0.8 -2.0 1.7 10.0 0.0 0.5"
    (tmp_path / "ego.txt").write_text(line)
    rows = read_kitti(tmp_path, ["ego"], first_frame=5)
    assert rows.frame.tolist() == [2]
    np.testing.assert_allclose(rows.position, [[10.0, 2.0, 0.9 - 1.7]])  # ahead, left, up
    np.testing.assert_allclose(rows.size, [[0.8, 0.6, 1.8]])
    np.testing.assert_allclose(rows.yaw, -np.pi / 2)  # to the right
    assert CLASSES[rows.class_id[0]] == "pedestrian"


def test_scores_of_any_size_become_confidences_in_the_same_order(tmp_path: Path) -> None:
    lines = [f"0,2,0,0,0,0,{score},1.5,1.8,4.5,0,1,{20 + score},0,0" for score in (-3.0, 0.0, 9.5)]
    (tmp_path / "ego.txt").write_text("\n".join(lines))
    score = read_kitti(tmp_path, ["ego"], 0).score
    assert (np.diff(score) > 0).all()
    np.testing.assert_allclose(score[1], 0.5)


def test_a_shorter_run_leaves_out_later_frames_and_a_whole_one_refuses_them(saved, whole, tmp_path):
    folder = write_folder(tmp_path / "d", whole)
    part = OwnDetections(scene=RecordingFile(path=str(saved)), path=str(folder)).record(0, 2)
    assert len(part.detections) == whole.detection_start[4]
    with pytest.raises(SceneError, match=r"\.txt: line.*frame is 4"):
        replayed(saved, folder, first_frame=-1)


def test_any_scene_takes_detections_in_a_scenario(saved: Path, whole: Recording, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "d", whole)
    _, content = scenario.load("baseline", [f"scene=recording:{saved}", f"scene.detections={folder}"])
    spec = scenario.choose_scene(content["scene"])
    assert spec == {
        "type": "OwnDetections",
        "scene": {"type": "RecordingFile", "path": str(saved)},
        "path": str(folder),
    }
    assert isinstance(registry.build(spec, Scene, "scene"), OwnDetections)
    again = scenario.choose_scene(f"recording:{saved}", detections=dict(path=str(folder), first_frame=1))
    assert again["first_frame"] == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0,2,0,0", r"ego.txt.*2.*4"),
        ("0 2 car", r"2.*3 values"),
        ("0,2,0,0,0,0,x,1,1,1,1,1,1,0,0", r"2: could.*convert"),
        ("0.5,2,0,0,0,0,1,1,1,1,1,1,1,0,0", r"2.*0.5.*number"),
        ("inf,2,0,0,0,0,1,1,1,1,1,1,1,0,0", r"line 2.*frame"),
        ("0,2,0,0,0,0,nan,1,1,1,1,1,1,0,0", "line 2: score"),
        ("0,2,0,0,0,0,1,1,1,1,inf,1,1,0,0", "line 2: position"),
        ("0,2,0,0,0,0,1,0,1,1,1,1,1,0,0", r"line 2: size.*above 0"),
        ("0,2,0,0,0,0,1,1,1,4500,1,1,1,0,0", r"line 2: size.*1000"),
        ("-1,2,0,0,0,0,1,1,1,1,1,1,1,0,0", r"2: frame.*-1"),
        ("0,2,0,0,0,0,1,1,1,1,1,1,1,nan,0", "line 2: yaw"),
    ],
)
def test_a_damaged_line_is_refused_by_file_and_number(line, message, saved, whole, tmp_path):
    folder = write_folder(tmp_path / "d", whole)
    lines = (folder / "ego.txt").read_text().splitlines()
    (folder / "ego.txt").write_text("\n".join([lines[0], line, *lines[2:]]))
    with pytest.raises(SceneError, match=message):
        replayed(saved, folder)


def test_a_missing_file_is_refused_by_name(saved: Path, whole: Recording, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "d", whole)
    (folder / "mobile_1.txt").rename(folder / "mobile1.txt")
    with pytest.raises(SceneError, match=r"mobile_1.txt.*file.*'mobile1'"):
        replayed(saved, folder)
    for missing in ("d.parquet", "d.jsonl", "nosuch"):
        with pytest.raises(SceneError, match=missing):
            replayed(saved, tmp_path / missing)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (dict(frame=0, agent="mobile1", detections=[]), r"agent is 'mobile1'.*mobile_1"),
        (dict(frame=999, agent="ego", detections=[]), "frame is 999, expected 0 to"),
        (dict(frame=0, agent="ego", detections=[dict(x=0, y=0, z=0, l=4500, w=1, h=1, yaw=0)]), r"l, w, h.*4500.*1000"),
        (dict(frame=0, agent="ego", detections=[dict(x=1e9, y=0, z=0, l=4, w=1, h=1, yaw=0)]), r"x, y, z.*1e\+09"),
    ],
)
def test_a_line_of_another_scene_or_unit_is_refused_with_its_number(line, message, saved, whole, tmp_path):
    path = write_lines(tmp_path / "d.jsonl", whole)
    lines = [text for text in path.read_text().splitlines() if json.loads(text)["frame"] or line["agent"] != "ego"]
    path.write_text("\n".join([*lines, json.dumps(line)]))
    with pytest.raises(SceneError, match=f"d.jsonl: line {len(lines) + 1}: {message}"):
        replayed(saved, path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(yaw=None), r"column yaw.*missing"),
        (dict(xy=None), r"covariance.*columns xx"),
        (dict(frame=0.5), r"0.*0.5.*number"),
        (dict(frame=9), r"0: frame.*9"),
        (dict(agent="nobody"), "row 0: .*'nobody'"),
        (dict(l=-1.0), "row 0: size"),
        (dict(score=1.5), r"0: score.*1.5"),
        (dict(x=float("nan")), "row 0: position"),
        (dict(x="here"), r"column x.*numbers"),
        (dict(xx=-1.0), r"0: covariance.*symmetric"),
    ],
)
def test_a_damaged_table_is_refused_by_column_and_row(changes, message, saved, whole, tmp_path):
    n = len(whole.detections)
    columns = {name: None if value is None else [value] * n for name, value in changes.items()}
    with pytest.raises(SceneError, match=f"d.parquet: .*{message}"):
        replayed(saved, write_table(tmp_path / "d.parquet", whole, **columns))


def test_a_truncated_table_is_refused(saved: Path, whole: Recording, tmp_path: Path) -> None:
    path = write_table(tmp_path / "d.parquet", whole)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(SceneError, match=r"d.parquet.*read.*Parquet"):
        replayed(saved, path)


@given(text=st.text(alphabet="0123456789.,-+einfa \n", max_size=120))
def test_any_text_is_read_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("d")
    (folder / "ego.txt").write_text(text)
    try:
        with np.errstate(all="ignore"):
            rows = read_kitti(folder, ["ego"], 0)
            rows.columns(1000, 1, folder)
    except MastError:
        return
    assert np.isfinite(rows.position).all()


def test_the_order_of_rows_within_a_frame_is_kept(whole: Recording) -> None:
    rows = rows_of(whole, 0)
    twice = replace(rows, agent=rows.agent * 0)
    detections, start, _ = twice.columns(FRAMES, 1, Path("d"))
    np.testing.assert_array_equal(detections.position, rows.position)
    assert start[-1] == len(rows.frame)
