"""Points that OPV2V and its relatives, DAIR-V2X and the AVstack layout have are where the objects are."""

import contextlib
import os
import re
import sys
import tarfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import carla_writer
import dair_writer
import mast_datasets
import numpy as np
import opv2v_writer
import pytest
from comparison import junction, lidar_pose
from damages import DAMAGE, damaged
from fuzzing import Fuzzing
from hypothesis import given, settings
from hypothesis import strategies as st
from layouts import TWINS
from mast_datasets.point_files import read_bin, read_pcd

from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.recorded_scans import MAX_POINTS
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import sensor_pose

pypcd4 = pytest.importorskip("pypcd4")
lzf = pytest.importorskip("lzf")

ENCODINGS = ("ascii", "binary", "binary_compressed")
FRAMES, SEEN = 4, 5


def pcd(rows: Any, encoding: str = "binary", **fields: str) -> bytes:
    """A PCD file of rows with a value for each field. fields: type of each; x, y, z and intensity without any"""
    names = fields or dict.fromkeys(("x", "y", "z", "intensity"), "f4")
    columns = [np.array(column, kind) for column, kind in zip(np.array(rows).T, names.values(), strict=True)]
    cloud = pypcd4.PointCloud.from_points(columns, list(names), [column.dtype for column in columns])
    header: str = cloud.metadata.compose_header(pypcd4.Encoding(encoding))
    return header.encode() + body(cloud.pc_data, encoding)


def body(rows: np.ndarray, encoding: str) -> bytes:
    """What follows the header."""
    if encoding == "ascii":
        return "".join(" ".join(map(str, row.tolist())) + "\n" for row in rows).encode()
    if encoding == "binary":
        return rows.tobytes()
    whole = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in rows.dtype.names or ())
    packed: bytes = lzf.compress(whole, 2 * len(whole) + 64)
    return len(packed).to_bytes(4, "little") + len(whole).to_bytes(4, "little") + packed


def middles(source: Recording, frame: int, column: int) -> np.ndarray:
    """(n, 4) the middles of what an agent sees in a frame, in the frame of its lidar, and an intensity."""
    rows = np.arange(*source.truth_start[frame : frame + 2])
    position, rotation = lidar_pose(source, frame, column)
    seen = source.truth.position[rows[source.points[rows, column] >= SEEN]]
    return np.column_stack([(seen - position) @ rotation, np.full(len(seen), 51.0)])


def opv2v_name(source: Recording, column: int, frame: int) -> str:
    return f"{opv2v_writer.number_of(source, column)}/{opv2v_writer.FIRST + 2 * frame:06d}"


def v2xreal_name(source: Recording, column: int, frame: int) -> str:
    return f"{column + 1 if source.agents[column].kind == 'mobile' else -column}/{frame:06d}"


def dair_name(source: Recording, column: int, frame: int) -> str:
    side = ("vehicle-side", "infrastructure-side")[column]
    return f"{side}/velodyne/{(dair_writer.vehicle_frame, dair_writer.pole_frame)[column](frame)}"


def multiv2x_name(source: Recording, column: int, frame: int) -> str:
    agent = source.agents[column]
    folder = f"cav_{agent.object_id}" if agent.kind == "mobile" else f"rsu_{column}"
    return f"{folder}/{opv2v_writer.FIRST + 2 * frame:06d}"


def v2v4real_name(source: Recording, column: int, frame: int) -> str:
    return f"{column}/{frame:06d}"


#: By type of scene: the sign of y, how many agents have files, and their names without the ending.
NAMES: dict[str, tuple[int, int, Callable[[Recording, int, int], str]]] = {
    "OPV2VScene": (-1, 3, opv2v_name),
    "V2XRealScene": (-1, 3, v2xreal_name),
    "MultiV2XScene": (-1, 3, multiv2x_name),
    "V2V4RealScene": (1, 2, v2v4real_name),
    "DAIRScene": (1, 2, dair_name),
}


