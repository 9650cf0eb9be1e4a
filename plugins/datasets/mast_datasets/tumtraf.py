"""Sequences of TUMTraf V2X."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from mast_datasets.files import Coordinate, Element, Seconds, Side, Whole, read_json, read_listed_pose
from mast_datasets.traffic import ABOVE_0, DataSetScene, Labels, check_times, classes_of, ground_below
from mast_zenoh.arrays.geometry import along_and_across, heading, rotation_from_quaternion
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble, standing
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor

_BETWEEN = "_to_"


class Coordinates:
    """The tree of coordinate systems in one frame.

    openlabel:  the file's content, with `coordinate_systems`
    properties: the frame's `frame_properties`, with `transforms`, which take precedence

    Raises SceneError. Matrices are decoded only when they are needed, since other sensors' have other forms.
    """

    def __init__(self, openlabel: Element, properties: Element) -> None:
        self._element = properties
        self._parents: dict[str, tuple[str, Element]] = {}  # "": it is a root
        systems, transforms = openlabel.get("coordinate_systems"), properties.get("transforms")
        for name, system in systems.members() if systems else ():
            parent = system.get("parent")
            self._add(name, parent.text() if parent else "", system)
        for name, transform in transforms.members() if transforms else ():
            source, target = transform.get("src"), transform.get("dst")
            ends = name.split(_BETWEEN) if source is None or target is None else [source.text(), target.text()]
            if len(ends) != 2:
                transform.fail("src and dst, or a name SRC_to_DST")
            self._add(ends[0], ends[1], transform)

    def _add(self, name: str, parent: str, element: Element) -> None:
        self._parents[name] = parent, element
        if parent:
            self._parents.setdefault(parent, ("", element))

    def locate(self, name: str) -> tuple[str, Floats, Floats]:
        """The root above a coordinate system, and its position (3,) m and rotation (3, 3) there."""
        if name not in self._parents:
            expected = f"expected one in coordinate_systems or transforms{nearest(name, list(self._parents))}"
            place = f"{self._element.path}: {self._element.place}"
            raise SceneError(f"{place}: found no coordinate system {name!r}, {expected}")
        position, rotation = np.zeros(3), np.eye(3)
        current, visited = name, {name}
        while (above := self._parents[current])[0]:
            current, element = above
            if current in visited:
                raise SceneError(
                    f"{element.path}: {element.place}: found a parent {current!r} that is below {name!r} itself, "
                    "expected a tree of coordinate systems"
                )
            visited.add(current)
            matrix = (element.get("transform_src_to_dst") or element["pose_wrt_parent"])["matrix4x4"]
            offset, turn = read_listed_pose(matrix)
            position, rotation = offset + turn @ position, turn @ rotation
        return current, position, rotation


_Part = Annotated[float, Meta(ge=-2, le=2)]  # of a quaternion
_Box = tuple[Coordinate, Coordinate, Coordinate, _Part, _Part, _Part, _Part, Side, Side, Side]
_MAX_LENGTH_ERROR = 1e-3  # of a quaternion
_SIDES = ("labels_point_clouds", "_labels_point_clouds")
_REGISTERED = "s110_lidar_ouster_south_and_vehicle_lidar_robosense_registered"

#: Classes by type, in lower case; all others are unknown.
CLASS_OF_TYPE = classes_of(
    car="car van", truck="truck trailer", bus="bus", motorcycle="motorcycle", bicycle="bicycle", pedestrian="pedestrian"
)


class LabelledFrame(NamedTuple):
    """A labelled frame.

    properties: where it is in the file, for messages; objects: by track
    """

    time_ns: int
    properties: Element
    coordinates: Coordinates
    objects: Element | None

    def add_boxes(self, row: int, labels: Labels, system: str, root: str) -> None:
        """Add the labelled boxes in the root's frame.

        row: of the frame; system: coordinate system of labels that name none; root: the one above all
        """
        located: dict[str, tuple[str, Floats, Floats]] = {}
        for track, element in self.objects.members() if self.objects else ():
            data = element["object_data"]
            cuboid = data["cuboid"]
            if isinstance(cuboid.value, list):
                (cuboid,) = cuboid.elements() if len(cuboid.value) == 1 else cuboid.fail("one box")
            named = next((place for place in (cuboid, data, element) if place.get("coordinate_system")), None)
            name = named["coordinate_system"].text() if named else system
            if name not in located:
                located[name] = self.coordinates.locate(name)
                self.check_root(name, located[name][0], root)
            _, position, rotation = located[name]
            middle, turn, size = _cuboid(cuboid["val"])
            class_id = CLASS_OF_TYPE.get(data["type"].text().lower(), CLASS_INDEX["unknown"])
            labels.add(row, track, position + rotation @ middle, size, float(heading(rotation @ turn)), class_id)

    def check_root(self, name: str, found: str, root: str) -> None:
        """Raise SceneError unless the root found above a coordinate system is that of the first frame, and stands."""
        place = f"{self.properties.path}: {self.properties.place}"
        if found != root:
            raise SceneError(f"{place}: the root above {name} is {found!r}, expected {root!r} as in the first frame")
        if root.startswith("vehicle"):
            raise SceneError(f"{place}: the root above {name} is {root!r}, which moves: expected one that does not")


def find_labels(path: Path) -> Path:
    """The folder with the label files at `path`, which is that folder, or a folder of a split of the data set."""
    if not path.is_dir():
        raise SceneError(f"{path}: no such folder")
    for folder in (path, *(path / side / _REGISTERED for side in _SIDES)):
        if any(folder.glob("*.json")):
            return folder
    raise SceneError(f"{path}: found no label files *.json, expected them there or in {_SIDES[0]}/{_REGISTERED}")


def read_frames(folder: Path) -> list[LabelledFrame]:
    """All frames of the files in a folder, by the names of the files and then by number.

    Raises SceneError, also if their times do not ascend.
    """
    files = sorted(folder.glob("*.json"))
    frames = [frame for file in files for frame in _frames(file)]
    if not frames:
        raise SceneError(f"{folder}: found no frames in {len(files)} label files, expected at least one")
    names = [f"{frame.properties.path.name}: {frame.properties.place}" for frame in frames]
    check_times(folder, names, np.array([frame.time_ns for frame in frames]), math.inf)
    return frames


def _frames(file: Path) -> Iterator[LabelledFrame]:
    openlabel = read_json(file)["openlabel"]
    numbered = [
        (Element(key.lstrip("0") or "0", file, "$.openlabel.frames").read(Whole), frame)
        for key, frame in openlabel["frames"].members()
    ]
    for _, frame in sorted(numbered, key=lambda item: item[0]):
        properties = frame["frame_properties"]
        # Microseconds, since a number of seconds since 1970 has no more digits than that.
        time_ns = round(properties["timestamp"].read(Seconds) * 1e6) * 1000
        yield LabelledFrame(time_ns, properties, Coordinates(openlabel, properties), frame.get("objects"))


def _cuboid(element: Element) -> tuple[Floats, Floats, Floats]:
    """Position (3,) m, active rotation (3, 3) and size (3,) m of the numbers of a box; its quaternion is x, y, z, w."""
    values = np.array(element.read(_Box))
    if abs(float(np.linalg.norm(values[3:7])) - 1.0) > _MAX_LENGTH_ERROR:
        element.fail("a quaternion x, y, z, w of length 1")
    return values[:3], rotation_from_quaternion(np.roll(values[3:7], 1)), values[7:]


#: Of a car without a label: an assumption, as the data set does not give its size.
CAR_SIZE = np.array([4.8, 1.9, 1.7])
_ABOVE_ROOF_M = 0.2  # of the lidar of such a car
_MAX_ABOVE_ROOF_M = 1.5  # of the lidar of a labelled car


def own_object(boxes: SceneBoxes, position: Floats, rotation: Floats) -> tuple[SceneBoxes, int]:
    """The boxes with one of the car below a lidar in every frame, and its id.

    position: (F, 3) m, and rotation: (F, 3, 3), of the lidar in the world

    The car is the one track whose box is below the lidar in every frame. If there is none, boxes below the lidar are
    left out, and boxes of CAR_SIZE take their place.
    """
    offset, half = position[boxes.frame] - boxes.position, boxes.size / 2
    below = (np.abs(along_and_across(offset, boxes.yaw)) <= half[:, :2]).all(axis=1)
    below &= (offset[:, 2] >= -half[:, 2]) & (offset[:, 2] <= half[:, 2] + _MAX_ABOVE_ROOF_M)
    ids, count = np.unique(boxes.id[below], return_counts=True)
    throughout = ids[count == len(position)]
    if len(throughout) == 1:
        return boxes, int(throughout[0])
    own = int(boxes.id.max(initial=0)) + 1
    middle = position - [0.0, 0.0, _ABOVE_ROOF_M + CAR_SIZE[2] / 2]
    added = SceneBoxes.throughout(own, middle, CAR_SIZE, heading(rotation), CLASS_INDEX["car"])
    return SceneBoxes.concatenate([boxes.select(~below), added]), own


#: Models of the lidars, which the labels do not describe.
_CAR_LIDAR = LidarSensor(elevation_min_deg=-25.0, elevation_max_deg=15.0, channels=32)
_POLE_LIDAR = LidarSensor(mount_position=np.zeros(3), elevation_min_deg=-22.5, elevation_max_deg=0.0, max_range_m=120.0)
_MAX_DRIFT = 0.05  # m, and elements of the rotation matrix: of a pole's lidar in a sequence

Poses = tuple[Floats, Floats]  # (F, 3) m and (F, 3, 3)


@dataclass(kw_only=True, eq=False)
class TUMTrafV2X(DataSetScene):
    """A sequence of TUMTraf-V2X: a car and a pole at a junction, labelled in their registered point cloud.

    path:         the folder of a split (train, val, test), or the one with its label files
    sequence:     number of the sequence in the folder, from 0; None: the only one
    max_gap_s:    a longer time between two frames begins a new sequence
    lidars:       coordinate systems that are agents, those of cars beginning with "vehicle"; None: those in the
                  name of the label folder, LIDAR_and_LIDAR_registered
    label_system: coordinate system of labels that name none; None: that of the first of the lidars

    The world is the root of the coordinate systems, shifted so that its origin is on the ground below the ego's first
    position. All agents see by ray casting against the other boxes: the labels do not tell who saw an object, and the
    data has no buildings. See docs/how-to-data-sets.md#tumtraf-v2x.
    """

    short_name = "tumtraf"
    files = (("labels_point_clouds/*/*.json",),)

    sequence: int | None = None
    max_gap_s: float = 0.15
    lidars: tuple[str, ...] | None = None
    label_system: str | None = None

    def __post_init__(self) -> None:
        self.check(max_gap_s=ABOVE_0)

    def inputs(self) -> Sequence[Path]:
        """The folder with the labels."""
        return (find_labels(self.root),)

    def record(self, seed: int, frames: int | None) -> Recording:
        folder = find_labels(self.root)
        cars, playing, poles = self._agents(folder)
        number, sequence = self._sequence(folder, read_frames(folder))
        names = [*cars, *poles]
        label_system = self.label_system or (self.lidars or _lidars_of(folder))[0]
        root, poses = _poses(sequence, names)
        labels = Labels(folder)
        for row, frame in enumerate(sequence):
            frame.add_boxes(row, labels, label_system, root)
        boxes, objects = labels.boxes()[0], []
        for name in cars:
            boxes, own = own_object(boxes, *poses[name])
            objects.append(own)
        first, boxes = ground_below(boxes, objects[0], poses[cars[0]][0])
        poses = {name: (position - first, rotation) for name, (position, rotation) in poses.items()}
        paths = [
            _car("ego" if k == 0 else f"mobile_{k}", boxes, objects[k], *poses[name]) for k, name in enumerate(playing)
        ]
        for k, name in enumerate(poles, start=1):
            position, rotation = poses[name]
            paths.append(standing(f"infra_{k}", _POLE_LIDAR, position[0], rotation[0], len(position)))
        times = np.array([frame.time_ns for frame in sequence], np.int64)
        return assemble(
            f"{self.root.absolute().name}_{number}", times, boxes, paths, self.detector, seed=seed, frames=frames
        )

    def _agents(self, folder: Path) -> tuple[list[str], list[str], list[str]]:
        """Coordinate systems of lidars: of all cars, of those that are agents, the ego first, and of poles."""
        lidars = _lidars_of(folder) if self.lidars is None else self.lidars
        if len(set(lidars)) != len(lidars):
            raise ConfigurationError(f"{self.path}: lidars are {list(lidars)}, expected each of them once")
        cars, poles = ([name for name in lidars if name.startswith("vehicle") == moves] for moves in (True, False))
        if not cars:
            raise SceneError(f"{folder}: found the lidars {list(lidars)}, expected at least one of a car, vehicle…")
        return cars, *self.playing(cars, poles)

    def _sequence(self, folder: Path, frames: list[LabelledFrame]) -> tuple[int, list[LabelledFrame]]:
        """The number and the frames of the chosen sequence."""
        gaps = np.diff([frame.time_ns for frame in frames]) > self.max_gap_s * 1e9
        starts = [0, *(np.flatnonzero(gaps) + 1).tolist(), len(frames)]
        count = len(starts) - 1
        if self.sequence is None and count > 1:
            before, after = frames[starts[1] - 1], frames[starts[1]]
            gap = f"a gap of {(after.time_ns - before.time_ns) / 1e9:g} s before {after.properties.path.name}"
            raise SceneError(
                f"{folder}: found {count} sequences, the second after {gap}, expected one: "
                f"choose one with sequence=0 to {count - 1}, or allow longer gaps with max_gap_s"
            )
        number = self.sequence or 0
        if not 0 <= number < count:
            raise ConfigurationError(f"{self.path}: sequence is {number}, expected 0 to {count - 1}")
        return number, frames[starts[number] : starts[number + 1]]


def _lidars_of(folder: Path) -> tuple[str, ...]:
    """The coordinate systems in the name of a label folder."""
    name = folder.absolute().name
    if not name.endswith("_registered"):
        raise ConfigurationError(
            f"{folder}: the folder is not named LIDAR_and_LIDAR_registered, expected that, or the parameter lidars"
        )
    return tuple(name.removesuffix("_registered").split("_and_"))


def _poses(frames: list[LabelledFrame], names: list[str]) -> tuple[str, dict[str, Poses]]:
    """The root of the coordinate systems, and the poses of some of them in it, in all frames."""
    root, poses = frames[0].coordinates.locate(names[0])[0], {}
    for name in names:
        located = [frame.coordinates.locate(name) for frame in frames]
        _, first, facing = located[0]
        for frame, (found, position, rotation) in zip(frames, located, strict=True):
            frame.check_root(name, found, root)
            drift = max(np.abs(position - first).max(), np.abs(rotation - facing).max())
            if drift > _MAX_DRIFT and not name.startswith("vehicle"):
                raise SceneError(
                    f"{frame.properties.path}: {frame.properties.place}: {name} is at "
                    f"{np.round(position, 2).tolist()}, expected {np.round(first, 2).tolist()} as in the first frame: "
                    "poles do not move"
                )
        _, *columns = zip(*located, strict=True)
        poses[name] = np.array(columns[0]), np.array(columns[1])
    return root, poses


def _car(name: str, boxes: SceneBoxes, own: int, position: Floats, rotation: Floats) -> AgentPath:
    """A car; its origin is below the lidar, at the height of its underside in the first frame."""
    row = boxes.rows_of(own)[0]
    mount = np.array([0.0, 0.0, position[0, 2] - boxes.position[row, 2] + boxes.size[row, 2] / 2])
    sensor = replace(_CAR_LIDAR, mount_position=mount)
    return AgentPath(SceneAgent(name, "mobile", own, sensor, Camera(mount)), position - rotation @ mount, rotation)
