"""Twins of V2X-Seq-SPD, DAIR-V2X-C and RCooper are read back; damaged ones are refused."""

import json
import shutil
from pathlib import Path
from typing import Any

import dair_writer as writer
import numpy as np
import pytest
from comparison import assert_same, junction
from damages import GONE, Damage, assert_refused, removed, value
from mast_datasets import DAIRScene, RCooperScene
from mast_datasets.dair import linked, matched
from mast_datasets.traffic import Labels

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Recording
from mast_zenoh.scenes.recording import NO_MEASUREMENT
from mast_zenoh.sensing import CleanDetector, sensor_pose, to_world

FRAMES, FEW = 16, 4
SEEN = writer.SEEN
PAIRS = "cooperative/data_info.json"
CAR, POLE = "vehicle-side/data_info.json", "infrastructure-side/data_info.json"
LABELS = "cooperative/label/000011.json"  # of frame 1
CAR_LABELS, POLE_LABELS = "vehicle-side/label/lidar/000011.json", "infrastructure-side/label/virtuallidar/000051.json"
MOUNT, POSE = "vehicle-side/calib/lidar_to_novatel/000011.json", "vehicle-side/calib/novatel_to_world/000011.json"
POLE_POSE = "infrastructure-side/calib/virtuallidar_to_world/000051.json"
WORLD_LABELS = "cooperative/label_world/000011.json"
SITE = f"labels/{writer.SITE}"
COOP = f"{SITE}/coop/{writer.SEQUENCE}/1692685344.100000.json"
OWN = f"{SITE}/118/{writer.SEQUENCE}/1692685344.113000.json"
CALIBRATION = "calib/lidar2world/118.json"


@pytest.fixture(scope="module")
def original() -> Recording:
    """A junction with an ego and three poles."""
    return junction(n_infrastructure=3, n_mobile=0, frames=FRAMES)


def write(folder: Path, original: Recording, count: int) -> Path:
    """The first frames of the junction in all layouts: the folders spd, unreferenced, c and rcooper."""
    writer.write_spd(folder / "spd", original, count)
    writer.write_spd(folder / "unreferenced", original, count, references=False)
    writer.write_c(folder / "c", original, count)
    writer.write_rcooper(folder / "rcooper", original, count)
    return folder


@pytest.fixture(scope="module")
def twins(original: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("twins"), original, FRAMES)


@pytest.fixture(scope="module")
def short(original: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("short"), original, FEW)


def read_spd(root: Path, **options: Any) -> Recording:
    return DAIRScene(path=str(root), detector=CleanDetector(), **options).record(0, None)


def read_c(root: Path) -> Recording:
    return read_spd(root, link_radius_m=2.0)


def read_rcooper(root: Path, **options: Any) -> Recording:
    return RCooperScene(path=str(root), detector=CleanDetector(), **options).record(0, None)


def compare(recording: Recording, original: Recording, agents: tuple[int, ...], kept_ids: bool = True) -> None:
    """Compare times, poses, boxes and who sees what. agents: columns of the original"""
    seen = original.points[:, list(agents)] >= SEEN
    listed = seen.any(axis=1)
    own = [agent.object_id for agent in recording.agents]
    rows, columns = assert_same(recording, original, listed=listed, added=own, kept_ids=kept_ids, bodies=False)
    assert list(columns.values()) == list(agents)
    np.testing.assert_array_equal(recording.points[rows] >= SEEN, seen[listed])
    assert (recording.points[rows][~seen[listed]] == 0).all()


@pytest.mark.parametrize("name", ["spd", "unreferenced"])
def test_the_twin_of_v2x_seq_spd_is_read_back(twins: Path, original: Recording, name: str) -> None:
    recording = read_spd(twins / name)
    assert recording.agent_names == ("ego", "infra_1")
    compare(recording, original, (0, 1))
    assert (recording.agent_velocity[:, 1] == 0.0).all()


