"""Recorded scenes in the CARLA multi-agent layout of AVstack.

Unpacks tar archives from anybody: within limits, and never outside a folder.
"""

from __future__ import annotations

import bz2
import contextlib
import gzip
import lzma
import re
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import IO, Annotated, Any, NamedTuple, cast

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mast_datasets.files import Coordinate, Count, Element, Point, Seconds, Size, closed_outline, only, read_json
from mast_datasets.point_files import PointFiles, read_bin
from mast_datasets.traffic import ABOVE_0, DataSetScene, boxes_of, check_steps
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import Detections, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.own_detections import class_of, lines_of_agents, read_json_lines
from mast_zenoh.scenes.recording import SEEN_RETURNS, Recording, SceneAgent
from mast_zenoh.scenes.recording_file import check_counts
from mast_zenoh.sensing import Camera, LidarSensor

_MAX_DEPTH = 3  # levels of subfolders that are searched for a run


class RunLayout(NamedTuple):
    """A run folder, and the folders that may hold accompanying files, nearest first."""

    run: Path
    search_folders: tuple[Path, ...]

    def accompanying_file(self, name: str) -> Path | None:
        """The nearest accompanying file of that name; None: there is none."""
        return next((folder / name for folder in self.search_folders if (folder / name).is_file()), None)

    def frames(self) -> dict[int, Path]:
        """The actors' file of every frame, in order. Raises SceneError for gaps."""
        folder = self.run / "objects"
        actors = _files(folder, "actors")
        if not actors:
            raise SceneError(f"{folder}: no file objectstate-actors-<frame>-<time>.txt")
        check_steps(folder, list(actors))
        return actors

    def sensors(self, kind: str, agent: int) -> list[str]:
        """Names of an agent's sensors of a kind with data, such as "lidar-0-3".

        kind: "lidar" or "camera"
        """
        folder = self.run / "data"
        names = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
        return [name for name in names if (parts := name.split("-"))[0] == kind and parts[-1] == str(agent)]

    def of_sensor(self, kind: str, sensor: str, frames: Sequence[int]) -> dict[int, Path]:
        """The file of a sensor in every frame. kind: "calib" or "data", which are points"""
        return _files(self.run / "data" / sensor, kind, frames)


@contextlib.contextmanager
def open_layout(path: Path, max_unpacked_mb: float, more: tuple[str, ...] = ()) -> Iterator[RunLayout]:
    """Open the layout at `path`: a run folder, a folder above one, or a tar archive.

    A folder above must contain a single run. An archive is unpacked into a temporary folder, of images and points only
    what has an ending in `more`; the folder is deleted when the context ends. Raises SceneError without exactly one
    run, or if the files exceed `max_unpacked_mb` (10^6 bytes).
    """
    if path.is_dir():
        yield find_layout(path)
        return
    if not path.is_file():
        raise SceneError(f"{path}: no such file or folder")
    with tempfile.TemporaryDirectory(prefix="mast-scene-") as folder:
        unpack(path, Path(folder), (".txt", ".json", ".jsonl", *more), int(max_unpacked_mb * 1e6))
        # Error messages name the archive, not the temporary folder.
        try:
            yield find_layout(Path(folder))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(path))) from error


def find_layout(path: Path) -> RunLayout:
    """The layout in a folder: the folder itself, or the only run below it."""
    if (path / "objects").is_dir():
        return RunLayout(path, (path, path.parent))
    patterns = ("*/" * depth + "objects" for depth in range(1, _MAX_DEPTH + 1))
    runs = [found.parent for pattern in patterns for found in sorted(path.glob(pattern)) if found.is_dir()]
    run = only(path, "run folders, which have objects/, objects_sensor/ and data/", runs)
    return RunLayout(run, (run, *(folder for folder in run.parents if folder == path or path in folder.parents)))


