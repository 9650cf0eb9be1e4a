"""Points that data sets recorded feed the same detector; files that cannot be are refused."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import junction
from damages import Damage, assert_refused, content
from kitti_writer import write_kitti
from mast_datasets import KittiTracking

import mast_zenoh as mast
from mast_zenoh.errors import SceneError
from mast_zenoh.runs.messages import messages
from mast_zenoh.scenes import RecordingFile, recorded_scans
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.export import export

FRAMES = 6
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
        (content(FILE, b"\0" * 160_000_000), "found 160000000 bytes, expected 16 .* at most 500000 points"),
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
    with pytest.raises(SceneError, match=r"0004: found more than 10 points in 3 of 12 frames, .* choose fewer frames"):
        read(kitti(tmp_path))
