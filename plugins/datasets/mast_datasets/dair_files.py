"""Files of the DAIR family: labels, calibrations, and the pairs of frames of V2X-Seq-SPD and DAIR-V2X-C.

Yu et al.: DAIR-V2X, CVPR 2022; Yu et al.: V2X-Seq, CVPR 2023; Hao et al.: RCooper, CVPR 2024.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from mast_datasets.files import Coordinate, Element, Name, Point, choose_name, find_folder, read_json
from mast_datasets.traffic import classes_of
from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError

MAX_LABELS = 5_000  # in one file
_Length = Annotated[float, Meta(ge=0, le=1e8)]
_Track = str | Annotated[int, Meta(ge=-1, le=2**63 - 1)]
_Corners = Annotated[list[Point], Meta(min_length=8, max_length=8)]

#: Types by class, in lower case. A van is a car; three wheels and a motor count as a motorcycle.
CLASS_OF_TYPE = classes_of(
    car="car van",
    truck="truck",
    bus="bus",
    motorcycle="motorcycle motorcyclist tricycle tricyclist",
    bicycle="bicycle bicyclist cyclist",
    pedestrian="pedestrian barrowlist",
)
#: Types that are not road users, in lower case.
LEFT_OUT = ("trafficcone", "traffic_cone")

# Signs of the corners of `world_8_points`: four at the bottom, then four at the top, each from the front left
# clockwise (seen from above).
_CORNERS = np.array([[x, y, z] for z in (-1, 1) for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]) / 2
_MAX_CORNER_ERROR_M = 0.5  # between the corners in a file and those of an upright box; cars lean on slopes


def read_labels(path: Path) -> list[Element]:
    """The labels of a frame, without those of types that are `LEFT_OUT`."""
    labels = read_json(path).elements()
    if len(labels) > MAX_LABELS:
        raise SceneError(f"{path}: found {len(labels)} labels, expected at most {MAX_LABELS}")
    return [label for label in labels if type_of(label) not in LEFT_OUT]


def type_of(label: Element) -> str:
    """The type of a label, in lower case."""
    return label["type"].text().lower()


def class_of(label: Element) -> int:
    """Index into CLASSES of the type of a label, 0 (unknown) for unlisted types."""
    return CLASS_OF_TYPE.get(type_of(label), 0)


def location(label: Element) -> Floats:
    """(3,) m, middle of the box of a label."""
    return np.array([label["3d_location"][axis].read(Coordinate) for axis in "xyz"])


def dimensions(label: Element) -> Floats:
    """(3,) m, length, width and height of a label, 0 or more."""
    return np.array([label["3d_dimensions"][side].read(_Length) for side in "lwh"])


def box(label: Element) -> tuple[Floats, Floats, float]:
    """Position (3,) m, size (3,) m and yaw rad of a label, from its eight corners if it has them."""
    corners = label.get("world_8_points")
    if corners is not None:
        return _box_of_corners(corners)
    size = dimensions(label)
    if size.min() <= 0:
        label["3d_dimensions"].fail("3 numbers above 0")
    return location(label), size, label["rotation"].read(Coordinate)


def _box_of_corners(element: Element) -> tuple[Floats, Floats, float]:
    """The upright box nearest to eight corners, see `_CORNERS`."""
    corners = np.array(element.read(_Corners))
    forward, left = corners[0] - corners[3], corners[0] - corners[1]
    size = np.array([np.linalg.norm(forward), np.linalg.norm(left), np.linalg.norm(corners[4] - corners[0])])
    if size.min() <= 0:
        element.fail("8 corners of a box with sizes above 0")
    position, yaw = corners.mean(axis=0), math.atan2(forward[1], forward[0])
    upright = position + (_CORNERS * size) @ rotation_from_yaw(yaw).T
    if np.abs(upright - corners).max() > _MAX_CORNER_ERROR_M:
        element.fail("8 corners of an upright box: 4 at the bottom, 4 at the top, each from the front left clockwise")
    return position, size, yaw


def track_of(label: Element, key: str = "track_id") -> str:
    """The name of a label's track: text, or a number as text; empty if the label has none."""
    element = label.get(key)
    if element is None:
        return ""
    name = str(element.read(_Track))
    if not 1 <= len(name) <= 100:
        element.fail("a name of 1 to 100 characters")
    return name


