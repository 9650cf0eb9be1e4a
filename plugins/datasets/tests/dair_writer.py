"""Writes a recording in the layouts of V2X-Seq-SPD, DAIR-V2X-C and RCooper."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from comparison import lidar_pose

from mast_zenoh.arrays.geometry import box_corners, rotation_from_yaw, to_local
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

#: Names of the types, by class.
DAIR_TYPES = ("Unknowns_movable", "Car", "Truck", "Bus", "Motorcyclist", "Cyclist", "Pedestrian")
SEEN = 5
START_US = 1_626_155_123_000_000
DELAY_US = 20_000  # of the pole's clock
OFFSET = np.array([0.4, -0.3])  # m, system_error_offset
#: Mount of the car's lidar on its inertial sensor, which looks to the left.
MOUNT = np.array([0.2, 0.1, 0.5]), rotation_from_yaw(-np.pi / 2)

Pose = tuple[np.ndarray, np.ndarray]


def local_yaw(yaw: float, rotation: np.ndarray) -> float:
    """The yaw about the z axis of a frame whose heading in the world is `yaw`."""
    flat = np.linalg.solve(rotation[:2, :2], [np.cos(yaw), np.sin(yaw)])
    return float(np.arctan2(flat[1], flat[0]))


def label(recording: Recording, row: int, pose: Pose | None, as_text: bool = False) -> dict[str, Any]:
    """A label of a row of the truth. pose: of the frame it is in; None: the world."""
    truth = recording.truth
    position, rotation = (np.zeros(3), np.eye(3)) if pose is None else pose
    place = to_local(truth.position[row : row + 1], position, rotation)[0].tolist()
    length, width, height = truth.size[row].tolist()
    write: Callable[[float], Any] = str if as_text else float
    return {
        "type": DAIR_TYPES[truth.class_id[row]],
        "occluded_state": 0,
        "truncated_state": 0,
        "3d_dimensions": {"h": write(height), "w": write(width), "l": write(length)},
        "3d_location": dict(zip("xyz", map(write, place), strict=True)),
        "rotation": write(local_yaw(truth.yaw[row], rotation)),
    }


def tracked(entry: dict[str, Any], name: str) -> dict[str, Any]:
    return {"token": f"token-{name}", "track_id": name} | entry


CONE = {"type": "TrafficCone", "3d_dimensions": {"h": 1, "w": 1, "l": 1}, "3d_location": {"x": 0, "y": 0, "z": 0}}


def write_json(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def transform(position: np.ndarray, rotation: np.ndarray) -> dict[str, Any]:
    return {"rotation": rotation.tolist(), "translation": position[:, None].tolist()}


def rows_seen(recording: Recording, frame: int, agents: Sequence[int]) -> list[int]:
    """Rows of the truth in a frame that one of the agents sees."""
    rows = np.arange(recording.truth_start[frame], recording.truth_start[frame + 1])
    return rows[(recording.points[rows][:, list(agents)] >= SEEN).any(axis=1)].tolist()


def vehicle_frame(frame: int) -> str:
    return f"{10 + frame:06d}"


def pole_frame(frame: int) -> str:
    return f"{50 + frame:06d}"


def write_spd(root: Path, recording: Recording, count: int, references: bool = True) -> Path:
    """The ego and the first pole in the first `count` frames as V2X-Seq-SPD.

    references: cooperative labels name the sides' tracks
    """
    pairs = []
    for frame in range(count):
        car, _ = write_sides(root, recording, frame, tracks=True)
        entries = []
        for row in rows_seen(recording, frame, (0, 1)):
            entry = tracked(label(recording, row, car), f"{recording.truth.id[row]:06d}")
            if references:
                by_car, by_pole = recording.points[row, :2] >= SEEN
                entry["veh_track_id"] = f"v{recording.truth.id[row]}" if by_car else "-1"
                entry["inf_track_id"] = f"i{recording.truth.id[row]}" if by_pole else "-1"
            entries.append(entry)
        write_json(root / "cooperative" / "label" / f"{vehicle_frame(frame)}.json", [*entries, CONE])
        pair = {"vehicle_frame": vehicle_frame(frame), "infrastructure_frame": pole_frame(frame)}
        pair |= {"vehicle_sequence": "0003", "infrastructure_sequence": "0003"}
        pairs.append(pair | {"system_error_offset": {"delta_x": OFFSET[0], "delta_y": OFFSET[1]}})
    write_json(root / "cooperative" / "data_info.json", pairs)
    write_clocks(root, recording, count, lambda name: {"frame_id": name, "sequence_id": "0003"})
    return root


def write_c(root: Path, recording: Recording, count: int) -> Path:
    """The ego and the first pole in the first `count` frames as DAIR-V2X-C: corners in the world frame, no tracks."""
    pairs = []
    for frame in range(count):
        write_sides(root, recording, frame, tracks=False)
        entries = []
        for row in rows_seen(recording, frame, (0, 1)):
            truth = recording.truth.select(slice(row, row + 1))
            corners = box_corners(truth.position, truth.size, truth.yaw)[0]
            clockwise = corners[clockwise_from_front_left(corners, truth.yaw[0], truth.position[0])]
            entries.append({"type": DAIR_TYPES[truth.class_id[0]], "world_8_points": clockwise.tolist()})
        write_json(root / "cooperative" / "label_world" / f"{vehicle_frame(frame)}.json", entries)
        pair = {"vehicle_pointcloud_path": f"vehicle-side/velodyne/{vehicle_frame(frame)}.pcd"}
        pair |= {"infrastructure_pointcloud_path": f"infrastructure-side/velodyne/{pole_frame(frame)}.pcd"}
        pair |= {"cooperative_label_path": f"cooperative/label_world/{vehicle_frame(frame)}.json"}
        pairs.append(pair | {"system_error_offset": {"delta_x": OFFSET[0], "delta_y": ""}})
    write_json(root / "cooperative" / "data_info.json", pairs)
    write_clocks(root, recording, count, lambda name: {"pointcloud_path": f"velodyne/{name}.pcd", "batch_id": "7"})
    return root


def write_sides(root: Path, recording: Recording, frame: int, tracks: bool) -> tuple[Pose, Pose]:
    """Calibration and labels of the car and of the pole in a frame; their lidars' poses."""
    car, pole = (lidar_pose(recording, frame, agent) for agent in (0, 1))
    turned = car[1] @ MOUNT[1].T
    calibration = root / "vehicle-side" / "calib"
    name = f"{vehicle_frame(frame)}.json"
    write_json(calibration / "lidar_to_novatel" / name, {"transform": transform(*MOUNT)})
    write_json(calibration / "novatel_to_world" / name, transform(car[0] - turned @ MOUNT[0], turned))
    shift = car[1] @ [*OFFSET, 0.0] if tracks else np.array([OFFSET[0], 0.0, 0.0])
    file = root / "infrastructure-side" / "calib" / "virtuallidar_to_world" / f"{pole_frame(frame)}.json"
    write_json(file, transform(pole[0] - shift, pole[1]) | {"relative_error": {"delta_x": "", "delta_y": ""}})
    for agent, pose, letter, folder, name in (
        (0, car, "v", "vehicle-side/label/lidar", vehicle_frame(frame)),
        (1, pole, "i", "infrastructure-side/label/virtuallidar", pole_frame(frame)),
    ):
        entries = []
        for row in rows_seen(recording, frame, (agent,)):
            entry = label(recording, row, pose, as_text=not tracks)
            entries.append(tracked(entry, f"{letter}{recording.truth.id[row]}") if tracks else entry)
        flat = CONE | {"type": "Car", "3d_dimensions": {"h": 0, "w": 0, "l": 0}}  # labelled in the image alone
        write_json(root / folder / f"{name}.json", [*entries, CONE, flat])
    return car, pole