def test_the_twins_of_dair_v2x_c_and_rcooper_are_read_back(twins: Path, original: Recording) -> None:
    compare(read_c(twins / "c"), original, (0, 1), kept_ids=False)  # they are linked
    recording = read_rcooper(twins / "rcooper")
    assert recording.agent_names == ("ego", "infra_1", "infra_2")
    assert recording.agents[0].kind == "static"
    assert {agent.object_id for agent in recording.agents} == {-1}
    compare(recording, original, (1, 2, 3))


def test_the_car_has_a_box_below_its_lidar(twins: Path, original: Recording) -> None:
    recording = read_spd(twins / "spd")
    (ego, _) = recording.agents
    own = recording.truth.id == ego.object_id
    assert own.sum() == FRAMES
    np.testing.assert_allclose(recording.truth.position[own][:, :2], recording.agent_position[:, 0, :2])
    np.testing.assert_allclose(recording.truth.yaw[own], heading(recording.agent_rotation[:, 0]))
    assert (recording.points[own, 0] == 0).all()
    assert recording.points[own, 1].max() > SEEN, "without a label of the car, rays decide"
    # The ground is flat and at height 0; the estimate is the bottom of the boxes nearby.
    np.testing.assert_allclose(recording.truth.position[own][:, 2] - 0.8, 0.0, atol=0.3)


def test_a_label_of_the_car_itself_says_when_the_pole_sees_it(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "spd", tmp_path / "spd")
    for frame in (1, 2):
        file = root / "cooperative" / "label" / f"{writer.vehicle_frame(frame)}.json"
        labels = json.loads(file.read_text())
        own = {"type": "Car", "track_id": "900000", "veh_track_id": "-1", "inf_track_id": "i900000", "rotation": 0.1}
        own |= {"3d_location": {"x": 0.5, "y": 0, "z": -1}, "3d_dimensions": {"l": 4.5, "w": 1.8, "h": 1.5}}
        file.write_text(json.dumps([*labels, own]))
        side = root / "infrastructure-side" / "label" / "virtuallidar" / f"{writer.pole_frame(frame)}.json"
        side.write_text(json.dumps([*json.loads(side.read_text()), own | {"track_id": "i900000"}]))
    recording = read_spd(root)
    assert 900000 not in recording.truth.id
    rows = recording.truth.id == recording.agents[0].object_id
    assert (recording.points[rows, 1] >= SEEN).tolist() == [False, True, True, False]


def test_objects_seen_without_a_count_have_at_least_5_returns(short: Path) -> None:
    for recording in (read_spd(short / "spd"), read_rcooper(short / "rcooper")):
        assert set(recording.points[recording.points > 0].tolist()) - set(range(SEEN))
        assert recording.points[recording.points > 0].min() >= 1
        listed = recording.points[recording.truth.id != recording.agents[0].object_id]
        assert listed[listed > 0].min() >= SEEN


def test_the_time_between_car_and_pole_is_exposed_and_limited(short: Path) -> None:
    scene = DAIRScene(path=str(short / "spd"))
    np.testing.assert_allclose(scene.time_differences_s(), np.full(FEW, 0.02))
    with pytest.raises(SceneError, match=r"data_info.json: frame 000010: .*infra_1 is \+0.020 s .* 0.01 s"):
        DAIRScene(path=str(short / "spd"), max_time_difference_s=0.01).record(0, 1)
    poles = RCooperScene(path=str(short / "rcooper"))
    np.testing.assert_allclose(poles.time_differences_s()["120"], np.full(FEW, 0.026))
    with pytest.raises(SceneError, match=r"seq-4: frame 1692685344.026000.json: the frame of agent 120 is \+0.026 s"):
        RCooperScene(path=str(short / "rcooper"), max_time_difference_s=0.02).record(0, 1)


