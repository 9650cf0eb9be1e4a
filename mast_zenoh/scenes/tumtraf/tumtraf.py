"""Recorded scenes: sequences of TUMTraf-V2X, with a car and a pole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import AgentPath, assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.labels import Labels
from mast_zenoh.scenes.making.virtual_agents import standing
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.scenes.selection import check_counts
from mast_zenoh.scenes.tumtraf.openlabel import Frame, find_labels, read_frames
from mast_zenoh.scenes.tumtraf.own_boxes import own_object
from mast_zenoh.sensing import Camera, DetectionModel, Detector, LidarSensor

#: Models of the lidars, which the labels do not describe.
_CAR_LIDAR = LidarSensor(elevation_min_deg=-25.0, elevation_max_deg=15.0, channels=32)
_POLE_LIDAR = LidarSensor(mount_position=np.zeros(3), elevation_min_deg=-22.5, elevation_max_deg=0.0, max_range_m=120.0)
_MAX_DRIFT = 0.05  # m, and elements of the rotation matrix: of a pole's lidar in a sequence
_DETECTOR = DetectionModel()

Poses = tuple[Floats, Floats]  # (F, 3) m and (F, 3, 3)


class TUMTrafV2X(Scene):
    """A sequence of TUMTraf-V2X: a car and a pole at a junction, labelled in their registered point cloud.

    path:             the folder of a split (train, val, test), or the one with its label files
    n_infrastructure: number of poles to use, the first ones; None: all
    n_mobile:         number of cars besides the ego to use, the first ones; None: all
    sequence:         number of the sequence in the folder, from 0; None: the only one
    max_gap_s:        a longer time between two frames begins a new sequence
    lidars:           coordinate systems that are agents, those of cars beginning with "vehicle"; None: those in the
                      name of the label folder, LIDAR_and_LIDAR_registered
    label_system:     coordinate system of labels that name none; None: that of the first of the lidars
    detector:         the model that generates detections from lidar visibility

    The world is the root of the coordinate systems, shifted so that its origin is on the ground below the ego's first
    position. All agents see by ray casting against the other boxes: the labels do not tell who saw an object, and the
    data has no buildings. See docs/scenes_tumtraf.md.
    """

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        sequence: int | None = None,
        max_gap_s: float = 0.15,
        lidars: Sequence[str] | None = None,
        label_system: str | None = None,
        detector: Detector = _DETECTOR,
    ) -> None:
        if not isinstance(max_gap_s, (int, float)) or not 0 < max_gap_s < float("inf"):
            raise ConfigurationError(f"{path}: max_gap_s is {max_gap_s!r}, expected a number above 0")
        self.path = Path(path)
        self.n_infrastructure = n_infrastructure
        self.n_mobile = n_mobile
        self.sequence = sequence
        self.max_gap_s = max_gap_s
        self.lidars = None if lidars is None else tuple(lidars)
        self.label_system = label_system
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The folder with the labels; that of the split, if there is none."""
        try:
            return (find_labels(self.path),)
        except SceneError:
            return (self.path,)

    def record(self, seed: int, frames: int | None) -> Recording:
        folder = find_labels(self.path)
        cars, playing, poles = self._agents(folder)
        number, sequence = self._sequence(folder, read_frames(folder))
        names = [*cars, *poles]
        label_system = self.label_system or (self.lidars or _lidars_of(folder))[0]
        root, poses = _poses(sequence, names)
        boxes = _boxes(folder, sequence, label_system, root)
        objects = []
        for name in cars:
            boxes, own = own_object(boxes, *poses[name])
            objects.append(own)
        boxes, poses = _shift(boxes, poses, cars[0], objects[0])
        paths = [
            _car("ego" if k == 0 else f"mobile_{k}", boxes, objects[k], *poses[name]) for k, name in enumerate(playing)
        ]
        for k, name in enumerate(poles, start=1):
            position, rotation = poses[name]
            paths.append(standing(f"infra_{k}", _POLE_LIDAR, position[0], rotation[0], len(position)))
        times = np.array([frame.time_ns for frame in sequence], np.int64)
        return assemble(
            f"{self.path.absolute().name}_{number}", times, boxes, paths, self.detector, seed=seed, frames=frames
        )

    def _agents(self, folder: Path) -> tuple[list[str], list[str], list[str]]:
        """Coordinate systems of lidars: of all cars, of those that are agents, the ego first, and of poles."""
        lidars = self.lidars or _lidars_of(folder)
        if len(set(lidars)) != len(lidars):
            raise ConfigurationError(f"{self.path}: lidars are {list(lidars)}, expected each of them once")
        cars = [name for name in lidars if name.startswith("vehicle")]
        poles = [name for name in lidars if not name.startswith("vehicle")]
        if not cars:
            raise SceneError(f"{folder}: found the lidars {list(lidars)}, expected at least one of a car, vehicle…")
        kinds = "cars besides the ego", "poles"
        check_counts(self.path, (self.n_mobile, len(cars) - 1), (self.n_infrastructure, len(poles)), kinds)
        kept = len(cars) if self.n_mobile is None else 1 + self.n_mobile
        return cars, cars[:kept], poles[: self.n_infrastructure]

    def _sequence(self, folder: Path, frames: list[Frame]) -> tuple[int, list[Frame]]:
        """The number and the frames of the chosen sequence."""
        gaps = np.diff([frame.time_ns for frame in frames]) > self.max_gap_s * 1e9
        starts = [0, *(np.flatnonzero(gaps) + 1).tolist(), len(frames)]
        count = len(starts) - 1
        if self.sequence is None and count > 1:
            before, after = frames[starts[1] - 1], frames[starts[1]]
            raise SceneError(
                f"{folder}: found {count} sequences, the second after a gap of "
                f"{(after.time_ns - before.time_ns) / 1e9:g} s before {after.properties.path.name}, expected one: "
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


def _poses(frames: list[Frame], names: list[str]) -> tuple[str, dict[str, Poses]]:
    """The root of the coordinate systems, and the poses of some of them in it, in all frames."""
    root, poses = frames[0].coordinates.locate(names[0])[0], {}
    for name in names:
        located = [frame.coordinates.locate(name) for frame in frames]
        for frame, (found, _, _) in zip(frames, located, strict=True):
            _check_root(frame, name, found, root)
        poses[name] = np.stack([position for _, position, _ in located]), np.stack([turn for _, _, turn in located])
        if not name.startswith("vehicle"):
            _check_still(frames, name, *poses[name])
    return root, poses


def _check_root(frame: Frame, name: str, found: str, root: str) -> None:
    place = f"{frame.properties.path}: {frame.properties.place}"
    if found != root:
        raise SceneError(f"{place}: the root above {name} is {found!r}, expected {root!r} as in the first frame")
    if root.startswith("vehicle"):
        raise SceneError(f"{place}: the root above {name} is {root!r}, which moves: expected one that does not")


def _check_still(frames: list[Frame], name: str, position: Floats, rotation: Floats) -> None:
    drift = np.maximum(np.abs(position - position[0]).max(axis=1), np.abs(rotation - rotation[0]).max(axis=(1, 2)))
    moved = np.flatnonzero(drift > _MAX_DRIFT)
    if len(moved):
        properties = frames[moved[0]].properties
        raise SceneError(
            f"{properties.path}: {properties.place}: {name} is at {np.round(position[moved[0]], 2).tolist()}, expected "
            f"{np.round(position[0], 2).tolist()} as in the first frame: poles do not move"
        )


def _boxes(folder: Path, frames: list[Frame], label_system: str, root: str) -> Boxes:
    """The labelled boxes in the root's frame."""
    labels = Labels(folder)
    for row, frame in enumerate(frames):
        systems = {cuboid.system or label_system for cuboid in frame.cuboids}
        located = {name: frame.coordinates.locate(name) for name in sorted(systems)}
        for name, (found, _, _) in located.items():
            _check_root(frame, name, found, root)
        for cuboid in frame.cuboids:
            _, position, rotation = located[cuboid.system or label_system]
            middle, yaw = position + rotation @ cuboid.position, float(heading(rotation @ cuboid.rotation))
            labels.add(row, cuboid.track, middle, cuboid.size, yaw, cuboid.class_id)
    return labels.boxes()[0]


def _shift(boxes: Boxes, poses: dict[str, Poses], ego: str, own: int) -> tuple[Boxes, dict[str, Poses]]:
    """Boxes and poses with the origin on the ground below the ego's lidar in the first frame."""
    row = np.flatnonzero((boxes.id == own) & (boxes.frame == 0))[0]
    origin = np.append(poses[ego][0][0, :2], boxes.position[row, 2] - boxes.size[row, 2] / 2)
    names = ("frame", "id", "size", "yaw", "class_id", "velocity")
    shifted = Boxes(position=boxes.position - origin, **{name: getattr(boxes, name) for name in names})
    return shifted, {name: (position - origin, rotation) for name, (position, rotation) in poses.items()}


def _car(name: str, boxes: Boxes, own: int, position: Floats, rotation: Floats) -> AgentPath:
    """A car; its origin is below the lidar, at the height of its underside in the first frame."""
    row = np.flatnonzero((boxes.id == own) & (boxes.frame == 0))[0]
    mount = np.array([0.0, 0.0, position[0, 2] - boxes.position[row, 2] + boxes.size[row, 2] / 2])
    sensor = replace(_CAR_LIDAR, mount_position=mount)
    return AgentPath(SceneAgent(name, "mobile", own, sensor, Camera(mount)), position - rotation @ mount, rotation)
