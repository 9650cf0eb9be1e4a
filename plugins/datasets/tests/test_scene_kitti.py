"""Reading sequences of the KITTI tracking benchmark, and refusal of damaged ones."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import boxes_of, junction
from damages import Damage, assert_refused, content, text
from kitti_writer import imu_positions, write_kitti
from mast_datasets import KittiTracking

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import assemble, vehicle
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector

#: No rotation but that of the axes; the lidar is 0.8 m above the IMU, the camera at the lidar.
CALIBRATION = """P2: 1 0 0 0 0 1 0 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0
Tr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 -0.8
"""
#: A car that stands and faces north, and one 10 m ahead of its camera that faces it.
POSITIONS = "".join(f"49.0 8.4 115.0 0.0 0.0 {np.pi / 2}{' 0' * 24}\n" for _ in range(4))
LABELS = "".join(
    f"{k} -1 DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n"
    f"{k} 7 Car 0.00 0 1.5 600.0 170.0 650.0 200.0 1.5 1.7 4.1 0.0 1.73 10.0 {np.pi / 2}\n"
    f"{k} 9 Cyclist 0 3 1.5 600 170 650 200 1.7 0.6 1.8 3.0 1.73 60.0 0.0\n"
    for k in range(4)
)
LABEL_FILE = "label_02/0000.txt"
FILES = {"label_02": LABELS, "calib": CALIBRATION, "oxts": POSITIONS}


def write(folder: Path, **files: str) -> Path:
    for name, lines in (FILES | files).items():
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "0000.txt").write_text(lines)
    return folder


def read(path: Path, **parameters: Any) -> Recording:
    return KittiTracking(path=str(path), **{"n_infrastructure": 0} | parameters).record(0, None)


@pytest.fixture(scope="session")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kitti(junction(n_infrastructure=0, n_mobile=2), tmp_path_factory.mktemp("kitti"))


def test_a_twin_is_read_back(twin: Path) -> None:
    source = junction(n_infrastructure=0, n_mobile=2)
    recording = read(twin, n_mobile=12)
    imu = imu_positions(source)
    shift = np.array([*imu[0, :2], 0.0])
    assert recording.times_ns.tolist() == source.times_ns.tolist()
    np.testing.assert_allclose(recording.agent_position[:, 0], imu - shift, atol=1e-5)
    np.testing.assert_allclose(recording.agent_rotation[:, 0], source.agent_rotation[:, 0], atol=1e-6)
    ego = source.agents[0].object_id
    others = source.truth.id != ego
    rows = recording.truth.id != 0
    assert recording.truth.id[rows].tolist() == (source.truth.id[others] + 1).tolist()
    np.testing.assert_allclose(recording.truth.position[rows], source.truth.position[others] - shift, atol=1e-5)
    np.testing.assert_allclose(recording.truth.size[rows], source.truth.size[others])
    turn = recording.truth.yaw[rows] - source.truth.yaw[others]
    # The camera is not level, and rotation_y is about its own axis: the heading is that of the projection.
    np.testing.assert_allclose(np.angle(np.exp(1j * turn)), 0.0, atol=1e-3)
    names = [{"bus": "unknown"}.get(CLASSES[k], CLASSES[k]) for k in source.truth.class_id[others]]
    assert [CLASSES[k] for k in recording.truth.class_id[rows]] == names
    own = recording.truth.position[~rows] - (source.truth.position[~others] - shift)
    np.testing.assert_allclose(own[:, :2], 0.0, atol=1e-5)  # it has another height


def test_agents_see_what_is_labelled_as_visible_and_what_rays_hit(twin: Path) -> None:
    source = junction(n_infrastructure=0, n_mobile=2)
    recording = read(twin, n_mobile=2)
    others = source.truth.id != source.agents[0].object_id
    seen = source.points[others, 0] >= 5
    assert (recording.points[recording.truth.id != 0][seen, 0] >= 5).all()
    boxes = boxes_of(recording)
    paths = [vehicle(agent.name, boxes, agent.object_id) for agent in recording.agents[1:]]
    expected = assemble("rays", recording.times_ns, boxes, paths, CleanDetector(), seed=0)
    np.testing.assert_array_equal(recording.points[:, 1:], expected.points)
    assert (expected.points >= 5).any(axis=0).all()


def test_labels_are_turned_from_the_axes_of_the_camera_to_the_world(tmp_path: Path) -> None:
    recording = read(write(tmp_path))
    truth = recording.truth_at(0)
    # The ego faces north. The car 10 m ahead faces it, so south; its middle is 0.75 m up. The bicycle faces right.
    np.testing.assert_allclose(truth.position[1], [0.0, 10.0, 0.75], atol=1e-9)
    np.testing.assert_allclose(truth.position[2], [3.0, 60.0, 0.85], atol=1e-9)
    np.testing.assert_allclose(np.cos(truth.yaw), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(np.sin(truth.yaw), [1, -1, 0], atol=1e-9)
    np.testing.assert_allclose(truth.size[1:], [[4.1, 1.7, 1.5], [1.8, 0.6, 1.7]])
    assert truth.id.tolist() == [0, 8, 10]
    assert [CLASSES[k] for k in truth.class_id] == ["car", "car", "bicycle"]
    np.testing.assert_allclose(recording.agent_position[0, 0], [0, 0, 0.93], atol=1e-9)
    np.testing.assert_allclose(recording.agents[0].sensor.mount_position, [0, 0, 0.8])


def test_a_step_of_latitude_and_longitude_is_a_step_in_metres(tmp_path: Path) -> None:
    lines = [f"{49 + k * 1e-5} {8.4 + k * 1e-5} {115 + k} 0 0 0{' 0' * 24}" for k in range(4)]
    position = read(write(tmp_path, oxts="\n".join(lines))).agent_position[:, 0]
    arc = np.radians(1e-5) * 6378137.0
    np.testing.assert_allclose(np.diff(position, axis=0), [[arc * np.cos(np.radians(49)), arc, 1.0]] * 3, rtol=1e-4)


def test_roll_and_pitch_of_the_car_turn_what_it_sees(tmp_path: Path) -> None:
    oxts = "".join(f"49.0 8.4 115.0 0.0 -0.1 0.0{' 0' * 24}\n" for _ in range(4))  # the nose is up
    truth = read(write(tmp_path, oxts=oxts)).truth_at(0)
    assert truth.position[1, 2] == pytest.approx(0.75 + 10 * np.sin(0.1), abs=0.1)


def test_labels_with_a_score_are_read(tmp_path: Path) -> None:
    scored = "".join(f"{line} 0.9\n" for line in LABELS.splitlines())
    (tmp_path / "other").mkdir()
    one, other = read(write(tmp_path)), read(write(tmp_path / "other", label_02=scored))
    np.testing.assert_array_equal(one.truth.position, other.truth.position)


def test_a_part_of_a_sequence_can_be_used(tmp_path: Path) -> None:
    labels = "".join(line + "\n" for line in LABELS.splitlines() if not line.startswith("3 7"))
    recording = read(write(tmp_path, label_02=labels), first_frame=1, last_frame=2, n_mobile=1)
    assert len(recording) == 2
    assert recording.agents[1].object_id == 8
    with pytest.raises(ConfigurationError, match=r"0000\.txt: n_mobile is 1, expected 0 to 0: 0 vehicles besides"):
        read(tmp_path, n_mobile=1)
    with pytest.raises(ConfigurationError, match=r"oxts/0000\.txt: first_frame is 4, .* expected some of 0 to 3"):
        read(tmp_path, first_frame=4)
    with pytest.raises(ConfigurationError, match="first_frame is 3, last_frame is 2: found no frame"):
        read(tmp_path, first_frame=3, last_frame=2)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (text(LABEL_FILE, "1.5 1.7 4.1", "1.5 4.1"), "line 2: found 16 values, expected 17, or one more: a score"),
        (text(LABEL_FILE, "0 7 Car", "4 7 Car"), "line 2: frame: found 4, expected 0 to 3, and every"),
        (text(LABEL_FILE, "0 9 Cyc", "0 7 Cyc"), "line 3: frame: found 0, .*every track once in it"),
        (text(LABEL_FILE, "Cyclist", "Horse"), "line 3.type: found .*'Horse'"),
        (text(LABEL_FILE, "1.5 1.7 4.1", "1.5 1.7 0"), "line 2.length: found .*, expected `float` > 0"),
        (text(LABEL_FILE, "1.73 10.0", "1.73 1e9"), "line 2.z: found .*, expected `float` <= 100000"),
        (text(LABEL_FILE, "Cyclist 0 3", "Cyclist 0 7"), "line 3.occluded: found .*, expected `int` <= 3"),
        (text("calib/0000.txt", "R_rect", "R_other"), "found no matrix R_rect, expected one"),
        (text("calib/0000.txt", "R_rect", "P2: 1\nR_rect"), "line 2: found P2 twice, expected it once"),
        (text("calib/0000.txt", "R_rect 1", "R_rect 2"), "line 2: R_rect: found .*, expected an orthonormal"),
        (text("calib/0000.txt", "R_rect 1 0", "R_rect 1"), "R_rect: found .*, expected `array` of length >= 9"),
        (text("oxts/0000.txt", "49.0 8.4", "49.0"), "line 1: found 29 values, expected 30"),
        (text("oxts/0000.txt", "49.0", "149.0"), r"line 1\[0\]: found .*, expected `float` <= 89"),
        (text("oxts/0000.txt", "115.0 0.0", "115.0 90"), r"line 1\[3\]: found .*, expected `float` <= 7"),
        (content("oxts/0000.txt", b"\n"), "found no line, expected one for each frame"),
    ],
)
def test_damaged_files_are_refused_with_file_line_and_reason(damage: Damage, message: str, tmp_path: Path) -> None:
    assert_refused(read, write(tmp_path), damage, message)


def test_missing_files_and_several_sequences_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="found no folder label_02, expected label_02, calib, oxts in it"):
        read(tmp_path)
    write(tmp_path)
    (tmp_path / "label_02" / "0001.txt").write_text(LABELS)
    with pytest.raises(ConfigurationError, match="label_02: sequence is not given, expected one of 2: 0000, 0001"):
        read(tmp_path)
    assert read(tmp_path, sequence="0000").name == "kitti-0000"
    with pytest.raises(ConfigurationError, match=r"label_02: unknown sequence '\.\./0000'.*: 0000, 0001"):
        read(tmp_path, sequence="../0000")
    with pytest.raises(SceneError, match=r"oxts/0001\.txt: cannot be read: .*No such file"):
        read(tmp_path, sequence="0001")


def test_empty_lines_may_follow_the_last_pose_alone(tmp_path: Path) -> None:
    assert len(read(write(tmp_path, oxts=POSITIONS + "\n \n"))) == 4
    lines = POSITIONS.splitlines(keepends=True)
    with pytest.raises(SceneError, match=r"oxts/0000.txt: line 3: found an empty line"):
        read(write(tmp_path, oxts="".join([*lines[:2], " \n", *lines[2:]])))
