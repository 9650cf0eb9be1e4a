"""Sequences of UrbanIng-V2X."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from mast_datasets.files import Angle, Element, Name, Point, Seconds, Size, choose_name, read_json
from mast_datasets.traffic import DataSetScene, Labels, check_times, classes_of, ground_below
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble, standing
from mast_zenoh.scenes.own_detections import read_text
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

TIMESYNC = "timesync_info.csv"
_TIME = "timestamp_ms"
_Milliseconds = Annotated[int, Meta(ge=0, le=9 * 10**12)]  # to the year 2255; more nanoseconds are no 64 bit number
_MAX_STATE_OFFSET_MS = 50  # of a vehicle's state from the time of its frame
_MAX_STEP = 1.5  # between frames, in periods
_STATE_ROW = re.compile(r"vehicle[0-9]{1,6}_state")
_LIDAR_ROW = re.compile(r"crossing[0-9]{1,6}_[0-9]{1,6}_lidar")
_STATE_FILE = re.compile(r"([0-9]{1,15})\.json")


class Files(NamedTuple):
    """Paths of a sequence: its folder, its labels, and two files about the vehicles of all sequences."""

    folder: Path
    labels: Path
    av_tracks: Path
    av_data: Path


def find_sequence(path: Path, name: str | None) -> Files:
    """The files of a sequence at `path`: the data set, or the folder of the sequence in it.

    name: of the sequence; None: the only one. Raises SceneError, and ConfigurationError for an unknown name.
    """
    if not path.is_dir():
        raise SceneError(f"{path}: no such folder")
    path = path.absolute()
    if (path / TIMESYNC).is_file():
        root, folder = path.parent.parent, path
        if name not in (None, path.name):
            raise ConfigurationError(f"{path}: sequence is {name!r}, expected {path.name!r}: the path is that sequence")
    else:
        root = path
        names = (file.parent.name for file in (root / "dataset").glob(f"*/{TIMESYNC}"))
        folder = root / "dataset" / choose_name(root / "dataset" / "*" / TIMESYNC, "sequence", names, name)
    beside = f"labels/{folder.name}.json", "labels_av_track_ids.json", "av_vehicle_data.json"
    return Files(folder, *(root / file for file in beside))


class Timesync(NamedTuple):
    """The F frames of a sequence. times_ms: of each frame; states: F file names for each vehicle; lidars: of poles."""

    times_ms: list[int]
    states: dict[str, list[str]]
    lidars: list[str]


def read_timesync(path: Path) -> Timesync:
    """The frames in timesync_info.csv: a row for each sensor, a column for each frame, after a column of row names."""
    try:
        table = list(csv.reader(read_text(path).splitlines(), strict=True))
    except csv.Error as error:
        raise SceneError(f"{path}: not a table of comma-separated values: {error}") from error
    rows: dict[str, list[str]] = {}
    for number, row in enumerate(table[1:], start=2):
        if not row:
            continue
        if len(row) != len(table[0]):
            raise SceneError(f"{path}: line {number}: found {len(row)} cells, expected {len(table[0])}")
        if row[0] in rows:
            raise SceneError(f"{path}: line {number}: found {row[0]!r} again, expected each row once")
        rows[row[0]] = row[1:]
    if _TIME not in rows:
        raise SceneError(f"{path}: found no row {_TIME}{nearest(_TIME, list(rows))}")
    if not rows[_TIME]:
        raise SceneError(f"{path}: found no frames, expected at least one")
    cells = enumerate(rows[_TIME])
    times = [Element(cell.strip(), path, f"row {_TIME}, frame {frame}").read(_Milliseconds) for frame, cell in cells]
    times_ns = np.array(times, np.int64) * 1_000_000
    period_s = float(np.median(np.diff(times_ns))) / 1e9 if len(times) > 1 else 0.0
    check_times(f"{path}: row {_TIME}", range(len(times)), times_ns, _MAX_STEP * period_s)
    states = {name.removesuffix("_state"): rows[name] for name in sorted(rows) if _STATE_ROW.fullmatch(name)}
    if not states:
        raise SceneError(f"{path}: found no row vehicle<number>_state, expected at least one vehicle")
    return Timesync(times, states, sorted(filter(_LIDAR_ROW.fullmatch, rows)))


def read_states(folder: Path, vehicle: str, timesync: Timesync) -> tuple[Floats, Floats]:
    """Positions (F, 3) m and rotations (F, 3, 3) of a vehicle's body in the global frame, from gTv."""
    poses = []
    for frame, (cell, time) in enumerate(zip(timesync.states[vehicle], timesync.times_ms, strict=True)):
        match = _STATE_FILE.fullmatch(cell.strip())
        if match is None or abs(int(match[1]) - time) > _MAX_STATE_OFFSET_MS:
            expected = f"a file name <milliseconds>.json, with a time within {_MAX_STATE_OFFSET_MS} ms of {time}"
            place = f"{folder / TIMESYNC}: row {vehicle}_state, frame {frame}"
            raise SceneError(f"{place}: found {cell[:80]!r}, expected {expected}")
        poses.append(read_json(folder / f"{vehicle}_state" / match[0])["gTv"].rigid())
    position, rotation = map(np.array, zip(*poses, strict=True))
    return position, rotation


