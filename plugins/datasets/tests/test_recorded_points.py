"""Points that data sets recorded feed the same detector; files that cannot be are refused."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from comparison import junction
from damages import Damage, assert_refused, content
from kitti_writer import write_kitti
from mast_datasets import KittiTracking, RosBag
from mast_datasets.rosbag import PointsEntry, parse_map
from mast_datasets.rosbag_points import read_scans, stamp_of_scan
from mast_ros2 import type_store
from mast_ros2.spatial import header
from rosbag_writer import START_NS, TYPES, Sent, pose_stamped, write_bag

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError
from mast_zenoh.runs.messages import messages
from mast_zenoh.scenes import RecordingFile, recorded_scans
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.export import export

FRAMES = 6
MS = 10**6
SHIPPED = Path(mast.__file__).parents[1] / "scenarios"


def played(folder: Path, scene: Mapping[str, Any], **points: Any) -> mast.Run:
    """A run of a scene whose lidars have points, which are recorded."""
    folder.mkdir()
    points = dict(clutter=None, recorded=True) | points
    (folder / "scanned.py").write_text(
        f"import sys\n\nsys.path.insert(0, {str(SHIPPED)!r})\nfrom baseline import scenario as baseline\n\n\n"
        f"def scenario():\n    return baseline() | dict(scene={dict(scene)!r}, points={points!r})\n"
    )
    return mast.run(folder / "scanned.py", frames=FRAMES, out=folder / "run", runtime="inproc")


def bodies(run: mast.Run, wire: str) -> list[Mapping[str, np.ndarray]]:
    return [message.body for message in messages(run.path, wire)]


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run with simulated points, which exports write as those of a data set."""
    scene = dict(type="Intersection", n_infrastructure=1, n_mobile=1, n_vehicles=6)
    return played(tmp_path_factory.mktemp("simulated") / "files", scene, lidar="VLP-32C")


def assert_same_perception(simulated: mast.Run, run: mast.Run) -> None:
    """The same points reach the detector, and it finds the same."""
    for wire in ("agent/ego/points", "agent/ego/detections"):
        pairs = list(zip(bodies(simulated, wire), bodies(run, wire), strict=True))
        assert len(pairs) == FRAMES
        for one, other in pairs:
            np.testing.assert_allclose(one["position"], other["position"], atol=1e-4)
    assert any(len(body["yaw"]) for body in bodies(run, "agent/ego/detections"))


def test_points_of_kitti_reach_the_detector(simulated: mast.Run, tmp_path: Path) -> None:
    export(simulated.path, "kitti", tmp_path / "kitti")
    scene = dict(type="KittiTracking", path=str(tmp_path / "kitti"), recorded_points=True, n_infrastructure=1)
    run = played(tmp_path / "files", scene)
    assert_same_perception(simulated, run)
    assert min(len(body["channel"]) for body in bodies(run, "agent/infra_1/points")) > 1000, "it is simulated"
    for body in bodies(run, "scene/truth"):
        returned = body["points"][:, body["agents"].tolist().index("ego")]
        assert returned[body["id"] == 0].tolist() == [0], "a lidar does not meet its own car"
        assert returned.max() > 20


def test_a_model_of_the_scenario_replaces_recorded_points(simulated: mast.Run, tmp_path: Path) -> None:
    export(simulated.path, "kitti", tmp_path / "kitti")
    for file in (tmp_path / "kitti" / "velodyne" / "0000").iterdir():
        file.write_bytes(b"")
    scene = dict(type="KittiTracking", path=str(tmp_path / "kitti"), recorded_points=True, n_infrastructure=0)
    assert {len(body["channel"]) for body in bodies(played(tmp_path / "a", scene), "agent/ego/points")} == {0}
    cast = played(tmp_path / "b", scene, lidar="VLP-16")
    assert min(len(body["channel"]) for body in bodies(cast, "agent/ego/points")) > 1000


def kitti(folder: Path) -> Path:
    """A sequence with four points in each frame."""
    write_kitti(junction(n_infrastructure=0, n_mobile=2), folder)
    for frame in range(len(junction(n_infrastructure=0, n_mobile=2))):
        file = folder / "velodyne" / "0004" / f"{frame:06d}.bin"
        file.parent.mkdir(parents=True, exist_ok=True)
        np.tile(np.array([frame + 1, 2, 3, 0.5], "<f4"), (4, 1)).tofile(file)
    return folder


def read(path: Path, **parameters: Any) -> Recording:
    scene = KittiTracking(path=str(path), recorded_points=True, **{"n_infrastructure": 0, "n_mobile": 1} | parameters)
    return scene.record(0, None)