def test_poles_measure_at_the_times_of_their_own_clocks(short: Path) -> None:
    """A measurement 20 ms after a frame is new in the next one, of objects where they were at its time."""
    recording = read_spd(short / "spd")
    ages_ms = [[recording.age_ns_at(frame, agent) / 1e6 for frame in range(FEW)] for agent in (0, 1)]
    assert ages_ms == [[0.0] * FEW, [NO_MEASUREMENT / 1e6, 80.0, 80.0, 80.0]]
    for frame in range(1, FEW):
        before, ids = recording.truth_at(frame - 1), recording.detection_truth_id_at(frame, 1)
        assert set(ids) == set(before.id[recording.points_at(frame - 1)[:, 1] >= SEEN])
        pose = recording.agent_position[frame, 1], recording.agent_rotation[frame, 1]
        found = to_world(recording.detections_at(frame, 1), *sensor_pose(*pose, *recording.mount_at(frame, 1)))
        row = [before.id.tolist().index(number) for number in ids]
        expected = before.position[row] + 0.02 * before.velocity[row]
        np.testing.assert_allclose(found.position, expected, atol=0.02)
        assert np.abs(expected - before.position[row]).max() > 0.1, "something moves"
    poles = read_rcooper(short / "rcooper")
    assert [poles.age_ns_at(2, agent) / 1e6 for agent in range(3)] == pytest.approx([0.0, 87.0, 74.0])


def test_a_sequence_is_chosen_by_parameter_or_path(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "spd", tmp_path / "spd")
    for side in ("vehicle", "infrastructure"):
        value(PAIRS, f"[2].{side}_sequence", "1").apply(root)
    with pytest.raises(ConfigurationError, match="sequence is not given, expected one of 2: 0003, 1"):
        read_spd(root)
    with pytest.raises(ConfigurationError, match="unknown sequence '0004'; did you mean '0003'"):
        read_spd(root, sequence="0004")
    with pytest.raises(ConfigurationError, match="sequence is '2', expected '1' as in the path"):
        read_spd(root / "1", sequence=2)
    for recording in (read_spd(root, sequence=1), read_spd(root / "1"), read_spd(root / "1", sequence="1")):
        assert len(recording) == 1
    assert len(read_spd(tmp_path / "spd" / "0003", max_gap_s=1.0)) == FEW - 1
    for path in (f"{writer.SITE}/{writer.SEQUENCE}", writer.SITE):
        assert len(read_rcooper(short / "rcooper" / path)) == FEW
    assert len(read_rcooper(short / "rcooper", site=writer.SITE, sequence=writer.SEQUENCE)) == FEW


def test_a_range_of_frames_is_read(short: Path) -> None:
    whole, part = read_spd(short / "spd"), read_spd(short / "spd", first_frame=11, last_frame=12)
    assert len(part) == 2
    np.testing.assert_array_equal(part.truth_at(0).position[:-1], whole.truth_at(1).position[:-1])
    with pytest.raises(ConfigurationError, match="found no frame, expected some of 10 to 13"):
        read_spd(short / "spd", first_frame=900)


def test_boxes_without_ids_are_linked_where_their_motion_leads() -> None:
    # Two cars 30 m apart that accelerate: 2, 4, 6 and 8 m from frame to frame.
    frame = np.repeat(np.arange(5), 2)
    position = np.zeros((10, 3))
    position[:, 0] = frame * (frame + 1) + np.tile([0.0, 30.0], 5)
    times = 100_000_000 * np.arange(5)
    cars = np.ones(10, np.int64)
    assert linked(frame, position, cars, times, 2.5).tolist() == [1, 2] * 5
    assert linked(frame, position, cars, times, 0.9).tolist() == list(range(1, 11))
    classes = np.where(frame == 2, 2, 1)
    assert linked(frame, position, classes, times, 2.5).tolist() == [1, 2, 1, 2, 3, 4, 5, 6, 7, 8]
    gone = frame != 2
    assert linked(frame[gone], position[gone], cars[gone], times, 9.0).tolist() == [1, 2, 1, 2, 3, 4, 3, 4]


def test_a_label_matches_one_box_the_nearest() -> None:
    boxes = np.array([[0.0, 0, 0], [1.0, 0, 5], [9.0, 0, 0]])
    assert matched(np.array([[0.8, 0, 0]]), boxes, 2.0).tolist() == [False, True, False]
    assert matched(np.zeros((0, 3)), boxes, 2.0).tolist() == [False] * 3