def read_vehicle_lidar(path: Path, vehicle: str) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a vehicle's lidar in its body, from vTl in calibration.json."""
    calibration = read_json(path)
    names = [name for name, _ in calibration.members() if name.startswith(f"{vehicle}_") and name.endswith("_lidar")]
    if len(names) != 1:
        raise SceneError(f"{path}: found {len(names)} sensors {vehicle}_…_lidar, expected one")
    return calibration[names[0]]["extrinsics"]["vTl"].rigid()


def read_pole_lidar(path: Path, name: str) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a pole's lidar in the global frame, from gTl in calibration.json."""
    return read_json(path)[name]["extrinsics"]["gTl"].rigid()


def read_av_tracks(files: Files, vehicles: list[str]) -> dict[str, str]:
    """The tracks that are vehicles with a lidar, by vehicle; without those that have none."""
    sequence = read_json(files.av_tracks)[files.folder.name]
    named = {vehicle: sequence.get(vehicle) for vehicle in vehicles}
    tracks = {vehicle: str(track.read(Name)) for vehicle, track in named.items() if track}
    if len(set(tracks.values())) != len(tracks):
        sequence.fail("a different track for each vehicle")
    return tracks


def read_av_size(files: Files, vehicle: str) -> Floats | None:
    """(3,) m l w h of a vehicle with a lidar, from av_vehicle_data.json; None if it is not there."""
    data = read_json(files.av_data).get(vehicle) if files.av_data.is_file() else None
    return np.array(data["size"].read(Size)) if data else None


#: Classes by type; all others are unknown.
CLASS_OF_TYPE = classes_of(
    car="Car Van",
    truck="Truck Trailer",
    bus="Bus",
    motorcycle="Motorcycle",
    bicycle="Cyclist EScooter",
    pedestrian="Pedestrian OtherPedestrians",
)


class _Labelled(Struct):
    """A track in a file of labels; dimensions: of each time, or one for all."""

    track_id: Name
    object_type: str
    timestamps: list[Seconds]
    positions: list[Point]
    orientations: list[Angle]
    dimensions: list[Size]


class Track(NamedTuple):
    """A track: where it is in its file, its n labels, the row of the frame of each, and its size m in each."""

    element: Element
    labels: _Labelled
    frames: list[int]
    sizes: list[tuple[float, float, float]]

    @property
    def class_id(self) -> int:
        """Index into CLASSES."""
        return CLASS_OF_TYPE.get(self.labels.object_type, CLASS_INDEX["unknown"])


def read_tracks(path: Path, times_ms: list[int]) -> dict[str, Track]:
    """The tracks in labels/<sequence>.json by name.

    times_ms: of the scene's frames; a label at another time is refused. Raises SceneError.
    """
    frame_at = {time: row for row, time in enumerate(times_ms)}
    tracks: dict[str, Track] = {}
    for element in read_json(path)["tracks"].elements():
        labels: _Labelled = element.read(_Labelled)
        if str(labels.track_id) in tracks:
            element["track_id"].fail("an id that no other track has")
        tracks[str(labels.track_id)] = _track(element, labels, frame_at)
    return tracks


def _track(element: Element, labels: _Labelled, frame_at: Mapping[int, int]) -> Track:
    n, frames = len(labels.timestamps), list[int]()
    for row, time in enumerate(labels.timestamps):
        frame = frame_at.get(round(time * 1000), -1)
        if frame <= (frames[-1] if frames else -1):
            reason = "the time of a frame in timesync_info.csv, s" if frame < 0 else "a time after the one before"
            element["timestamps"].elements()[row].fail(reason)
        frames.append(frame)
    sizes = labels.dimensions * n if len(labels.dimensions) == 1 else labels.dimensions
    for name, values in (("positions", labels.positions), ("dimensions", sizes), ("orientations", labels.orientations)):
        if len(values) != n:
            element[name].fail(f"a list of {n}")
    return Track(element, labels, frames, sizes)


#: Models of the lidars, whose channels and angles are not in the files.
_CAR_LIDAR = LidarSensor(elevation_min_deg=-25.0, elevation_max_deg=15.0)
_POLE_LIDAR = LidarSensor(mount_position=np.zeros(3), elevation_min_deg=-45.0, elevation_max_deg=45.0, channels=128)
#: l w h of a car with neither a label nor an entry in av_vehicle_data.json.
_CAR_SIZE = np.array([4.8, 1.9, 1.7])
_MAX_LABEL_ERROR_M = 2.0  # between the label of a car and its own state


