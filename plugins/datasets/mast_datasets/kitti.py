"""Sequences of the KITTI tracking benchmark.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from mast_datasets.files import Angle, Coordinate, Count, Element, Side, choose_name, orthonormal, read_lines
from mast_datasets.point_files import PointFiles, read_bin
from mast_datasets.traffic import TrafficScene, boxes_of, choose_frames, classes_of, listed_returns
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

#: Limit on a file, bytes, and on a calibration.
_MAX_BYTES, _MAX_CALIBRATION_BYTES = 100_000_000, 1_000_000
_EARTH_RADIUS_M = 6378137.0
_OXTS_COLUMNS = 30
#: Columns of a label; a score may follow.
_COLUMNS = (
    *("frame", "track", "type", "truncated", "occluded", "alpha", "left", "top", "right", "bottom"),
    *("height", "width", "length", "x", "y", "z", "rotation_y"),
)
CLASS_OF_TYPE = classes_of(
    car="Car Van",
    truck="Truck",
    pedestrian="Pedestrian Person Person_sitting",
    bicycle="Cyclist",
    unknown="Tram Misc",
)
_NO_OBJECT = "DontCare"


class CameraLabels(NamedTuple):
    """N labelled boxes in the axes of the rectified camera: x right, y down, z ahead.

    boxes:    their positions are middles of undersides, their yaws are about the downward axis; at 0 an object faces
              right
    occluded: (N,) 0 visible, 1 partly, 2 largely occluded, 3 unknown
    """

    boxes: SceneBoxes
    occluded: Ints


class Calibration(NamedTuple):
    """Rotation (3, 3) and position (3,) m of the rectified camera and of the lidar in the frame of the IMU."""

    camera: tuple[Floats, Floats]
    lidar: tuple[Floats, Floats]


_Degrees = Annotated[float, Meta(ge=-180, le=180)]
_Radians = Annotated[float, Meta(ge=-7, le=7)]  # larger ones would be degrees
#: Latitude, longitude, altitude, roll, pitch and yaw.
_Pose = tuple[Annotated[float, Meta(ge=-89, le=89)], _Degrees, Coordinate, _Radians, _Radians, _Radians]


class _Label(Struct):
    frame: Count
    track: Count
    type: Literal[tuple(CLASS_OF_TYPE)]  # type: ignore[valid-type]  # they are known when it runs
    occluded: Annotated[int, Meta(ge=-1, le=3)]
    height: Side
    width: Side
    length: Side
    x: Coordinate
    y: Coordinate
    z: Coordinate
    rotation_y: Angle


def read_labels(path: Path, frames: int) -> CameraLabels:
    """The labels of a sequence with so many frames, without regions that are not annotated (DontCare)."""
    rows: dict[tuple[int, int], _Label] = {}
    for number, fields in _rows(path):
        if len(fields) not in (len(_COLUMNS), len(_COLUMNS) + 1):
            expected = f"expected {len(_COLUMNS)}, or one more: a score"
            raise SceneError(f"{path}: line {number}: found {len(fields)} values, {expected}")
        if fields[2] != _NO_OBJECT:
            row: _Label = Element(dict(zip(_COLUMNS, fields, strict=False)), path, f"line {number}").read(_Label)
            if row.frame >= frames or rows.setdefault((row.frame, row.track), row) is not row:
                Element(row.frame, path, f"line {number}: frame").fail(f"0 to {frames - 1}, and every track once in it")
    boxes = []
    for each in rows.values():
        place, size = (each.x, each.y, each.z), (each.length, each.width, each.height)
        boxes.append((each.frame, each.track, place, size, each.rotation_y, CLASS_OF_TYPE[each.type]))
    return CameraLabels(boxes_of(boxes), np.array([each.occluded for each in rows.values()], np.int64))


def read_calibration(path: Path) -> Calibration:
    """Where the camera and the lidar are. Raises SceneError with file, line and name of the matrix."""
    values: dict[str, Element] = {}
    for number, fields in _rows(path, _MAX_CALIBRATION_BYTES):
        name = fields[0].rstrip(":")
        if name in values:
            raise SceneError(f"{path}: line {number}: found {name} twice, expected it once")
        values[name] = Element(fields[1:], path, f"line {number}: {name}")
    rectification, _ = _matrix(path, values, "R_rect", 3)
    to_camera, camera_shift = _matrix(path, values, "Tr_velo_cam", 4)
    to_lidar, lidar_shift = _matrix(path, values, "Tr_imu_velo", 4)
    lidar = to_lidar.T, -to_lidar.T @ lidar_shift
    camera_in_lidar = -to_camera.T @ camera_shift
    camera = lidar[0] @ to_camera.T @ rectification.T, lidar[0] @ camera_in_lidar + lidar[1]
    return Calibration(camera, lidar)


def _matrix(path: Path, values: dict[str, Element], name: str, columns: int) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and last column (3,) of a matrix of three rows."""
    if name not in values:
        raise SceneError(f"{path}: found no matrix {name}, expected one")
    listed = values[name]
    numbers = listed.read(Annotated[list[Coordinate], Meta(min_length=3 * columns, max_length=3 * columns)])
    matrix = np.array(numbers).reshape(3, columns)
    return orthonormal(matrix[:, :3], listed), matrix[:, -1] if columns == 4 else np.zeros(3)


