"""Writes a recording into the layouts of OPV2V, V2X-Real, Multi-V2X and V2V4Real."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from comparison import lidar_pose, matrix

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

FIRST = 68
#: Categories of each class, as Multi-V2X and the real data sets write them.
MULTI = dict(zip(CLASSES, ("other", "car", "truck", "bus", "motorcycle", "cycle", "pedestrian"), strict=True))
REAL = dict(zip(CLASSES, ("Scooter", "Car", "Truck", "Bus", "Motorcycle", "BicycleRider", "Pedestrian"), strict=True))


def numbers(values: Any) -> list[float]:
    return [float(value) for value in values]


def carla_place(position: Any) -> list[float]:
    return numbers([position[0], -position[1], position[2]])


def carla_pose(position: Any, rotation: Any) -> list[float]:
    """x, y, z, roll, yaw, pitch of a right-handed pose without roll."""
    yaw = -np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
    return [*carla_place(position), 0.0, float(yaw), float(np.degrees(np.arcsin(rotation[2, 0])))]


def rows(recording: Recording, frame: int, column: int | None) -> list[int]:
    """The objects that an agent hits, or all."""
    start, end = recording.truth_start[frame : frame + 2]
    return [k for k in range(start, end) if column is None or recording.points[k, column] > 0]


def carla_objects(recording: Recording, chosen: Sequence[int]) -> dict[int, dict[str, Any]]:
    """Objects whose location is the middle of their underside."""
    truth, objects = recording.truth, {}
    for k in chosen:
        half = truth.size[k] / 2
        objects[int(truth.id[k])] = {
            "angle": [0.0, float(-np.degrees(truth.yaw[k])), 0.0],
            "center": [0.0, 0.0, float(half[2])],
            "extent": numbers(half),
            "location": carla_place(truth.position[k] - [0.0, 0.0, half[2]]),
            "speed": float(np.linalg.norm(truth.velocity[k]) * 3.6),
        }
    return objects


def poses(recording: Recording, frame: int, column: int) -> dict[str, Any]:
    rotation = recording.agent_rotation[frame, column]
    return {
        "camera0": {"cords": [0.0] * 6, "extrinsic": np.eye(4).tolist(), "intrinsic": np.eye(3).tolist()},
        "ego_speed": 18.0,
        "lidar_pose": carla_pose(*lidar_pose(recording, frame, column)),
        "predicted_ego_pos": [0.0] * 6,
        "true_ego_pos": carla_pose(recording.agent_position[frame, column], rotation),
    }


def number_of(recording: Recording, column: int) -> int:
    """The number of an agent's folder in OPV2V: its object, or below 0 for a pole."""
    return recording.agents[column].object_id if recording.agents[column].kind == "mobile" else -column


def write_yaml(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.dump(content, Dumper=yaml.CDumper))


def write_opv2v(recording: Recording, folder: Path) -> Path:
    for column in range(len(recording.agents)):
        for frame in range(len(recording)):
            content = poses(recording, frame, column)
            content["vehicles"] = carla_objects(recording, rows(recording, frame, column))
            write_yaml(folder / str(number_of(recording, column)) / f"{FIRST + 2 * frame:06d}.yaml", content)
    (folder / "data_protocol.yaml").write_text("world: {fixed_delta_seconds: 0.05}\n")
    return folder


def write_v2xreal(recording: Recording, folder: Path) -> Path:
    """Cars 1, 2, … whose numbers are not those of objects; nobody says where their bodies are."""
    for column, agent in enumerate(recording.agents):
        for frame in range(len(recording)):
            content = {"lidar_pose": poses(recording, frame, column)["lidar_pose"]}
            chosen = rows(recording, frame, column)
            content["vehicles"] = carla_objects(recording, chosen)
            for k in chosen:
                category = REAL[CLASSES[recording.truth.class_id[k]]]
                content["vehicles"][int(recording.truth.id[k])]["obj_type"] = category
            number = column + 1 if agent.kind == "mobile" else -column
            write_yaml(folder / str(number) / f"{frame:06d}.yaml", content)
    return folder


def write_multiv2x(recording: Recording, folder: Path) -> Path:
    for frame in range(len(recording)):
        everything = rows(recording, frame, None)
        category = {int(recording.truth.id[k]): MULTI[CLASSES[recording.truth.class_id[k]]] for k in everything}
        objects = carla_objects(recording, everything)
        for number, each in objects.items():
            each |= {"category": category[number], "speed": [each["speed"] / 3.6, 0.0]}
        write_yaml(folder / "map" / f"{FIRST + 2 * frame:05d}.yaml", {"objects": objects})
        for column, agent in enumerate(recording.agents):
            name = f"cav_{agent.object_id}" if agent.kind == "mobile" else f"rsu_{column}"
            stem = FIRST + 2 * frame
            content = poses(recording, frame, column) | {"conn_agents": [], "objects": {}}
            write_yaml(folder / name / f"{stem:06d}.yaml", content)
            seen = {
                int(recording.truth.id[k]): int(recording.points[k, column]) for k in rows(recording, frame, column)
            }
            visible = [{"object_id": number, "visible_points": count} for number, count in seen.items()]
            write_yaml(folder / name / f"{stem:05d}_view.yaml", {"visible_objects": visible})
    return folder


def write_v2v4real(recording: Recording, folder: Path, alone: int = -1) -> Path:
    """The first two agents. Each numbers the objects itself; `ass_id` is the recording's id, -1 for `alone`."""
    truth = recording.truth
    for column in range(2):
        order = {int(number): k for k, number in enumerate(np.unique(truth.id)[:: 1 - 2 * column])}
        for frame in range(len(recording)):
            rotation, origin = recording.agent_rotation[frame, column], lidar_pose(recording, frame, column)[0]
            pose = matrix(origin, rotation)
            vehicles = {}
            for k in rows(recording, frame, column):
                yaw = truth.yaw[k] - np.arctan2(rotation[1, 0], rotation[0, 0])
                vehicles[order[int(truth.id[k])]] = {
                    "angle": [0.0, float(np.degrees(yaw)), 0.0],
                    "ass_id": -1 if truth.id[k] == alone else int(truth.id[k]),
                    "center": [0.0, 0.0, 0.0],
                    "extent": numbers(truth.size[k] / 2),
                    "location": numbers(rotation.T @ (truth.position[k] - origin)),
                    "obj_type": REAL[CLASSES[truth.class_id[k]]],
                }
            gps = [np.float64(40.0), np.float64(-83.0)]
            content = {"ego_speed": 5.0, "gps": gps, "lidar_pose": pose, "true_ego_pos": pose, "vehicles": vehicles}
            path = folder / str(column) / f"{frame:06d}.yaml"
            path.parent.mkdir(parents=True, exist_ok=True)
            # As NumPy 1 wrote it.
            path.write_text(yaml.dump(content).replace("numpy._core", "numpy.core"))
    return folder