@dataclass(kw_only=True, eq=False)
class UrbanIngV2X(DataSetScene):
    """A sequence of UrbanIng-V2X: one or two cars and the lidars of poles at a crossing.

    path:             the folder of the data set, or `dataset/<sequence>` in it
    n_infrastructure: number of pole lidars to use, the first ones by name; None: all
    sequence:         name of the sequence; None: the only one

    The ego is the first vehicle; each lidar on a pole is an agent. The world is the crossing's global frame, shifted
    so that its origin is on the ground below the ego's first position. All agents see by ray casting against the other
    boxes: the labels do not tell who saw an object, and buildings are not read. See docs/how-to-data-sets.md.
    """

    short_name = "urbaning"
    files = (("labels_av_track_ids.json",), ("timesync_info.csv", "calibration.json"))

    sequence: str | None = None

    def inputs(self) -> Sequence[Path]:
        """The sequence's folder and the files about it."""
        return find_sequence(self.root, self.sequence)

    def record(self, seed: int, frames: int | None) -> Recording:
        files = find_sequence(self.root, self.sequence)
        timesync = read_timesync(files.folder / TIMESYNC)
        vehicles, lidars = self.playing(list(timesync.states), timesync.lidars, "lidars on poles")
        poses = {name: read_states(files.folder, name, timesync) for name in timesync.states}
        own_tracks = read_av_tracks(files, list(poses))
        boxes, objects = _boxes(files, read_tracks(files.labels, timesync.times_ms), poses, own_tracks)
        origin, boxes = ground_below(boxes, objects[vehicles[0]], poses[vehicles[0]][0])
        calibration = files.folder / "calibration.json"
        paths = []
        for k, name in enumerate(vehicles):
            (position, rotation), own = poses[name], objects[name]
            underside = np.array([0.0, 0.0, -boxes.size[boxes.rows_of(own)[0], 2] / 2])
            mount, turn = read_vehicle_lidar(calibration, name)
            sensor = replace(_CAR_LIDAR, mount_position=mount - underside, mount_rotation=turn)
            camera = Camera(mount_position=mount - underside)
            # The origin of a car's body is the middle of its box, that of an agent the middle of its underside.
            agent = SceneAgent("ego" if k == 0 else f"mobile_{k}", "mobile", own, sensor, camera)
            paths.append(AgentPath(agent, position - origin + rotation @ underside, rotation))
        for k, name in enumerate(lidars, start=1):
            position, rotation = read_pole_lidar(calibration, name)
            paths.append(standing(f"infra_{k}", _POLE_LIDAR, position - origin, rotation, len(timesync.times_ms)))
        times = np.array(timesync.times_ms, np.int64) * 1_000_000
        return assemble(files.folder.name, times, boxes, paths, self.detector, seed=seed, frames=frames)


def _boxes(
    files: Files, tracks: dict[str, Track], poses: dict[str, tuple[Floats, Floats]], own_tracks: dict[str, str]
) -> tuple[SceneBoxes, dict[str, int]]:
    """All boxes in the global frame, and the object ids of the vehicles with a lidar.

    Such a vehicle has a box in every frame, from its own state, in place of its labels.
    """
    labels = Labels(files.labels)
    for name, track in tracks.items():
        columns = zip(track.frames, track.labels.positions, track.sizes, track.labels.orientations, strict=True)
        for frame, place, size, yaw in columns if name not in own_tracks.values() else ():
            labels.add(frame, name, np.array(place), np.array(size), yaw, track.class_id)
    all_boxes, ids = labels.boxes(own_tracks.values())
    unused = max(ids.values(), default=0) + 1
    parts, objects = [all_boxes], {}
    for k, (vehicle, (position, rotation)) in enumerate(poses.items()):
        name = own_tracks.get(vehicle, "")
        objects[vehicle] = ids[name] if name else unused + k
        own_size, class_id = read_av_size(files, vehicle), CLASS_INDEX["car"]
        if name in tracks and tracks[name].frames:
            track = tracks[name]
            expected = position[track.frames]
            error = np.linalg.norm(np.array(track.labels.positions) - expected, axis=1)
            if error.max() > _MAX_LABEL_ERROR_M:
                track.element["positions"].elements()[row := int(error.argmax())].fail(
                    f"a position within {_MAX_LABEL_ERROR_M:g} m of {vehicle} in its state, "
                    f"{np.round(expected[row], 2).tolist()}"
                )
            own_size, class_id = np.array(track.sizes[0]), track.class_id
        own_size = _CAR_SIZE if own_size is None else own_size
        parts.append(SceneBoxes.throughout(objects[vehicle], position, own_size, heading(rotation), class_id))
    return SceneBoxes.concatenate(parts), objects
