"""Logs of the Argoverse 2 sensor data set.

Wilson et al.: Argoverse 2, NeurIPS Datasets and Benchmarks 2021.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_datasets.files import find_folder, only
from mast_datasets.traffic import TrafficScene, classes_of
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.own_detections import read_column
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

POSES = "city_SE3_egovehicle.feather"
_POSE = {**dict.fromkeys(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), "float64"), "timestamp_ns": "int64"}
_SIZE = "length_m", "width_m", "height_m"
_BOX = _POSE | dict.fromkeys(_SIZE, "float64") | dict.fromkeys(("track_uuid", "category"), "string")
_BOX |= {"num_interior_pts": "int64"}

#: Categories by class. The two halves of an articulated lorry are two objects, as in the data.
CLASS_OF_CATEGORY = classes_of(
    car="REGULAR_VEHICLE",
    truck="LARGE_VEHICLE BOX_TRUCK TRUCK TRUCK_CAB VEHICULAR_TRAILER",
    bus="BUS SCHOOL_BUS ARTICULATED_BUS",
    motorcycle="MOTORCYCLE MOTORCYCLIST",
    bicycle="BICYCLE BICYCLIST",
    pedestrian="PEDESTRIAN OFFICIAL_SIGNALER STROLLER WHEELCHAIR",
)
#: Objects that are not road users, and the ego, whose box is derived from its pose.
LEFT_OUT = (
    *("BOLLARD", "CONSTRUCTION_BARREL", "CONSTRUCTION_CONE", "EGO_VEHICLE", "MESSAGE_BOARD_TRAILER"),
    *("MOBILE_PEDESTRIAN_CROSSING_SIGN", "MOBILE_PEDESTRIAN_SIGN", "SIGN", "STOP_SIGN", "TRAFFIC_LIGHT_TRAILER"),
)


#: m, between two boxes' centres and sizes, up to which they are the same box.
SAME_BOX_M = 0.1


class Annotations(NamedTuple):
    """N annotated boxes by time and then by track, and what else is known of them.

    times_ns: (F,) of the frames
    boxes:    in the frame of the recording car; ids are the numbers of tracks, from 1, in the order of their UUIDs
    rotation: (N, 3, 3) active;  points: (N,) lidar returns
    """

    times_ns: Ints
    boxes: SceneBoxes
    rotation: Floats
    points: Ints


def find_log(path: Path) -> tuple[Path, Path]:
    """The annotations and the poses of the log at `path`.

    path: its folder, or a folder that holds a single log
    """
    folder = find_folder(path, f"logs with a file {POSES}", lambda folder: (folder / POSES).is_file())
    annotations = only(folder, "files annotations*.feather", sorted(folder.glob("annotations*.feather")))
    return annotations, folder / POSES


def read_poses(path: Path, times_ns: Ints) -> tuple[Floats, Floats]:
    """Position (F, 3) m and active rotation (F, 3, 3) of the recording car.

    In the city frame, at `times_ns` (F,).
    """
    columns = _read(path, _POSE)
    times, rows, count = np.unique(columns["timestamp_ns"], return_index=True, return_counts=True)
    if count.max(initial=1) > 1:
        raise SceneError(f"{path}: timestamp_ns {times[count > 1][0]} occurs twice")
    if len(missing := np.setdiff1d(times_ns, times)):
        raise SceneError(f"{path}: no pose at timestamp_ns {missing[0]} of the annotations")
    chosen = rows[np.searchsorted(times, times_ns)]
    return _poses(path, {name: values[chosen] for name, values in columns.items()})


def read_annotations(path: Path) -> Annotations:
    """The annotated road users of a log, without those `LEFT_OUT`.

    Unknown categories get class 0 (unknown). An object that is annotated twice, as two tracks, is read once.
    """
    columns = _read(path, _BOX)
    times = np.unique(columns["timestamp_ns"])
    if len(times) == 0:
        raise SceneError(f"{path}: the file has no rows")
    # Times come from all rows: a frame without road users still counts.
    keep = ~np.isin(columns["category"], LEFT_OUT)
    columns = {name: values[keep] for name, values in columns.items()}
    track = np.unique(columns["track_uuid"], return_inverse=True)[1].astype(np.int64) + 1
    frame = np.searchsorted(times, columns["timestamp_ns"])
    order = np.lexsort((track, frame))
    frame, track = frame[order], track[order]
    columns = {name: values[order] for name, values in columns.items()}
    for row in np.flatnonzero((np.diff(frame) == 0) & (np.diff(track) == 0)):
        raise SceneError(f"{path}: track {columns['track_uuid'][row]} occurs twice at timestamp_ns {times[frame[row]]}")
    size = np.stack([columns[name] for name in _SIZE], axis=1)
    if len(size) and (size.min() <= 0 or columns["num_interior_pts"].min() < 0):
        raise SceneError(f"{path}: a size is 0 or less, or num_interior_pts is negative")
    position, rotation = _poses(path, columns)
    class_id = np.array([CLASS_OF_CATEGORY.get(name, 0) for name in columns["category"]], np.uint8)
    boxes = SceneBoxes(frame, track, position, size, heading(rotation), class_id)
    once = ~np.isin(track, _copies(boxes))
    return Annotations(times, boxes.select(once), rotation[once], columns["num_interior_pts"][once])


def _copies(boxes: SceneBoxes) -> list[int]:
    """Tracks that coincide with another one of their class in all their frames.

    That one is longer, or as long and has a lower number. Two objects cannot be in one place: these are one, annotated
    twice.
    """
    from scipy.spatial import cKDTree  # takes 0.2 s, and every run imports this module

    # Frames are so far apart in the first coordinate that no two of them have neighbours.
    place = np.column_stack([boxes.frame * 10.0 * SAME_BOX_M, boxes.position, boxes.size])
    i, j = cKDTree(place).query_pairs(SAME_BOX_M, output_type="ndarray").T
    same = boxes.class_id[i] == boxes.class_id[j]
    pairs = np.sort(np.column_stack([boxes.id[i], boxes.id[j]])[same], axis=1)
    pairs, count = np.unique(pairs, axis=0, return_counts=True)
    frames = np.bincount(boxes.id)
    longer = frames[pairs[:, 1]] > frames[pairs[:, 0]]
    shorter = np.where(longer, pairs[:, 0], pairs[:, 1])
    copies: list[int] = shorter[count == frames[shorter]].tolist()
    return copies


def _read(path: Path, expected: dict[str, str]) -> dict[str, NDArray[Any]]:
    """The expected columns of a feather file, complete and finite."""
    # Imported here because it is slow and few processes of a run need it.
    import pyarrow

    from mast_zenoh.run_folder.unpacking import read_feather

    try:
        table = read_feather(path)
    except (pyarrow.ArrowException, OSError) as error:
        raise SceneError(f"{path}: cannot be read as Feather: {error}") from error
    columns = {name: read_column(path, table, name, kind) for name, kind in expected.items()}
    for name in (name for name, kind in expected.items() if kind == "float64"):
        for row in np.flatnonzero(~np.isfinite(columns[name])):
            raise SceneError(f"{path}: column {name}, row {row} is {columns[name][row]}, expected a finite number")
    return columns


def _poses(path: Path, columns: dict[str, NDArray[Any]]) -> tuple[Floats, Floats]:
    quaternion = np.stack([columns[name] for name in ("qw", "qx", "qy", "qz")], axis=1).astype(np.float64)
    for row in np.flatnonzero(np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) > 1e-3):
        raise SceneError(f"{path}: the quaternion {quaternion[row].tolist()} does not have length 1")
    position = np.stack([columns[name] for name in ("tx_m", "ty_m", "tz_m")], axis=1).astype(np.float64)
    return position, rotation_from_quaternion(quaternion)


#: The recording car. The origin of its frame is the rear axle; the ego's box encloses the body.
_EGO_ID = 0
_EGO_SIZE = np.array([4.877, 2.0, 1.473])
_AXLE_HEIGHT_M = 0.33
_EGO_CENTRE = np.array([1.42, 0.0, _EGO_SIZE[2] / 2 - _AXLE_HEIGHT_M])
#: Its two roof lidars, 32 channels each, modelled as one.
_EGO_LIDAR = LidarSensor(
    mount_position=np.array([1.35, 0.0, 1.64]), elevation_min_deg=-25.0, elevation_max_deg=15.0, max_range_m=200.0
)
_EGO_CAMERA = Camera(mount_position=np.array([1.6, 0.0, 1.4]))


@dataclass(kw_only=True, eq=False)
class AV2Log(TrafficScene):
    """An Argoverse 2 sensor log: a real car in real traffic, to which virtual agents are added.

    path:             the folder of a log, with annotations*.feather and city_SE3_egovehicle.feather

    The world's origin is on the ground below the ego's first position. The ego's visibility is the number of lidar
    returns in the data set; that of the other agents comes from ray casting against the other boxes (the data has no
    buildings). Traffic signs, cones and similar objects are left out (`LEFT_OUT`).
    """

    short_name = "av2"
    files = (("city_SE3_egovehicle.feather",), ("*/city_SE3_egovehicle.feather",))

    def record(self, seed: int, frames: int | None) -> Recording:
        file, pose_file = find_log(self.root)
        annotations = read_annotations(file)
        city, rotation = read_poses(pose_file, annotations.times_ns)
        axle = city - city[0] + [0.0, 0.0, _AXLE_HEIGHT_M]
        boxes = _boxes(annotations, axle, rotation)
        ego = AgentPath(
            SceneAgent("ego", "mobile", _EGO_ID, _EGO_LIDAR, _EGO_CAMERA),
            axle,
            rotation,
            points=np.concatenate([np.zeros(len(axle), np.int32), annotations.points.astype(np.int32)]),
            ground=axle[:, 2] - _AXLE_HEIGHT_M,
        )
        paths = self.agents(boxes, ego, self.root)
        name = file.parent.name
        return assemble(name, annotations.times_ns, boxes, paths, self.detector, seed=seed, frames=frames)


def _boxes(annotations: Annotations, axle: Floats, rotation: Floats) -> SceneBoxes:
    """The ego's boxes, then those of the traffic, in the world frame."""
    ego = SceneBoxes.throughout(
        _EGO_ID, axle + rotation @ _EGO_CENTRE, _EGO_SIZE, heading(rotation), CLASS_INDEX["car"]
    )
    now = annotations.boxes.frame
    position = np.einsum("nij,nj->ni", rotation[now], annotations.boxes.position) + axle[now]
    traffic = replace(annotations.boxes, position=position, yaw=heading(rotation[now] @ annotations.rotation))
    return SceneBoxes.concatenate([ego, traffic])
