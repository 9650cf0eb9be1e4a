"""A prepared scene that stays in its file: the same as one that is read, and refused for the same reasons."""

import contextlib
import io
import re
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes import recording as module
from mast_zenoh.scenes.mapped import MappedArray, mapped_arrays
from mast_zenoh.scenes.recording import Measurements, Recording


@pytest.fixture(autouse=True)
def every_file_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAPPED_BYTES", 0)


@pytest.fixture
def complete(recording: Recording) -> Recording:
    """A recording with every optional part."""
    measurements = Measurements(np.zeros((2, 2), np.int64), np.ones((2, 2, 3)), np.tile(np.eye(3), (2, 2, 1, 1)))
    sweeps = tuple(np.full((2, 1, 4), agent, np.float32) for agent in (3, 4))
    return replace(recording, measurements=measurements, sweeps=sweeps, notes=("by hand",))


@pytest.fixture(scope="session")
def content(saved: Path) -> bytes:
    return saved.read_bytes()


def look_at(played: Recording) -> list[np.ndarray]:
    """All that can be asked of all frames."""
    columns: list[Any] = []
    for frame in range(len(played)):
        columns += [*played.truth_at(frame).columns().values(), played.points_at(frame)]
        columns += [played.agent_position[frame], played.agent_rotation[frame], played.agent_velocity[frame]]
        for agent in range(len(played.agents)):
            columns += [*played.detections_at(frame, agent).columns().values(), played.sweep_at(frame, agent)]
            columns += [played.detection_truth_id_at(frame, agent), *played.mount_at(frame, agent)]
    return [np.asarray(column) for column in columns]


def with_arrays(path: Path, **changes: np.ndarray) -> Path:
    """A file with some arrays replaced. changes: dots in names are written as underscores"""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    names = {name.replace(".", "_"): name for name in arrays}
    np.savez(path, **arrays | {names[name]: values for name, values in changes.items()})
    return path


def test_an_opened_scene_equals_a_loaded_one(complete: Recording, tmp_path: Path) -> None:
    complete.save(tmp_path / "scene.npz")
    opened, loaded = Recording.open(tmp_path / "scene.npz"), Recording.load(tmp_path / "scene.npz")
    assert isinstance(opened.truth.position, MappedArray)
    assert isinstance(opened.sweeps[0], MappedArray)
    for part in ("name", "period_ns", "agent_names", "origin", "notes"):
        assert getattr(opened, part) == getattr(loaded, part)
    for one, other in zip(look_at(opened), look_at(loaded), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
        assert one.flags.aligned
    np.testing.assert_array_equal(opened.buildings[1], loaded.buildings[1])
    opened.validate()
    opened.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "scene.npz").read_bytes()


def test_parts_of_an_opened_scene_are_taken_as_numpy_takes_them(complete: Recording, tmp_path: Path) -> None:
    complete.save(tmp_path / "scene.npz")
    opened = Recording.open(tmp_path / "scene.npz")
    rotation = np.asarray(complete.agent_rotation)
    for key in (0, slice(1), (1, 0), (slice(None), 1), [1, 0], np.array([True, False]), (..., 2), np.array([1])):
        np.testing.assert_array_equal(opened.agent_rotation[key], rotation[key])
    np.testing.assert_array_equal(opened.truth.select(complete.truth.id == 7).position, complete.truth.position[[0, 2]])
    np.testing.assert_array_equal(np.isin(opened.truth.id, [9]), [False, True, False])
    assert opened.agent_position.shape == (2, 2, 3)
    with pytest.raises(ValueError, match="read-only"):
        opened.agent_position[0][:] = 1.0


