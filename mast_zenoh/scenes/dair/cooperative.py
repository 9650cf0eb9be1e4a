"""Cooperative labels of a car and a pole: the truth, and who saw what."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import along_and_across, heading, rotation_from_yaw, to_world
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.dair.labels import box, class_of, dimensions, location, read_labels, track_of
from mast_zenoh.scenes.dair.layout import Layout, Pair
from mast_zenoh.scenes.dair.tracks import linked, matched, numbered
from mast_zenoh.scenes.files.elements import Element
from mast_zenoh.scenes.making.assembly import ground_level
from mast_zenoh.scenes.making.boxes import Boxes

_UNSEEN = "-1"  # in place of the name of a side's track
_REFERENCES = ("veh_track_id", "inf_track_id")
#: The data sets give neither the size of the car nor the height of its lidar.
_CAR_SIZE = np.array([4.8, 1.9, 1.6])
_LIDAR_HEIGHT_M = (1.0, 4.0)  # above the ground; estimated from the boxes nearby, within these limits


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a lidar in the world: position (F, 3) m, rotation (F, 3, 3) active."""

    position: Floats
    rotation: Floats


@dataclass(frozen=True, eq=False)
class Truth:
    """N boxes, and which agents see them.

    seen:  (N, A) whether the data lists the box for the agent
    known: (N, A) whether the data says anything about it
    """

    boxes: Boxes
    seen: Bools
    known: Bools


def labelled_boxes(frame: int, labels: list[Element], pose: tuple[Floats, Floats] | None) -> Boxes:
    """The boxes of a frame's labels in the world frame, without ids (0).

    pose: position (3,) and rotation (3, 3) of the frame of the labels; None: they are in the world frame
    """
    found = [box(label) for label in labels]
    n = len(found)
    position = np.array([middle for middle, _, _ in found]).reshape(n, 3)
    yaw = np.array([angle for _, _, angle in found])
    if pose is not None:
        position = to_world(position, *pose)
        yaw = np.array([float(heading(pose[1] @ rotation_from_yaw(angle))) for angle in yaw])
    return Boxes(
        frame=np.full(n, frame, np.int64),
        id=np.zeros(n, np.int64),
        position=position,
        size=np.array([size for _, size, _ in found]).reshape(n, 3),
        yaw=yaw,
        class_id=np.array([class_of(label) for label in labels], np.uint8),
        velocity=np.full((n, 3), np.nan),
    )


def positions(labels: list[Element], position: Floats, rotation: Floats) -> Floats:
    """(n, 3) m of a side's labels in the world frame. Those without a 3D box (a size is 0) are left out."""
    local = [location(label) for label in labels if dimensions(label).min() > 0]
    return to_world(np.array(local).reshape(len(local), 3), position, rotation)


def read_truth(
    layout: Layout, pairs: list[Pair], car: Poses, pole: Poses, times_ns: Ints, match_m: float, link_m: float | None
) -> Truth:
    """The cooperative labels of a sequence in the world frame; agents are the car and the pole.

    match_m: of labels without references to the sides' tracks; link_m: of labels without ids, None: refused
    """
    boxes, seen, names, files = [], [], [], []
    for frame, pair in enumerate(pairs):
        file = layout.cooperative_labels(pair)
        labels = read_labels(file)
        pose = car.position[frame], car.rotation[frame]
        boxes.append(labelled_boxes(frame, labels, None if layout.in_world else pose))
        sides = (
            _Side(layout.vehicle_labels(pair), *pose, _REFERENCES[0]),
            _Side(layout.infrastructure_labels(pair), pole.position[frame], pole.rotation[frame], _REFERENCES[1]),
        )
        seen.append(np.stack([side.sees(labels, boxes[-1].position, match_m) for side in sides], axis=1))
        names += [track_of(label) for label in labels]
        files += [f"{file}: {label.place}" for label in labels]
    everything = Boxes.concatenate(boxes)
    if not len(everything):
        folder = layout.cooperative_labels(pairs[0]).parent
        raise SceneError(f"{folder}: found no labels in {len(pairs)} frames, expected at least one")
    ids = _ids(names, files, everything, times_ns, link_m)
    known = np.ones((len(everything), 2), bool)
    return Truth(replace(everything, id=ids), np.concatenate(seen), known)


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
        seen = near.copy()
        for row, (label, element) in enumerate(zip(cooperative, references, strict=True)):
            if element is None:
                continue
            name = track_of(label, self.reference)
            seen[row] = name != _UNSEEN
            if seen[row] and name not in tracks:
                element.fail(f"-1, or the track of a label in {self.path}")
        return seen


def _ids(names: list[str], places: list[str], boxes: Boxes, times_ns: Ints, link_m: float | None) -> Ints:
    """Ids (N,) from the names of tracks, or by linking boxes if there are none at all."""
    if all(names):
        return numbered(names)
    if any(names) or link_m is None:
        without = places[names.index("")]
        raise SceneError(
            f"{without}: track_id is missing, expected one in every label: without, no object can be followed over "
            "time. DAIR-V2X-C has none; link_radius_m makes ids by distance, see docs/scenes_dair.md"
        )
    return linked(boxes.frame, boxes.position, boxes.class_id.astype(np.int64), times_ns, link_m)


def with_car(truth: Truth, car: Poses) -> tuple[Truth, int]:
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
    added = Boxes.throughout(object_id, middle, _CAR_SIZE, heading(car.rotation), CLASS_INDEX["car"])
    seen = np.column_stack([np.zeros(frames, bool), seen_by_pole])
    known = np.column_stack([np.ones(frames, bool), np.full(frames, own.any())])
    return (
        Truth(
            Boxes.concatenate([rest, added]),
            np.concatenate([truth.seen[~own], seen]),
            np.concatenate([truth.known[~own], known]),
        ),
        object_id,
    )


def _enclosing(boxes: Boxes, position: Floats) -> Ints:
    """Ids of the tracks whose boxes enclose a position (F, 3), on the ground, in at least half of their frames."""
    offset = position[boxes.frame, :2] - boxes.position[:, :2]
    inside = (np.abs(along_and_across(offset, boxes.yaw)) <= boxes.size[:, :2] / 2).all(axis=1)
    ids, index, count = np.unique(boxes.id, return_inverse=True, return_counts=True)
    enclosing: Ints = ids[2 * np.bincount(index, weights=inside, minlength=len(ids)) >= count]
    return enclosing


def _lidar_height(boxes: Boxes, position: Floats) -> float:
    """Height m of the car's lidar at (F, 3) above the ground, estimated from the boxes nearby."""
    ground = np.array([ground_level(boxes, place) for place in position[:, :2]])
    return float(np.clip(np.median(position[:, 2] - ground), *_LIDAR_HEIGHT_M))
