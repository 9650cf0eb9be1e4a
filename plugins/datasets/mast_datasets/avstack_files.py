"""Files of the CARLA multi-agent layout of AVstack: archives, folders, objects and calibrations."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import itertools
import lzma
import re
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Annotated, Any, cast

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mast_datasets.files import Coordinate, Element, Point, read_json
from mast_datasets.traffic import closed_outline
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import class_of
from mast_zenoh.scenes.own_detections import lines_of_agents

#: Limit on the members of an archive, of any kind.
MAX_MEMBERS = 200_000

#: Limit on the unpacked size of an archive, its other files included, by its own size; beyond `max_bytes`. Above what
#: gzip can reach (1032), so it bounds xz and bzip2 alone.
_MAX_RATIO = 1100
#: Limit on the memory in which xz unpacks; its highest level takes 65 MB.
_MAX_XZ_MEMORY = 200_000_000

#: Limit on the header bytes of one member: a header may hold a path of any length, and is read into memory.
_MAX_HEADER = 64 << 10

_COMPRESSIONS: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_READ_ERRORS = (tarfile.TarError, EOFError, OSError, ValueError, ArithmeticError, lzma.LZMAError, zlib.error)


def unpack(path: Path, folder: Path, suffixes: tuple[str, ...], max_bytes: int) -> None:
    """Unpack the files of a tar archive whose names end in one of the suffixes.

    path:      the archive, plain or compressed by gzip, bzip2 or xz
    max_bytes: limit on the total size of the unpacked files

    Raises SceneError at the first file that exceeds a limit, leaves the folder, is a link or a device, or cannot be
    read. Earlier files have been unpacked by then.
    """
    total = 0
    try:
        with _decompressed(path) as content:
            bounded = _Bounded(content, path, max_bytes + _MAX_RATIO * path.stat().st_size)
            with tarfile.open(fileobj=cast("IO[bytes]", bounded), mode="r:") as archive:
                for member in _members(archive, bounded, path):
                    if not member.name.endswith(suffixes) or member.isdir():
                        continue
                    if not member.isfile() or member.issparse():
                        is_link = member.islnk() or member.issym()
                        kind = f"a link to {member.linkname!r}" if is_link else "not a regular file"
                        expected = "expected plain files: pack with tar --dereference --hard-dereference"
                        raise SceneError(f"{path}: {member.name} is {kind}, {expected}")
                    total += member.size
                    if total > max_bytes:
                        raise SceneError(
                            f"{path}: too large: {_mb(total)} unpacked up to and including {member.name}, expected at "
                            f"most {_mb(max_bytes)}; if you trust the archive, raise the scene's max_unpacked_mb"
                        )
                    bounded.budget = member.size
                    archive.extract(member, folder, filter="data")
    except _READ_ERRORS as error:
        raise SceneError(f"{path}: cannot be unpacked: {error}") from error


def _decompressed(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(1 << 16)
    for magic, opener in _COMPRESSIONS.items():
        if start.startswith(magic):
            if opener is lzma.open:
                lzma.LZMADecompressor(memlimit=_MAX_XZ_MEMORY).decompress(start, 1)
            return cast("IO[bytes]", opener(path, "rb"))
    return path.open("rb")


class _Bounded:
    """The file that tarfile reads; `budget` is the number of bytes it may still read.

    Seeking unpacks what is skipped, up to `end` bytes from the start.
    """

    def __init__(self, content: IO[bytes], path: Path, end: int) -> None:
        self._end = end
        self.budget = _MAX_HEADER
        self._content = content
        self._path = path

    def read(self, size: int) -> bytes:
        self.budget -= size
        if self.budget < 0:
            raise SceneError(f"{self._path}: a header exceeds the limit of {_MAX_HEADER} bytes")
        return self._content.read(size)

    def seek(self, offset: int) -> int:
        if offset > self._end:
            raise SceneError(
                f"{self._path}: found {_mb(offset)} unpacked or more, files that are not needed included; "
                f"expected at most {_mb(self._end)}"
            )
        return self._content.seek(offset)

    def tell(self) -> int:
        return self._content.tell()


def _members(archive: tarfile.TarFile, bounded: _Bounded, path: Path) -> Iterator[tarfile.TarInfo]:
    """Yield the members one at a time without keeping them in memory."""
    count = 0
    bounded.budget = _MAX_HEADER
    while (member := archive.next()) is not None:
        count += 1
        if count > MAX_MEMBERS:
            raise SceneError(f"{path}: the archive exceeds the limit of {MAX_MEMBERS:,} files and folders")
        yield member
        archive.members.clear()  # type: ignore[attr-defined]  # missing in typeshed
        archive.pax_headers.clear()  # type: ignore[attr-defined]  # a dict
        bounded.budget = _MAX_HEADER


def _mb(size: int) -> str:
    return f"{size / 1e6:,.6g} MB"


_MAX_DEPTH = 3  # levels of subfolders that are searched for a run


@dataclass(frozen=True)
class RunLayout:
    """A run folder, and the folders that may hold accompanying files, nearest first."""

    run: Path
    search_folders: tuple[Path, ...]

    def accompanying_file(self, name: str) -> Path | None:
        """The nearest accompanying file of that name; None: there is none."""
        return next((folder / name for folder in self.search_folders if (folder / name).is_file()), None)

    def frames(self) -> dict[int, Path]:
        """The actors' file of every frame, in order.

        Raises SceneError for gaps and for missing files.
        """
        folder = self.run / "objects"
        actors, others = (_files(folder, kind) for kind in ("actors", "npcs"))
        if not actors:
            raise SceneError(f"{folder}: no file objectstate-actors-<frame>-<time>.txt")
        _files(folder, "npcs", list(actors))
        _files(folder, "actors", list(others))
        numbers = list(actors)
        stride = numbers[1] - numbers[0] if len(numbers) > 1 else 1
        for before, after in itertools.pairwise(numbers):
            if after - before != stride:
                raise SceneError(f"{folder}: frame {before} is followed by {after}, expected {before + stride}")
        return actors

    def sensors(self, kind: str, agent: int) -> list[str]:
        """Names of an agent's sensors of a kind with data, such as "lidar-0-3".

        kind: "lidar" or "camera"
        """
        folder = self.run / "data"
        names = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
        return [name for name in names if (parts := name.split("-"))[0] == kind and parts[-1] == str(agent)]

    def calibrations(self, sensor: str, frames: Sequence[int]) -> dict[int, Path]:
        """The calibration of a sensor in every frame."""
        return _files(self.run / "data" / sensor, "calib", frames)

    def seen(self, sensor: str, frames: Sequence[int]) -> dict[int, Path] | None:
        """The file of visible objects of a sensor in every frame.

        None without a folder for that sensor.
        """
        folder = self.run / "objects_sensor" / sensor
        return _files(folder, "objects", frames) if folder.is_dir() else None


@contextlib.contextmanager
def open_layout(path: Path, max_unpacked_mb: float) -> Iterator[RunLayout]:
    """Open the layout at `path`: a run folder, a folder above one, or a tar archive.

    A folder above must contain a single run. An archive is unpacked into a temporary folder, without the images and
    point clouds; the folder is deleted when the context ends. Raises SceneError without exactly one run, or if the
    files exceed `max_unpacked_mb` (10^6 bytes).
    """
    if path.is_dir():
        yield find_layout(path)
        return
    if not path.is_file():
        raise SceneError(f"{path}: no such file or folder")
    with tempfile.TemporaryDirectory(prefix="mast-scene-") as folder:
        unpack(path, Path(folder), (".txt", ".json", ".jsonl"), int(max_unpacked_mb * 1e6))
        # Error messages name the archive, not the temporary folder.
        try:
            yield find_layout(Path(folder))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(path))) from error


def find_layout(path: Path) -> RunLayout:
    """The layout in a folder: the folder itself, or the only run below it."""
    if (path / "objects").is_dir():
        return RunLayout(path, (path, path.parent))
    level, runs = [path], []
    for _ in range(_MAX_DEPTH):
        level = sorted(child for folder in level for child in folder.iterdir() if child.is_dir())
        runs += [folder for folder in level if (folder / "objects").is_dir()]
        level = [folder for folder in level if folder not in runs]
    if not runs:
        raise SceneError(f"{path}: no run folder, expected a folder with objects/, objects_sensor/ and data/")
    if len(runs) > 1:
        names = ", ".join(str(run.relative_to(path)) for run in runs[:5])
        raise SceneError(f"{path}: {len(runs)} runs ({names}), expected the path of one")
    above = [folder for folder in runs[0].parents if folder == path or path in folder.parents]
    return RunLayout(runs[0], (runs[0], *above))


def _files(folder: Path, kind: str, frames: Sequence[int] | None = None) -> dict[int, Path]:
    """The files of a kind by the frames in their names, in order; None: of all frames.

    Raises SceneError with the first frame that has none, and for a name without a number.
    """
    begin = "calib-timestamp_" if kind == "calib" else f"objectstate-{kind}-"
    name = re.compile(r".*-frame_([0-9]+)\.txt" if kind == "calib" else rf"{begin}([0-9]+)-[^-]*\.txt")
    files: dict[int, Path] = {}
    for path in folder.glob(f"{begin}*.txt"):
        match = name.fullmatch(path.name)
        if match is None:
            raise SceneError(f"{path}: found no frame number in the name, expected {begin}… with one")
        files[int(match[1])] = path
    missing = [frame for frame in frames or () if frame not in files]
    if frames and missing:
        count = f"{len(missing)} of {len(frames)} frames"
        raise SceneError(f"{folder}: no {kind} file for frame {missing[0]} (missing for {count})")
    return {frame: files[frame] for frame in (sorted(files) if frames is None else frames)}


#: Values of `occlusion` of an object that a sensor does not see: invalid and complete. 0, 1 and 2 mean none, partial
#: and most, 99 means unknown.
_HIDDEN = (-1, 3)
_Side = Annotated[float, Meta(gt=0, le=1e8)]  # m
_Fraction = Annotated[float, Meta(ge=0, le=1)]
_Time = Annotated[float, Meta(ge=-9e9, le=9e9)]  # s; more nanoseconds are no 64 bit number
_Pixels = Annotated[list[Annotated[int, Meta(ge=0, le=10**6)]], Meta(min_length=2)]
_Focal = Annotated[list[Annotated[list[Coordinate], Meta(min_length=1)]], Meta(min_length=1)]


@dataclass(frozen=True, eq=False)
class ObjectState:
    """One object or agent in the world.

    position: (3,) m of its reference point; rotation: (3, 3) active, body to world
    velocity: (3,) m/s; None: not stored
    centre: (3,) m of its box; size: (3,) m l w h; yaw: rad of the box; all None without a box (a pole)
    """

    id: int
    kind: str
    position: Floats
    rotation: Floats
    velocity: Floats | None
    centre: Floats | None
    size: Floats | None
    yaw: float | None

    @property
    def class_id(self) -> int:
        """Index into CLASSES."""
        return class_of(self.kind)


def read_objects(path: Path, frame: int) -> tuple[float, list[ObjectState]]:
    """Time s and states in a file of `objects/`. Raises SceneError with the file and the place in it."""
    time, listed = _container(path, frame)
    return time, [_object_state(data) for data in listed]


def read_seen(path: Path, frame: int) -> dict[int, float | None]:
    """Ids in a file of `objects_sensor/` with visible fractions (None: not stored).

    Completely occluded objects are left out.
    """
    seen: dict[int, float | None] = {}
    for state in _container(path, frame)[1]:
        fraction = state.get("visible_fraction")
        if fraction is not None and fraction.read(_Fraction) > 0.0:
            seen[state["ID"].read(int)] = fraction.read(_Fraction)
        elif fraction is None and state["occlusion"].read(int) not in _HIDDEN:
            seen[state["ID"].read(int)] = None
    return seen


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """The pose of a sensor in the world; image size and focal length of a camera.

    position: (3,) m;  rotation: (3, 3) active, sensor to world;  focal, width, height: px, None for a lidar
    """

    position: Floats
    rotation: Floats
    focal: float | None
    width: int | None
    height: int | None


def read_calibration(path: Path) -> SensorCalibration:
    """Read a `calib-…` file. Raises SceneError with its path."""
    calibration = read_json(path)["calibration"]
    position, rotation = _frame(calibration["reference"])
    if calibration.get("img_shape") is None:
        return SensorCalibration(position, rotation, None, None, None)
    height, width, *_ = calibration["img_shape"].read(_Pixels)
    return SensorCalibration(position, rotation, calibration["P"].read(_Focal)[0][0], width, height)


def _object_state(data: Element) -> ObjectState:
    position, rotation, velocity = _point(data, "position"), _rotation(data), None
    if data.get("velocity") is not None:
        vector, frame = _referenced(data, "velocity")
        velocity = frame[1] @ np.array(vector["x"].read(Point))
    centre = size = yaw = None
    if data.get("box") is not None:
        box = _parsed(data["box"])["box3d"]
        height, width, length = box["hwl"].read(tuple[_Side, _Side, _Side])
        turn = _rotation(box)
        bottom = box["where_is_t"].text(("bottom", "center")) == "bottom"
        centre = _point(box, "position") + (turn[:, 2] * height / 2 if bottom else 0.0)
        size, yaw = np.array([length, width, height]), float(heading(turn))
    return ObjectState(data["ID"].read(int), data["obj_type"].text(), position, rotation, velocity, centre, size, yaw)


def _point(data: Element, name: str) -> Floats:
    """(3,) m, a position in the world."""
    point, (origin, rotation) = _referenced(data, name)
    return np.asarray(origin + rotation @ np.array(point["x"].read(Point)))


def _rotation(data: Element) -> Floats:
    """(3, 3) active rotation of an attitude, body to world."""
    attitude, (_, rotation) = _referenced(data, "attitude")
    return np.asarray(rotation @ _active(attitude))


def _referenced(data: Element, name: str) -> tuple[Element, tuple[Floats, Floats]]:
    """A position, velocity or attitude, and the pose of its reference frame."""
    value = _parsed(data[name])[name]
    return value, _frame(value["reference"])


def _frame(reference: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of a reference frame in the world."""
    try:
        return _pose(reference.text())
    except SceneError as error:
        raise SceneError(f"{reference.path}: {reference.place}: {error}") from error


