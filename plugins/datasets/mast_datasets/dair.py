"""Scenes of V2X-Seq-SPD and DAIR-V2X-C: a car and a pole. Their labels and calibrations are those of RCooper, too.

Yu et al.: DAIR-V2X, CVPR 2022; Yu et al.: V2X-Seq, CVPR 2023; Hao et al.: RCooper, CVPR 2024.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from mast_datasets.files import Coordinate, Element, Name, Point, choose_name, find_folder, read_json
from mast_datasets.point_files import PointFiles
from mast_datasets.traffic import ABOVE_0, DataSetScene, Labels, check_times, choose_frames, classes_of, listed_returns
from mast_zenoh.arrays.geometry import along_and_across, heading, rotation_from_yaw, to_world
from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble, ground_level
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

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


def location(label: Element) -> Floats:
    """(3,) m, middle of the box of a label."""
    return np.array([label["3d_location"][axis].read(Coordinate) for axis in "xyz"])


def dimensions(label: Element) -> Floats:
    """(3,) m, length, width and height of a label, 0 or more."""
    return np.array([label["3d_dimensions"][side].read(_Length) for side in "lwh"])


def box(label: Element) -> tuple[Floats, Floats, float]:
    """Position (3,) m, size (3,) m and yaw rad of a label, from its eight corners if it has them."""
    if corners := label.get("world_8_points"):
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
    return name if 1 <= len(name) <= 100 else element.fail("a name of 1 to 100 characters")


def read_transform(path: Path) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3), active, of a calibration file: of the first frame in the second.

    The file has `rotation` (3 x 3) and `translation` (3, or 3 x 1), at the top or in an object `transform`.
    """
    root = read_json(path)
    root = root.get("transform") or root
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


class Pair(NamedTuple):
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


#: Of a lidar in the world: position (F, 3) m, rotation (F, 3, 3) active.
LidarPoses = tuple[Floats, Floats]


class DAIRFolder(NamedTuple):
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

    def labels(self, side: str, pair: Pair) -> Path:
        """The file of what a side lists. side: VEHICLE or INFRASTRUCTURE"""
        sensor, name = ("lidar", pair.vehicle) if side == VEHICLE else ("virtuallidar", pair.infrastructure)
        return self.root / side / "label" / sensor / f"{name}.json"

    def scan(self, side: str, pair: Pair) -> Path:
        """The file of a side's points. side: VEHICLE or INFRASTRUCTURE"""
        return self.root / side / "velodyne" / f"{pair.vehicle if side == VEHICLE else pair.infrastructure}.pcd"

    def poses(self, pairs: list[Pair]) -> tuple[LidarPoses, LidarPoses]:
        """The poses of the lidars of the car, and of the pole with the pairs' offsets."""
        poses: tuple[list[Floats], ...] = [], [], [], []
        calibration = self.root / VEHICLE / "calib"
        for pair in pairs:
            mount, turned = read_transform(calibration / "lidar_to_novatel" / f"{pair.vehicle}.json")
            position, rotation = read_transform(calibration / "novatel_to_world" / f"{pair.vehicle}.json")
            position, rotation = position + rotation @ mount, rotation @ turned
            file = self.root / INFRASTRUCTURE / "calib" / "virtuallidar_to_world" / f"{pair.infrastructure}.json"
            place, facing = read_transform(file)
            offset = np.append(pair.offset, 0.0)
            offset = offset if self.in_world else rotation @ offset
            for column, value in zip(poses, (position, rotation, place + offset, facing), strict=True):
                column.append(value)
        car_position, car_rotation, place, facing = (np.array(column) for column in poses)
        return (car_position, car_rotation), (place, facing)


def open_layout(path: Path) -> DAIRFolder:
    """The data set at `path`: its folder, or a folder that holds a single one."""
    root = find_folder(path, f"data sets with a file {PAIRS}", lambda folder: (folder / PAIRS).is_file())
    kinds = [name for name in ("label", "label_world") if (root / "cooperative" / name).is_dir()]
    if len(kinds) != 1:
        raise SceneError(
            f"{root / 'cooperative'}: found {len(kinds)} of the folders label (V2X-Seq-SPD) and label_world "
            "(DAIR-V2X-C), expected one"
        )
    return DAIRFolder(root, kinds[0] == "label_world")


