"""Scenes of V2X-Seq-SPD and DAIR-V2X-C: a car and a pole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mast_datasets.dair_files import (
    INFRASTRUCTURE,
    VEHICLE,
    Layout,
    Pair,
    box,
    class_of,
    clocks,
    dimensions,
    frame_number,
    location,
    open_layout,
    read_labels,
    read_pairs,
    split_path,
    track_of,
)
from mast_datasets.files import Element
from mast_datasets.traffic import ABOVE_0, DataSetScene, Labels, check_times, listed_returns
from mast_zenoh.arrays.geometry import along_and_across, heading, rotation_from_yaw, to_world
from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble, ground_level
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, LidarSensor


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
_REFERENCES = ("veh_track_id", "inf_track_id")
#: The data sets give neither the size of the car nor the height of its lidar.
_CAR_SIZE = np.array([4.8, 1.9, 1.6])
_LIDAR_HEIGHT_M = (1.0, 4.0)  # above the ground; estimated from the boxes nearby, within these limits


class LidarPoses(NamedTuple):
    """Poses of a lidar in the world: position (F, 3) m, rotation (F, 3, 3) active."""

    position: Floats
    rotation: Floats


@dataclass(frozen=True, eq=False)
class Truth:
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
        labels.add(frame, track_of(label), middle, size, angle, class_of(label))
    return position


def positions(labels: list[Element], position: Floats, rotation: Floats) -> Floats:
    """(n, 3) m of a side's labels in the world frame. Those without a 3D box (a size is 0) are left out."""
    local = [location(label) for label in labels if dimensions(label).min() > 0]
    return to_world(np.array(local).reshape(len(local), 3), position, rotation)


def read_truth(
    layout: Layout,
    pairs: list[Pair],
    car: LidarPoses,
    pole: LidarPoses,
    times_ns: Ints,
    match_m: float,
    link_m: float | None,
) -> Truth:
    """The cooperative labels of a sequence in the world frame; agents are the car and the pole.

    match_m: of labels without references to the sides' tracks; link_m: of labels without ids, None: refused
    """
    cooperative, seen, places = Labels(layout.root / "cooperative"), [], []
    for frame, pair in enumerate(pairs):
        file = layout.cooperative_labels(pair)
        labels = read_labels(file)
        pose = car.position[frame], car.rotation[frame]
        position = add_labels(cooperative, frame, labels, None if layout.in_world else pose)
        sides = (
            _Side(layout.vehicle_labels(pair), *pose, _REFERENCES[0]),
            _Side(layout.infrastructure_labels(pair), pole.position[frame], pole.rotation[frame], _REFERENCES[1]),
        )
        seen.append(np.stack([side.sees(labels, position, match_m) for side in sides], axis=1))
        places += [f"{file}: {label.place}" for label in labels]
    if not places:
        folder = layout.cooperative_labels(pairs[0]).parent
        raise SceneError(f"{folder}: found no labels in {len(pairs)} frames, expected at least one")
    boxes, _ = cooperative.boxes()
    if "" in cooperative.tracks:
        if any(cooperative.tracks) or link_m is None:
            without = places[cooperative.tracks.index("")]
            raise SceneError(
                f"{without}: track_id is missing, expected one in every label: without, no "
                "object can be followed over time. DAIR-V2X-C has none; link_radius_m makes ids by distance, see "
                "docs/scenes_dair.md"
            )
        ids = linked(boxes.frame, boxes.position, boxes.class_id.astype(np.int64), times_ns, link_m)
        boxes = replace(boxes, id=ids)
    return Truth(boxes, np.concatenate(seen), np.ones((len(boxes), 2), bool))


@dataclass(frozen=True)
class _Side:
    """The labels of the car or of the pole in one frame.

    path: their file; position, rotation: of the lidar; reference: key of its tracks in cooperative labels
    """

    path: Path
    position: Floats
    rotation: Floats
    reference: str

    def sees(self, cooperative: list[Element], boxes: Floats, radius_m: float) -> Bools:
        """Which of the cooperative labels (n,), with boxes at (n, 3), this side sees."""
        labels = read_labels(self.path)
        references = [label.get(self.reference) for label in cooperative]
        near = matched(positions(labels, self.position, self.rotation), boxes, radius_m)
        tracks = {track_of(label) for label in labels}
        for row, (label, element) in enumerate(zip(cooperative, references, strict=True)):
            if element is not None:
                name = track_of(label, self.reference)
                near[row] = name != _UNSEEN
                if near[row] and name not in tracks:
                    element.fail(f"-1, or the track of a label in {self.path}")
        return near