def read_transform(path: Path) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3), active, of a calibration file: of the first frame in the second.

    The file has `rotation` (3 x 3) and `translation` (3, or 3 x 1), at the top or in an object `transform`.
    """
    root = read_json(path)
    inner = root.get("transform")
    root = root if inner is None else inner
    rows = root["translation"]
    if isinstance(rows.value, list):
        rows.value = [row[0] if isinstance(row, list) and len(row) == 1 else row for row in rows.value]
    return np.array(rows.read(Point)), root["rotation"].rotation()


PAIRS = "cooperative/data_info.json"
VEHICLE, INFRASTRUCTURE = "vehicle-side", "infrastructure-side"
_Time = Annotated[int, Meta(ge=0, le=9 * 10**15)]  # µs, so that nanoseconds fit into 64 bits
_Offset = Annotated[float, Meta(ge=-1000, le=1000)]  # m
_SHOWN = 10  # names of sequences in a message
_NAME = re.compile(r"[0-9A-Za-z_]{1,40}")


@dataclass(frozen=True, eq=False)
class Pair:
    """A frame of the car, and the pole's frame that belongs to it.

    vehicle, infrastructure:          names of the frames
    time_ns, infrastructure_time_ns:  of their point clouds
    offset:                           (2,) m, of the pole relative to the car's localisation, in the frame of the labels
    """

    vehicle: str
    infrastructure: str
    time_ns: int
    infrastructure_time_ns: int
    offset: Floats


@dataclass(frozen=True)
class Layout:
    """The folders of a data set.

    root:     with cooperative, vehicle-side and infrastructure-side
    in_world: the cooperative labels are in the world frame (DAIR-V2X-C), otherwise in the car's lidar (V2X-Seq-SPD)
    """

    root: Path
    in_world: bool

    def clocks(self, side: str) -> Path:
        """The file with the times of a side's frames. side: VEHICLE or INFRASTRUCTURE"""
        return self.root / side / "data_info.json"

    def cooperative_labels(self, pair: Pair) -> Path:
        """The file with the cooperative labels of a pair."""
        return self.root / "cooperative" / ("label_world" if self.in_world else "label") / f"{pair.vehicle}.json"

    def vehicle_labels(self, pair: Pair) -> Path:
        """The file with the labels of the car."""
        return self.root / VEHICLE / "label" / "lidar" / f"{pair.vehicle}.json"

    def infrastructure_labels(self, pair: Pair) -> Path:
        """The file with the labels of the pole."""
        return self.root / INFRASTRUCTURE / "label" / "virtuallidar" / f"{pair.infrastructure}.json"

    def vehicle_pose(self, pair: Pair) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of the car's lidar in the world."""
        calibration = self.root / VEHICLE / "calib"
        mount, turned = read_transform(calibration / "lidar_to_novatel" / f"{pair.vehicle}.json")
        position, rotation = read_transform(calibration / "novatel_to_world" / f"{pair.vehicle}.json")
        return position + rotation @ mount, rotation @ turned

    def infrastructure_pose(self, pair: Pair, vehicle_rotation: Floats) -> tuple[Floats, Floats]:
        """Position (3,) m and rotation (3, 3) of the pole's lidar in the world, with the pair's offset.

        vehicle_rotation: (3, 3) of the car's lidar in the world
        """
        file = self.root / INFRASTRUCTURE / "calib" / "virtuallidar_to_world" / f"{pair.infrastructure}.json"
        position, rotation = read_transform(file)
        offset = np.append(pair.offset, 0.0)
        return position + (offset if self.in_world else vehicle_rotation @ offset), rotation


def split_path(path: Path) -> tuple[Path, str | None]:
    """The folder of the data set, and the name of a sequence if the path ends in one: `<data set>/<sequence>`."""
    if not os.path.exists(path) and os.path.isfile(path.parent / PAIRS):
        return path.parent, path.name
    return path, None


def open_layout(path: Path) -> Layout:
    """The data set at `path`: its folder, or a folder that holds a single one."""
    root = find_folder(path, f"data sets with a file {PAIRS}", lambda folder: (folder / PAIRS).is_file())
    kinds = [name for name in ("label", "label_world") if (root / "cooperative" / name).is_dir()]
    if len(kinds) != 1:
        raise SceneError(
            f"{root / 'cooperative'}: found {len(kinds)} of the folders label (V2X-Seq-SPD) and label_world "
            "(DAIR-V2X-C), expected one"
        )
    return Layout(root, kinds[0] == "label_world")