def read_pairs(layout: DAIRFolder, sequence: str | None) -> list[Pair]:
    """The pairs of a sequence, in the order of the car's frames.

    sequence: None: the only one. Raises ConfigurationError, with the names, if there are several.
    """
    file = layout.root / PAIRS
    sides = {side: _side(layout.clocks(side)) for side in (VEHICLE, INFRASTRUCTURE)}
    groups: dict[str, dict[str, tuple[Pair, str]]] = {}
    for entry in read_json(file).elements():
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


def _side(path: Path) -> dict[str, Element]:
    """The frames of one side, by name."""
    frames: dict[str, Element] = {}
    for entry in read_json(path).elements():
        name = _name(entry.get("frame_id") or entry["pointcloud_path"])
        if name in frames:
            raise SceneError(f"{path}: {entry.place}: found frame {name} twice, expected it once")
        frames[name] = entry
    return frames


def _name(element: Element) -> str:
    """A name, or the name of the file at a path, that is safe as the name of a file."""
    name = str(element.read(Name)).rsplit("/", 1)[-1].removesuffix(".pcd")
    return name if _NAME.fullmatch(name) else element.fail("a name of 1 to 40 letters, digits and _")


def _pair(entry: Element, sides: Mapping[str, dict[str, Element]], in_world: bool) -> tuple[Pair, str, str]:
    """A pair, and the sequences of its two frames."""
    frames, times, groups = [], [], []
    for side, key in ((VEHICLE, "vehicle"), (INFRASTRUCTURE, "infrastructure")):
        named = entry[f"{key}_pointcloud_path"] if in_world else entry[f"{key}_frame"]
        frames.append(_name(named))
        info = sides[side].get(frames[-1]) or named.fail(f"a frame of {side}/data_info.json")
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


def check_differences(path: Path, names: Sequence[str], agent: str, difference_s: Floats, limit_s: float) -> None:
    """Raise SceneError if an agent's frame is too far from the scene's in time.

    difference_s: (F,) s, time of the agent's frame minus that of the scene's
    """
    far = np.flatnonzero(np.abs(difference_s) > limit_s)
    if len(far):
        raise SceneError(
            f"{path}: frame {names[far[0]]}: the frame of {agent} is {difference_s[far[0]]:+.3f} s away, "
            f"expected at most {limit_s:g} s (max_time_difference_s)"
        )


def linked(frame: Ints, position: Floats, class_id: Ints, times_ns: Ints, radius_m: float) -> Ints:
    """Ids (n,) of boxes without any, from 1.

    frame: (n,) ascending, row of times_ns (F,); position: (n, 3) m; class_id: (n,)

    A box continues the track of the box in the frame before that has the same class and is the nearest on the ground,
    within `radius_m` of where its last two positions lead. The closest pairs are linked first. Tracks never bridge a
    frame without a box.
    """
    ids = np.zeros(len(frame), np.int64)
    velocity = np.zeros((len(frame), 2))
    count = 0
    before = np.zeros(0, np.intp)
    for index in range(len(times_ns)):
        now = np.flatnonzero(frame == index)
        elapsed = (times_ns[index] - times_ns[index - 1]) / 1e9 if index else 1.0
        predicted = position[before, :2] + velocity[before] * elapsed
        distance = np.linalg.norm(position[now, None, :2] - predicted[None], axis=2)
        distance[class_id[now, None] != class_id[None, before]] = np.inf
        for row, column in zip(*_closest(distance, radius_m), strict=True):
            box, last = now[row], before[column]
            ids[box] = ids[last]
            velocity[box] = (position[box, :2] - position[last, :2]) / elapsed
        new = now[ids[now] == 0]
        ids[new] = count + 1 + np.arange(len(new))
        count += len(new)
        before = now
    return ids


def matched(labels: Floats, boxes: Floats, radius_m: float) -> Bools:
    """Which boxes (n, 3) have a label (m, 3) of their own, the nearest within a radius on the ground.

    The closest pairs are matched first.
    """
    distance = np.linalg.norm(boxes[:, None, :2] - labels[None, :, :2], axis=2)
    found: Bools = np.zeros(len(boxes), bool)
    found[_closest(distance, radius_m)[0]] = True
    return found