@lru_cache(maxsize=256)
def _pose(reference: str) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of a reference frame, resolved through all its parents."""
    data = _parsed(Element(reference, Path("its text")))["reference"]
    position, rotation = np.array(data["x"].read(Point)), _active(data)
    if data["reference"].value is None:
        return position, rotation
    parent_position, parent_rotation = _pose(data["reference"].text())
    return parent_position + parent_rotation @ position, parent_rotation @ rotation


def _active(data: Element) -> Floats:
    """(3, 3) active rotation of a passive quaternion."""
    quaternion = np.array([data["qw"].read(Coordinate), *data["qv"].read(Point)])
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-3:
        data.fail("a quaternion qw, qv of length 1")
    return rotation_from_quaternion(quaternion * [1.0, -1.0, -1.0, -1.0])


def _container(path: Path, frame: int) -> tuple[float, list[Element]]:
    """Time s, and the objects in a file of a frame."""
    container = read_json(path)["datacontainer"]
    if container["frame"].read(int) != frame:
        container["frame"].fail(f"{frame} as in the name of the file")
    listed = [_parsed(element)["objectstate"] for element in container["data"].elements()]
    return container["timestamp"].read(_Time), listed


def _parsed(element: Element) -> Element:
    """What the text of a value says in JSON."""
    try:
        return Element(msgspec.json.decode(element.text()), element.path, element.place)
    except (msgspec.DecodeError, RecursionError) as error:
        raise SceneError(f"{element.path}: {element.place}: not JSON: {error}") from error


_DEFAULT_HEIGHT_M = 12.0  # of buildings


class _Returns(Struct, array_like=True):
    """Lidar returns of an object; more numbers may follow."""

    id: int
    points: Annotated[int, Meta(ge=0, le=2**31 - 1)]


def read_visibility(
    path: Path, frames: Sequence[int], agents: Sequence[int], ids: Ints, start: Ints
) -> NDArray[np.int32]:
    """(N, A) lidar returns of each truth row at each agent, from `visibility.jsonl`.

    ids (N,) and start (F + 1,): the truth rows. Objects that are not listed have no returns.
    """
    points = np.zeros((len(ids), len(agents)), np.int32)
    for place, frame, agent, data in lines_of_agents(path, frames, agents, "objects"):
        row = {int(i): k for k, i in enumerate(ids[start[frame] : start[frame + 1]], start=int(start[frame]))}
        for listed in Element(data, Path(place)).read(list[_Returns]):
            if listed.id not in row:
                raise SceneError(f"{place}: object {listed.id} is not in the scene in this frame")
            points[row[listed.id], agent] = listed.points
    return points


def read_buildings(path: Path, scene: Path | None) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (k, 2) m, and heights (B,) m, from `buildings.json`.

    The polygons are in the world frame. All have the height `building_height_m` of `scene.json`, by default 12 m.
    """
    height = None if scene is None else read_json(scene).get("building_height_m")
    outlines = []
    for index, polygon in enumerate(read_json(path).read(list[list[tuple[Coordinate, Coordinate]]])):
        outlines.append(closed_outline(np.array(polygon), Element(polygon, path, f"$[{index}]").fail))
    return tuple(outlines), np.full(len(outlines), _DEFAULT_HEIGHT_M if height is None else height.read(Coordinate))