def read_poses(path: Path) -> tuple[Floats, Floats]:
    """Position (F, 3) m, x east, y north, z up, from the first one, and active rotation (F, 3, 3) of the IMU.

    Positions are in the Mercator projection, scaled to metres at the first latitude, as in KITTI's development kit.
    """
    rows: list[tuple[float, ...]] = []
    for number, fields in _rows(path):
        if number != len(rows) + 1:  # the number of a line is that of its frame
            raise SceneError(f"{path}: line {len(rows) + 1}: found an empty line, expected the pose of a frame")
        if len(fields) != _OXTS_COLUMNS:
            raise SceneError(f"{path}: line {number}: found {len(fields)} values, expected {_OXTS_COLUMNS}")
        rows.append(Element(fields[:6], path, f"line {number}").read(_Pose))
    if not rows:
        raise SceneError(f"{path}: found no line, expected one for each frame")
    latitude, longitude, altitude, roll, pitch, yaw = np.array(rows).T
    scale = np.cos(np.radians(latitude[0])) * _EARTH_RADIUS_M
    north = scale * np.log(np.tan(np.radians(90.0 + latitude) / 2))
    position = np.stack([scale * np.radians(longitude), north, altitude], axis=1)
    return position - position[0], _rotations(roll, pitch, yaw)


