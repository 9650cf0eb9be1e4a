"""Perceived objects of a CPM as columns of integers in the standard's units: PerceivedObject, TS 102 894-2 v2.4.1.

Axes: PerceivedObjects of TS 103 324 v2.1.1 has x to the east, y to the north and z up, from the message's reference
position. Angles turn by the right-hand rule from the x-axis, as CartesianAngleValue says.

Perception quality of objects, as messages of Collective Perception carry it: 0 to 15.

There is no probability of existence in these messages; receivers see this number instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.v2x.asn1.cdd import ObjectClassWithConfidence, PerceivedObject
from mast_zenoh.v2x.asn1.layout import slot_of, width
from mast_zenoh.v2x.asn1.uper import Values

#: In place of the value of an optional field that is absent.
ABSENT = -(1 << 31)

#: Alternatives of a velocity: magnitude, direction, z; or x, y, z.
POLAR, CARTESIAN = 0, 1
#: Alternatives of ObjectClass, and of VruProfileAndSubprofile.
VEHICLE, VRU, GROUP, OTHER = range(4)
PEDESTRIAN, BICYCLIST, MOTORCYCLIST, ANIMAL = range(4)

#: An optional field is named with "?"; mandatory ones stand in the place of the object id, which is always present.
_ALWAYS = "objectId?"


def _with_confidence(attribute: str, *fields: tuple[str, str]) -> dict[str, list[tuple[str, str]]]:
    """Columns of values, then of their confidences; fields: path, and optional field that it is part of"""
    return {
        name: [(f"{path}.{part}", optional) for path, optional in fields]
        for name, part in ((attribute, "value"), (f"{attribute}_confidence", "confidence"))
    }


#: For each attribute its columns: the path of each value, and of the optional field that it is part of. The slots of a
#: polar velocity are those of a cartesian one.
_FIELDS: dict[str, list[tuple[str, str]]] = {
    "id": [("objectId", _ALWAYS)],
    "delta_time": [("measurementDeltaTime", _ALWAYS)],
    **_with_confidence(
        "position",
        ("position.xCoordinate", _ALWAYS),
        ("position.yCoordinate", _ALWAYS),
        ("position.zCoordinate", "position.zCoordinate?"),
    ),
    "velocity_form": [("velocity", "velocity?")],
    **_with_confidence(
        "velocity",
        ("velocity.cartesianVelocity.xVelocity", "velocity?"),
        ("velocity.cartesianVelocity.yVelocity", "velocity?"),
        ("velocity.cartesianVelocity.zVelocity", "velocity.cartesianVelocity.zVelocity?"),
    ),
    **_with_confidence("yaw", ("angles.zAngle", "angles?")),
    **_with_confidence("dimensions", *((f"objectDimension{axis}", f"objectDimension{axis}?") for axis in "XYZ")),
    "quality": [("objectPerceptionQuality", "objectPerceptionQuality?")],
}
_COLUMNS = [field for fields in _FIELDS.values() for field in fields]
_FIRST = dict(zip(_FIELDS, np.cumsum([0, *map(len, _FIELDS.values())]).tolist(), strict=False))


def _slots(paths: list[str]) -> Values:
    return np.array([slot_of(PerceivedObject, path) for path in paths], np.int64)


#: For each column: the slot of its value, and of the presence of the optional field that it is part of.
_VALUE = _slots([path for path, _ in _COLUMNS])
_PRESENCE = _slots([optional for _, optional in _COLUMNS])
#: Slots of presence, and the column that decides each: the first of the field.
_FLAGS, _DECIDERS = np.unique(_PRESENCE, return_index=True)

_CLASSES = slot_of(PerceivedObject, "classification")
#: Places of ObjectClassWithConfidence: alternative, contents (of a VRU its alternative, then the subprofile).
_CLASS_WIDTH = width(ObjectClassWithConfidence)
_CONFIDENCE = slot_of(ObjectClassWithConfidence, "confidence")

WIDTH = width(PerceivedObject)


class _Column:
    """A column of `PerceivedObjects`, or several neighbours, as a view."""

    def __set_name__(self, owner: type, name: str) -> None:
        first, n = _FIRST[name], len(_FIELDS[name])
        self._columns = first if n == 1 else slice(first, first + n)

    @overload
    def __get__(self, instance: None, owner: type) -> _Column: ...
    @overload
    def __get__(self, instance: PerceivedObjects, owner: type) -> Values: ...
    def __get__(self, instance: PerceivedObjects | None, owner: type) -> Values | _Column:
        return self if instance is None else instance.table[:, self._columns]


@dataclass(frozen=True, eq=False)
class PerceivedObjects:
    """n objects; what is absent is `ABSENT`.

    table: (n, k) int64; the attributes below are its columns, as views
    classes: (m, 5) hypotheses by object: row in the table, alternative of ObjectClass, alternative of the VRU profile
        (else `ABSENT`), subclass (not of a group), confidence in percent
    """

    table: Values
    classes: Values

    #: (n,) object id; measurement time after the reference time, ms
    id = _Column()
    delta_time = _Column()
    #: (n, 3) centre of the box and 95 % confidence, 0.01 m
    position = _Column()
    position_confidence = _Column()
    #: (n,) POLAR or CARTESIAN; (n, 3) 0.01 m/s, a direction 0.1 deg
    velocity_form = _Column()
    velocity = _Column()
    velocity_confidence = _Column()
    #: (n,) about z, 0.1 deg
    yaw = _Column()
    yaw_confidence = _Column()
    #: (n, 3) along x, y, z of the box: length, width, height, 0.1 m
    dimensions = _Column()
    dimensions_confidence = _Column()
    #: (n,) perception quality 0..15
    quality = _Column()

    @classmethod
    def empty(cls, n: int) -> PerceivedObjects:
        """n objects of which nothing is present, to be filled in."""
        table = np.full((n, len(_COLUMNS)), ABSENT, np.int64)
        return cls(table, np.zeros((0, 5), np.int64))

    def __len__(self) -> int:
        return len(self.table)

    def take(self, rows: Values) -> PerceivedObjects:
        """Some of the objects, by ascending row."""
        place = np.full(len(self), -1)
        place[rows] = np.arange(len(rows))
        classes = self.classes[place[self.classes[:, 0]] >= 0]
        classes[:, 0] = place[classes[:, 0]]
        return PerceivedObjects(self.table[rows], classes)


def to_rows(objects: PerceivedObjects, start: int) -> Values:
    """Rows of the objects and then of their classes, as flat values (see `layout`) that begin at slot `start`."""
    table, classes, n = objects.table, objects.classes, len(objects)
    first = n * WIDTH
    values = np.zeros(first + len(classes) * _CLASS_WIDTH, np.int64)
    rows = values[:first].reshape(n, WIDTH)
    rows[:, _FLAGS] = table.take(_DECIDERS, axis=1) != ABSENT
    rows[:, _VALUE] = np.where(rows.take(_PRESENCE, axis=1), table, 0)
    out = values[first:].reshape(-1, _CLASS_WIDTH)
    owner, kind, profile, subclass, confidence = classes.T
    vru = kind == VRU
    out[:, 0], out[:, _CONFIDENCE] = kind, confidence
    out[:, 1], out[:, 2] = np.where(vru, profile, subclass), np.where(vru, subclass, 0)
    counts = np.bincount(owner, minlength=n)
    rows[:, _CLASSES - 1], rows[:, _CLASSES] = counts > 0, counts
    rows[:, _CLASSES + 1] = np.where(counts, start + first + _CLASS_WIDTH * (np.cumsum(counts) - counts), 0)
    return values


def from_rows(values: Values, start: int, n: int) -> PerceivedObjects:
    """Objects from flat values."""
    rows = values[start : start + n * WIDTH].reshape(n, WIDTH)
    table = rows.take(_VALUE, axis=1)
    table[rows.take(_PRESENCE, axis=1) == 0] = ABSENT
    counts = rows[:, _CLASSES]
    owner = np.repeat(np.arange(n), counts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    place = rows[owner, _CLASSES + 1] + _CLASS_WIDTH * number
    out = values[place[:, None] + np.arange(_CLASS_WIDTH)]
    kind = out[:, 0]
    vru = kind == VRU
    profile, subclass = np.where(vru, out[:, 1], ABSENT), np.where(vru, out[:, 2], out[:, 1])
    classes = np.empty((len(owner), 5), np.int64)
    classes.T[:] = owner, kind, profile, subclass, out[:, _CONFIDENCE]
    return PerceivedObjects(table, classes)


MAX_QUALITY = 15  #: of objectPerceptionQuality (TS 102 894-2 v2.2.1)


def quality_of_score(score: Floats) -> Ints:
    """(n,) quality, 0 to 15, of scores (n,) in [0, 1]."""
    return np.rint(np.clip(score, 0.0, 1.0) * MAX_QUALITY).astype(np.int64)
