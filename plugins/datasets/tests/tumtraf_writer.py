"""Writes a recording in the layout of TUMTraf-V2X: one OpenLABEL file for each frame."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from comparison import lidar_pose, matrix

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

CAR, POLE = "vehicle_lidar_robosense", "s110_lidar_ouster_south"
LABELS = f"labels_point_clouds/{POLE}_and_{CAR}_registered"
#: Pose of the recording's world in the base, which is far away.
BASE = matrix(np.array([691_000.0, 5_335_000.0, 480.0]), np.eye(3))
TIME_S = 1_688_625_741.0
TYPES = {"unknown": "OTHER"} | {name: name.upper() for name in CLASSES[1:]}


def write(split: Path, recording: Recording, *, car: int = 0, pole: int = 2) -> list[Path]:
    """The label files of a recording. car, pole: agents"""
    folder = split / LABELS
    folder.mkdir(parents=True)
    files = []
    for frame in range(len(recording)):
        time_s = TIME_S + int(recording.times_ns[frame]) / 1e9
        file = folder / f"{time_s:.9f}".replace(".", "_")
        files.append(file.with_name(f"{file.name}_{POLE}_and_{CAR}_registered.json"))
        content = {"openlabel": openlabel(recording, frame, time_s, car, pole)}
        files[-1].write_text(json.dumps(content))
    return files


def openlabel(recording: Recording, frame: int, time_s: float, car: int, pole: int) -> dict[str, Any]:
    pole_pose = matrix(*lidar_pose(recording, frame, pole))
    to_pole = np.linalg.inv(pole_pose)
    sensor = {"type": "sensor", "parent": "s110_base", "children": []}
    pose = (BASE @ pole_pose).tolist()
    transform = (to_pole @ matrix(*lidar_pose(recording, frame, car))).tolist()
    car_to_pole = {"src": CAR, "dst": POLE, "transform_src_to_dst": {"matrix4x4": transform}}
    properties = {"timestamp": time_s, "transforms": {f"{CAR}_to_{POLE}": car_to_pole}}
    return {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": {
            "s110_base": {"type": "geo", "parent": "", "children": [POLE]},
            POLE: sensor | {"pose_wrt_parent": {"matrix4x4": pose}},
            "s110_camera_basler_south1_8mm": sensor | {"pose_wrt_parent": {"quaternion": [0, 0, 0, 1]}},
        },
        "frames": {str(frame): {"frame_properties": properties, "objects": cuboids(recording, frame, to_pole)}},
    }


def cuboids(recording: Recording, frame: int, to_pole: np.ndarray) -> dict[str, Any]:
    """The objects of a frame in the pole's frame."""
    objects = {}
    truth = recording.truth_at(frame)
    for row, number in enumerate(truth.id):
        pose = to_pole @ matrix(truth.position[row], rotation_from_yaw(float(truth.yaw[row])))
        w, x, y, z = quaternion_from_rotation(pose[:3, :3]).tolist()
        value = [*pose[:3, 3].tolist(), x, y, z, w, *truth.size[row].tolist()]
        cuboid = {"name": "shape3D", "val": value, "attributes": {"num": [{"name": "num_points", "val": 3}]}}
        kind = TYPES[CLASSES[truth.class_id[row]]]
        objects[str(number)] = {"object_data": {"name": f"{kind}_{number}", "type": kind, "cuboid": cuboid}}
    return objects