def _rotations(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """(F, 3, 3) active: about x by roll, then y by pitch, then z by yaw."""
    x, y, z = np.tile(np.eye(3), (3, len(roll), 1, 1))
    for matrix, angle, (i, j) in ((x, roll, (1, 2)), (y, pitch, (2, 0)), (z, yaw, (0, 1))):
        matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
        matrix[:, j, i], matrix[:, i, j] = np.sin(angle), -np.sin(angle)
    return np.asarray(z @ y @ x)


def _rows(path: Path, max_bytes: int = _MAX_BYTES) -> Iterator[tuple[int, list[str]]]:
    """Number and values of each line that is not empty."""
    for number, line in enumerate(read_lines(path, max_bytes), start=1):
        if fields := line.split():
            yield number, fields


_PERIOD_NS = 100_000_000  # the benchmark has no times; its sensors run at 10 Hz
_FILES = ("label_02", "calib", "oxts")
_SCANS = "velodyne"
_MAX_OCCLUSION = 1  # partly occluded; more than that is left to ray casting

#: The recording car, a VW Passat (B6) estate: approximate size, and where its middle is ahead of the IMU.
_EGO_SIZE = np.array([4.77, 1.82, 1.52])
_EGO_AHEAD_M = 1.3
_LIDAR_HEIGHT_M = 1.73  # of the lidar above the ground
_EGO_LIDAR = LidarSensor(elevation_min_deg=-24.8, elevation_max_deg=2.0, max_range_m=120.0)


@dataclass(kw_only=True, eq=False)
class KittiTracking(PointFiles, TrafficScene):
    """A sequence of the KITTI tracking benchmark: a real car in real traffic, to which virtual agents are added.

    path:             the folder with label_02, calib and oxts, such as "training"
    sequence:         name of the sequence, such as "0004"; None: the only one
    first_frame:      of the sequence that is used
    last_frame:       of the sequence that is used, itself included; None: the last
    recorded_points:  whether the ego's points, of velodyne, are read: a scenario with `points` detects objects in them

    Labels are in the axes of the rectified camera (x right, y down, z ahead), at the middle of the underside, with the
    rotation about the downward axis ("readme" of the tracking development kit). They are converted by the calibration
    to the IMU, and by its latitude, longitude, altitude and attitude to a world with x east, y north, z up. The world's
    origin is on the ground below the IMU in the first frame used. Objects are labelled only while the front camera
    sees them; there is nothing elsewhere. The ego sees objects that are labelled as visible or partly occluded, with at
    least 5 returns; ray casting decides for the others, and for the other agents.
    """

    short_name = "kitti"
    files = (("label_02/*.txt", "oxts/*.txt"),)

    sequence: str | None = None
    first_frame: int = 0
    last_frame: int | None = None

    def inputs(self) -> Sequence[Path]:
        """The folders of labels, calibrations and positions, and of scans."""
        return tuple(self.root / name for name in (*_FILES, _SCANS)[: None if self.recorded_points else -1])

    def record(self, seed: int, frames: int | None) -> Recording:
        labels_file, calibration_file, poses_file = self._find()
        position, rotation = read_poses(poses_file)
        labels = read_labels(labels_file, len(position))
        calibration = read_calibration(calibration_file)
        rows = choose_frames(poses_file, range(len(position)), self.first_frame, self.last_frame)
        window, count = slice(rows[0], rows[-1] + 1), len(rows)
        ground = calibration.lidar[1][2] - _LIDAR_HEIGHT_M  # z in the frame of the IMU
        position = position[window] - position[window.start] - [0.0, 0.0, ground]
        rotation = rotation[window]
        boxes, occluded = _boxes(labels, calibration, position, rotation, window, ground)
        camera = Camera(mount_position=calibration.camera[1])
        turn, mount = calibration.lidar
        lidar = replace(_EGO_LIDAR, mount_position=mount, mount_rotation=turn)
        agent = SceneAgent("ego", "mobile", 0, lidar, camera)
        ego = AgentPath(agent, position, rotation, ground=position[:, 2] + ground)
        visible = (occluded >= 0) & (occluded <= _MAX_OCCLUSION)
        ego = replace(ego, points=listed_returns(boxes, ego, visible, ~visible, frames))
        paths, times_ns = self.agents(boxes, ego, labels_file), np.arange(count) * _PERIOD_NS
        name = f"kitti-{labels_file.stem}"
        recording = assemble(name, times_ns, boxes, paths, self.detector, seed=seed, frames=frames)
        folder = self.root / _SCANS / labels_file.stem
        files = (folder / f"{window.start + frame:06d}.bin" for frame in range(count))
        return self.with_points(recording, folder, files, read=read_bin)

    def _find(self) -> list[Path]:
        """Files of labels, calibration and positions of the sequence."""
        folder = self.root / _FILES[0]
        if not folder.is_dir():
            raise SceneError(f"{self.root}: found no folder {_FILES[0]}, expected {', '.join(_FILES)} in it")
        sequence = choose_name(folder, "sequence", (file.stem for file in folder.glob("*.txt")), self.sequence)
        return [self.root / kind / f"{sequence}.txt" for kind in _FILES]


def _boxes(
    labels: CameraLabels, calibration: Calibration, position: Floats, rotation: Floats, window: slice, ground: float
) -> tuple[SceneBoxes, NDArray[np.int64]]:
    """The ego's boxes, then the labelled ones, in the world; and how occluded each is (3: unknown)."""
    frames = len(position)
    keep = (labels.boxes.frame >= window.start) & (labels.boxes.frame < window.stop)
    listed = labels.boxes.select(keep)
    frame, angle = listed.frame - window.start, listed.yaw
    middle = listed.position - np.stack([0 * angle, listed.size[:, 2] / 2, 0 * angle], axis=1)
    ahead = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)
    to_imu, origin = calibration.camera
    to_world = rotation[frame]
    centre = np.einsum("nij,nj->ni", to_world, middle @ to_imu.T + origin) + position[frame]
    direction = np.einsum("nij,nj->ni", to_world, ahead @ to_imu.T)
    own = np.array([_EGO_AHEAD_M, calibration.lidar[1][1], ground + _EGO_SIZE[2] / 2])
    ego = SceneBoxes.throughout(0, position + rotation @ own, _EGO_SIZE, heading(rotation), CLASS_INDEX["car"])
    yaw = np.arctan2(direction[:, 1], direction[:, 0])
    others = replace(listed, frame=frame, id=listed.id + 1, position=centre, yaw=yaw)
    return SceneBoxes.concatenate([ego, others]), np.concatenate([np.full(frames, 3), labels.occluded[keep]])
