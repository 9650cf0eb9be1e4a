"""Reads labels, calibration and positions of the KITTI tracking benchmark.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.bounded_file import MAX_FILE_BYTES, read_lines
from mast_zenoh.scenes.files.elements import orthonormal
from mast_zenoh.scenes.files.text_elements import TextElement

_MAX_ROWS = 1_000_000
_MAX_CALIBRATION_BYTES = 1_000_000
_MAX_FRAMES = 100_000
_MAX_COORDINATE_M = 1e5
_MAX_SIZE_M = 100.0
_EARTH_RADIUS_M = 6378137.0
_OXTS_COLUMNS = 30
#: Columns of a label; a score may follow.
_COLUMNS = (
    *("frame", "track", "type", "truncated", "occluded", "alpha", "left", "top", "right", "bottom"),
    *("height", "width", "length", "x", "y", "z", "rotation_y"),
)
#: Types by class; None: not an object.
CLASS_OF_TYPE = {
    "Car": "car",
    "Van": "car",
    "Truck": "truck",
    "Pedestrian": "pedestrian",
    "Person": "pedestrian",
    "Person_sitting": "pedestrian",
    "Cyclist": "bicycle",
    "Tram": "unknown",
    "Misc": "unknown",
    "DontCare": None,
}
#: Names of the matrices, in the tracking benchmark and in the object benchmark.
_MATRICES = {
    "rectification": ("R_rect", "R0_rect"),
    "lidar_to_camera": ("Tr_velo_cam", "Tr_velo_to_cam"),
    "imu_to_lidar": ("Tr_imu_velo", "Tr_imu_to_velo"),
}


@dataclass(frozen=True, eq=False)
class Labels:
    """N labelled boxes in the axes of the rectified camera: x right, y down, z ahead.

    frame: (N,);  track: (N,);  class_id: (N,);  occluded: (N,) 0 visible, 1 partly, 2 largely occluded, 3 unknown
    size: (N, 3) m, length, width, height;  bottom: (N, 3) m, middle of the underside
    rotation_y: (N,) rad about the downward axis; at 0 the object faces right
    """

    frame: Ints
    track: Ints
    class_id: NDArray[np.uint8]
    occluded: Ints
    size: Floats
    bottom: Floats
    rotation_y: Floats


@dataclass(frozen=True, eq=False)
class Calibration:
    """Rotation (3, 3) and position (3,) m of the rectified camera and of the lidar in the frame of the IMU."""

    camera: tuple[Floats, Floats]
    lidar: tuple[Floats, Floats]


def read_labels(path: Path, frames: int) -> Labels:
    """The labels of a sequence with so many frames, without regions that are not annotated (DontCare)."""
    rows: list[tuple[float, ...]] = []
    seen: set[tuple[int, int]] = set()
    for number, fields in _rows(path):
        if len(fields) not in (len(_COLUMNS), len(_COLUMNS) + 1):
            raise SceneError(
                f"{path}: line {number}: found {len(fields)} values, expected {len(_COLUMNS)}, or one more: a score"
            )
        row = {
            name: TextElement(text, path, f"line {number}: {name}")
            for name, text in zip(_COLUMNS, fields, strict=False)
        }
        frame = row["frame"].integer(0, frames - 1)
        kind = CLASS_OF_TYPE[row["type"].text(tuple(CLASS_OF_TYPE))]
        if kind is None:
            continue
        track = row["track"].integer(0, 10**9)
        if (frame, track) in seen:
            row["track"].fail(f"every track once in frame {frame}")
        seen.add((frame, track))
        if len(rows) >= _MAX_ROWS:
            raise SceneError(f"{path}: found more than {_MAX_ROWS} labels, expected at most as many")
        sizes = [_size(row[name]) for name in ("length", "width", "height")]
        place = [row[name].number(-_MAX_COORDINATE_M, _MAX_COORDINATE_M) for name in ("x", "y", "z")]
        occluded = row["occluded"].integer(-1, 3)
        rows.append((frame, track, CLASS_INDEX[kind], occluded, *sizes, *place, row["rotation_y"].number(-1e3, 1e3)))
    table = np.array(rows, np.float64).reshape(-1, 11)
    frame_of, track_of, class_of, occlusion = table[:, :4].astype(np.int64).T
    return Labels(frame_of, track_of, class_of.astype(np.uint8), occlusion, table[:, 4:7], table[:, 7:10], table[:, 10])


def _size(value: TextElement) -> float:
    number = value.number(0.0, _MAX_SIZE_M)
    if number == 0.0:
        value.fail("a size above 0")
    return number


def read_calibration(path: Path) -> Calibration:
    """Where the camera and the lidar are. Raises SceneError with file, line and name of the matrix."""
    values: dict[str, list[TextElement]] = {}
    for number, fields in _rows(path, _MAX_CALIBRATION_BYTES):
        name = fields[0].rstrip(":")
        if name in values:
            raise SceneError(f"{path}: line {number}: found {name} twice, expected it once")
        values[name] = [TextElement(text, path, f"line {number}: {name}") for text in fields[1:]]
    rectification, _ = _matrix(path, values, "rectification", 3)
    to_camera, camera_shift = _matrix(path, values, "lidar_to_camera", 4)
    to_lidar, lidar_shift = _matrix(path, values, "imu_to_lidar", 4)
    lidar = to_lidar.T, -to_lidar.T @ lidar_shift
    camera_in_lidar = -to_camera.T @ camera_shift
    camera = lidar[0] @ to_camera.T @ rectification.T, lidar[0] @ camera_in_lidar + lidar[1]
    return Calibration(camera, lidar)


def _matrix(path: Path, values: dict[str, list[TextElement]], what: str, columns: int) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and last column (3,) of a matrix of three rows."""
    names = [name for name in _MATRICES[what] if name in values]
    if len(names) != 1:
        raise SceneError(f"{path}: found {len(names)} of {' and '.join(_MATRICES[what])}, expected one of them")
    numbers = values[names[0]]
    if len(numbers) != 3 * columns:
        raise SceneError(f"{path}: {names[0]}: found {len(numbers)} numbers, expected {3 * columns}")
    matrix = np.array([number.number(-1e4, 1e4) for number in numbers]).reshape(3, columns)
    return orthonormal(matrix[:, :3], numbers[0]), matrix[:, -1] if columns == 4 else np.zeros(3)


