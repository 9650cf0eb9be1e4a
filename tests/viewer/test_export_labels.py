"""KITTI and MOTChallenge, read back by mast's reader and TrackEval."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trackeval
from mast_datasets.kitti import KittiTracking, read_calibration, read_labels, read_poses
from plain_record import PlainRecord, assert_same_boxes

SEEN = 5  # lidar returns


@pytest.fixture
def kitti(exported_to: Callable[[str], Path]) -> Path:
    return exported_to("kitti")


@pytest.fixture
def mot(exported_to: Callable[[str], Path]) -> Path:
    return exported_to("mot")


# -- KITTI -------------------------------------------------------------------------------------------------------------


def boxes_of_kitti(kitti: Path, file: Path, record: PlainRecord) -> dict[int, tuple[Any, Any]]:
    """Ids and boxes in the world frame, by the readers of the KITTI scene."""
    frames = len(record.frames)
    labels = read_labels(file, frames).boxes
    to_imu, origin = read_calibration(kitti / "calib" / "0000.txt").camera
    position, rotation = read_poses(kitti / "oxts" / "0000.txt")
    position = position + record.poses["ego"][0][0]  # the reader's origin is the first position
    ahead = np.stack([np.cos(labels.yaw), 0 * labels.yaw, -np.sin(labels.yaw)], axis=1)
    middle = labels.position - np.stack([0 * labels.yaw, labels.size[:, 2] / 2, 0 * labels.yaw], axis=1)
    centre = np.einsum("nij,nj->ni", rotation[labels.frame], middle @ to_imu.T + origin) + position[labels.frame]
    heading = np.einsum("nij,nj->ni", rotation[labels.frame], ahead @ to_imu.T)
    box = np.column_stack([centre, labels.size, np.arctan2(heading[:, 1], heading[:, 0])])
    return {frame: (labels.id[labels.frame == frame], box[labels.frame == frame]) for frame in range(frames)}


def in_image(record: PlainRecord, frame: int, boxes: Any) -> np.ndarray:
    """(n,) which boxes the ego's camera may see: with a corner ahead of it, and not around it."""
    place, (w, _, _, z) = record.poses["ego"][frame]
    yaw = 2 * np.arctan2(z, w)
    x, y = (boxes.box[:, :2] - place[:2]).T
    ahead = np.cos(yaw) * x + np.sin(yaw) * y
    reach = np.hypot(boxes.box[:, 3], boxes.box[:, 4]) / 2
    return np.asarray((ahead > -reach) & (np.hypot(x, y) > 1.0))


def test_kitti_labels_and_tracks_are_read_back_at_the_recorded_places(kitti: Path, record: PlainRecord) -> None:
    """Those that are in the image."""
    for name, frames in record.boxes.items():
        file = kitti / "trackers" / name / "data" / "0000.txt"
        if name == "truth":
            file = kitti / "label_02" / "0000.txt"
        written = boxes_of_kitti(kitti, file, record)
        kept = {frame: np.isin(boxes.number, written[frame][0]) for frame, boxes in frames.items()}
        for frame, boxes in frames.items():
            assert not (kept[frame] & ~in_image(record, frame, boxes)).any()
        expected = {
            frame: boxes._replace(number=boxes.number[kept[frame]], box=boxes.box[kept[frame]])
            for frame, boxes in frames.items()
        }
        assert_same_boxes(written, expected, 2e-6)


def test_a_kitti_export_can_be_played_as_a_scene(kitti: Path) -> None:
    scene = KittiTracking(path=str(kitti), n_infrastructure=0).record(0, 3)
    lines = [line.split() for line in (kitti / "label_02" / "0000.txt").read_text().splitlines()]
    assert len(scene) == 3
    for frame in range(3):
        labelled = scene.truth_at(frame).id[1:] - 1  # the ego is the first, as object 0
        assert sorted(labelled.tolist()) == sorted(int(line[1]) for line in lines if line[0] == str(frame))


def kitti_data(kitti: Path) -> Any:
    config = trackeval.datasets.Kitti2DBox.get_default_dataset_config()
    config |= {"GT_FOLDER": str(kitti), "TRACKERS_FOLDER": str(kitti / "trackers"), "SPLIT_TO_EVAL": "training"}
    return trackeval.datasets.Kitti2DBox(config | {"PRINT_CONFIG": False})