def test_a_small_file_is_loaded(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAPPED_BYTES", saved.stat().st_size + 1)
    assert isinstance(Recording.open(saved).truth.position, np.ndarray)
    monkeypatch.setattr(module, "MAPPED_BYTES", saved.stat().st_size)
    assert isinstance(Recording.open(saved).truth.position, MappedArray)


def test_opening_and_asking_for_a_frame_take_little_memory(complete: Recording, tmp_path: Path) -> None:
    frames = 20_000
    poses = {name: np.repeat(getattr(complete, name)[:1], frames, 0) for name in ("agent_position", "agent_rotation")}
    replace(
        complete,
        **poses,
        times_ns=np.arange(frames),
        agent_velocity=poses["agent_position"],
        truth=complete.truth.select(np.zeros(frames, np.int64)),
        truth_start=np.arange(frames + 1),
        points=np.zeros((frames, 2), np.int32),
        detections=complete.detections.select(np.zeros(2 * frames, np.int64)),
        detection_start=np.arange(2 * frames + 1),
        detection_truth_id=np.zeros(2 * frames, np.int64),
        sweeps=tuple(np.zeros((frames, 8, 4), np.float32) for _ in range(2)),
        measurements=None,
    ).save(tmp_path / "scene.npz")
    assert (tmp_path / "scene.npz").stat().st_size > 16_000_000
    tracemalloc.start()
    try:
        opened = Recording.open(tmp_path / "scene.npz")
        opened.truth_at(frames - 1), opened.detections_at(5, 1), opened.agent_rotation[7], opened.sweep_at(9, 0)
        assert tracemalloc.get_traced_memory()[1] < 3_000_000
    finally:
        tracemalloc.stop()


def far(values: np.ndarray, place: tuple[int, ...]) -> np.ndarray:
    changed = values.copy()
    changed[place] = np.inf
    return changed


@pytest.mark.parametrize(
    ("change", "sound", "asked"),
    [
        (lambda r: {"truth_position": far(r.truth.position, (2, 1))}, lambda r: r.truth_at(0), lambda r: r.truth_at(1)),
        (
            lambda r: {"truth_class_id": np.array([1, 1, 99], np.uint8)},
            lambda r: r.truth_at(0),
            lambda r: r.truth_at(1),
        ),
        (lambda r: {"truth_id": np.array([7, 7, 7])}, lambda r: r.truth_at(1), lambda r: r.truth_at(0)),
        (
            lambda r: {"detections_covariance": far(r.detections.covariance, (1, 2, 2))},
            lambda r: r.detections_at(0, 0),
            lambda r: r.detections_at(1, 1),
        ),
        (
            lambda r: {"agent_position": far(r.agent_position, (1, 0, 2))},
            lambda r: r.agent_position[0],
            lambda r: r.agent_position[1, 0],
        ),
        (
            lambda r: {"agent_rotation": far(r.agent_rotation, (1, 0, 2, 1))},
            lambda r: r.agent_rotation[:1],
            lambda r: r.agent_rotation[:, 0],
        ),
        (lambda r: {"sweeps_1": far(r.sweeps[1], (1, 0, 3))}, lambda r: r.sweep_at(0, 1), lambda r: r.sweep_at(1, 1)),
    ],
)
def test_a_frame_with_an_invalid_number_is_refused_when_it_is_asked_for(change, sound, asked, complete, tmp_path):
    complete.save(tmp_path / "scene.npz")
    path = with_arrays(tmp_path / "scene.npz", **change(complete))
    with pytest.raises(SceneError) as refused:
        Recording.load(path)
    opened = Recording.open(path)
    sound(opened)
    with pytest.raises(SceneError) as found:
        asked(opened)
    assert str(found.value) == str(refused.value)
    with pytest.raises(SceneError):
        opened.validate()


def test_measured_poses_are_checked_when_they_are_asked_for(complete: Recording, tmp_path: Path) -> None:
    complete.save(tmp_path / "scene.npz")
    assert complete.measurements is not None
    ages = np.array([[0, 0], [0, 1]])
    path = with_arrays(
        tmp_path / "scene.npz",
        measurements_age_ns=ages,
        measurements_position=far(complete.measurements.position, (1, 1, 0)),
    )
    opened = Recording.open(path)
    opened.mount_at(1, 0)
    with pytest.raises(SceneError, match=r"measurements\.position\[1.*0\].*finite"):
        opened.mount_at(1, 1)
    with pytest.raises(SceneError, match=r"measurements\.age_ns: infra_1/lidar.*1"):
        Recording.open(with_arrays(path, measurements_age_ns=np.where(ages, -7, 0)))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"times_ns": np.array([100, 100])}, r"hand.*1.*0"),
        ({"truth_start": np.array([0, 2, 2])}, r"hand.*offsets.*truth"),
        ({"truth_yaw": np.zeros(2)}, r"truth\.yaw.*\(2,\).*\(3,\)"),
        ({"points": np.zeros((3, 2))}, r"points.*float64.*int32"),
        ({"building_height": np.array([1.0, np.nan])}, r"building_height\[1\] is nan"),
        ({"building_start": np.array([0, 9, 6])}, r"building_start is \[0, 9, 6\]"),
        ({"truth_yaw": np.array([None] * 3)}, r"not.*prepared scene"),
    ],
)
def test_what_every_frame_needs_is_checked_at_once(saved: Path, tmp_path: Path, change: dict, reason: str) -> None:
    (tmp_path / "scene.npz").write_bytes(saved.read_bytes())
    path = with_arrays(tmp_path / "scene.npz", **change)
    for read in (Recording.load, Recording.open):
        with pytest.raises(SceneError, match=reason):
            read(path)


