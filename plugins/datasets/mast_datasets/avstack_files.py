"""Files of the CARLA multi-agent layout of AVstack: archives, folders, objects and calibrations."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import itertools
import json
import lzma
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.detection_tables import class_of
from mast_zenoh.scenes.own_detections import lines_of_agents, reason, reject_constant

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
                        raise SceneError(f"{path}: {_describe_special(member)}")
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


def _describe_special(member: tarfile.TarInfo) -> str:
    if member.islnk() or member.issym():
        kind = f"a link to {member.linkname!r}"
    else:
        kind = "a sparse file" if member.issparse() else "not a regular file"
    return f"{member.name} is {kind}, expected plain files: pack with tar --dereference --hard-dereference"


def _mb(size: int) -> str:
    return f"{size / 1e6:,.6g} MB"


_MAX_DEPTH = 3  # levels of subfolders that are searched for a run


@dataclass(frozen=True)
class Layout:
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
        actors = object_files(self.run / "objects", "actors")
        others = object_files(self.run / "objects", "npcs")
        if not actors:
            raise SceneError(f"{self.run / 'objects'}: no file objectstate-actors-<frame>-<time>.txt")
        check_frames(self.run / "objects", "npcs", others, list(actors))
        check_frames(self.run / "objects", "actors", actors, list(others))
        numbers = list(actors)
        stride = numbers[1] - numbers[0] if len(numbers) > 1 else 1
        for before, after in itertools.pairwise(numbers):
            if after - before != stride:
                raise SceneError(
                    f"{self.run / 'objects'}: frame {before} is followed by {after}, expected {before + stride}"
                )
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
        folder = self.run / "data" / sensor
        files: dict[int, Path] = {}
        for path in folder.glob("calib-timestamp_*-frame_*.txt"):
            files[_frame_number(path, path.stem.rpartition("frame_")[2])] = path
        check_frames(folder, "calib", files, frames)
        return {frame: files[frame] for frame in frames}

    def seen(self, sensor: str, frames: Sequence[int]) -> dict[int, Path] | None:
        """The file of visible objects of a sensor in every frame.

        None without a folder for that sensor.
        """
        folder = self.run / "objects_sensor" / sensor
        if not folder.is_dir():
            return None
        files = object_files(folder, "objects")
        check_frames(folder, "objects", files, frames)
        return {frame: files[frame] for frame in frames}


@contextlib.contextmanager
def open_layout(path: Path, max_unpacked_mb: float) -> Iterator[Layout]:
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


def find_layout(path: Path) -> Layout:
    """The layout in a folder: the folder itself, or the only run below it."""
    if (path / "objects").is_dir():
        return Layout(path, (path, path.parent))
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
    return Layout(runs[0], (runs[0], *above))


def object_files(folder: Path, kind: str) -> dict[int, Path]:
    """The files `objectstate-<kind>-<frame>-<time>.txt` by frame, in order."""
    files: dict[int, Path] = {}
    for path in folder.glob(f"objectstate-{kind}-*.txt"):
        parts = path.stem.split("-")
        if len(parts) != 4:
            raise SceneError(f"{path}: the name has {len(parts)} parts, expected objectstate-{kind}-<frame>-<time>.txt")
        files[_frame_number(path, parts[2])] = path
    return dict(sorted(files.items()))


def _frame_number(path: Path, text: str) -> int:
    if not text.isdecimal():
        raise SceneError(f"{path}: {text!r} in the name is not a frame number")
    return int(text)


def check_frames(folder: Path, kind: str, files: dict[int, Path], frames: Sequence[int]) -> None:
    """Raise SceneError with the first frame that has no file of a kind."""
    missing = [frame for frame in frames if frame not in files]
    if missing:
        raise SceneError(
            f"{folder}: no {kind} file for frame {missing[0]} (missing for {len(missing)} of {len(frames)} frames)"
        )


#: Values of `occlusion` of an object that a sensor does not see: invalid and complete. 0, 1 and 2 mean none, partial
#: and most, 99 means unknown.
_HIDDEN = (-1, 3)


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
    """Time s and states in a file of `objects/`.

    Raises SceneError with the file and the index of the object.
    """
    time, texts = _container(path, frame)
    states = []
    for index, text in enumerate(texts):
        try:
            states.append(_object_state(_decode(text)["objectstate"]))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise SceneError(f"{path}: data[{index}]: {reason(error)}") from error
    return time, states


def read_seen(path: Path, frame: int) -> dict[int, float | None]:
    """Ids in a file of `objects_sensor/` with visible fractions (None: not stored).

    Completely occluded objects are left out.
    """
    seen: dict[int, float | None] = {}
    _, texts = _container(path, frame)
    for index, text in enumerate(texts):
        try:
            state = _decode(text)["objectstate"]
            fraction = state.get("visible_fraction")
            if fraction is not None and not 0.0 <= float(fraction) <= 1.0:
                raise ValueError(f"visible_fraction is {fraction}, expected 0 to 1")
            if fraction is not None and float(fraction) > 0.0:
                seen[int(state["ID"])] = float(fraction)
            elif fraction is None and int(state["occlusion"]) not in _HIDDEN:
                seen[int(state["ID"])] = None
        except (ValueError, KeyError, TypeError) as error:
            raise SceneError(f"{path}: data[{index}]: {reason(error)}") from error
    return seen


@dataclass(frozen=True, eq=False)
class Calibration:
    """The pose of a sensor in the world; image size and focal length of a camera.

    position: (3,) m;  rotation: (3, 3) active, sensor to world;  focal, width, height: px, None for a lidar
    """

    position: Floats
    rotation: Floats
    focal: float | None
    width: int | None
    height: int | None


def read_calibration(path: Path) -> Calibration:
    """Read a `calib-…` file. Raises SceneError with its path."""
    data = _read(path)
    try:
        calibration = data["calibration"]
        position, rotation = _pose(calibration["reference"])
        if "img_shape" not in calibration:
            return Calibration(position, rotation, None, None, None)
        height, width = (int(size) for size in calibration["img_shape"][:2])
        return Calibration(position, rotation, float(calibration["P"][0][0]), width, height)
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error


def _object_state(data: dict[str, Any]) -> ObjectState:
    point, frame = _referenced(data["position"], "position")
    attitude, _ = _referenced(data["attitude"], "attitude")
    velocity = None
    if data.get("velocity") is not None:
        velocity_data, velocity_frame = _referenced(data["velocity"], "velocity")
        velocity = velocity_frame[1] @ _vector(velocity_data["x"], 3)
    rotation = frame[1] @ _active(attitude["qw"], attitude["qv"])
    centre = size = yaw = None
    if data.get("box") is not None:
        box = _decode(data["box"])["box3d"]
        corner, box_frame = _referenced(box["position"], "position")
        box_attitude, attitude_frame = _referenced(box["attitude"], "attitude")
        box_rotation = attitude_frame[1] @ _active(box_attitude["qw"], box_attitude["qv"])
        height, width, length = _vector(box["hwl"], 3)
        if min(height, width, length) <= 0:
            raise ValueError(f"hwl is {box['hwl']}, expected more than 0")
        centre = box_frame[0] + box_frame[1] @ _vector(corner["x"], 3)
        if box["where_is_t"] == "bottom":
            centre = centre + box_rotation[:, 2] * height / 2
        elif box["where_is_t"] != "center":
            raise ValueError(f"where_is_t is {box['where_is_t']!r}, expected 'bottom' or 'center'")
        size, yaw = np.array([length, width, height]), float(heading(box_rotation))
    position = frame[0] + frame[1] @ _vector(point["x"], 3)
    return ObjectState(int(data["ID"]), str(data["obj_type"]), position, rotation, velocity, centre, size, yaw)


def _referenced(text: str, name: str) -> tuple[dict[str, Any], tuple[Floats, Floats]]:
    """A position, velocity or attitude, and the pose of its reference frame."""
    data = _decode(text)[name]
    return data, _pose(data["reference"])


@lru_cache(maxsize=256)
def _pose(reference: str) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of a reference frame in the world.

    Resolved through all its parents.
    """
    data = _decode(reference)["reference"]
    position, rotation = _vector(data["x"], 3), _active(data["qw"], data["qv"])
    if data["reference"] is None:
        return position, rotation
    parent_position, parent_rotation = _pose(data["reference"])
    return parent_position + parent_rotation @ position, parent_rotation @ rotation


