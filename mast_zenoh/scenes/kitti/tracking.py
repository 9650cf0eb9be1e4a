"""Recorded scenes: sequences of the KITTI tracking benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.kitti.files import Calibration, Labels, read_calibration, read_labels, read_poses
from mast_zenoh.scenes.making.assembly import AgentPath, assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.recorded_traffic import agent_counts, nearest_vehicles
from mast_zenoh.scenes.making.virtual_agents import poles
from mast_zenoh.scenes.making.visibility import listed_returns
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

_DETECTOR = DetectionModel()
_PERIOD_NS = 100_000_000  # the benchmark has no times; its sensors run at 10 Hz
_FILES = ("label_02", "calib", "oxts")
_MIN_POINTS = 5
_MAX_OCCLUSION = 1  # partly occluded; more than that is left to ray casting

#: The recording car, a VW Passat (B6) estate: approximate size, and where its middle is ahead of the IMU.
_EGO_SIZE = np.array([4.77, 1.82, 1.52])
_EGO_AHEAD_M = 1.3
_LIDAR_HEIGHT_M = 1.73  # of the lidar above the ground
_EGO_LIDAR = LidarSensor(elevation_min_deg=-24.8, elevation_max_deg=2.0, max_range_m=120.0)


class KittiTracking(Scene):
    """A sequence of the KITTI tracking benchmark: a real car in real traffic, to which virtual agents are added.

    path:             the folder with label_02, calib and oxts, such as "training"
    sequence:         name of the sequence, such as "0004"; None: the only one
    first_frame:      of the sequence that is used
    last_frame:       of the sequence that is used, itself included; None: the last
    n_infrastructure: virtual poles along the ego's path, 15 m above the ground, looking 30 degrees down, 0 to 16;
                      None: 4
    n_mobile:         labelled vehicles that get a lidar on the roof, besides the ego, the nearest that are labelled in
                      every frame used; None: 0
    detector:         the model that generates detections from lidar visibility

    Labels are in the axes of the rectified camera (x right, y down, z ahead), at the middle of the underside, with the
    rotation about the downward axis ("readme" of the tracking development kit). They are converted by the calibration
    to the IMU, and by its latitude, longitude, altitude and attitude to a world with x east, y north, z up. The world's
    origin is on the ground below the IMU in the first frame used. Objects are labelled only while the front camera
    sees them; there is nothing elsewhere. The ego sees objects that are labelled as visible or partly occluded, with at
    least 5 returns; ray casting decides for the others, and for the other agents.
    """

    def __init__(
        self,
        *,
        path: str,
        sequence: str | None = None,
        first_frame: int = 0,
        last_frame: int | None = None,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        detector: Detector = _DETECTOR,
    ) -> None:
        self.counts = agent_counts("KittiTracking", n_infrastructure, n_mobile)
        if first_frame < 0 or (last_frame is not None and last_frame < first_frame):
            raise ConfigurationError(
                f"KittiTracking: first_frame, last_frame are {first_frame}, {last_frame}, expected 0 or more, ascending"
            )
        self.path = Path(path)
        self.sequence = sequence
        self.first_frame = first_frame
        self.last_frame = last_frame
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The folders of labels, calibrations and positions."""
        return tuple(self.path / name for name in _FILES)

    def record(self, seed: int, frames: int | None) -> Recording:
        labels_file, calibration_file, poses_file = self._find()
        position, rotation = read_poses(poses_file)
        labels = read_labels(labels_file, len(position))
        calibration = read_calibration(calibration_file)
        window = self._window(len(position), poses_file)
        count = window.stop - window.start
        ground = calibration.lidar[1][2] - _LIDAR_HEIGHT_M  # z in the frame of the IMU
        position = position[window] - position[window.start] - [0.0, 0.0, ground]
        rotation = rotation[window]
        boxes, occluded = _boxes(labels, calibration, position, rotation, window, ground)
        ego = AgentPath(
            SceneAgent("ego", "mobile", 0, _lidar(calibration), Camera(mount_position=calibration.camera[1])),
            position,
            rotation,
            ground=position[:, 2] + ground,
        )
        times_ns = np.arange(count) * _PERIOD_NS
        name = f"kitti-{labels_file.stem}"
        visible = (occluded >= 0) & (occluded <= _MAX_OCCLUSION)
        ego = replace(ego, points=listed_returns(boxes, ego, visible, ~visible, frames))
        n_infrastructure, n_mobile = self.counts
        others = nearest_vehicles(boxes, 0, count, n_mobile, labels_file)
        roadside = poles(boxes, position[:, :2], heading(rotation), n_infrastructure)
        paths = [ego, *others, *roadside]
        return assemble(name, times_ns, boxes, paths, self.detector, seed=seed, frames=frames)

    def _find(self) -> tuple[Path, Path, Path]:
        """Files of labels, calibration and positions of the sequence."""
        folder = self.path / _FILES[0]
        if not folder.is_dir():
            raise SceneError(f"{self.path}: found no folder {_FILES[0]}, expected {', '.join(_FILES)} in it")
        names = sorted(file.stem for file in folder.glob("*.txt"))
        known = ", ".join(names[:30]) or "none"
        if self.sequence is None and len(names) != 1:
            raise SceneError(f"{folder}: found {len(names)} sequences ({known}), expected one; choose it with sequence")
        sequence = names[0] if self.sequence is None else self.sequence
        if sequence not in names:
            raise ConfigurationError(f"{folder}: sequence is {sequence!r}, expected one of {known}")
        labels, calibration, poses = (self.path / kind / f"{sequence}.txt" for kind in _FILES)
        return labels, calibration, poses

    def _window(self, frames: int, file: Path) -> slice:
        last = frames - 1 if self.last_frame is None else self.last_frame
        if last >= frames or self.first_frame >= frames:
            raise ConfigurationError(
                f"{file}: first_frame, last_frame are {self.first_frame}, {last}, expected 0 to {frames - 1}"
            )
        return slice(self.first_frame, last + 1)