def with_car(truth: Truth, car: LidarPoses) -> tuple[Truth, int]:
    """The truth with a box of the car in every frame, and its id.

    Tracks whose boxes enclose the car's lidar in at least half of their frames are the car itself, as the pole sees
    it: their boxes are left out. Without such a track, ray casting decides whether the pole sees the car.
    """
    boxes, frames = truth.boxes, len(car.position)
    own = np.isin(boxes.id, _enclosing(boxes, car.position))
    seen_by_pole = np.zeros(frames, bool)
    seen_by_pole[boxes.frame[own & truth.seen[:, 1]]] = True
    rest = boxes.select(~own)
    bottom = car.position[:, 2] - _lidar_height(rest, car.position)
    object_id = int(boxes.id.max()) + 1
    middle = np.column_stack([car.position[:, :2], bottom + _CAR_SIZE[2] / 2])
    added = SceneBoxes.throughout(object_id, middle, _CAR_SIZE, heading(car.rotation), CLASS_INDEX["car"])
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
_CAR_LIDAR = LidarSensor(
    mount_position=_ORIGIN, elevation_min_deg=-25.0, elevation_max_deg=15.0, channels=40, max_range_m=200.0
)
_POLE_LIDAR = LidarSensor(
    mount_position=_ORIGIN,
    azimuth_min_deg=-50.0,
    azimuth_max_deg=50.0,
    elevation_min_deg=-30.0,
    elevation_max_deg=10.0,
    channels=300,
    max_range_m=200.0,
)
_CAMERA = Camera(mount_position=_ORIGIN)


@dataclass(kw_only=True, eq=False)
class DAIRScene(DataSetScene):
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
    and its poses and visibility come from the frame that is paired with the car's, see docs/scenes_dair.md. An agent's
    frame is that of its lidar: x forward, y left, z up; positions are middles of boxes, and rotations are active.
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
        _, named = split_path(self.root)
        if None not in (named, self.sequence) and named != str(self.sequence):
            raise ConfigurationError(
                f"{self.path}: sequence is {str(self.sequence)!r}, expected {named!r} as in the path"
            )

    def inputs(self) -> Sequence[Path]:
        """The data set's folder."""
        return (split_path(self.root)[0],)

    def _chosen(self) -> str | None:
        """The name of the sequence; None: the only one."""
        return split_path(self.root)[1] if self.sequence is None else str(self.sequence)

    def time_differences_s(self) -> Floats:
        """(F,) s that each frame of the pole is later than the car's frame it is paired with.

        Raises SceneError and ConfigurationError as `record` does.
        """
        return clocks(self._pairs(open_layout(self.inputs()[0])))[1]

    def record(self, seed: int, frames: int | None) -> Recording:
        layout = open_layout(self.inputs()[0])
        pairs = self._pairs(layout)
        times, _ = clocks(pairs)
        car, pole = _poses(layout, pairs)
        truth = read_truth(layout, pairs, car, pole, times, self.match_radius_m, self.link_radius_m)
        truth, object_id = with_car(truth, car)
        measured_ns = np.array([pair.infrastructure_time_ns for pair in pairs], np.int64)
        ego = SceneAgent("ego", "mobile", object_id, _CAR_LIDAR, _CAMERA)
        infra = SceneAgent("infra_1", "static", -1, _POLE_LIDAR, _CAMERA)
        paths = [
            AgentPath(ego, *car),
            AgentPath(infra, *pole, velocity=np.zeros_like(pole.position), measured_ns=measured_ns),
        ]
        seen = []
        for path, listed, known in zip(
            paths[: 1 + (self.n_infrastructure != 0)], truth.seen.T, truth.known.T, strict=False
        ):
            seen.append(replace(path, points=listed_returns(truth.boxes, path, listed, ~known, frames)))
        name = f"{layout.root.name} {self._chosen() or ''}".strip()
        return assemble(name, times, truth.boxes, seen, self.detector, seed=seed, frames=frames)

    def _pairs(self, layout: Layout) -> list[Pair]:
        """The pairs of the requested frames, with times checked."""
        first, last = self.first_frame or 0, math.inf if self.last_frame is None else self.last_frame
        pairs = read_pairs(layout, self._chosen())
        chosen = [pair for pair in pairs if first <= frame_number(pair.vehicle) <= last]
        if not chosen:
            raise ConfigurationError(
                f"{layout.root}: first_frame {self.first_frame} to last_frame {self.last_frame}: found no frame, "
                f"expected some of {pairs[0].vehicle} to {pairs[-1].vehicle}"
            )
        names = [pair.vehicle for pair in chosen]
        times, difference = clocks(chosen)
        check_times(layout.clocks(VEHICLE), names, times, self.max_gap_s, "max_gap_s")
        check_differences(layout.clocks(INFRASTRUCTURE), names, "infra_1", difference, self.max_time_difference_s)
        return chosen


def _poses(layout: Layout, pairs: list[Pair]) -> tuple[LidarPoses, LidarPoses]:
    """Poses of the lidars of the car and of the pole."""
    car = [layout.vehicle_pose(pair) for pair in pairs]
    pole = [layout.infrastructure_pose(pair, rotation) for pair, (_, rotation) in zip(pairs, car, strict=True)]
    return LidarPoses(*map(np.array, zip(*car, strict=True))), LidarPoses(*map(np.array, zip(*pole, strict=True)))