def with_clouds(kind: str, folder: Path, source: Recording) -> Path:
    """The files of a data set with a point in the middle of all that an agent sees, in all encodings."""
    path = TWINS[kind](folder, source)
    sign, agents, name = NAMES[kind]
    for column in range(agents):
        for frame in range(len(source)):
            file = folder / f"{name(source, column, frame)}.pcd"
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(pcd(middles(source, frame, column) * [1, sign, 1, 1], ENCODINGS[frame % 3]))
    return path


def source_of(kind: str) -> Recording:
    return junction(frames=FRAMES, n_mobile=0 if kind == "DAIRScene" else 1, n_infrastructure=1)


def assert_on_objects(recording: Recording) -> None:
    """Each point is in the middle of an object."""
    assert recording.scans is not None
    assert recording.scans.recorded.all()
    for frame in range(len(recording)):
        truth = recording.truth_at(frame).position
        for row, agent in enumerate(recording.agents):
            points, mount = recording.scans.at(frame, row), agent.sensor
            pose = recording.agent_position[frame, row], recording.agent_rotation[frame, row]
            origin, rotation = sensor_pose(*pose, mount.mount_position, mount.mount_rotation)
            world = origin + points.position @ rotation.T
            assert len(world) > 2
            assert np.linalg.norm(world[:, None] - truth[None], axis=2).min(axis=1).max() < 0.02
            np.testing.assert_allclose(points.intensity, 0.2, atol=1e-6)


@pytest.mark.parametrize("kind", NAMES)
def test_points_are_on_the_objects_of_each_data_set(kind: str, tmp_path: Path) -> None:
    path = with_clouds(kind, tmp_path / "scene", source_of(kind))
    scene = getattr(mast_datasets, kind)(path=str(path), recorded_points=True)
    assert_on_objects(scene.record(0, None))
    assert scene.record(0, 2).scans.start.shape == (2 * len(scene.record(0, 2).agents) + 1,)
    assert getattr(mast_datasets, kind)(path=str(path)).record(0, None).scans is None, "nothing was asked for"


@pytest.mark.parametrize("kind", NAMES)
def test_a_scan_that_is_missing_is_refused_by_its_name(kind: str, tmp_path: Path) -> None:
    path = with_clouds(kind, tmp_path / "scene", source_of(kind))
    file = tmp_path / "scene" / f"{NAMES[kind][2](source_of(kind), 1, 2)}.pcd"
    file.unlink()
    with pytest.raises(SceneError, match=f"{file}: cannot be read"):
        getattr(mast_datasets, kind)(path=str(path), recorded_points=True).record(0, None)


def with_lidar_files(run: Path) -> Path:
    """A run with two points in each scan: the place of the lidar's object, and one beside it."""
    carla_writer.write_run(run)
    for folder in run.glob("data/lidar-*"):
        for file in folder.iterdir():
            rows = np.array([[carla_writer.FRAMES[0], 1.0, -1.0, 0.5], [9.0, 0.0, 0.0, 0.25]], "<f4")
            rows[0, 0] = int(file.stem[-6:])
            rows.tofile(folder / f"{file.stem.replace('calib', 'data')}.bin")
    return run


@pytest.mark.parametrize("packed", [False, True])
def test_points_of_the_avstack_layout_go_with_their_frames(packed: bool, tmp_path: Path) -> None:
    path = with_lidar_files(tmp_path / "run-0")
    if packed:
        with tarfile.open(tmp_path / "run.tar.gz", "w:gz") as archive:
            archive.add(path, "run-0")
        path = tmp_path / "run.tar.gz"
    recording = mast_datasets.AVstackScene(path=str(path), recorded_points=True).record(0, None)
    assert recording.scans is not None
    for frame, number in enumerate(carla_writer.FRAMES):
        for row in range(2):
            assert recording.scans.at(frame, row).position.tolist() == [[number, 1.0, -1.0], [9.0, 0.0, 0.0]]
    assert mast_datasets.AVstackScene(path=str(path)).record(0, None).scans is None


def test_a_scan_that_is_missing_in_the_avstack_layout_is_refused(tmp_path: Path) -> None:
    run = with_lidar_files(tmp_path / "run-0")
    next((run / "data" / "lidar-0-1").glob("*frame_000006.bin")).unlink()
    with pytest.raises(SceneError, match="lidar-0-1: no data file for frame 6"):
        mast_datasets.AVstackScene(path=str(run), recorded_points=True).record(0, None)