def _active(qw: Any, qv: Any) -> Floats:
    """(3, 3) active rotation of a passive quaternion."""
    quaternion = np.concatenate([_vector([qw], 1), -_vector(qv, 3)])
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-3:
        raise ValueError(f"quaternion {[qw, *qv]} does not have length 1")
    return rotation_from_quaternion(quaternion)


def _vector(values: Sequence[Any], length: int) -> Floats:
    vector = np.array([float(value) for value in values])
    if len(vector) != length:
        raise ValueError(f"{list(values)} has {len(vector)} numbers, expected {length}")
    if not np.isfinite(vector).all():
        raise ValueError(f"{list(values)} contains a number that is not finite")
    return vector


def _container(path: Path, frame: int) -> tuple[float, list[str]]:
    data = _read(path)
    try:
        container = data["datacontainer"]
        if int(container["frame"]) != frame:
            raise ValueError(f"frame is {container['frame']}, but {frame} in the name of the file")
        return float(container["timestamp"]), list(container["data"])
    except (ValueError, KeyError, TypeError) as error:
        raise SceneError(f"{path}: datacontainer: {reason(error)}") from error


def _read(path: Path) -> Any:
    try:
        return _decode(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error


def _decode(text: str) -> Any:
    return json.loads(text, parse_constant=reject_constant)


_DEFAULT_HEIGHT_M = 12.0  # of buildings


def read_visibility(
    path: Path, frames: Sequence[int], agents: Sequence[int], ids: Ints, start: Ints
) -> NDArray[np.int32]:
    """(N, A) lidar returns of each truth row at each agent, from `visibility.jsonl`.

    ids (N,) and start (F + 1,): the truth rows. Objects that are not listed have no returns.
    """
    points = np.zeros((len(ids), len(agents)), np.int32)
    for place, frame, agent, data in lines_of_agents(path, frames, agents, "objects"):
        row = {int(i): k for k, i in enumerate(ids[start[frame] : start[frame + 1]], start=int(start[frame]))}
        try:
            for entry in data:
                if int(entry[0]) not in row:
                    raise ValueError(f"object {entry[0]} is not in the scene in this frame")
                if int(entry[1]) < 0:
                    raise ValueError(f"object {entry[0]} has {entry[1]} points, expected 0 or more")
                points[row[int(entry[0])], agent] = int(entry[1])
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise SceneError(f"{place}: {reason(error)}") from error
    return points


def read_buildings(path: Path, scene: Path | None) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (k, 2) m, and heights (B,) m, from `buildings.json`.

    The polygons are in the world frame. All have the height `building_height_m` of `scene.json`, by default 12 m.
    """
    data = _read(path)
    settings = _read(scene) if scene is not None else {}
    outlines = []
    try:
        height = float(settings.get("building_height_m", _DEFAULT_HEIGHT_M))
        for index, polygon in enumerate(data):
            outline = np.array(polygon, np.float64)
            if outline.ndim != 2 or outline.shape[1:] != (2,) or not np.isfinite(outline).all():
                raise ValueError(f"polygon {index}: expected [[x, y], ...], finite")
            if np.array_equal(outline[0], outline[-1]):
                outline = outline[:-1]
            if len(outline) < 3:
                raise ValueError(f"polygon {index} has {len(outline)} corners, expected at least 3")
            outlines.append(outline)
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error
    return tuple(outlines), np.full(len(outlines), height)