def test_track_names_that_are_numbers_are_ids() -> None:
    for names, expected in (
        (["000012", "7", "000012"], [12, 7, 12]),
        (["b", "7", "a", "b"], [3, 1, 2, 3]),
        (["9" * 30, "1"], [2, 1]),
    ):
        labels = Labels(Path("x"))
        for name in names:
            labels.add(0, name, np.zeros(3), np.ones(3), 0.0, 1)
        assert labels.boxes()[0].id.tolist() == expected


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (value(PAIRS, "", [])._replace(file=""), "found no sequence, expected at least one"),
        (value(PAIRS, "[1].vehicle_frame", "../../x y"), r"\[1\].vehicle_frame: found .*, expected a name of 1 to 40"),
        (value(PAIRS, "[1].vehicle_frame", "000099"), "found '000099', expected a frame of"),
        (value(PAIRS, "", lambda pairs: [*pairs, pairs[2]]), r"\[4\]: found frame 000012 of the car twice"),
        (value(PAIRS, "[1]", GONE)._replace(file=CAR), "frame 000012: found a gap of 0.200 s after .*(max_gap_s)"),
        (value(PAIRS, "[1].infrastructure_sequence", "0004"), "frames of the pole from the sequences 0003, 0004, exp"),
        (value(PAIRS, "[0].system_error_offset.delta_x", 1e9), "delta_x: found .*, expected `float` <= 1000"),
        (value(CAR, "[1].pointcloud_timestamp", 10**17), "pointcloud_timestamp: found 100000000000000000, expected"),
        (value(CAR, "[1].pointcloud_timestamp", writer.START_US), "frame 000011: time is not later than that of frame"),
        (value(CAR, "", lambda frames: [*frames, frames[1]]), r"\[4\]: found frame 000011 twice"),
        (value(LABELS, "", lambda labels: [*labels, labels[0]])._replace(file="spd"), "object .*: found two boxes"),
        (value(LABELS, "[0].track_id", GONE), r"\[0\]: track_id is missing, expected one in every label"),
        (value(LABELS, "[0].track_id", ""), r"\[0\].track_id: found '', expected a name of 1 to 100"),
        (value(LABELS, "[0].3d_dimensions.w", 0.0), r"\[0\].3d_dimensions: found .*, expected 3 numbers above 0"),
        (value(LABELS, "[0].3d_location.x", 1e300), r"3d_location.x: found 1e\+300, expected"),
        (value(LABELS, "[0].3d_location.x", "1e300"), "3d_location.x: found '1e300', expected"),
        (value(LABELS, "[0].3d_location.x", "inf"), "3d_location.x: found 'inf', expected `float`"),
        (value(LABELS, "[0].veh_track_id", "v1"), "veh_track_id: found 'v1', expected -1, or the track of a label in"),
        (value(LABELS, "", lambda labels: labels * 2000), "labels, expected at most 5000"),
        (value(CAR_LABELS, "[0].3d_location.x", "x"), r"\[0\].3d_location.x: found 'x', expected `float`, got `str`"),
        (value(POSE, "rotation[0]", [2, 0, 0]), "rotation: .*, expected an orthonormal"),
    ],
)
def test_a_damaged_twin_of_v2x_seq_spd_is_refused(short: Path, tmp_path: Path, damage: Damage, message: str) -> None:
    assert_refused(read_spd, shutil.copytree(short / "spd", tmp_path / "spd"), damage, message)


def test_a_missing_file_of_v2x_seq_spd_is_refused(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "spd", tmp_path / "spd")
    for file in (PAIRS, CAR, POLE, LABELS, CAR_LABELS, POLE_LABELS, MOUNT, POSE, POLE_POSE):
        (root / file).rename(root / "moved")
        with pytest.raises(SceneError, match=f"{'spd: found 0 data sets with a file ' if file == PAIRS else ''}{file}"):
            read_spd(root)
        (root / "moved").rename(root / file)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (value(WORLD_LABELS, "[0].world_8_points", [[0, 0, 0]] * 8), "expected 8 corners of a box with sizes above 0"),
        (value(WORLD_LABELS, "[0].world_8_points", lambda corners: corners[::-1]), "of an upright box"),
        (value(WORLD_LABELS, "[0].world_8_points[0][0]", 1e12), r"\[0\]\[0\]: found .*, expected `float` <= 100000000"),
        (value(CAR, "[1].batch_id", GONE), r"\[1\]: batch_id is missing"),
        (value(PAIRS, "[1].vehicle_pointcloud_path", GONE), r"\[1\]: vehicle_pointcloud_path is missing"),
        (value(WORLD_LABELS, "[0].track_id", "17")._replace(file="000010.json"), r"\$\[0\]: track_id is missing"),
    ],
)
def test_a_damaged_twin_of_dair_v2x_c_is_refused(short: Path, tmp_path: Path, damage: Damage, message: str) -> None:
    assert_refused(read_c, shutil.copytree(short / "c", tmp_path / "c"), damage, message)
    with pytest.raises(SceneError, match=r"000010.json: \$\[0\]: track_id is missing.*link_radius_m makes ids by"):
        read_spd(short / "c")