def _closest(distance: Floats, radius_m: float) -> tuple[Ints, Ints]:
    """Rows and columns of the pairs within a radius, one to one, the closest first."""
    row, column = np.nonzero(distance <= radius_m)
    chosen = greedy_matching(row.astype(np.int64), column.astype(np.int64), distance[row, column])
    return row[chosen], column[chosen]


_UNSEEN = "-1"  # in place of the name of a side's track
#: The data sets give neither the size of the car nor the height of its lidar.
_CAR_SIZE = np.array([4.8, 1.9, 1.6])
_LIDAR_HEIGHT_M = (1.0, 4.0)  # above the ground; estimated from the boxes nearby, within these limits


class Truth(NamedTuple):
    """N boxes, and which agents see them.

    seen:  (N, A) whether the data lists the box for the agent
    known: (N, A) whether the data says anything about it
    """

    boxes: SceneBoxes
    seen: Bools
    known: Bools


def add_labels(labels: Labels, frame: int, found: list[Element], pose: tuple[Floats, Floats] | None) -> Floats:
    """Add the boxes of a frame's labels in the world frame, and return their middles (n, 3) m.

    pose: position (3,) and rotation (3, 3) of the frame of the labels; None: they are in the world frame
    """
    boxes = [box(label) for label in found]
    position = np.array([middle for middle, _, _ in boxes]).reshape(-1, 3)
    position = position if pose is None else to_world(position, *pose)
    for label, middle, (_, size, yaw) in zip(found, position, boxes, strict=True):
        angle = yaw if pose is None else float(heading(pose[1] @ rotation_from_yaw(yaw)))
        labels.add(frame, track_of(label), middle, size, angle, CLASS_OF_TYPE.get(type_of(label), 0))
    return position


def positions(labels: list[Element], position: Floats, rotation: Floats) -> Floats:
    """(n, 3) m of a side's labels in the world frame. Those without a 3D box (a size is 0) are left out."""
    local = [location(label) for label in labels if dimensions(label).min() > 0]
    return to_world(np.array(local).reshape(len(local), 3), position, rotation)


class Side(NamedTuple):
    """What an agent lists in a frame.

    file: of its labels;  position, rotation: (3,) m and (3, 3) of its lidar in the world
    reference: key of its tracks in the cooperative labels, "": they have none
    """

    file: Path
    position: Floats
    rotation: Floats
    reference: str = ""


def read_truth(
    frames: Sequence[tuple[Path, tuple[Floats, Floats] | None, Sequence[Side]]],
    times_ns: Ints,
    match_m: float,
    link_m: float | None = None,
) -> Truth:
    """The cooperative labels of a sequence in the world frame.

    frames:  the file of the cooperative labels, their pose (None: they are in the world frame), and what each agent
             lists, for each frame
    match_m: of labels without references to the sides' tracks; link_m: of labels without ids, None: refused
    """
    folder = frames[0][0].parent
    cooperative, seen, places = Labels(folder), [], []
    for frame, (file, pose, sides) in enumerate(frames):
        labels = read_labels(file)
        position = add_labels(cooperative, frame, labels, pose)
        seen.append(np.stack([_seen(side, labels, position, match_m) for side in sides], axis=1))
        places += [f"{file}: {label.place}" for label in labels]
    if not places:
        raise SceneError(f"{folder}: found no labels in {len(frames)} frames, expected at least one")
    boxes, _ = cooperative.boxes()
    if "" in cooperative.tracks:
        if any(cooperative.tracks) or link_m is None:
            raise SceneError(
                f"{places[cooperative.tracks.index('')]}: track_id is missing, expected one in every label. For "
                "DAIR-V2X-C, which has none, link_radius_m makes ids by distance, see docs/how-to-data-sets.md"
            )
        ids = linked(boxes.frame, boxes.position, boxes.class_id.astype(np.int64), times_ns, link_m)
        boxes = replace(boxes, id=ids)
    listed = np.concatenate(seen)
    return Truth(boxes, listed, np.ones_like(listed))


def _seen(side: Side, cooperative: list[Element], boxes: Floats, radius_m: float) -> Bools:
    """Which of the cooperative labels (n,), with boxes at (n, 3), an agent sees in a frame."""
    labels = read_labels(side.file)
    near = matched(positions(labels, side.position, side.rotation), boxes, radius_m)
    tracks = {track_of(label) for label in labels}
    for row, label in enumerate(cooperative):
        if name := track_of(label, side.reference):
            near[row] = name != _UNSEEN
            if near[row] and name not in tracks:
                label[side.reference].fail(f"-1, or the track of a label in {side.file}")
    return near


