"""Writes a recording as a sequence of the KITTI tracking benchmark."""

from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading, rotation_from_yaw
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

TYPES = {"car": "Car", "truck": "Truck", "bus": "Misc", "bicycle": "Cyclist", "pedestrian": "Pedestrian"}
EARTH_RADIUS_M = 6378137.0
LATITUDE, LONGITUDE, ALTITUDE = 49.011, 8.4228, 112.8
#: As in a real sequence: the lidar is 0.8 m above the IMU, ahead of it and to its right, and slightly turned.
IMU_HEIGHT_M = 0.93
EGO_AHEAD_M = 1.3


def turned(x: float, y: float, z: float) -> np.ndarray:
    """A rotation about x, then y, then z, rad."""
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    return rotation_from_yaw(z) @ about_y @ about_x


LIDAR_IN_IMU = np.array([0.81, -0.32, 0.80])
IMU_TO_LIDAR = turned(0.002, -0.001, 0.015)
LIDAR_TO_CAMERA = turned(0.01, 0.005, -0.008) @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
CAMERA_SHIFT = np.array([-0.004, -0.076, -0.27])
RECTIFICATION = turned(-0.003, 0.009, 0.002)


def write_kitti(recording: Recording, folder: Path, sequence: str = "0004") -> Path:
    """Write label_02, calib and oxts. Objects that the ego does not see have an unknown occlusion."""
    position = imu_positions(recording)
    rotation = recording.agent_rotation[:, 0]
    scale = EARTH_RADIUS_M * np.cos(np.radians(LATITUDE))
    start = np.array([scale * np.radians(LONGITUDE), scale * np.log(np.tan(np.radians(90 + LATITUDE) / 2))])
    east, north = (position[:, :2] - position[0, :2] + start).T
    latitude = 2 * np.degrees(np.arctan(np.exp(north / scale))) - 90
    altitude = position[:, 2] - position[0, 2] + ALTITUDE
    columns = [latitude, np.degrees(east / scale), altitude, 0 * east, 0 * east, heading(rotation)]
    oxts = [" ".join([*(repr(float(v)) for v in row), *["0"] * 24]) for row in zip(*columns, strict=True)]
    write(folder / "oxts" / f"{sequence}.txt", oxts)
    write(folder / "calib" / f"{sequence}.txt", calibration())
    lines = []
    for frame in range(len(recording)):
        lines += labels(recording, frame, position[frame], rotation[frame])
    write(folder / "label_02" / f"{sequence}.txt", lines)
    return folder


def imu_positions(recording: Recording) -> np.ndarray:
    """(F, 3) m in the world of the recording."""
    offset = np.array([-EGO_AHEAD_M, -LIDAR_IN_IMU[1], IMU_HEIGHT_M])
    return recording.agent_position[:, 0] + recording.agent_rotation[:, 0] @ offset


def write(path: Path, lines: list[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def calibration() -> list[str]:
    def row(name: str, matrix: np.ndarray) -> str:
        return " ".join([name, *(repr(float(value)) for value in matrix.ravel())])

    return [
        *(row(f"P{k}:", np.eye(3, 4)) for k in range(4)),
        row("R_rect", RECTIFICATION),
        row("Tr_velo_cam", np.column_stack([LIDAR_TO_CAMERA, CAMERA_SHIFT])),
        row("Tr_imu_velo", np.column_stack([IMU_TO_LIDAR, -IMU_TO_LIDAR @ LIDAR_IN_IMU])),
    ]


def labels(recording: Recording, frame: int, position: np.ndarray, rotation: np.ndarray) -> list[str]:
    truth, points = recording.truth_at(frame), recording.points_at(frame)[:, 0]
    lines = [f"{frame} -1 DontCare -1 -1 -10 219 188 245 218 -1000 -1000 -1000 -10 -1 -1 -1"]
    to_lidar = IMU_TO_LIDAR @ rotation.T
    to_camera = RECTIFICATION @ LIDAR_TO_CAMERA @ to_lidar
    shift = RECTIFICATION @ (LIDAR_TO_CAMERA @ (-IMU_TO_LIDAR @ LIDAR_IN_IMU) + CAMERA_SHIFT)
    for row in range(len(truth)):
        if truth.id[row] == recording.agents[0].object_id:
            continue
        length, width, height = truth.size[row].tolist()
        x, y, z = (to_camera @ (truth.position[row] - position) + shift + [0, height / 2, 0]).tolist()
        ahead = to_camera @ rotation_from_yaw(float(truth.yaw[row]))[:, 0]
        angle = float(np.arctan2(-ahead[2], ahead[0]))
        occluded = 0 if points[row] >= 5 else 3
        lines.append(
            f"{frame} {truth.id[row]} {TYPES[CLASSES[truth.class_id[row]]]} 0 {occluded} -10 0 0 9 9 "
            f"{height!r} {width!r} {length!r} {x!r} {y!r} {z!r} {angle!r}"
        )
    return lines