def test_trackeval_matches_what_the_picture_has_of_the_cars_that_the_camera_sees(kitti: Path, tmp_path: Path) -> None:
    """A tracker that repeats the labels is perfect, and no car of it is dropped for want of a rectangle."""
    folder = tmp_path / "kitti"
    shutil.copytree(kitti, folder)
    perfect = folder / "trackers" / "perfect" / "data"
    perfect.mkdir(parents=True)
    labels = (folder / "label_02" / "0000.txt").read_text().splitlines()
    perfect.joinpath("0000.txt").write_text("".join(f"{line} 1.0\n" for line in labels))
    data = kitti_data(folder)
    clear = trackeval.metrics.CLEAR({"PRINT_CONFIG": False})
    scores = {
        name: clear.eval_sequence(data.get_preprocessed_seq_data(data.get_raw_seq_data(name, "0000"), "car"))
        for name in ("perfect", "picture")
    }
    whole_cars = [line for line in map(str.split, labels) if line[2] == "Car" and line[3] == "0"]
    assert (scores["perfect"]["CLR_TP"], scores["perfect"]["CLR_FN"]) == (len(whole_cars), 0)
    assert len(whole_cars) > 50
    assert scores["picture"]["CLR_TP"] > 0.5 * len(whole_cars)


def test_rectangles_in_the_image_contain_the_projected_centre(kitti: Path) -> None:
    lines = [line.split() for line in (kitti / "label_02" / "0000.txt").read_text().splitlines()]
    assert len(lines) > 50
    for line in lines:
        left, top, right, bottom, height, _, _, x, y, z = map(float, line[6:16])
        if z < 1.0:
            continue  # the centre is behind the camera, or beside it
        u, v = 400 + 400 * x / z, 300 + 400 * (y - height / 2) / z
        assert left <= max(min(u, 799), 0) <= right
        assert top <= max(min(v, 599), 0) <= bottom


# -- MOTChallenge ------------------------------------------------------------------------------------------------------


def test_trackeval_reads_the_boxes_of_mot_from_above(mot: Path, record: PlainRecord) -> None:
    sequence = (mot / "seqmap.txt").read_text().split()[1]
    config = trackeval.datasets.MotChallenge2DBox.get_default_dataset_config()
    config |= {"GT_FOLDER": str(mot / "gt"), "TRACKERS_FOLDER": str(mot / "trackers"), "SKIP_SPLIT_FOL": True}
    config |= {"SEQMAP_FILE": str(mot / "seqmap.txt"), "DO_PREPROC": False, "BENCHMARK": "MOT15", "PRINT_CONFIG": False}
    data = trackeval.datasets.MotChallenge2DBox(config)
    assert set(data.tracker_list) == set(record.boxes) - {"truth"}
    for name in data.tracker_list:
        raw = data.get_raw_seq_data(name, sequence)
        assert raw["num_timesteps"] == len(record.frames)
        for kind, of in (("gt", "truth"), ("tracker", name)):
            for frame in record.frames:
                order = np.argsort(raw[f"{kind}_ids"][frame])
                boxes = record.boxes[of][frame]
                assert raw[f"{kind}_ids"][frame][order].tolist() == boxes.number.tolist()
                rectangles = raw[f"{kind}_dets"][frame][order].reshape(-1, 4)
                np.testing.assert_allclose(rectangles[:, :2] + rectangles[:, 2:] / 2, boxes.box[:, :2], atol=2e-6)
                length, width, yaw = boxes.box[:, 3], boxes.box[:, 4], boxes.box[:, 6]
                sides = np.abs([np.cos(yaw) * length, np.sin(yaw) * length]) + np.abs(
                    [np.sin(yaw) * width, np.cos(yaw) * width]
                )
                np.testing.assert_allclose(rectangles[:, 2:], sides.T, atol=2e-6)
        scored = data.get_preprocessed_seq_data(raw, "pedestrian")
        seen = sum((boxes.columns["points"].max(axis=1) >= SEEN).sum() for boxes in record.boxes["truth"].values())
        assert (scored["num_gt_dets"], scored["num_tracker_dets"]) == (seen, record.count(name))
        clear = trackeval.metrics.CLEAR({"PRINT_CONFIG": False, "THRESHOLD": 0.1}).eval_sequence(scored)
        assert clear["CLR_TP"] + clear["CLR_FP"] == record.count(name)
        assert clear["CLR_TP"] > 0.5 * record.count(name)


def test_the_example_of_the_page_evaluates_the_folder(
    mot: Path, record: PlainRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to-export.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, flags=re.S | re.M)
    shutil.copytree(mot, tmp_path / "mine_mot")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(block, names)
    (results,) = names["results"].values()
    assert set(results) == set(record.boxes) - {"truth"}
    combined = results["picture"]["COMBINED_SEQ"]["pedestrian"]
    assert 0.1 < combined["CLEAR"]["MOTA"] <= 1.0
    assert combined["Count"]["Dets"] == record.count("picture")
