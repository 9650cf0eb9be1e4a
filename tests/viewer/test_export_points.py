"""Recorded scans in the exports, read back by each format's own library: those that detectors received."""

import struct
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mast_datasets.kitti import read_calibration
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import mast_zenoh as mast
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.runs.messages import WireMessage, messages
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.runs.scans import scanned_agents, scans_in
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.export import export

FRAMES = 4
SCENARIO = """
from spoofed import scenario as spoofed


def scenario():
    content = spoofed(attack="removal", attack_start_s=0.2, lidar="VLP-16", n_infrastructure=1, n_mobile=0)
    content["points"]["recorded"] = True
    return content
"""
Scans = dict[str, list[WireMessage]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run whose scans are recorded; a spoofer is on the points of the ego."""
    folder = tmp_path_factory.mktemp("points")
    shipped = Path(__file__).parents[2] / "scenarios"
    text = f"import sys\n\nsys.path.insert(0, {str(shipped)!r})\n{SCENARIO}"
    (folder / "scanned.py").write_text(text)
    return mast.run(folder / "scanned.py", frames=FRAMES, out=folder / "run", runtime="inproc")


@pytest.fixture(scope="module")
def scans(run: mast.Run) -> Scans:
    """The scans by agent and frame as the recording has them, on the legs to the detectors."""
    found: Scans = defaultdict(list)
    for message in messages(run.path, "agent/*/points"):
        found[message.wire.split("/")[1]].append(message)
    assert {len(of_agent) for of_agent in found.values()} == {FRAMES}
    return found


@pytest.fixture(scope="module")
def written(run: mast.Run, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    @cache
    def to(name: str) -> Path:
        out = tmp_path_factory.mktemp(name) / {"foxglove": "run.mcap", "rrd": "run.rrd"}.get(name, name)
        export(run.path, name, out)
        return out

    return to


def test_scans_are_those_that_the_detector_received(run: mast.Run, scans: Scans) -> None:
    opened = open_recorded(run.path)
    assert set(scanned_agents(opened)) == set(scans)
    sent = [m for m in messages(run.path, "agent/ego/points", taps=True) if m.tap]
    assert len(sent) == FRAMES
    differs = []
    for frame in frames_of(opened):
        for agent, scan in scans_in(frame).items():
            np.testing.assert_array_equal(scan.points.position, scans[agent][frame.index]["position"])
        ego = scans_in(frame)["ego"].points.position
        differs.append(not np.array_equal(ego, sent[frame.index]["position"]))
    assert differs == [False, False, True, True], "the spoofer begins at 0.2 s"


def test_foxglove_has_a_channel_of_point_clouds_of_each_agent(written: Callable[[str], Path], scans: Scans) -> None:
    found: dict[str, list[Any]] = defaultdict(list)
    with written("foxglove").open("rb") as file:
        for schema, channel, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_messages():
            if schema.name in ("foxglove.PointCloud", "foxglove.FrameTransforms"):
                decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)
                found[channel.topic].append(decoded)
    for agent, of_agent in scans.items():
        clouds = found[f"/agent/{agent}/points"]
        assert len(clouds) == FRAMES
        for cloud, scan, update in zip(clouds, of_agent, found["/tf"], strict=True):
            kinds = {7: "f", 3: "H"}  # of PackedElementField
            names = [field.name for field in cloud.fields]
            assert names == ["x", "y", "z", "intensity", "t", "ring"]
            for field, values in zip(cloud.fields, columns_of(scan), strict=True):
                code = f"<{kinds[field.type]}"
                rows = range(field.offset, len(cloud.data), cloud.point_stride)
                assert [struct.unpack_from(code, cloud.data, at)[0] for at in rows] == values.tolist()
            (mount,) = [each for each in update.transforms if each.child_frame_id == cloud.frame_id]
            assert mount.parent_frame_id == agent
            place, turn = mount.translation, mount.rotation
            np.testing.assert_allclose([place.x, place.y, place.z], scan["mount_position"])
            np.testing.assert_allclose([turn.w, turn.x, turn.y, turn.z], scan["mount_rotation"], atol=1e-12)


def columns_of(scan: WireMessage) -> list[np.ndarray]:
    """x, y, z, intensity, time and channel."""
    return [*scan["position"].T, scan["intensity"], scan["time_s"], scan["channel"]]


def test_rerun_has_the_points_below_the_pose_of_the_agent(written: Callable[[str], Path], scans: Scans) -> None:
    from rerun.chunk import RrdReader  # slow

    rows: dict[str, dict[int, dict[str, Any]]] = defaultdict(dict)
    for chunk in RrdReader(written("rrd")).stream():
        for row in chunk.to_record_batch().to_pylist():
            if row.get("frame") is not None:
                rows[chunk.entity_path.lstrip("/")][row["frame"]] = row
    for agent, of_agent in scans.items():
        lidar = f"agent/{agent}/pose/lidar"
        for frame, scan in enumerate(of_agent):
            points = np.reshape(rows[f"{lidar}/points"][frame]["Points3D:positions"], (-1, 3))
            np.testing.assert_array_equal(points.astype(np.float32), scan["position"])
            mount = rows[lidar][frame]
            np.testing.assert_allclose(mount["Transform3D:translation"][0], scan["mount_position"], atol=1e-6)
            matrix = np.reshape(mount["Transform3D:mat3x3"][0], (3, 3)).T  # by columns
            np.testing.assert_allclose(matrix, rotation_from_quaternion(scan["mount_rotation"]), atol=1e-6)


def test_kitti_has_a_file_a_frame_in_the_lidar_of_its_calibration(
    run: mast.Run, written: Callable[[str], Path], scans: Scans
) -> None:
    folder = written("kitti")
    files = sorted((folder / "velodyne" / "0000").iterdir())
    assert [file.name for file in files] == [f"{frame:06d}.bin" for frame in range(FRAMES)]
    for file, scan in zip(files, scans["ego"], strict=True):
        points = np.fromfile(file, "<f4").reshape(-1, 4)  # as KITTI's development kit reads it
        np.testing.assert_array_equal(points, np.column_stack([scan["position"], scan["intensity"]]))
    rotation, position = read_calibration(folder / "calib" / "0000.txt").lidar
    sensor = Recording.load(run.path / "scene.npz").agents[0].sensor
    np.testing.assert_allclose(position, sensor.mount_position, atol=1e-9)
    np.testing.assert_allclose(rotation, sensor.mount_rotation, atol=1e-9)
    np.testing.assert_allclose(position, scans["ego"][0]["mount_position"], atol=1e-9)


def test_a_run_without_recorded_scans_has_none_in_its_exports(recorded: mast.Run, tmp_path: Path) -> None:
    assert scanned_agents(open_recorded(recorded.path)) == ()
    export(recorded.path, "kitti", tmp_path / "kitti")
    assert not (tmp_path / "kitti" / "velodyne").exists()