def read_pairs(layout: Layout, sequence: str | None) -> list[Pair]:
    """The pairs of a sequence, in the order of the car's frames.

    sequence: None: the only one. Raises ConfigurationError, with the names, if there are several.
    """
    file = layout.root / PAIRS
    entries = read_json(file).elements()
    sides = {side: _side(layout.clocks(side)) for side in (VEHICLE, INFRASTRUCTURE)}
    groups: dict[str, dict[str, tuple[Pair, str]]] = {}
    for entry in entries:
        pair, group, pole_group = _pair(entry, sides, layout.in_world)
        members = groups.setdefault(group, {})
        if pair.vehicle in members:
            raise SceneError(f"{file}: {entry.place}: found frame {pair.vehicle} of the car twice, expected it once")
        members[pair.vehicle] = pair, pole_group
    chosen = choose_name(layout.root, "sequence", groups, sequence)
    poles = sorted({pole_group for _, pole_group in groups[chosen].values()})
    if len(poles) != 1:
        raise SceneError(
            f"{file}: sequence {chosen}: found frames of the pole from the sequences {', '.join(poles[:_SHOWN])}, "
            "expected one sequence"
        )
    return [groups[chosen][name][0] for name in sorted(groups[chosen], key=lambda name: (len(name), name))]


def clocks(pairs: list[Pair]) -> tuple[Ints, Floats]:
    """Times (F,) ns of the car's frames, and how much later (F,) s the pole's frames are."""
    vehicle = np.array([pair.time_ns for pair in pairs], np.int64)
    infrastructure = np.array([pair.infrastructure_time_ns for pair in pairs], np.int64)
    return vehicle, (infrastructure - vehicle) / 1e9


def frame_number(name: str) -> int:
    """The number in the name of a frame, such as 123 for 000123."""
    return int("0" + "".join(character for character in name if character.isdigit()))


def _side(path: Path) -> dict[str, Element]:
    """The frames of one side, by name."""
    frames: dict[str, Element] = {}
    for entry in read_json(path).elements():
        name = _frame(entry)
        if name in frames:
            raise SceneError(f"{path}: {entry.place}: found frame {name} twice, expected it once")
        frames[name] = entry
    return frames


def _frame(entry: Element) -> str:
    """The name of an entry's frame: its `frame_id`, otherwise the name of its point cloud."""
    return _name(entry.get("frame_id") or entry["pointcloud_path"])


def _name(element: Element) -> str:
    """A name, or the name of the file at a path, that is safe as the name of a file."""
    name = str(element.read(Name)).rsplit("/", 1)[-1].removesuffix(".pcd")
    if not _NAME.fullmatch(name):
        element.fail("a name of 1 to 40 letters, digits and _")
    return name


def _pair(entry: Element, sides: Mapping[str, dict[str, Element]], in_world: bool) -> tuple[Pair, str, str]:
    """A pair, and the sequences of its two frames."""
    frames, times, groups = [], [], []
    for side, key in ((VEHICLE, "vehicle"), (INFRASTRUCTURE, "infrastructure")):
        named = entry[f"{key}_pointcloud_path"] if in_world else entry[f"{key}_frame"]
        name = _name(named)
        if name not in sides[side]:
            named.fail(f"a frame of {side}/data_info.json")
        info = sides[side][name]
        frames.append(name)
        times.append(info["pointcloud_timestamp"].read(_Time) * 1000)
        groups.append(_name(info["batch_id"] if in_world else entry[f"{key}_sequence"]))
    return Pair(frames[0], frames[1], times[0], times[1], _offset(entry)), groups[0], groups[1]


def _offset(entry: Element) -> Floats:
    """(2,) m, 0 where the file leaves it empty."""
    offset = entry.get("system_error_offset")
    if offset is None or offset.value == "":
        return np.zeros(2)
    deltas = [offset[f"delta_{axis}"] for axis in "xy"]
    return np.array([0.0 if delta.value == "" else delta.read(_Offset) for delta in deltas])