def _lidar(calibration: Calibration) -> LidarSensor:
    rotation, position = calibration.lidar
    return replace(_EGO_LIDAR, mount_position=position, mount_rotation=rotation)


def _boxes(
    labels: Labels, calibration: Calibration, position: Floats, rotation: Floats, window: slice, ground: float
) -> tuple[Boxes, NDArray[np.int64]]:
    """The ego's boxes, then the labelled ones, in the world; and how occluded each is (3: unknown)."""
    frames = len(position)
    keep = (labels.frame >= window.start) & (labels.frame < window.stop)
    frame, size, angle = labels.frame[keep] - window.start, labels.size[keep], labels.rotation_y[keep]
    middle = labels.bottom[keep] - np.stack([0 * angle, size[:, 2] / 2, 0 * angle], axis=1)
    ahead = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)
    to_imu, origin = calibration.camera
    to_world = rotation[frame]
    centre = np.einsum("nij,nj->ni", to_world, middle @ to_imu.T + origin) + position[frame]
    direction = np.einsum("nij,nj->ni", to_world, ahead @ to_imu.T)
    own = np.array([_EGO_AHEAD_M, calibration.lidar[1][1], ground + _EGO_SIZE[2] / 2])
    ego = Boxes.throughout(0, position + rotation @ own, _EGO_SIZE, heading(rotation), CLASS_INDEX["car"])
    others = Boxes(
        frame=frame,
        id=labels.track[keep] + 1,
        position=centre,
        size=size,
        yaw=np.arctan2(direction[:, 1], direction[:, 0]),
        class_id=labels.class_id[keep],
        velocity=np.full_like(centre, np.nan),
    )
    return Boxes.concatenate([ego, others]), np.concatenate([np.full(frames, 3), labels.occluded[keep]])