def test_scans_go_with_their_frames_and_agents_into_a_file_and_back(tmp_path: Path) -> None:
    recording = read(kitti(tmp_path), first_frame=2)
    recording.save(tmp_path / "scene.npz")
    for loaded in (Recording.load(tmp_path / "scene.npz"), Recording.open(tmp_path / "scene.npz")):
        assert loaded.scans is not None
        assert loaded.scans.recorded.tolist() == [True, False]
        assert loaded.scans.at(1, 0).position.tolist() == [[4.0, 2.0, 3.0]] * 4
        assert loaded.scans.at(1, 0).intensity.tolist() == [0.5] * 4
        assert len(loaded.scans.at(1, 1)) == 0
    part = RecordingFile(path=str(tmp_path / "scene.npz"), n_mobile=0).record(0, 3)
    assert part.scans is not None
    assert len(part.scans.points) == 12
    assert part.scans.at(2, 0).position[0, 0] == 5.0
    part.validate()
    assert KittiTracking(path=str(tmp_path), n_infrastructure=0).record(0, None).scans is None, "nothing was asked for"


NAN = np.array([1, 2, 3, 0, 1, np.nan, 3, 0], "<f4")  # two points
FILE = "velodyne/0004/000003.bin"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (content(FILE, b"x" * 63), r"found 63 bytes, expected 16 for each point \(x, y, z, intensity in float32\)"),
        (content(FILE, b"\0" * 160_000_000), "found 160000000 bytes, expected 16 .* at most 200000 points"),
        (content(FILE, NAN.tobytes()), r"point 1: x, y, z: found \[1.0, nan, 3.0\], expected numbers from"),
        (content(FILE, np.full(8, 300.7).tobytes()), "point 0: .*: found .*, expected numbers from"),
        (
            content(FILE, np.full(4, 1e9, "<f4").tobytes()),
            r"point 0: x, y, z: .*, expected numbers from -10000 to 10000",
        ),
        (content(FILE, np.full(4, 7.0, "<f4").tobytes()), r"point 0: intensity: found \[7.0\], expected .* 0 to 1"),
        (Damage(FILE, lambda root: (root / FILE).unlink()), "cannot be read: No such file"),
    ],
)
def test_damaged_files_of_points_are_refused(damage: Damage, message: str, tmp_path: Path) -> None:
    assert_refused(read, kitti(tmp_path), damage, message)


def test_more_points_than_fit_into_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_scans, "MAX_ALL_POINTS", 10)
    with pytest.raises(SceneError, match="0004: found more than 10 points up to frame 3 of 12 of lidar 1 of 1, "):
        read(kitti(tmp_path))


# -- ROS 2 bags --------------------------------------------------------------------------------------------------------


def test_points_of_an_exported_bag_reach_the_detector(simulated: mast.Run, tmp_path: Path) -> None:
    export(simulated.path, "rosbag2", tmp_path / "bag")
    mount = bodies(simulated, "agent/ego/points")[0]["mount_position"].tolist()
    points = dict(topic="/agent/ego/points", frame="ego/lidar", most_intensity=1.0)
    ego = dict(pose=dict(topic="/tf", child="ego"), detections=dict(kind="lidar", position=mount, points=points))
    topics = dict(frames=dict(world={}), agents=dict(ego=ego), truth=dict(all=dict(topic="/scene/truth")))
    run = played(tmp_path / "files", dict(type="RosBag", path=str(tmp_path / "bag"), topics=topics))
    assert_same_perception(simulated, run)
    for one, other in zip(*(bodies(each, "agent/ego/points") for each in (simulated, run)), strict=True):
        for column in ("intensity", "time_s", "channel"):
            np.testing.assert_array_equal(one[column], other[column])


FIELDS = dict(x="<f4", y="<f4", z="<f4", intensity="<f4", ring="<u2", t="<u4")


def cloud(time_ns: int, rows: Any, **fields: str) -> Any:
    """A PointCloud2 at ns after the start, with as many values in each row as it has fields. fields: name and type"""
    kind = np.dtype(list((fields or FIELDS).items()))
    points = np.array([tuple(row) for row in rows], kind)
    numbers = {"<f4": 7, "<u2": 4, "<u4": 6, "<f8": 8, "<i4": 5}
    listed = [TYPES["sensor_msgs/msg/PointField"](n, kind.fields[n][1], numbers[kind[n].str], 1) for n in kind.names]
    size, data = kind.itemsize, np.frombuffer(points.tobytes(), np.uint8)
    head = header(START_NS + time_ns, "velodyne")
    message = TYPES["sensor_msgs/msg/PointCloud2"]
    return message(head, 1, len(points), listed, False, size, size * len(points), data, True)


ROWS = [(9.0, 1.0, 0.5, 51.0, 3, 1000), (np.nan, 0, 0, 0, 0, 0), (0, 0, 0, 9, 1, 5), (5.0, 0.0, 0.0, 510.0, 2, 0)]


