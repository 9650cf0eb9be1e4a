"""Reading Argoverse 2 logs, and refusal of damaged ones."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from av2_writer import BOXES, FRAMES, POSES, boxes, poses, write, write_log
from mast_datasets import AV2Log

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes import Recording
from mast_zenoh.sensing import CleanDetector


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path / "logs" / "7fab")


def read(path: Path, **parameters: Any) -> Recording:
    return AV2Log(path=str(path), **parameters).record(0, None)


def test_objects_are_in_a_world_frame_with_its_origin_below_the_first_pose(log: Path) -> None:
    recording = read(log)
    truth = recording.truth_at(2)
    assert [CLASSES[k] for k in truth.class_id] == ["car", "pedestrian", "bus"]
    assert truth.id.tolist() == [0, 1, 2]
    # The car heads north: ahead is y, left is -x.
    np.testing.assert_allclose(truth.position[2], [0.0, 22.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(truth.position[1], [-10.0, 2.0, 0.9], atol=1e-9)
    np.testing.assert_allclose(truth.position[0, 2] - truth.size[0, 2] / 2, 0.0, atol=1e-9)
    np.testing.assert_allclose(truth.yaw, np.pi / 2)
    np.testing.assert_allclose(truth.velocity, [[0.0, 10.0, 0.0]] * 3, atol=1e-6)
    assert recording.times_ns.tolist() == [k * 100_000_000 for k in range(FRAMES)]


def test_the_ego_has_the_lidar_returns_of_the_data_set(log: Path) -> None:
    recording = read(log.parent)
    assert (recording.name, len(recording.agents), recording.agents[0].name) == ("7fab", 5, "ego")
    assert recording.agents[0].object_id == 0
    assert recording.points_at(3)[:, 0].tolist() == [0, 3, 90]
    np.testing.assert_allclose(recording.agent_velocity[2, 0], [0.0, 10.0, 0.0], atol=1e-6)


def test_poles_are_next_to_the_path_and_detect_by_ray_casting(log: Path) -> None:
    recording = read(log, n_infrastructure=6)
    assert recording.agent_names[1:] == tuple(f"infra_{k}" for k in range(1, 7))
    few = read(log, n_infrastructure=2)  # more poles do not move the others
    np.testing.assert_array_equal(few.agent_position[:, :3], recording.agent_position[:, :3])
    np.testing.assert_array_equal(few.detections_at(1, 2).position, recording.detections_at(1, 2).position)
    position = recording.agent_position[0, 1:]
    np.testing.assert_allclose(position[:, 2], 15.0, atol=1e-6)
    np.testing.assert_allclose(np.abs(position[:, 0]), 16.0, atol=1e-6)
    assert recording.points_at(0)[2, 1:].max() >= 5


def test_the_order_of_the_rows_does_not_matter(log: Path) -> None:
    order, one = np.random.default_rng(0).permutation(4 * FRAMES), read(log)
    write(log, BOXES, {name: np.array(values)[order] for name, values in boxes().items()})
    np.testing.assert_array_equal(one.truth.position, read(log).truth.position)
    np.testing.assert_array_equal(one.detections.position, read(log).detections.position)


def test_an_object_that_is_annotated_twice_is_read_once(log: Path, tmp_path: Path) -> None:
    columns = boxes()
    bus = np.array(columns["track_uuid"]) == "bus-1"

    def with_twin(offset_m: float, frames: int) -> Recording:
        rows = np.flatnonzero(bus)[:frames]
        twin = {name: np.array(values)[rows] for name, values in columns.items()}
        twin |= {"track_uuid": np.full(frames, "a-twin"), "tx_m": twin["tx_m"] + offset_m}
        folder = tmp_path / f"{offset_m}-{frames}"
        write(folder, POSES, poses())
        write(folder, BOXES, {name: np.concatenate([columns[name], twin[name]]) for name in columns})
        return read(folder)

    assert len(read(log).truth) == 3 * FRAMES
    for frames in (2, FRAMES):
        whole = with_twin(0.03, frames)
        assert len(whole.truth) == 3 * FRAMES
        for frame in range(FRAMES):
            assert len(set(whole.truth_at(0).id) & set(whole.truth_at(frame).id)) == 3
    assert len(with_twin(0.5, FRAMES).truth) == 4 * FRAMES


def test_recorded_vehicles_get_a_lidar_on_the_roof(log: Path) -> None:
    recording = read(log, n_infrastructure=0, n_mobile=1)
    assert recording.agent_names == ("ego", "mobile_1")
    bus = recording.agents[1]
    assert (bus.kind, bus.object_id) == ("mobile", 2)
    np.testing.assert_allclose(recording.agent_position[2, 1], [0.0, 22.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(bus.sensor.mount_position, [0.0, 0.0, 3.2])
    assert recording.points_at(2)[:, 1].tolist()[2] == 0  # it does not see itself,
    assert recording.points_at(2)[0, 1] >= 5  # but the ego behind it


def with_value(name: str, row: int, value: object) -> Callable[[dict[str, Any]], dict[str, Any]]:
    def change(columns: dict[str, Any]) -> dict[str, Any]:
        values = list(columns[name])
        values[row] = value
        return columns | {name: values}

    return change


def without(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda columns: {key: values for key, values in columns.items() if key != name}


@pytest.mark.parametrize(
    ("file", "change", "reason"),
    [
        (BOXES, without("track_uuid"), "column track_uuid is missing"),
        (BOXES, with_value("tx_m", 7, float("nan")), "column tx_m, row 7 is nan"),
        (BOXES, with_value("tx_m", 7, None), "column tx_m has 1 empty values"),
        (BOXES, with_value("length_m", 0, 0.0), "a size is 0 or less"),
        (BOXES, with_value("num_interior_pts", 0, -3), "num_interior_pts is negative"),
        (BOXES, with_value("qw", 0, 3.0), "quaternion .* does not have length 1"),
        (BOXES, with_value("track_uuid", 2, "bus-1"), "track bus-1 occurs twice at timestamp_ns 1000000000000000000"),
        (BOXES, lambda columns: {name: values[:0] for name, values in columns.items()}, "no row"),
        (BOXES, lambda columns: columns | {"tx_m": ["x"] * 4 * FRAMES}, "column tx_m is not of numbers: "),
        (POSES, with_value("timestamp_ns", 2, 5), "no pose at timestamp_ns 1000000000100000000"),
        (POSES, with_value("timestamp_ns", 1, 10**18), "timestamp_ns 1000000000000000000 occurs twice"),
    ],
)
def test_a_damaged_table_is_refused_with_file_column_and_reason(
    log: Path, file: str, change: Callable[[dict[str, Any]], dict[str, Any]], reason: str
) -> None:
    write(log, file, change(poses() if file == POSES else boxes()))
    with pytest.raises(SceneError, match=rf"{file}: .*{reason}"):
        read(log)


def test_a_truncated_or_missing_file_is_refused_by_name(log: Path) -> None:
    for file in (BOXES, POSES):
        whole = (log / file).read_bytes()
        (log / file).write_bytes(whole[:200])
        with pytest.raises(SceneError, match=rf"{file}: cannot be read as Feather"):
            read(log)
        (log / file).write_bytes(whole)
    (log / BOXES).unlink()
    with pytest.raises(SceneError, match=r"7fab: found 0 files annotations"):
        read(log)


def test_every_real_log_is_readable_and_poles_see_objects_hidden_from_the_ego(av2_logs: list[Path]) -> None:
    for path in av2_logs:
        recording = AV2Log(path=str(path), detector=CleanDetector()).record(0, 40)
        assert len(recording) == 40
        assert recording.period_ns == pytest.approx(1e8, rel=0.01)
        assert 25 < len(recording.truth) / 40 < 100
        seen = recording.points >= 5
        assert seen.any(axis=1).sum() > seen[:, 0].sum() + 40
        # Town traffic is slow, and objects on the ground are near each other.
        assert np.linalg.norm(recording.truth.velocity, axis=1).max() < 40
        assert np.abs(recording.truth.position[:, 2]).max() < 20
        pole = recording.agent_position[0, 1:, 2]
        assert (np.abs(pole - 15) < 5).all()