def _files(folder: Path, kind: str, frames: Sequence[int] | None = None) -> dict[int, Path]:
    """The files of a kind by the frames in their names, in order; None: of all frames.

    Raises SceneError with the first frame that has none, and for a name without a number.
    """
    is_of_sensor, ending = kind in ("calib", "data"), "bin" if kind == "data" else "txt"
    begin = f"{kind}-timestamp_" if is_of_sensor else f"objectstate-{kind}-"
    name = re.compile((r".*-frame_([0-9]+)\." if is_of_sensor else rf"{begin}([0-9]+)-[^-]*\.") + ending)
    files: dict[int, Path] = {}
    for path in folder.glob(f"{begin}*.{ending}"):
        match = name.fullmatch(path.name)
        if match is None:
            raise SceneError(f"{path}: found no frame number in the name, expected {begin}… with one")
        files[int(match[1])] = path
    for frame in frames or ():
        if frame not in files:
            raise SceneError(f"{folder}: no {kind} file for frame {frame}")
    return {frame: files[frame] for frame in (sorted(files) if frames is None else frames)}


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
            bounded = _BoundedContent(content, path, max_bytes + _MAX_RATIO * path.stat().st_size)
            archive: Any = tarfile.open(fileobj=cast("IO[bytes]", bounded), mode="r:")  # noqa: SIM115 (it holds nothing)
            for count, member in enumerate(iter(archive.next, None), start=1):
                if count > MAX_MEMBERS:
                    raise SceneError(f"{path}: the archive exceeds the limit of {MAX_MEMBERS:,} files and folders")
                if member.name.endswith(suffixes) and not member.isdir():
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
                archive.members.clear()  # they need memory
                archive.pax_headers.clear()
                bounded.budget = _MAX_HEADER
    except _READ_ERRORS as error:
        raise SceneError(f"{path}: cannot be unpacked: {error}") from error