def read_poses(path: Path) -> tuple[Floats, Floats]:
    """Position (F, 3) m, x east, y north, z up, from the first one, and active rotation (F, 3, 3) of the IMU.

    Positions are in the Mercator projection, scaled to metres at the first latitude, as in KITTI's development kit.
    """
    rows = []
    for number, fields in _rows(path):
        if len(fields) != _OXTS_COLUMNS:
            raise SceneError(f"{path}: line {number}: found {len(fields)} values, expected {_OXTS_COLUMNS}")
        limits = (
            ("latitude", 89.0),
            ("longitude", 180.0),
            ("altitude", 1e5),
            ("roll", 7.0),
            ("pitch", 7.0),
            ("yaw", 7.0),
        )
        rows.append(
            [
                TextElement(text, path, f"line {number}: {name}").number(-limit, limit)
                for text, (name, limit) in zip(fields, limits, strict=False)
            ]
        )
        if len(rows) > _MAX_FRAMES:
            raise SceneError(f"{path}: found more than {_MAX_FRAMES} frames, expected at most as many")
    if not rows:
        raise SceneError(f"{path}: found no line, expected one for each frame")
    latitude, longitude, altitude, roll, pitch, yaw = np.array(rows).T
    scale = np.cos(np.radians(latitude[0])) * _EARTH_RADIUS_M
    position = np.stack(
        [scale * np.radians(longitude), scale * np.log(np.tan(np.radians(90.0 + latitude) / 2)), altitude], axis=1
    )
    return position - position[0], _rotations(roll, pitch, yaw)


def _rotations(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """(F, 3, 3) active: about x by roll, then y by pitch, then z by yaw."""
    zero, one = np.zeros(len(roll)), np.ones(len(roll))

    def matrices(*rows: tuple[Floats, Floats, Floats]) -> Floats:
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    x = matrices((one, zero, zero), (zero, np.cos(roll), -np.sin(roll)), (zero, np.sin(roll), np.cos(roll)))
    y = matrices((np.cos(pitch), zero, np.sin(pitch)), (zero, one, zero), (-np.sin(pitch), zero, np.cos(pitch)))
    z = matrices((np.cos(yaw), -np.sin(yaw), zero), (np.sin(yaw), np.cos(yaw), zero), (zero, zero, one))
    return z @ y @ x


def _rows(path: Path, max_bytes: int = MAX_FILE_BYTES) -> Iterator[tuple[int, list[str]]]:
    """Number and values of each line that is not empty."""
    for number, line in enumerate(read_lines(path, max_bytes), start=1):
        if fields := line.split():
            yield number, fields
