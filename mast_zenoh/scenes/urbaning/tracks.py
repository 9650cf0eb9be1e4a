"""Reads the labels of an UrbanIng-V2X sequence: tracks in the crossing's global frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.scenes.files.elements import Element, read_json
from mast_zenoh.scenes.making.labels import Labels, read_point, read_size

_MAX_TRACKS = 100_000
_MAX_ANGLE = 1e4  # rad
_MAX_TIME_ERROR_MS = 1

#: Classes by type; all others are unknown.
_TYPES = {
    "car": ("Car", "Van"),
    "truck": ("Truck", "Trailer"),
    "bus": ("Bus",),
    "motorcycle": ("Motorcycle",),
    "bicycle": ("Cyclist", "EScooter"),
    "pedestrian": ("Pedestrian", "OtherPedestrians"),
}
CLASS_OF_TYPE = {kind: CLASS_INDEX[name] for name, kinds in _TYPES.items() for kind in kinds}


@dataclass(frozen=True, eq=False)
class Track:
    """A track with n boxes.

    frame: (n,) rows of the scene's frames;  position: (n, 3) m, middle;  size: (n, 3) m l w h;  yaw: (n,) rad
    element: where it is, for messages
    """

    name: str
    class_id: int
    frame: Ints
    position: Floats
    size: Floats
    yaw: Floats
    element: Element


def read_tracks(path: Path, times_ms: list[int]) -> dict[str, Track]:
    """The tracks in labels/<sequence>.json by name.

    times_ms: of the scene's frames; a label at another time is refused. Raises SceneError.
    """
    frame_at = {time + error: row for row, time in enumerate(times_ms) for error in _errors(times_ms)}
    listed = read_json(path)["tracks"].elements()
    if len(listed) > _MAX_TRACKS:
        Element(len(listed), path, "tracks").fail(f"at most {_MAX_TRACKS} tracks")
    tracks: dict[str, Track] = {}
    for element in listed:
        track = _track(element, frame_at)
        if track.name in tracks:
            element["track_id"].fail("an id that no other track has")
        tracks[track.name] = track
    return tracks


def add_tracks(tracks: Mapping[str, Track], labels: Labels) -> None:
    """Add the boxes of all tracks to `labels`."""
    for name, track in tracks.items():
        for row in range(len(track.frame)):
            labels.add(
                int(track.frame[row]), name, track.position[row], track.size[row], float(track.yaw[row]), track.class_id
            )


def _errors(times_ms: list[int]) -> range:
    """The errors of a time, ms, that are less than half a period."""
    period = min((later - earlier for earlier, later in pairwise(times_ms)), default=100)
    error = min(_MAX_TIME_ERROR_MS, (period - 1) // 2)
    return range(-error, error + 1)


def _track(element: Element, frame_at: Mapping[int, int]) -> Track:
    name = element["track_id"]
    frames = [_frame(time, frame_at) for time in element["timestamps"].elements()]
    for row in range(1, len(frames)):
        if frames[row] <= frames[row - 1]:
            element["timestamps"].elements()[row].fail("a time after the one before")
    n = len(frames)
    dimensions = element["dimensions"]
    single = isinstance(dimensions.value, list) and len(dimensions.value) == 1
    sizes = _column(dimensions, 1 if single else n, read_size, 3)
    return Track(
        name.text() if isinstance(name.value, str) else str(name.integer(0)),
        CLASS_OF_TYPE.get(element["object_type"].text(), CLASS_INDEX["unknown"]),
        np.array(frames, np.int64),
        _column(element["positions"], n, read_point, 3),
        np.repeat(sizes, n, axis=0) if single else sizes,
        _column(element["orientations"], n, lambda value: value.number(-_MAX_ANGLE, _MAX_ANGLE), 0),
        element,
    )


def _frame(time: Element, frame_at: Mapping[int, int]) -> int:
    """The row of the frame at a time in s."""
    frame = frame_at.get(round(time.number(0, 1e10) * 1000))
    if frame is None:
        time.fail("the time of a frame in timesync_info.csv, s")
    return frame


def _column(element: Element, count: int, read: Callable[[Element], Floats | float], width: int) -> Floats:
    """(count, width) or (count,) of the values of a list, one for each time."""
    values = [read(value) for value in element.elements(count)]
    return np.array(values, np.float64).reshape((count, width) if width else (count,))