def test_a_folder_that_is_no_data_set_is_refused(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "spd", tmp_path / "spd")
    (root / "cooperative" / "label_world").mkdir()
    with pytest.raises(SceneError, match="cooperative: found 2 of the folders label"):
        read_spd(root)
    assert len(read_spd(shutil.copytree(short / "spd", tmp_path / "above" / "spd").parent)) == FEW
    for file in (root / "cooperative" / "label").iterdir():
        file.write_text("[]")
    (root / "cooperative" / "label_world").rmdir()
    with pytest.raises(SceneError, match="label: found no labels in 4 frames"):
        read_spd(root)


def renamed(file: str, name: str) -> Damage:
    return Damage("", lambda root: (root / file).rename((root / file).with_name(name)))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (value(COOP, "[0].track_id", None), r"\[0\]: track_id is missing, expected one in every label"),
        (value(OWN, "[0].3d_dimensions.h", -2), r"\[0\].3d_dimensions.h: found -2, expected"),
        (value(CALIBRATION, "translation", [1, 2]), r"translation: found \[1, 2\], expected `array` of length 3, got"),
        (removed(OWN), "118/seq-4: found 3 frames, expected 4 as in coop"),
        (renamed(OWN, "x.json"), "found name x"),
        (renamed(OWN, "1692685344.113000.txt"), "a time in seconds and .json"),
        (renamed(COOP, "1692685349.json"), "expected at most 0.2"),
        (Damage("", lambda root: shutil.rmtree(root / SITE / "120")), "120/seq-4: .*No such file or directory"),
        (Damage("", lambda root: shutil.rmtree(root / "labels")), "label: .*No such file"),
        (Damage("", lambda root: shutil.rmtree(root / "calib")), "calib/lidar2world/117.json: .*No such file"),
        (Damage("", lambda root: shutil.rmtree(root / SITE / "118" / "seq-4")), "118/seq-4: .*No such file"),
        (Damage("", lambda root: shutil.rmtree(root / SITE)), "labels: found no site, expected at least one"),
    ],
)
def test_a_damaged_twin_of_rcooper_is_refused(short: Path, tmp_path: Path, damage: Damage, message: str) -> None:
    assert_refused(read_rcooper, shutil.copytree(short / "rcooper", tmp_path / "rcooper"), damage, message)


def test_a_site_and_a_sequence_of_rcooper_are_chosen_among_several(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "rcooper", tmp_path / "rcooper")
    (root / SITE / "coop" / "seq-9").mkdir()
    with pytest.raises(ConfigurationError, match=r"sequence is not given, .*seq-4, seq-9"):
        read_rcooper(root)
    (root / "labels" / "1-2").mkdir()
    with pytest.raises(ConfigurationError, match="site is not given, expected one of 2: 1-2"):
        read_rcooper(root)


def test_rcooper_frames_far_apart_are_a_gap(short: Path, tmp_path: Path) -> None:
    root = shutil.copytree(short / "rcooper", tmp_path / "rcooper")
    for name in ("coop", *writer.POLES):
        files = sorted((root / SITE / name / writer.SEQUENCE).iterdir())
        files[-1].rename(files[-1].with_name("1692685345.5.json"))
    with pytest.raises(SceneError, match=r"coop/seq-4: frame 1692685345.5.json: found a gap of 1.300 s after frame"):
        read_rcooper(root)
