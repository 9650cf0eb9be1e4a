"""Writes a recording in the layout of UrbanIng-V2X."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from comparison import lidar_pose, matrix

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

SEQUENCE = "20241126_0001_crossing2_00"
TIME_MS = 1_732_632_674_000
#: Coordinates of the recording's origin in the global frame.
SHIFT = np.array([678_000.0, 5_404_000.0, 370.0])
POLES = ("crossing2_11_lidar", "crossing2_31_lidar")
VEHICLES = ("vehicle1", "vehicle2")
TYPES = {"unknown": "Other", "bicycle": "Cyclist"} | {
    name: name.capitalize() for name in CLASSES[1:] if name != "bicycle"
}


def write(root: Path, recording: Recording) -> Path:
    """The files of a recording, whose agents are two cars and two poles. Returns the sequence's folder."""
    folder = root / "dataset" / SEQUENCE
    times = [TIME_MS + int(time) // 1_000_000 for time in recording.times_ns]
    calibration: dict[str, Any] = {"crossing2_13_thermal_camera": {"extrinsics": {"cTg": np.eye(4).tolist()}}}
    for agent, vehicle in enumerate(VEHICLES):
        states = folder / f"{vehicle}_state"
        states.mkdir(parents=True)
        for frame, time in enumerate(times):
            pose = body(recording, frame, agent)
            state = {"gTv": pose.tolist(), "vV": [0.0] * 3, "vA": [0.0] * 3, "W": [0.0] * 3}
            (states / f"{time}.json").write_text(json.dumps(state))
        lidar = lidar_pose(recording, 0, agent)
        mount = np.linalg.inv(body(recording, 0, agent)) @ matrix(lidar[0] + SHIFT, lidar[1])
        calibration[f"{vehicle}_middle_lidar"] = {"extrinsics": {"vTl": mount.tolist()}}
    for agent, pole in enumerate(POLES, start=2):
        position, rotation = lidar_pose(recording, 0, agent)
        calibration[pole] = {"extrinsics": {"gTl": matrix(position + SHIFT, rotation).tolist()}}
    (folder / "calibration.json").write_text(json.dumps(calibration))
    write_timesync(folder / "timesync_info.csv", timesync(times))
    (root / "labels").mkdir()
    (root / "labels" / f"{SEQUENCE}.json").write_text(json.dumps({"tracks": tracks(recording, times)}))
    own = {vehicle: recording.agents[agent].object_id for agent, vehicle in enumerate(VEHICLES)}
    (root / "labels_av_track_ids.json").write_text(json.dumps({SEQUENCE: own}))
    return folder


def body(recording: Recording, frame: int, agent: int) -> np.ndarray:
    """gTv of a vehicle: the middle of its box."""
    truth = recording.truth_at(frame)
    row = int(np.flatnonzero(truth.id == recording.agents[agent].object_id)[0])
    return matrix(truth.position[row] + SHIFT, recording.agent_rotation[frame, agent])


def timesync(times: list[int]) -> list[list[str]]:
    """The cells of timesync_info.csv."""
    rows = [["", *map(str, range(len(times)))], ["timestamp_ms", *map(str, times)]]
    rows += [[pole, *(f"{time - 50}.npz" for time in times)] for pole in POLES]
    return rows + [[f"{vehicle}_state", *(f"{time}.json" for time in times)] for vehicle in VEHICLES]


def write_timesync(path: Path, rows: list[list[str]]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def tracks(recording: Recording, times: list[int]) -> list[dict[str, Any]]:
    """The tracks of all objects; every other one has a size for each time."""
    frame = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
    truth, result = recording.truth, []
    for number in np.unique(truth.id):
        rows = np.flatnonzero(truth.id == number)
        sizes = truth.size[rows] if number % 2 else truth.size[rows[:1]]
        track = {"track_id": int(number), "object_type": TYPES[CLASSES[truth.class_id[rows[0]]]]}
        track |= {"timestamps": [times[k] / 1000 for k in frame[rows]], "orientations": truth.yaw[rows].tolist()}
        track |= {"positions": (truth.position[rows] + SHIFT).tolist(), "dimensions": sizes.tolist()}
        result.append(track | {"attributes": {"color": "red"}})
    return result
