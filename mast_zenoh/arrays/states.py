"""Columnar object states: one array per quantity, one row per object; and orders of rows.

The orders do not depend on the original order of the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.kernels import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Object classes; a message carries the index into this tuple.
CLASSES = ("unknown", "car", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
CLASS_INDEX = {name: index for index, name in enumerate(CLASSES)}

#: Order of the rows and columns of every covariance.
COVARIANCE_ORDER = ("x", "y", "z", "l", "w", "h", "vx", "vy", "vz")


@dataclass(frozen=True, slots=True)
class ObjectStates:
    """n objects in one frame of reference, the world frame by default.

    Frames are right-handed, x forward/east, z up.

    id:         (n,) int64, unique within one producer
    position:   (n, 3) float64, m, centre of the box
    velocity:   (n, 3) float64, m/s
    size:       (n, 3) float64, m, length width height
    yaw:        (n,) float64, rad, heading of the length axis, counter-clockwise from x
    covariance: (n, 9, 9) float64, of [x y z l w h vx vy vz]
    score:      (n,) float64, in [0, 1], evidence that the object exists: ranks objects
    (docs/explanation-tracking-and-fusion.md, "Ranking")
    class_id:   (n,) uint8, index into CLASSES
    """

    id: Ints
    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats
    covariance: Floats
    score: Floats
    class_id: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.id)

    @classmethod
    def empty(cls) -> ObjectStates:
        """No objects."""
        return _NO_STATES

    @classmethod
    def of(
        cls,
        position: Floats,
        *,
        id: Ints | None = None,
        velocity: Floats | None = None,
        size: Floats | None = None,
        yaw: Floats | None = None,
        covariance: Floats | None = None,
        score: Floats | None = None,
        class_id: NDArray[np.uint8] | None = None,
    ) -> ObjectStates:
        """States at `position` (n, 3); defaults: ids from 0, scores 1, all else 0."""
        n = len(position)
        return cls(
            id=np.arange(n, dtype=np.int64) if id is None else np.asarray(id, np.int64),
            position=np.asarray(position, np.float64).reshape(n, 3),
            velocity=np.zeros((n, 3)) if velocity is None else np.asarray(velocity, np.float64),
            size=np.zeros((n, 3)) if size is None else np.asarray(size, np.float64),
            yaw=np.zeros(n) if yaw is None else np.asarray(yaw, np.float64),
            covariance=np.zeros((n, 9, 9)) if covariance is None else np.asarray(covariance, np.float64),
            score=np.ones(n) if score is None else np.asarray(score, np.float64),
            class_id=np.zeros(n, np.uint8) if class_id is None else np.asarray(class_id, np.uint8),
        )

    @classmethod
    def from_columns(cls, columns: Mapping[str, NDArray[Any]]) -> ObjectStates:
        """The states in a message body (other columns are left out)."""
        return cls(*_pick_states(columns))

    def columns(self) -> dict[str, NDArray[Any]]:
        """The states as message columns, by name; the arrays are shared, not copied."""
        return {  # written out: this is done for every message, and several times
            "id": self.id,
            "position": self.position,
            "velocity": self.velocity,
            "size": self.size,
            "yaw": self.yaw,
            "covariance": self.covariance,
            "score": self.score,
            "class_id": self.class_id,
        }

    def select(self, index: NDArray[Any] | slice) -> ObjectStates:
        """The rows that a mask, an index array or a slice picks."""
        rows = index if isinstance(index, slice) or index.dtype != bool else index.nonzero()[0]
        if not isinstance(rows, slice) and len(rows) == 0:
            return _NO_STATES
        return ObjectStates(*_rows(_states_of(self), rows))

    def with_(self, **columns: NDArray[Any]) -> ObjectStates:
        """A copy with some columns replaced."""
        return ObjectStates(**self.columns() | columns)


@dataclass(frozen=True, slots=True)
class Detections:
    """n detections of one sensor in one frame.

    In the sensor frame or, after `sensing.to_world`, in the world frame.

    position:   (n, 3) float64, m, centre of the box
    size:       (n, 3) float64, m, length width height
    yaw:        (n,) float64, rad, about the world's vertical; in the sensor frame less the sensor's heading
    score:      (n,) float64, confidence in [0, 1]
    class_id:   (n,) uint8, index into CLASSES
    covariance: (n, 3, 3) float64, m^2, of the position; all zero where the detector gives none
    """

    position: Floats
    size: Floats
    yaw: Floats
    score: Floats
    class_id: NDArray[np.uint8]
    covariance: Floats

    def __len__(self) -> int:
        return len(self.yaw)

    @classmethod
    def empty(cls) -> Detections:
        """No detections."""
        return _NO_DETECTIONS

    @classmethod
    def from_columns(cls, columns: Mapping[str, NDArray[Any]]) -> Detections:
        """The detections in a message body (other columns are left out)."""
        return cls(*_pick_detections(columns))

    @classmethod
    def joined(cls, parts: Sequence[Detections]) -> Detections:
        """All rows of one part or more, in order."""
        return cls(*[np.concatenate(columns) for columns in zip(*map(_detections_of, parts), strict=True)])

    def columns(self) -> dict[str, NDArray[Any]]:
        """The detections as message columns, by name; the arrays are shared, not copied."""
        return dict(zip(DETECTION_COLUMNS, _detections_of(self), strict=True))

    def select(self, index: NDArray[Any] | slice) -> Detections:
        """The rows that a mask, an index array or a slice picks."""
        return Detections(*_rows(_detections_of(self), index))


def _rows(columns: tuple[NDArray[Any], ...], index: NDArray[Any] | slice) -> list[NDArray[Any]]:
    """The rows of each column that a mask, an index array or a slice picks."""
    if isinstance(index, slice):
        return [column[index] for column in columns]
    if index.dtype == bool:
        index = index.nonzero()[0]
    return [column.take(index, 0) for column in columns]


STATE_COLUMNS = tuple(field.name for field in fields(ObjectStates))
DETECTION_COLUMNS = tuple(field.name for field in fields(Detections))
#: All columns of one object, or of one message body, in one call.
_states_of, _pick_states = attrgetter(*STATE_COLUMNS), itemgetter(*STATE_COLUMNS)
_detections_of, _pick_detections = attrgetter(*DETECTION_COLUMNS), itemgetter(*DETECTION_COLUMNS)
_NO_STATES = ObjectStates.of(np.zeros((0, 3)))
_NO_DETECTIONS = Detections(
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, np.uint8), np.zeros((0, 3, 3))
)


def concatenate(parts: Sequence[ObjectStates]) -> ObjectStates:
    """All rows of `parts`, in order; a single non-empty part is not copied."""
    filled = [part for part in parts if len(part)]
    if len(filled) < 2:
        return filled[0] if filled else ObjectStates.empty()
    return ObjectStates(*[np.concatenate(columns) for columns in zip(*map(_states_of, filled), strict=True)])


def propagate(states: ObjectStates, dt: float) -> ObjectStates:
    """Move objects `dt` seconds at constant velocity, without process noise."""
    if len(states) == 0 or dt == 0.0:
        return states
    position, covariance = constant_velocity(states.position, states.velocity, states.covariance, dt)
    return states.with_(position=position, covariance=covariance)


@kernel
def constant_velocity(position: Floats, velocity: Floats, covariance: Floats, dt: float) -> tuple[Floats, Floats]:
    """Predict (n, 3) positions and (n, 9, 9) covariances as in `propagate`."""
    transition = np.eye(9)
    transition[0:3, 6:9] = np.eye(3) * dt
    return position + velocity * dt, transition @ covariance @ transition.T


#: Number of rows up to which sorting is faster than checking whether they are sorted.
_FEW = 256


def row_order(*keys: NDArray[Any], ties: Callable[[], Iterable[NDArray[Any]]] | None = None) -> Ints:
    """(n,) row indices sorting by `keys` (n,), then by those of `ties`; the last comes first.

    The same as `np.lexsort((*ties(), *keys))`, but faster if the rows are sorted already or no two keys are equal.
    """
    if len(keys) > 1 and len(keys[0]) > _FEW:
        if ascending(*keys):
            return np.arange(len(keys[0]), dtype=np.int64)
        order = keys[-1].argsort(kind="stable")
        if ascending(*[key.take(order) for key in keys]):
            return order.astype(np.int64)
    order, tied = sorted_rows(keys)
    if tied and ties is not None:
        order = np.lexsort((*ties(), *keys))
    return order.astype(np.int64, copy=False)


@kernel
def sorted_rows(keys: tuple[NDArray[Any], ...]) -> tuple[Ints, bool]:
    """(n,) row indices that sort by `keys` (n,), the last comes first, and whether two rows have the same."""
    order = np.lexsort(keys)
    ordered = [key.take(order) for key in keys]
    equal = np.ones(max(len(order) - 1, 0), bool)
    for key in ordered:
        equal &= key[1:] == key[:-1]
    return order, bool(np.count_nonzero(equal))


def ascending(*keys: NDArray[Any]) -> bool:
    """Whether rows are in strictly ascending order of `keys` (n,), last key first."""
    n = max(len(keys[0]) - 1, 0)
    later, equal = np.zeros(n, bool), np.ones(n, bool)
    for key in keys[::-1]:
        later |= equal & (key[1:] > key[:-1])
        equal &= key[1:] == key[:-1]
    return bool(later.all())


def within_runs(count: Ints) -> Ints:
    """0 to count - 1 for each of k runs of rows, one run after the other: (sum of count,)."""
    return np.asarray(np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count))


#: Of so many values, one is in a sample.
_SAMPLED = 16


def lowest_rows(keys: Sequence[NDArray[Any]], count: int) -> Ints:
    """(count,) rows, ascending: the lowest of n > count by the first of `keys` (n,), then by the next; in linear time.

    Rows that are equal in all keys come in their order. Fewer if a key is not a number.
    """
    if count <= 0:
        return np.zeros(0, np.int64)
    candidates, kept = np.arange(len(keys[0])), []
    for key in keys:
        values = key[candidates]
        cutoff = values.min()  # often many share it, and nothing needs sorting
        if np.count_nonzero(values == cutoff) < count:
            cutoff = _nth_lowest(values, count)
        below = candidates[values < cutoff]
        kept.append(below)
        count -= len(below)
        candidates = candidates[values == cutoff]
        if len(candidates) <= count:
            break
    return np.sort(np.concatenate([*kept, candidates[:count]]))


def _nth_lowest(values: NDArray[Any], n: int) -> Any:
    """The n-th lowest of values (m,), m >= n."""
    sample = values[::_SAMPLED]
    if n <= len(sample):  # the n-th lowest of some is no lower than that of all: few remain to be compared
        low = values[values <= np.partition(sample, n - 1)[n - 1]]
        values = low if len(low) >= n else values  # all are not numbers
    return np.partition(values, n - 1)[n - 1]


def by_agent(states: ObjectStates, agent: Ints) -> Ints:
    """(n,) row indices that sort tracks by (agent, id); by position where a faulty source uses an id twice.

    agent: (n,)
    """
    return row_order(states.id, agent, ties=lambda: states.position.T)


def canonical_order(objects: ObjectStates, source: Ints | None = None) -> Ints:
    """(n,) row indices that sort objects by their columns, then by source.

    The order of the columns is position, velocity, size, yaw, score, class and id.

    The id comes last because objects converted from detections only have row numbers as ids.
    source: (n,) int64, where each row came from. Draws and matches made in this order are the same for every
    permutation of the rows.
    """
    o = objects

    def ties() -> list[NDArray[Any]]:
        keys = [*o.position.T[1:], *o.velocity.T, *o.size.T, o.yaw, o.score, o.class_id, o.id]
        return ([] if source is None else [source]) + keys[::-1]

    return row_order(o.position[:, 0], ties=ties)
