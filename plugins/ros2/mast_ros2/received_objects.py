"""Objects of ROS 2 as ours: Detection3DArray and DetectedObjects as detections, TrackedObjects as tracks.

A Detection3DArray with ids can be tracks, too, without velocities.

A message that is none raises an error. Objects that cannot be used are left out and counted by reason.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from mast_ros2 import type_store
from mast_ros2.object_messages import AUTOWARE_LABELS, id_of_text, id_of_uuid
from mast_ros2.spatial import MOST_METRES, frame_of, is_unit, pose_rows, time_of, turned, vector_rows
from mast_ros2.type_store import RosMessage
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import MessageError

#: Objects of a message, at most: a lidar detector has tens, and each costs.
MOST_OBJECTS = 1000
#: Largest length, width and height, m: a train of ten coaches.
MOST_SIZE_M = 300.0
#: Largest speed, m/s.
MOST_SPEED = 150.0
#: Why an object is left out that is faster.
TOO_FAST = f"velocity: beyond {MOST_SPEED:g} m/s"
#: Cosine of the largest angle between a box's upward axis and the vertical: our boxes stand upright.
_LEAST_UPRIGHT = float(np.cos(np.radians(45.0)))
#: The most negative eigenvalue of a covariance in relation to its largest one: rounding to float32.
_ROUNDING = 1e-5

#: Shapes of Autoware: the second and third have no box.
_CYLINDER, _POLYGON = 1, 2
_ORIENTATION_UNAVAILABLE = 0
#: Labels of Autoware that none of our classes has the same as: trailers are trucks.
_CLASS_OF_LABEL = {label: CLASS_INDEX[name] for name, label in AUTOWARE_LABELS.items()} | {4: CLASS_INDEX["truck"]}
#: Classes of detectors in other words.
_CLASS_OF_NAME: Mapping[str, int] = CLASS_INDEX | {
    other: CLASS_INDEX[name]
    for name, others in {
        "car": ("van",),
        "truck": ("trailer",),
        "motorcycle": ("motorbike", "motorcyclist"),
        "bicycle": ("bike", "cyclist"),
        "pedestrian": ("person",),
    }.items()
    for other in others
}

Objects = TypeVar("Objects", Detections, ObjectStates)


#: Standard deviations of positions, sizes and velocities that are assumed where a message has none: m, m, m/s.
ASSUMED_POSITION_M, ASSUMED_SIZE_M, ASSUMED_VELOCITY = 1.0, 0.5, 2.0


@dataclass(frozen=True, eq=False)
class ReceivedObjects(Generic[Objects]):
    """The objects of a message.

    frame_id: name of their frame of reference
    time_ns:  ns, of its header
    objects:  those that can be used
    rows:     (n,) where they are in the message
    dropped:  number of the others, by reason
    unclassified: number of objects with a class that is not ours; they are of the class unknown
    """

    frame_id: str
    time_ns: int
    objects: Objects
    rows: Ints
    dropped: Mapping[str, int]
    unclassified: int


def received_detections(message: RosMessage) -> ReceivedObjects[Detections]:
    """The detections of a Detection3DArray or of DetectedObjects, in the frame of its header.

    Of several hypotheses, the one with the highest score counts; a detection without any is of the class unknown, with
    score 1. Raises MessageError for another type, too many detections, or an invalid header.
    """
    read = {type_store.DETECTIONS: _vision_rows, type_store.DETECTED_OBJECTS: _detected_rows}
    if message.__msgtype__ not in read:
        raise MessageError(f"{message.__msgtype__}: expected {' or '.join(read)}")
    rows = read[message.__msgtype__](message)
    keep = rows.usable()
    objects = Detections(
        position=rows.position[keep],
        size=rows.size[keep],
        yaw=heading(rotation_from_quaternion(rows.quaternion[keep])),
        score=rows.score[keep],
        class_id=rows.class_id[keep],
        covariance=rows.position_covariance[keep],
    )
    return _received(message, objects, rows, keep)


def received_tracks(message: RosMessage) -> ReceivedObjects[ObjectStates]:
    """The tracks of TrackedObjects or of a Detection3DArray with ids, in the frame of its header.

    Where a covariance is 0, and for sizes, whose variances neither type has, some are assumed. The velocities of a
    Detection3DArray are 0, with such a covariance.

    Of several objects with one id, the first counts. Raises MessageError for another type, too many objects, or an
    invalid header.
    """
    read = {type_store.TRACKED_OBJECTS: _tracked_rows, type_store.DETECTIONS: _vision_tracks}
    if message.__msgtype__ not in read:
        raise MessageError(f"{message.__msgtype__}: expected {' or '.join(read)}")
    rows = read[message.__msgtype__](message)
    keep = rows.usable()
    rotation = rotation_from_quaternion(rows.quaternion[keep])
    covariance = np.zeros((int(keep.sum()), 9, 9))
    covariance[:, :3, :3] = _or_assumed(rows.position_covariance[keep], ASSUMED_POSITION_M)
    covariance[:, 3:6, 3:6] = np.eye(3) * ASSUMED_SIZE_M**2
    covariance[:, 6:, 6:] = _or_assumed(turned(rows.velocity_covariance[keep], rotation), ASSUMED_VELOCITY)
    objects = ObjectStates(
        id=rows.id[keep],
        position=rows.position[keep],
        velocity=(rotation @ rows.velocity[keep][:, :, None])[:, :, 0],
        size=rows.size[keep],
        yaw=heading(rotation),
        covariance=covariance,
        score=rows.score[keep],
        class_id=rows.class_id[keep],
    )
    return _received(message, objects, rows, keep)


def _received(message: RosMessage, objects: Objects, rows: _UncheckedRows, keep: Bools) -> ReceivedObjects[Objects]:
    return ReceivedObjects(
        frame_of(message.header.frame_id),
        time_of(message.header.stamp),
        objects,
        keep.nonzero()[0].astype(np.int64),
        dict(rows.dropped),
        int(np.count_nonzero(rows.unclassified & keep)),
    )


class _UncheckedRows:
    """What all types have: n objects as they are in the message, unchecked.

    id: (n,); position: (n, 3) m; quaternion: (n, 4) w x y z; size: (n, 3) m; score: (n,); class_id: (n,) uint8
    position_covariance: (n, 3, 3) m²
    velocity: (n, 3) m/s, velocity_covariance: (n, 3, 3) m²/s², in the axes of the object
    unclassified: (n,) whether the class is not ours;  named: (n,) whether it has an id, where ids are needed
    """

    def __init__(self, message: RosMessage, number: int) -> None:
        if number > MOST_OBJECTS:
            raise MessageError(f"{message.__msgtype__}: found {number} objects, expected at most {MOST_OBJECTS}")
        self.id: Ints = np.arange(number, dtype=np.int64)
        self.position, self.velocity, self.size = np.zeros((3, number, 3))
        self.quaternion = np.zeros((number, 4))
        self.score = np.ones(number)
        self.class_id = np.zeros(number, np.uint8)
        self.unclassified: Bools = np.zeros(number, bool)
        self.named: Bools = np.ones(number, bool)
        self.position_covariance, self.velocity_covariance = np.zeros((2, number, 3, 3))
        self.dropped: Counter[str] = Counter()

    def place(self, poses: Sequence[RosMessage]) -> None:
        """Set positions and quaternions."""
        values = pose_rows(poses)
        self.position, self.quaternion = values[:, :3], values[:, 3:]

    def classify(self, classes: Sequence[int | None]) -> None:
        """Set classes; None: not ours."""
        self.class_id = np.array([kind or 0 for kind in classes], np.uint8)
        self.unclassified = np.array([kind is None for kind in classes], bool)

    def usable(self) -> Bools:
        """(n,) mask of the objects that can be used; the others are counted."""
        keep = np.ones(len(self.id), bool)
        with np.errstate(all="ignore"):  # values may be anything
            for reason, valid in self._checks():
                self.dropped[reason] += int(np.count_nonzero(keep & ~valid))
                keep &= valid
            self.position_covariance = _symmetric(self.position_covariance)
            self.velocity_covariance = _symmetric(self.velocity_covariance)
            for reason, covariance in (
                ("covariance of the position", self.position_covariance),
                ("covariance of the velocity", self.velocity_covariance),
            ):
                valid = np.zeros(len(keep), bool)
                valid[keep] = _is_covariance(covariance[keep])
                self.dropped[f"{reason}: not positive semi-definite"] += int(np.count_nonzero(keep & ~valid))
                keep &= valid
        first = np.zeros(len(keep), bool)
        rows = keep.nonzero()[0]
        first[rows[np.unique(self.id[rows], return_index=True)[1]]] = True
        self.dropped["id: occurs twice"] += int(np.count_nonzero(keep & ~first))
        self.dropped = +self.dropped  # without reasons that did not occur
        return first

    def _checks(self) -> Iterator[tuple[str, Bools]]:
        """(reason, mask of the objects to which it does not apply), each for what the ones before let through."""
        finite = np.ones(len(self.id), bool)
        for values in (
            self.position,
            self.quaternion,
            self.size,
            self.velocity,
            self.score,
            self.position_covariance,
            self.velocity_covariance,
        ):
            finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        yield "a value is not finite", finite
        far = np.asarray(np.abs(self.position).max(axis=1) > MOST_METRES)
        yield f"position: beyond {MOST_METRES:g} m", ~far
        yield "orientation: a quaternion whose length is not 1", is_unit(self.quaternion)
        upright = 1.0 - 2.0 * (self.quaternion[:, 1:3] ** 2).sum(axis=1)  # z of the upward axis
        yield "orientation: the box is tilted by more than 45 degrees", np.asarray(upright >= _LEAST_UPRIGHT)
        sizes = (self.size > 0.0) & (self.size <= MOST_SIZE_M)
        yield f"size: not above 0 and at most {MOST_SIZE_M:g} m", np.asarray(sizes.all(axis=1))
        speed = np.linalg.norm(self.velocity, axis=1)
        yield TOO_FAST, np.asarray(speed <= MOST_SPEED)
        yield "score: not from 0 to 1", (self.score >= 0.0) & (self.score <= 1.0)
        yield "id: none", self.named


def _vision_rows(message: RosMessage) -> _UncheckedRows:
    detections = message.detections
    rows = _UncheckedRows(message, len(detections))
    best = [max(each.results, key=lambda result: result.hypothesis.score, default=None) for each in detections]
    rows.place([each.bbox.center for each in detections])
    rows.size = vector_rows([each.bbox.size for each in detections])
    rows.score = np.array([1.0 if result is None else result.hypothesis.score for result in best], np.float64)
    rows.classify(
        [
            CLASS_INDEX["unknown"] if result is None else _CLASS_OF_NAME.get(result.hypothesis.class_id.strip().lower())
            for result in best
        ]
    )
    rows.position_covariance = _of_positions(
        [np.zeros(36) if result is None else result.pose.covariance for result in best]
    )
    return rows


def _vision_tracks(message: RosMessage) -> _UncheckedRows:
    rows = _vision_rows(message)
    rows.id = np.array([id_of_text(each.id) for each in message.detections], np.int64)
    rows.named = np.array([each.id != "" for each in message.detections], bool)
    return rows


def _autoware_rows(message: RosMessage) -> _UncheckedRows:
    """What detected and tracked objects have in common."""
    objects = message.objects
    rows = _UncheckedRows(message, len(objects))
    rows.place([each.kinematics.pose_with_covariance.pose for each in objects])
    rows.score = np.array([each.existence_probability for each in objects], np.float64)
    rows.size = vector_rows([each.shape.dimensions for each in objects])
    rows.position_covariance = _of_positions([each.kinematics.pose_with_covariance.covariance for each in objects])
    best = [max(each.classification, key=lambda kind: kind.probability, default=None) for each in objects]
    rows.classify([CLASS_INDEX["unknown"] if kind is None else _CLASS_OF_LABEL.get(kind.label) for kind in best])
    for row, each in enumerate(objects):
        if each.kinematics.orientation_availability == _ORIENTATION_UNAVAILABLE:
            rows.quaternion[row] = [1.0, 0.0, 0.0, 0.0]
        if each.shape.type == _CYLINDER:
            rows.size[row, 1] = rows.size[row, 0]
        elif each.shape.type == _POLYGON:
            _enclose(rows, row, each.shape.footprint.points)
    return rows


def _detected_rows(message: RosMessage) -> _UncheckedRows:
    rows = _autoware_rows(message)
    has_covariance = [each.kinematics.has_position_covariance for each in message.objects]
    rows.position_covariance[~np.array(has_covariance, bool)] = 0.0
    return rows


def _tracked_rows(message: RosMessage) -> _UncheckedRows:
    rows, objects = _autoware_rows(message), message.objects
    rows.id = np.array([id_of_uuid(each.object_id.uuid.tobytes()) for each in objects], np.int64)
    twists = [each.kinematics.twist_with_covariance for each in objects]
    rows.velocity = vector_rows([each.twist.linear for each in twists])
    rows.velocity_covariance = _of_positions([each.covariance for each in twists])
    return rows


def _enclose(rows: _UncheckedRows, row: int, points: Sequence[RosMessage]) -> None:
    """Put the box of an object around its footprint, which is in the object's axes; without points it has no size."""
    corners = np.array([(point.x, point.y) for point in points], np.float64).reshape(-1, 2)
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else np.zeros((2, 2))
    rows.size[row, :2] = high - low
    if np.isfinite(corners).all() and is_unit(rows.quaternion[row]):
        centre = np.append((low + high) / 2, 0.0)
        rows.position[row] += rotation_from_quaternion(rows.quaternion[row]) @ centre


def _of_positions(covariances: Sequence[Floats]) -> Floats:
    """(n, 3, 3) upper left corners of n covariances of 36 numbers."""
    return np.array(covariances, np.float64).reshape(-1, 6, 6)[:, :3, :3].copy()


def _symmetric(covariance: Floats) -> Floats:
    return (covariance + np.swapaxes(covariance, 1, 2)) / 2


def _is_covariance(covariance: Floats) -> Bools:
    """(n,) whether (n, 3, 3) are positive semi-definite up to rounding, with values that are not absurd."""
    within = np.abs(covariance).max(axis=(1, 2), initial=0.0) <= MOST_METRES
    values = np.linalg.eigvalsh(np.where(within[:, None, None], covariance, 0.0))
    return np.asarray(within & (values[:, 0] >= -_ROUNDING * values[:, -1]))


def _or_assumed(covariance: Floats, assumed: float) -> Floats:
    """Covariances (n, 3, 3); where a variance is 0, that of an assumed standard deviation."""
    result = covariance.copy()
    axes = np.arange(3)
    missing = result[:, axes, axes] <= 0.0
    result[missing[:, :, None] | missing[:, None, :]] = 0.0
    result[:, axes, axes] += missing * assumed**2
    return result