def _decompressed(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(1 << 16)
    opener = next((opener for magic, opener in _COMPRESSIONS.items() if start.startswith(magic)), Path.open)
    if opener is lzma.open:
        lzma.LZMADecompressor(memlimit=_MAX_XZ_MEMORY).decompress(start, 1)
    return cast("IO[bytes]", opener(path, "rb"))


class _BoundedContent:
    """The file that tarfile reads; `budget` is the number of bytes it may still read.

    Seeking unpacks what is skipped, up to `end` bytes from the start.
    """

    def __init__(self, content: IO[bytes], path: Path, end: int) -> None:
        self._content, self._path, self._end = content, path, end
        self.budget = _MAX_HEADER
        self.tell = content.tell

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


def _mb(size: int) -> str:
    return f"{size / 1e6:,.6g} MB"


#: Values of `occlusion` of an object that a sensor does not see: invalid and complete. 0, 1 and 2 mean none, partial
#: and most, 99 means unknown.
_HIDDEN = (-1, 3)
_Fraction = Annotated[float, Meta(ge=0, le=1)]
_Pixels = Annotated[list[Annotated[int, Meta(ge=0, le=10**6)]], Meta(min_length=2)]
_Focal = Annotated[list[Annotated[list[Coordinate], Meta(min_length=1)]], Meta(min_length=1)]


class ObjectState(NamedTuple):
    """One object or agent in the world.

    class_id: index into CLASSES
    position: (3,) m of its reference point; rotation: (3, 3) active, body to world
    velocity: (3,) m/s; None: not stored
    centre: (3,) m of its box; size: (3,) m l w h; yaw: rad of the box; all None without a box (a pole)
    """

    id: int
    class_id: int
    position: Floats
    rotation: Floats
    velocity: Floats | None
    centre: Floats | None
    size: Floats | None
    yaw: float | None


def read_seen(path: Path, frame: int) -> dict[int, float]:
    """Ids in a file of `objects_sensor/` with visible fractions (1 if they are not stored).

    Completely occluded objects are left out.
    """
    seen: dict[int, float] = {}
    for state in _container(path, frame)[1]:
        fraction = state.get("visible_fraction")
        share = state["occlusion"].read(int) not in _HIDDEN if fraction is None else fraction.read(_Fraction)
        if share > 0.0:
            seen[state["ID"].read(int)] = float(share)
    return seen


def _object_state(data: Element) -> ObjectState:
    position, rotation, velocity = _point(data, "position"), _rotation(data), None
    if data.get("velocity") is not None:
        vector, frame = _referenced(data, "velocity")
        velocity = frame[1] @ np.array(vector["x"].read(Point))
    centre = size = yaw = None
    if data.get("box") is not None:
        box = _parsed(data["box"])["box3d"]
        height, width, length = box["hwl"].read(Size)
        turn = _rotation(box)
        bottom = box["where_is_t"].text(("bottom", "center")) == "bottom"
        centre = _point(box, "position") + (turn[:, 2] * height / 2 if bottom else 0.0)
        size, yaw = np.array([length, width, height]), float(heading(turn))
    class_id = class_of(data["obj_type"].text())
    return ObjectState(data["ID"].read(int), class_id, position, rotation, velocity, centre, size, yaw)


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


def _states(path: Path, frame: int) -> tuple[float, list[ObjectState]]:
    """Time s and states in a file of `objects/`."""
    time, listed = _container(path, frame)
    return time, [_object_state(data) for data in listed]


def _container(path: Path, frame: int) -> tuple[float, list[Element]]:
    """Time s, and the objects in a file of a frame."""
    container = read_json(path)["datacontainer"]
    if container["frame"].read(int) != frame:
        container["frame"].fail(f"{frame} as in the name of the file")
    listed = [_parsed(element)["objectstate"] for element in container["data"].elements()]
    return container["timestamp"].read(Seconds), listed


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
    points: Count


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


def read_buildings(path: Path | None, scene: Path | None) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (k, 2) m, and heights (B,) m, from `buildings.json`; None: there are none.

    The polygons are in the world frame. All have the height `building_height_m` of `scene.json`, by default 12 m.
    """
    height = read_json(scene).get("building_height_m") if path and scene else None
    outlines = []
    for polygon in read_json(path).elements() if path else ():
        corners = np.array(polygon.read(list[tuple[Coordinate, Coordinate]]))
        outlines.append(closed_outline(corners, polygon))
    return tuple(outlines), np.full(len(outlines), _DEFAULT_HEIGHT_M if height is None else height.read(Coordinate))


#: Object id of agent 0; agent k, if it is an object, has this plus k. The layout numbers agents and objects
#: separately, both from 0, and its original reader gives the ego this id.
EGO_ID = 99999

_MAX_MOUNT_ERROR_M = 0.05  # between a sensor's position in its calibration and according to the agent's state
_ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")
#: Converts a camera's optical axes (x right, y down, z forward) to x forward, y left, z up.
_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(kw_only=True, eq=False)
class AVstackScene(PointFiles, DataSetScene):
    """A scene in the CARLA multi-agent layout.

    With its accompanying files, see docs/how-to-scenes.md.

    path:             a run folder, a folder above a single run, or a tar archive of either
    n_infrastructure: number of static agents to use, the first ones; None: all
    n_mobile:         number of mobile agents besides the ego to use, the first ones; None: all
    replay:           use the detections in `detections.jsonl` if it exists; otherwise `detector` generates them
    detector:         the model that generates detections from lidar visibility
    max_unpacked_mb:  limit on the files unpacked from an archive, 10^6 bytes

    The first mobile agent is "ego", other ones are "mobile_k", static ones "infra_k", where k is their number in the
    files. An object's lidar returns come from `visibility.jsonl`. Without it, the objects in a lidar's object files
    are seen, with the returns that ray casting gives, scaled by their visible fraction, at least 5. For a lidar without
    object files, ray casting alone decides.
    """

    short_name = "avstack"
    files = (("objects/objectstate-*.txt",), ("*/objects/objectstate-*.txt",))

    replay: bool = True
    max_unpacked_mb: float = 1000.0

    def __post_init__(self) -> None:
        self.check(max_unpacked_mb=ABOVE_0)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or (path.is_file() and path.name.endswith(_ARCHIVES))

    def record(self, seed: int, frames: int | None) -> Recording:
        with open_layout(self.root, self.max_unpacked_mb, (".bin",) * self.recorded_points) as layout:
            return self._record(layout, layout.frames(), seed, frames)

    def _record(self, layout: RunLayout, files: dict[int, Path], seed: int, frames: int | None) -> Recording:
        numbers = list(files)
        if frames is not None:
            if not 1 <= frames <= len(numbers):
                raise ConfigurationError(f"{self.path}: {frames} frames requested, the scene has {len(numbers)}")
            numbers = numbers[:frames]
        times, actors, objects = _read_states({frame: files[frame] for frame in numbers})
        agents = self._agents(actors[0], layout.run)
        boxes, start = _boxes(objects)
        outlines, heights = read_buildings(*map(layout.accompanying_file, ("buildings.json", "scene.json")))
        paths = [
            _path(layout, numbers, number, k == 0, [each[number] for each in actors]) for k, number in enumerate(agents)
        ]
        make = partial(assemble, self.root.name, times, boxes, seed=seed, buildings=outlines, building_height=heights)
        if file := layout.accompanying_file("visibility.jsonl"):
            points = read_visibility(file, numbers, agents, boxes.id, start)
        else:
            none = Detections.empty(), np.zeros(len(times) * len(paths) + 1, np.int64), np.zeros(0, np.int64)
            points = _points(layout, boxes.id, start, numbers, agents, make(paths, none).points)
        bottoms = np.split(boxes.position[:, 2] - boxes.size[:, 2] / 2, start[1:-1])
        ground = np.array([np.median(bottom) for bottom in bottoms])
        paths = [replace(path, points=points[:, k], ground=ground) for k, path in enumerate(paths)]
        turns = np.stack([path.rotation @ path.agent.sensor.mount_rotation for path in paths], axis=1)
        file = layout.accompanying_file("detections.jsonl") if self.replay else None
        detected = read_json_lines(file, numbers, agents, turns) if file else self.detector
        recording, lidars = replace(make(paths, detected), times_ns=times), []
        if self.recorded_points:
            lidars = [layout.of_sensor("data", layout.sensors("lidar", number)[0], numbers) for number in agents]
        return self.with_points(recording, layout.run, *(files.values() for files in lidars), read=read_bin)

    def _agents(self, actors: dict[int, ObjectState], run: Path) -> list[int]:
        """Numbers of the agents: the ego, other mobile agents, then static agents."""
        mobile = [number for number, state in actors.items() if state.size is not None]
        static = [number for number, state in actors.items() if state.size is None]
        if not mobile:
            raise SceneError(f"{run / 'objects'}: no actor has a box, expected at least the ego")
        ego, *others = mobile
        check_counts(self.path, (self.n_mobile, len(others)), (self.n_infrastructure, len(static)))
        return [ego, *others[: self.n_mobile], *static[: self.n_infrastructure]]


def _read_states(
    files: dict[int, Path],
) -> tuple[Ints, list[dict[int, ObjectState]], list[dict[int, ObjectState]]]:
    """Times (F,) ns, and the actors by number and objects by id of every frame.

    The objects include actors with a box.
    """
    times: list[float] = []
    all_actors: list[dict[int, ObjectState]] = []
    all_objects: list[dict[int, ObjectState]] = []
    for frame, path in files.items():
        time, actors = _states(path, frame)
        by_number = {state.id: state for state in sorted(actors, key=lambda state: state.id)}
        others_path = path.with_name(path.name.replace("-actors-", "-npcs-"))
        others_time, others = _states(others_path, frame)
        if others_time != time:
            raise SceneError(f"{others_path}: time {others_time} s, but {time} s in {path.name}")
        if times and time <= times[-1]:
            raise SceneError(f"{path}: time {time} s is not later than {times[-1]} s in the frame before")
        if all_actors and list(by_number) != list(all_actors[0]):
            raise SceneError(f"{path}: actors {list(by_number)}, but {list(all_actors[0])} in the first frame")
        if len(by_number) != len(actors):
            raise SceneError(f"{path}: two actors have the same ID")
        objects = {state.id: state for state in others if state.size is not None}
        if len(objects) != len(others):
            raise SceneError(f"{others_path}: two objects have the same ID, or one has no box")
        objects |= {EGO_ID + number: state for number, state in by_number.items() if state.size is not None}
        times.append(time)
        all_actors.append(by_number)
        all_objects.append(dict(sorted(objects.items())))
    return np.round(np.array(times) * 1e9).astype(np.int64), all_actors, all_objects


def _boxes(objects: list[dict[int, ObjectState]]) -> tuple[SceneBoxes, Ints]:
    """The boxes of all objects by frame and id, and the row (F + 1,) with which each frame begins."""
    unknown = np.full(3, np.nan)
    rows = [
        (frame, number, each.centre, each.size, each.yaw, each.class_id, unknown if each.velocity is None else each[4])
        for frame, now in enumerate(objects)
        for number, each in now.items()
    ]
    return boxes_of(rows), np.cumsum([0, *map(len, objects)])


def _path(layout: RunLayout, numbers: list[int], number: int, is_ego: bool, states: list[ObjectState]) -> AgentPath:
    """The path of an agent with its first lidar and its first camera. states: of it in each frame"""
    mobile = states[0].size is not None
    position, rotation = np.array([each.position for each in states]), np.array([each.rotation for each in states])
    lidars = layout.sensors("lidar", number)
    if not lidars:
        raise SceneError(f"{layout.run / 'data'}: no folder lidar-<k>-{number} for agent {number}")
    files = layout.of_sensor("calib", lidars[0], numbers)
    mount_position, mount_rotation = _mount(read_json(files[numbers[0]])["calibration"], position[0], rotation[0])
    for k, path in enumerate(files.values()):
        calibrated, _ = _frame(read_json(path)["calibration"]["reference"])
        expected = position[k] + rotation[k] @ mount_position
        if np.abs(calibrated - expected).max() > _MAX_MOUNT_ERROR_M:
            raise SceneError(
                f"{path}: the lidar is at {np.round(calibrated, 2).tolist()}, expected "
                f"{np.round(expected, 2).tolist()}: its mount must not change after the first frame"
            )
    lidar = LidarSensor() if mobile else LidarSensor.infrastructure()
    lidar = replace(lidar, mount_position=mount_position, mount_rotation=mount_rotation)
    camera = Camera()
    for name in layout.sensors("camera", number)[:1]:
        read = read_json(layout.of_sensor("calib", name, numbers)[numbers[0]])["calibration"]
        height, width, *_ = read["img_shape"].read(_Pixels)
        camera_position, camera_rotation = _mount(read, position[0], rotation[0])
        camera = Camera(camera_position, camera_rotation @ _OPTICAL, width, height, read["P"].read(_Focal)[0][0])
    name = "ego" if is_ego else f"mobile_{number}" if mobile else f"infra_{number}"
    kind, own = ("mobile", EGO_ID + number) if mobile else ("static", -1)
    velocity = None if mobile else np.zeros_like(position)
    return AgentPath(SceneAgent(name, kind, own, lidar, camera), position, rotation, velocity)


def _mount(calibration: Element, position: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """A sensor's pose in its agent's frame, from both poses in the world.

    Some writers give the sensor's pose relative to the agent, others to the world: resolved, both are the same.
    """
    origin, turn = _frame(calibration["reference"])
    return rotation.T @ (origin - position), rotation.T @ turn


def _points(
    layout: RunLayout, ids: Ints, start: Ints, numbers: list[int], agents: list[int], cast_points: NDArray[np.int32]
) -> NDArray[np.int32]:
    """(N, A) lidar returns, from the lidars' object files where there are any.

    ids, start: (N,) of the boxes, and (F + 1,) row with which each frame begins; cast_points: what ray casting gives
    """
    points = cast_points.copy()
    listed: set[int] = set()
    for column, number in enumerate(agents):
        folder = layout.run / "objects_sensor" / layout.sensors("lidar", number)[0]
        if not folder.is_dir():
            continue
        points[:, column] = 0
        for k, (frame, path) in enumerate(_files(folder, "objects", numbers).items()):
            seen = read_seen(path, frame)
            listed |= seen.keys()
            for row in range(start[k], start[k + 1]):
                if (share := seen.get(int(ids[row]))) is not None:
                    points[row, column] = max(SEEN_RETURNS, round(share * int(cast_points[row, column])))
    # If a data set never lists the agents as objects, their visibility comes from ray casting.
    unlisted = (ids >= EGO_ID) & ~np.isin(ids, sorted(listed))
    points[unlisted] = cast_points[unlisted]
    return points