def with_car(truth: Truth, car: LidarPoses) -> tuple[Truth, int]:
    """The truth with a box of the car in every frame, and its id.

    Tracks whose boxes enclose the car's lidar in at least half of their frames are the car itself, as the pole sees
    it: their boxes are left out. Without such a track, ray casting decides whether the pole sees the car.
    """
    position, rotation = car
    boxes, frames = truth.boxes, len(position)
    own = np.isin(boxes.id, _enclosing(boxes, position))
    seen_by_pole = np.zeros(frames, bool)
    seen_by_pole[boxes.frame[own & truth.seen[:, 1]]] = True
    rest = boxes.select(~own)
    bottom = position[:, 2] - _lidar_height(rest, position)
    object_id = int(boxes.id.max()) + 1
    middle = np.column_stack([position[:, :2], bottom + _CAR_SIZE[2] / 2])
    added = SceneBoxes.throughout(object_id, middle, _CAR_SIZE, heading(rotation), CLASS_INDEX["car"])
    seen = np.concatenate([truth.seen[~own], np.column_stack([np.zeros(frames, bool), seen_by_pole])])
    known = np.column_stack([np.ones(frames, bool), np.full(frames, own.any())])
    known = np.concatenate([truth.known[~own], known])
    return Truth(SceneBoxes.concatenate([rest, added]), seen, known), object_id


def _enclosing(boxes: SceneBoxes, position: Floats) -> Ints:
    """Ids of the tracks whose boxes enclose a position (F, 3), on the ground, in at least half of their frames."""
    offset = position[boxes.frame, :2] - boxes.position[:, :2]
    inside = (np.abs(along_and_across(offset, boxes.yaw)) <= boxes.size[:, :2] / 2).all(axis=1)
    ids, index, count = np.unique(boxes.id, return_inverse=True, return_counts=True)
    enclosing: Ints = ids[2 * np.bincount(index, weights=inside, minlength=len(ids)) >= count]
    return enclosing


def _lidar_height(boxes: SceneBoxes, position: Floats) -> float:
    """Height m of the car's lidar at (F, 3) above the ground, estimated from the boxes nearby."""
    ground = np.array([ground_level(boxes, place) for place in position[:, :2]])
    return float(np.clip(np.median(position[:, 2] - ground), *_LIDAR_HEIGHT_M))


_ORIGIN = np.zeros(3)
_LIDAR = LidarSensor(mount_position=_ORIGIN, max_range_m=200.0)
_CAR_LIDAR = replace(_LIDAR, elevation_min_deg=-25.0, elevation_max_deg=15.0, channels=40)
_POLE_LIDAR = replace(_LIDAR, azimuth_min_deg=-50.0, azimuth_max_deg=50.0, elevation_min_deg=-30.0)
_POLE_LIDAR = replace(_POLE_LIDAR, elevation_max_deg=10.0, channels=300)
_CAMERA = Camera(mount_position=_ORIGIN)