def test_arrays_of_another_layout_or_type_are_read(saved: Path, recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "scene.npz").write_bytes(saved.read_bytes())
    path = with_arrays(
        tmp_path / "scene.npz",
        truth_position=np.asfortranarray(recording.truth.position),
        truth_velocity=recording.truth.velocity.astype(">f4"),
        truth_class_id=recording.truth.class_id.astype(np.int64),
    )
    opened = Recording.open(path)
    np.testing.assert_array_equal(opened.truth_at(0).position, recording.truth_at(0).position)
    np.testing.assert_array_equal(opened.truth_at(0).velocity, recording.truth_at(0).velocity)
    assert opened.truth_at(0).velocity.dtype == opened.truth_at(0).yaw.dtype
    assert opened.truth_at(0).class_id.dtype == np.uint8


def test_a_compressed_array_is_read_and_a_bomb_refused(saved: Path, recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    with zipfile.ZipFile(saved) as sound, zipfile.ZipFile(path, "w") as mixed:
        for info in sound.infolist():
            mixed.writestr(info.filename, sound.read(info), zipfile.ZIP_DEFLATED if "yaw" in info.filename else None)
    opened = Recording.open(path)
    np.testing.assert_array_equal(opened.truth_at(1).yaw, recording.truth_at(1).yaw)
    with np.load(saved) as file:
        np.savez_compressed(path, **dict(file) | {"points": np.zeros((40_000, 1000), np.int32)})
    for read in (Recording.open, Recording.load):
        tracemalloc.start()
        try:
            with pytest.raises(SceneError, match=r"scene\.npz.*prepared scene"):
                read(path)
            assert tracemalloc.get_traced_memory()[1] < 10_000_000
        finally:
            tracemalloc.stop()


def patched(content: bytes, name: str, field: int, width: int, value: int, *, central: bool) -> bytes:
    """A zip file with a number in one of the two headers of a member replaced. field: its offset in the header"""
    mark = b"PK\x01\x02" if central else b"PK\x03\x04"
    size = 46 if central else 30
    at = content.index(mark)
    while not content[at + size :].startswith(name.encode()):
        at = content.index(mark, at + 4)
    return content[: at + field] + value.to_bytes(width, "little") + content[at + field + width :]


def npy_of(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def test_arrays_outside_the_file_or_inside_others_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("inner.npy", npy_of(np.zeros(3)))
        inner = archive.start_dir
    member = np.frombuffer(path.read_bytes()[:inner], np.uint8)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("outer.npy", npy_of(member))
        inside = archive.start_dir - len(member)
        archive.writestr("inner.npy", npy_of(np.zeros(3)))
    nested = patched(path.read_bytes(), "inner.npy", 42, 4, inside, central=True)
    path.write_bytes(nested)
    with zipfile.ZipFile(path) as archive:
        assert archive.read("inner.npy") == npy_of(np.zeros(3)), "zipfile sees nothing wrong"
    last = patched(content, "building_corners.npy", 28, 2, 0xFFFF, central=False)
    for damaged in (nested, last):
        path.write_bytes(damaged)
        with (
            path.open("rb") as file,
            pytest.raises(ValueError, match=r"overlaps another.*within"),
        ):
            mapped_arrays(file)
        with pytest.raises(SceneError, match=r"not.*prepared scene"):
            Recording.open(path)


def test_an_array_ends_where_its_member_does(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "scene.npz", "w") as archive:
        archive.writestr("a.npy", npy_of(np.zeros(12)).replace(b"(12,)", b"(13,)"))
        archive.writestr("b.npy", npy_of(np.zeros(12)))
    with (tmp_path / "scene.npz").open("rb") as file, pytest.raises(ValueError, match=r"224 bytes.*232"):
        mapped_arrays(file)


@pytest.mark.parametrize("read", [Recording.load, Recording.open])
def test_an_encrypted_array_or_an_endless_header_is_refused(read: Callable, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    encrypted = patched(content, "truth.yaw.npy", 8, 2, 1, central=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("head.npy", b"\x93NUMPY\x01\x00\x08\x00{'a': ((")
    for damaged in (encrypted, path.read_bytes()):
        path.write_bytes(damaged)
        with pytest.raises(SceneError, match=r"not.*prepared scene"):
            read(path)


def opened_or_refused(path: Path) -> None:
    """Open a damaged file and take all that is in it, all of which is in the file."""
    content = path.read_bytes()
    with contextlib.suppress(SceneError), np.errstate(all="ignore"):
        opened = Recording.open(path)
        look_at(opened)
        for name, column in opened.truth.columns().items():
            assert name in ("covariance", "score") or np.asarray(column).astype(column.dtype).tobytes() in content


PIECES = st.binary(max_size=9) | st.sampled_from([b"\xff\xff\xff\xff", b"PK\x03\x04", b"PK\x01\x02", b"\x93NUMPY"])


@given(data=st.data())
def test_any_damage_to_a_file_is_opened_within_it_or_refused(data, content, tmp_path_factory):
    heads = [found.start() for found in re.finditer(rb"PK[\x01\x03\x05]|\x93NUMPY", content)]
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.sampled_from(heads)) + data.draw(st.integers(0, 60))
        piece = data.draw(PIECES)
        damaged[at : at + data.draw(st.sampled_from([0, len(piece)]))] = piece
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    path.write_bytes(damaged[: data.draw(st.integers(0, len(damaged)))] if data.draw(st.booleans()) else damaged)
    opened_or_refused(path)


@given(data=st.data())
def test_any_number_in_a_header_is_opened_within_the_file_or_refused(data, content, tmp_path_factory):
    """Sizes and offsets in the headers of a member, which are not hit often by chance."""
    central = data.draw(st.booleans())
    fields = (8, 10, 20, 24, 28, 30, 42) if central else (6, 8, 18, 22, 26, 28)
    name = data.draw(st.sampled_from(["truth.position.npy", "points.npy", "building_corners.npy", "head.npy"]))
    near = st.integers(0, len(content) + 10) | st.sampled_from([0xFFFF, 0xFFFFFFFF])
    field = data.draw(st.sampled_from(fields))
    width = 4 if field >= 18 and (central, field) not in ((True, 28), (True, 30), (False, 26), (False, 28)) else 2
    value = min(data.draw(near), (1 << 8 * width) - 1)
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    path.write_bytes(patched(content, name, field, width, value, central=central))
    opened_or_refused(path)
