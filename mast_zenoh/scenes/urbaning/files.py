"""Finds and reads the files of an UrbanIng-V2X sequence, except for its labels.

Sekaran et al.: UrbanIng-V2X, NeurIPS Datasets and Benchmarks 2025. Names of matrices: gTl turns coordinates of the
lidar (l) into those of the crossing's global frame (g); v is the body of a vehicle.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.files.elements import read_json, read_text
from mast_zenoh.scenes.files.matrices import read_pose
from mast_zenoh.scenes.making.labels import read_size

TIMESYNC = "timesync_info.csv"
_TIME = "timestamp_ms"
_MAX_FRAMES = 100_000
_MAX_TIME_MS = 9_000_000_000_000  # the year 2255; more nanoseconds are no 64 bit number
_MAX_STATE_OFFSET_MS = 50  # of a vehicle's state from the time of its frame
_MAX_STEP = 1.5  # between frames, in periods
_STATE_ROW = re.compile(r"vehicle[0-9]{1,6}_state")
_LIDAR_ROW = re.compile(r"crossing[0-9]{1,6}_[0-9]{1,6}_lidar")
_STATE_FILE = re.compile(r"([0-9]{1,15})\.json")
_MILLISECONDS = re.compile(r"[0-9]{1,15}(\.0*)?")


@dataclass(frozen=True)
class Files:
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
        folders = sorted((root / "dataset").glob(f"*/{TIMESYNC}"))
        names = [file.parent.name for file in folders]
        if name is not None and name not in names:
            raise ConfigurationError(
                f"{path}: sequence is {name!r}, expected a folder in dataset{nearest(name, names)}"
            )
        if name is None and len(names) != 1:
            raise SceneError(
                f"{path}: found {len(names)} sequences dataset/*/{TIMESYNC}, expected one, or the parameter sequence"
            )
        folder = root / "dataset" / (name or names[0])
    return Files(
        folder,
        root / "labels" / f"{folder.name}.json",
        root / "labels_av_track_ids.json",
        root / "av_vehicle_data.json",
    )


@dataclass(frozen=True)
class Timesync:
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
    if not 1 <= len(rows[_TIME]) <= _MAX_FRAMES:
        raise SceneError(f"{path}: found {len(rows[_TIME])} frames, expected 1 to {_MAX_FRAMES}")
    times = [_milliseconds(path, frame, cell) for frame, cell in enumerate(rows[_TIME])]
    _check_steps(path, times)
    states = {name.removesuffix("_state"): rows[name] for name in sorted(rows) if _STATE_ROW.fullmatch(name)}
    if not states:
        raise SceneError(f"{path}: found no row vehicle<number>_state, expected at least one vehicle")
    return Timesync(times, states, sorted(filter(_LIDAR_ROW.fullmatch, rows)))


def read_states(folder: Path, vehicle: str, timesync: Timesync) -> tuple[Floats, Floats]:
    """Positions (F, 3) m and rotations (F, 3, 3) of a vehicle's body in the global frame, from gTv."""
    poses = []
    for frame, (cell, time) in enumerate(zip(timesync.states[vehicle], timesync.times_ms, strict=True)):
        place = f"{folder / TIMESYNC}: row {vehicle}_state, frame {frame}"
        match = _STATE_FILE.fullmatch(cell.strip())
        if match is None:
            raise SceneError(f"{place}: found {cell[:80]!r}, expected a file name <milliseconds>.json")
        if abs(int(match[1]) - time) > _MAX_STATE_OFFSET_MS:
            raise SceneError(f"{place}: found {cell!r}, expected a time within {_MAX_STATE_OFFSET_MS} ms of {time}")
        poses.append(read_pose(read_json(folder / f"{vehicle}_state" / match[0])["gTv"]))
    return np.stack([position for position, _ in poses]), np.stack([rotation for _, rotation in poses])


def read_vehicle_lidar(path: Path, vehicle: str) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a vehicle's lidar in its body, from vTl in calibration.json."""
    calibration = read_json(path)
    names = [name for name, _ in calibration.members() if name.startswith(f"{vehicle}_") and name.endswith("_lidar")]
    if len(names) != 1:
        raise SceneError(f"{path}: found {len(names)} sensors {vehicle}_…_lidar, expected one")
    return read_pose(calibration[names[0]]["extrinsics"]["vTl"])


def read_pole_lidar(path: Path, name: str) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a pole's lidar in the global frame, from gTl in calibration.json."""
    return read_pose(read_json(path)[name]["extrinsics"]["gTl"])


def read_av_tracks(files: Files, vehicles: list[str]) -> dict[str, str]:
    """The tracks that are vehicles with a lidar, by vehicle; without those that have none."""
    sequence = read_json(files.av_tracks)[files.folder.name]
    tracks: dict[str, str] = {}
    for vehicle in vehicles:
        track = sequence.get(vehicle)
        if track is not None:
            tracks[vehicle] = str(track.integer(0)) if not isinstance(track.value, str) else track.text()
    if len(set(tracks.values())) != len(tracks):
        sequence.fail("a different track for each vehicle")
    return tracks


def read_av_size(files: Files, vehicle: str) -> Floats | None:
    """(3,) m l w h of a vehicle with a lidar, from av_vehicle_data.json; None if it is not there."""
    if not files.av_data.is_file():
        return None
    data = read_json(files.av_data).get(vehicle)
    return None if data is None else read_size(data["size"])


def _milliseconds(path: Path, frame: int, cell: str) -> int:
    time = int(float(cell)) if _MILLISECONDS.fullmatch(cell.strip()) else -1
    if not 0 <= time <= _MAX_TIME_MS:
        raise SceneError(
            f"{path}: row {_TIME}, frame {frame}: found {cell[:80]!r}, expected milliseconds from 0 to {_MAX_TIME_MS}"
        )
    return time


def _check_steps(path: Path, times: list[int]) -> None:
    """Raise SceneError for times that do not ascend, or that leave a frame out."""
    steps = [later - earlier for earlier, later in pairwise(times)]
    for frame, step in enumerate(steps, start=1):
        if step <= 0:
            raise SceneError(
                f"{path}: row {_TIME}, frame {frame}: found {times[frame]}, expected a time after the last"
            )
    period = float(np.median(steps)) if steps else 0.0
    for frame, step in enumerate(steps, start=1):
        if step > _MAX_STEP * period:
            raise SceneError(
                f"{path}: row {_TIME}, frame {frame}: found a step of {step} ms, expected {period:g} ms: "
                "a frame is missing"
            )