@dataclass(kw_only=True, eq=False)
class DAIRScene(PointFiles, DataSetScene):
    """A sequence of V2X-Seq-SPD or DAIR-V2X-C: a car and a pole, with cooperative labels.

    path:                  the folder of the data set, or a folder that holds a single one; the name of a sequence may
                           follow, as in V2X-Seq-SPD/0003
    sequence:              name of the sequence (DAIR-V2X-C: the car's batch_id); None: the only one
    n_infrastructure:      0: without the pole; None: 1
    n_mobile:              cars besides the ego; None: 0, the only value
    detector:              the model that generates detections from lidar visibility
    first_frame:           number of the car's frame with which to begin; None: the first
    last_frame:            number of the car's last frame; None: the last
    max_time_difference_s: limit on the time between a frame of the car and the pole's frame that belongs to it
    max_gap_s:             limit on the time between two frames of the car
    match_radius_m:        the labels of a side that do not refer to a cooperative label match one within this distance
    link_radius_m:         give labels without track ids the id of the nearest box in the frame before, within this
                           distance of where it leads; None: refuse labels without track ids

    The truth are the cooperative labels. Frames are those of the car; the pole measures at the times of its own clock,
    and its poses and visibility come from the frame that is paired with the car's, see
    docs/how-to-data-sets.md#v2x-seq-spd-dair-v2x-c-rcooper. An agent's frame is that of its lidar: x forward, y left, z
    up; positions are middles of boxes, and rotations are active.
    """

    short_name = "dair"
    files = (("cooperative/data_info.json",),)

    sequence: str | int | None = None
    first_frame: int | None = None
    last_frame: int | None = None
    max_time_difference_s: float = 0.2
    max_gap_s: float = 0.15
    match_radius_m: float = 2.0
    link_radius_m: float | None = None

    def __post_init__(self) -> None:
        self.playing([VEHICLE], [INFRASTRUCTURE])
        self.check(max_time_difference_s=ABOVE_0, max_gap_s=ABOVE_0, match_radius_m=ABOVE_0, link_radius_m=ABOVE_0)
        self.chosen(PAIRS, "sequence")

    def inputs(self) -> Sequence[Path]:
        """The data set's folder."""
        return (self.chosen(PAIRS, "sequence")[0],)

    def time_differences_s(self) -> Floats:
        """(F,) s that each frame of the pole is later than the car's frame it is paired with.

        Raises SceneError and ConfigurationError as `record` does.
        """
        _, pairs = self._pairs()
        return clocks(pairs)[1]

    def record(self, seed: int, frames: int | None) -> Recording:
        layout, pairs = self._pairs()
        times, _ = clocks(pairs)
        car, pole = layout.poses(pairs)
        labelled = []
        for pair, own, of_pole in zip(pairs, zip(*car, strict=True), zip(*pole, strict=True), strict=True):
            sides = [
                Side(layout.labels(VEHICLE, pair), *own, "veh_track_id"),
                Side(layout.labels(INFRASTRUCTURE, pair), *of_pole, "inf_track_id"),
            ]
            labelled.append((layout.cooperative_labels(pair), None if layout.in_world else own, sides))
        truth = read_truth(labelled, times, self.match_radius_m, self.link_radius_m)
        truth, object_id = with_car(truth, car)
        measured_ns = np.array([pair.infrastructure_time_ns for pair in pairs], np.int64)
        ego = SceneAgent("ego", "mobile", object_id, _CAR_LIDAR, _CAMERA)
        infra = SceneAgent("infra_1", "static", -1, _POLE_LIDAR, _CAMERA)
        standing = AgentPath(infra, *pole, velocity=np.zeros((len(pairs), 3)), measured_ns=measured_ns)
        paths = [AgentPath(ego, *car), standing]
        seen = [
            replace(path, points=listed_returns(truth.boxes, path, listed, ~known, frames))
            for path, listed, known in zip(paths, truth.seen.T, truth.known.T, strict=True)
        ][: 1 + (self.n_infrastructure != 0)]
        _, (sequence,) = self.chosen(PAIRS, "sequence")
        name = f"{layout.root.name} {sequence or ''}".strip()
        recording = assemble(name, times, truth.boxes, seen, self.detector, seed=seed, frames=frames)
        files = [[layout.scan(side, pair) for pair in pairs] for side in (VEHICLE, INFRASTRUCTURE)][: len(seen)]
        return self.with_points(recording, layout.root, *files)

    def _pairs(self) -> tuple[DAIRFolder, list[Pair]]:
        """The folders, and the pairs of the requested frames, with times checked."""
        root, (sequence,) = self.chosen(PAIRS, "sequence")
        layout = open_layout(root)
        pairs = read_pairs(layout, sequence)
        # The number in the name of a frame, such as 123 for 000123.
        numbers = [int("0" + re.sub(r"[^0-9]", "", pair.vehicle)) for pair in pairs]
        chosen = [pairs[row] for row in choose_frames(layout.root, numbers, self.first_frame, self.last_frame)]
        names = [pair.vehicle for pair in chosen]
        times, difference = clocks(chosen)
        check_times(layout.clocks(VEHICLE), names, times, self.max_gap_s, "max_gap_s")
        check_differences(layout.clocks(INFRASTRUCTURE), names, "infra_1", difference, self.max_time_difference_s)
        return layout, chosen