def write_clocks(root: Path, recording: Recording, count: int, more: Callable[[str], dict[str, Any]]) -> None:
    for side, name_of, delay in (("vehicle-side", vehicle_frame, 0), ("infrastructure-side", pole_frame, DELAY_US)):
        infos = []
        for frame, time in enumerate(recording.times_ns[:count].tolist()):
            moment = START_US + time // 1000 + delay
            infos.append({"pointcloud_timestamp": str(moment)} | more(name_of(frame)))
        write_json(root / side / "data_info.json", infos)


def clockwise_from_front_left(corners: np.ndarray, yaw: float, middle: np.ndarray) -> list[int]:
    """Indices of corners (8, 3): the bottom, then the top, each from the front left clockwise."""
    local = (corners - middle) @ rotation_from_yaw(yaw)
    wanted = [(x, y, z) for z in (-1, 1) for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return [int(np.flatnonzero((np.sign(local) == signs).all(axis=1))[0]) for signs in wanted]


SITE, SEQUENCE, POLES = "117-118-120", "seq-4", ("117", "118", "120")


def write_rcooper(root: Path, recording: Recording, count: int) -> Path:
    """The first three poles in the first `count` frames as RCooper."""
    first = lidar_pose(recording, 0, 1)
    for agent, name in enumerate(POLES, start=1):
        position, rotation = lidar_pose(recording, 0, agent)
        content = {"rotation": rotation.tolist(), "translation": position.tolist()}
        write_json(root / "calib" / "lidar2world" / f"{name}.json", content)
    folder = root / "labels" / SITE
    for frame, time in enumerate(recording.times_ns[:count].tolist()):
        moment = 1_692_685_344 * 10**9 + time
        rows = rows_seen(recording, frame, (1, 2, 3))
        coop = [rcooper_label(recording, row, first) for row in rows]
        write_json(folder / "coop" / SEQUENCE / rcooper_file(moment), coop)
        for agent, name in enumerate(POLES, start=1):
            pose = lidar_pose(recording, frame, agent)
            own = [rcooper_label(recording, row, pose) for row in rows_seen(recording, frame, (agent,))]
            delay = (agent - 1) * 13_000_000
            write_json(folder / name / SEQUENCE / rcooper_file(moment + delay), own)
    return root


def rcooper_label(recording: Recording, row: int, pose: Pose) -> dict[str, Any]:
    entry = label(recording, row, pose)
    return entry | {"type": CLASSES[recording.truth.class_id[row]], "track_id": int(recording.truth.id[row])}


def rcooper_file(moment_ns: int) -> str:
    return f"{moment_ns // 10**9}.{moment_ns % 10**9 // 1000:06d}.json"