def bag(folder: Path, *scans: tuple[int, Any], frames: int = 3) -> Recording:
    """What is read of a bag whose ego drives east at 10 m/s, with clouds at some ms."""
    poses = [
        Sent("/pose", k * 100 * MS, pose_stamped(k * 100 * MS, "map", (float(k), 0.0, 0.0))) for k in range(frames)
    ]
    sent = [Sent("/points", ms * MS, message) for ms, message in scans]
    path = write_bag(folder / "bag", sorted([*poses, *sent], key=lambda each: each.received_ns))
    lidar = dict(kind="lidar", position=[0.0, 0.0, 1.8], points=dict(topic="/points", frame="velodyne"))
    ego = dict(pose=dict(topic="/pose"), body=dict({"class": "car"}, size=[4.0, 2.0, 1.5]), detections=lidar)
    return RosBag(path=str(path), topics=dict(frames=dict(map={}), agents=dict(ego=ego))).record(0, None)


def test_the_nearest_scan_counts_from_where_its_agent_is_in_the_frame(tmp_path: Path) -> None:
    recording = bag(tmp_path, *((ms, cloud(ms * MS, ROWS)) for ms in (0, 30, 110)))
    assert recording.scans is not None
    first, second, third = (recording.scans.at(frame, 0) for frame in range(3))
    assert first.position.tolist() == [[5.0, 0.0, 0.0], [9.0, 1.0, 0.5]], "by time; what is no return is left out"
    assert first.intensity.tolist() == [1.0, pytest.approx(0.2)]
    assert first.channel.tolist() == [2, 3]
    assert first.time_s.tolist() == [0.0, pytest.approx(1e-6)]
    moved = np.array([0.1, 0.0, 0.0])  # the ego was as far ahead
    np.testing.assert_allclose(second.position, first.position + moved, atol=1e-5)
    assert len(third) == 0
    assert any("lidar: no points in 1 of 3 frames" in note for note in recording.notes)


@pytest.mark.parametrize(("time", "ring"), [(np.nan, 3), (1.7e9, 3), (0.01, 400), (0.01, -1)])
def test_times_and_channels_that_cannot_be_are_left_out_together(time: float, ring: int, tmp_path: Path) -> None:
    rows = [(9.0, 1.0, 0.5, time, ring), (1e300, 1.0, 0.5, 0.02, 1)]
    scan = bag(tmp_path, (0, cloud(0, rows, x="<f8", y="<f8", z="<f8", time="<f8", ring="<i4"))).scans
    assert scan is not None
    points = scan.at(0, 0)
    assert points.position.tolist() == [[9.0, 1.0, 0.5]]
    assert (points.time_s.tolist(), points.channel.tolist(), points.intensity.tolist()) == ([0.0], [0], [0.0])


def changed(**values: Any) -> Any:
    message = cloud(0, ROWS)
    for name, value in values.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (changed(data=np.zeros(50, np.uint8)), "found 50 bytes for 1 rows of 4 points of 22 bytes, row_step 88"),
        (changed(fields=cloud(0, ROWS).fields * 20), "found 120 fields, expected at most 100"),
        (changed(row_step=80), "row_step 80, expected"),
        (changed(width=10_000_000, height=10_000_000), "found 100000000000000 points, expected at most 200000"),
        (changed(point_step=4), "is at byte 4, expected it in 4 bytes|row_step"),
        (cloud(0, [(1, 2, 3)], x="<f4", y="<i4", z="<f4"), "expected x, y and z of floating point"),
        (cloud(0, [(1, 2)], x="<f4", y="<f4"), r"found the fields x \(float32\), y \(float32\), expected x, y and z"),
        (cloud(0, [(1e30, 2, 3)], x="<f4", y="<f4", z="<f4"), "point 0: x, y, z: found .* -10000 to 10000"),
    ],
)
def test_damaged_messages_of_points_are_refused(message: Any, error: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=rf"bag: /points: message 0, received at [0-9]+ ns.*{error}"):
        bag(tmp_path, (0, message))


def test_a_payload_that_is_cut_off_is_refused() -> None:
    payload = type_store.encode(cloud(0, ROWS))
    assert stamp_of_scan(payload) == (START_NS, "velodyne")
    connection = SimpleNamespace(topic="/points")
    sent = SimpleNamespace(path="bag", messages=lambda topics: [(connection, 7, payload[:-20])])
    with pytest.raises(SceneError, match="bag: /points: message 0, received at 7 ns, cannot be read"):
        read_scans(sent, PointsEntry(topic="/points", frame="velodyne"), {0})  # type: ignore[arg-type]
    with pytest.raises(MessageError, match="PointCloud2: 10 bytes"):
        stamp_of_scan(payload[:10])


def test_points_go_to_the_first_sensor_a_lidar_without_detections(tmp_path: Path) -> None:
    points = dict(topic="/points", frame="velodyne")
    for detections in (
        dict(kind="radar", points=points),
        [dict(kind="lidar"), dict(kind="lidar", name="other", points=points)],
        dict(kind="lidar", topic="/found", frame="velodyne", points=points),
    ):
        agents = dict(ego=dict(pose=dict(topic="/pose"), detections=detections))
        with pytest.raises(ConfigurationError, match="points: expected them of the first sensor, a lidar without"):
            parse_map(dict(frames=dict(map={}), agents=agents), tmp_path)