# -- files -------------------------------------------------------------------------------------------------------------


ROWS = [[9.0, 1.0, 0.5, 51.0], [np.nan, 0.0, 0.0, 3.0], [0.0, 0.0, 0.0, 9.0], [5.0, -1.0, 0.25, 255.0]]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_what_is_no_return_is_left_out_and_intensities_are_shares(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(pcd(ROWS, encoding))
    points = read_pcd(tmp_path / "a.pcd")
    assert points.position.tolist() == [[9.0, 1.0, 0.5], [5.0, -1.0, 0.25]]
    assert points.intensity.tolist() == [pytest.approx(0.2), 1.0]


OPEN3D = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z rgb
SIZE 4 4 4 4
TYPE F F F F
COUNT 1 1 1 1
WIDTH {count}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {count}
DATA ascii
"""


@pytest.mark.parametrize("rows", ["1 2 3 1.8366e-38\n", "1 2 3 1.8366e-38\r\n4 5 6 0\r\n"])
def test_the_red_of_a_file_of_open3d_is_the_intensity(rows: str, tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_text(OPEN3D.format(count=rows.count("\n")) + rows)
    points = read_pcd(tmp_path / "a.pcd")
    assert points.position[0].tolist() == [1.0, 2.0, 3.0]
    assert points.intensity[0] == pytest.approx(200 / 255, abs=0.01)


def test_times_and_channels_order_the_points(tmp_path: Path) -> None:
    kinds = dict(x="f4", y="f4", z="f8", intensity="u1", ring="u2", time="f4")
    (tmp_path / "a.pcd").write_bytes(pcd([[1, 2, 3, 255, 7, 0.05], [4, 5, 6, 0, 3, 0.0]], "binary_compressed", **kinds))
    points = read_pcd(tmp_path / "a.pcd")
    assert points.channel.tolist() == [3, 7]
    assert points.intensity.tolist() == [0.0, 1.0]


def edited(old: bytes, new: bytes, encoding: str = "binary") -> bytes:
    content = pcd(ROWS, encoding)
    assert old in content
    return content.replace(old, new)


def promising(count: int, encoding: str, more: bytes = b"") -> bytes:
    number = str(count).encode()
    content = edited(b"POINTS 4", b"POINTS " + number, encoding).replace(b"WIDTH 4", b"WIDTH " + number)
    if encoding == "binary_compressed":
        start = content.index(b"DATA binary_compressed\n") + 27
        content = content[:start] + (16 * count % 2**32).to_bytes(4, "little") + content[start + 4 :]
    return content + more


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "found no line DATA in 10000 bytes"),
        (b"\x00" * 5000, "found no line DATA in 10000 bytes"),
        (b"FIELDS x\n" * 2000 + b"DATA ascii\n", "found no line DATA in 10000 bytes"),
        (edited(b"DATA binary", b"DATA zip"), "header: .*data"),
        (edited(b"\nFIELDS x y z intensity", b""), "header: .*fields"),
        (edited(b"WIDTH 4", b"WIDTH " + b"9" * 5000), "header: "),
        (edited(b"WIDTH 4", b"WIDTH 5"), "header: found 4 points in 1 rows of 5, .* at most 200000 points"),
        (promising(10**9, "binary"), "header: found 1000000000 points"),
        (edited(b"COUNT 1 1 1 1", b"COUNT 1 1 1 1000000000"), "header: .* 1000000003 numbers each, .* points of 100"),
        (edited(b"COUNT 1 1 1 1", b"COUNT 1 1 1 -1"), "header: "),
        (edited(b"SIZE 4 4 4 4", b"SIZE 4 4 4 3"), "header: "),
        (edited(b"SIZE 4 4 4 4", b"SIZE 4 4"), "header: "),
        (edited(b"FIELDS x y z", b"FIELDS x x z"), "header: "),
        (edited(b"TYPE F F F F", b"TYPE I F F F"), r"found the fields x \(int32\), .* expected x, y and z of floating"),
        (edited(b"FIELDS x y z", b"FIELDS x y q"), "found the fields x .*, q .*, expected x, y and z of"),
        (pcd(ROWS)[:-1], "data: "),
        (pcd(ROWS)[:-16], "data: found 3 points, expected 4"),
        (pcd(ROWS, "ascii")[:-30], "data: "),
        (promising(5, "ascii"), "data: found 4 points, expected 5"),
        (promising(3, "ascii"), "data: found 4 points, expected 3"),
        (edited(b"9.0 1.0", b"9.0 car", "ascii"), "data: "),
        (promising(MAX_POINTS, "binary"), "data: found 64 bytes, expected 3200000 of 200000 points"),
        (promising(MAX_POINTS, "binary_compressed"), "data: found [0-9]+ bytes, expected 3200000 of 200000 points"),
        (promising(10, "binary_compressed"), "data: "),
        (pcd(ROWS, "binary_compressed")[:-3], "data: "),
        (pcd([[1e9, 0, 0, 0]]), "point 0: x, y, z: .* expected numbers from -10000 to 10000"),
        (pcd([[1, 2, 3, np.nan]]), "point 0: intensity: .*nan.*, expected numbers from 0 to 1"),
    ],
)
def test_damaged_files_are_refused_without_allocating_what_they_promise(
    content: bytes, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.pcd"
    file.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(SceneError, match=rf"^{file}: {message}"):
            read_pcd(file)
        assert tracemalloc.get_traced_memory()[1] < 3_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("read", [read_bin, read_pcd])
def test_a_folder_or_a_pipe_is_no_file_of_points(read: Callable[[Path], Any], tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe"):
        with pytest.raises(SceneError, match=f"{name}: cannot be read: not a regular file"):
            read(tmp_path / name)


def test_without_the_package_the_message_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypcd4.pypcd4", None)
    with pytest.raises(ConfigurationError, match=r"a\.pcd: pypcd4.* is not installed, .*mast-zenoh-datasets\[pcd\]"):
        read_pcd(tmp_path / "a.pcd")


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "a.pcd").open("wb") as file:
        file.truncate(200 * MAX_POINTS + 1)
    with pytest.raises(SceneError, match=r"a\.pcd: found more than 40000000 bytes"):
        read_pcd(tmp_path / "a.pcd")


#: Changes of the numbers in a header, and of the rest as in other files.
HEADER = st.tuples(
    st.sampled_from(["FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "POINTS", "DATA"]),
    st.lists(
        st.sampled_from(["0", "1", "-1", "4", "8", "1e9", "4294967296", "F", "U", "I", "x", "y", "z", "_", "#", "nan"])
        | st.sampled_from(ENCODINGS)
        | st.text(max_size=4),
        max_size=5,
    ),
)


def test_any_damaged_file_is_read_or_refused(fuzzing: Fuzzing, tmp_path: Path) -> None:
    file = tmp_path / "a.pcd"

    def is_read_or_refused(content: bytes) -> None:
        file.write_bytes(content)
        with contextlib.suppress(SceneError):
            points = read_pcd(file)
            assert len(points) <= 4
            assert np.isfinite(points.position).all()

    @settings(max_examples=fuzzing.draws(200, 3_000), deadline=None)
    @given(st.sampled_from(ENCODINGS), DAMAGE)
    def bytes_are_changed(encoding: str, damage: tuple[str, Any]) -> None:
        is_read_or_refused(damaged(pcd(ROWS, encoding), damage))

    @settings(max_examples=fuzzing.draws(200, 3_000), deadline=None)
    @given(st.sampled_from(ENCODINGS), st.lists(HEADER, min_size=1, max_size=3))
    def headers_are_changed(encoding: str, changes: list[tuple[str, list[str]]]) -> None:
        content = pcd(ROWS, encoding)
        for key, values in changes:
            line = f"{key} {' '.join(values)}".encode().replace(b"\\", b"\\\\")
            content = re.sub(rf"^{key} .*$".encode(), line, content, flags=re.MULTILINE)
        is_read_or_refused(content)

    bytes_are_changed()
    headers_are_changed()
