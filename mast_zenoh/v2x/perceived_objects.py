"""Perceived objects of a CPM as columns of integers in the standard's units: PerceivedObject, TS 102 894-2 v2.4.1.

Axes: PerceivedObjects of TS 103 324 v2.1.1 has x to the east, y to the north and z up, from the message's reference
position. Angles turn by the right-hand rule from the x-axis, as CartesianAngleValue says.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import overload

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import correlations
from mast_zenoh.v2x.asn1.cdd import ObjectClassWithConfidence, PerceivedObject
from mast_zenoh.v2x.asn1.codec_kernels import Values
from mast_zenoh.v2x.asn1.layout import extension_slot, slot_of, width

#: In place of the value of an optional field that is absent.
ABSENT = -(1 << 31)

#: Alternatives of a velocity or acceleration: magnitude, direction, z; or x, y, z.
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


def _vector(attribute: str, axis: str) -> dict[str, list[tuple[str, str]]]:
    """Columns of a velocity or acceleration; the slots of its polar form are the same."""
    path = f"{attribute}.cartesian{axis}"
    z = f"{path}.z{axis}"
    return {f"{attribute}_form": [(attribute, f"{attribute}?")]} | _with_confidence(
        attribute, (f"{path}.x{axis}", f"{attribute}?"), (f"{path}.y{axis}", f"{attribute}?"), (z, f"{z}?")
    )


#: For each attribute its columns: the path of each value, and of the optional field that it is part of.
_FIELDS: dict[str, list[tuple[str, str]]] = {
    "id": [("objectId", _ALWAYS)],
    "delta_time": [("measurementDeltaTime", _ALWAYS)],
    **_with_confidence(
        "position",
        ("position.xCoordinate", _ALWAYS),
        ("position.yCoordinate", _ALWAYS),
        ("position.zCoordinate", "position.zCoordinate?"),
    ),
    **_vector("velocity", "Velocity"),
    **_vector("acceleration", "Acceleration"),
    **_with_confidence(
        "angles", ("angles.zAngle", "angles?"), ("angles.yAngle", "angles.yAngle?"), ("angles.xAngle", "angles.xAngle?")
    ),
    "yaw_rate": [("zAngularVelocity.value", "zAngularVelocity?")],
    "yaw_rate_confidence": [("zAngularVelocity.confidence", "zAngularVelocity?")],
    **_with_confidence("dimensions", *((f"objectDimension{axis}", f"objectDimension{axis}?") for axis in "XYZ")),
    "age": [("objectAge", "objectAge?")],
    "quality": [("objectPerceptionQuality", "objectPerceptionQuality?")],
}
_COLUMNS = [field for fields in _FIELDS.values() for field in fields]
_FIRST = dict(zip(_FIELDS, np.cumsum([0, *map(len, _FIELDS.values())]).tolist(), strict=False))


def _slots(paths: list[str]) -> Values:
    return np.array([slot_of(PerceivedObject, path) for path in paths], np.int64)


#: For each column: the slot of its value, and of the presence of the optional field that it is part of.
_VALUE = _slots([path for path, _ in _COLUMNS])
_PRESENCE = _slots([optional for _, optional in _COLUMNS])
#: For each column the first column of the same optional field, and of the optional field around that: both must be
#: present. Then the slots of presence, and the column that decides each.
_OPTIONAL = [optional for _, optional in _COLUMNS]
_AROUND = [f"{optional.split('.')[0].removesuffix('?')}?" for optional in _OPTIONAL]
_LEAD = np.array([_OPTIONAL.index(optional) for optional in _OPTIONAL])
_OUTER = np.array([_OPTIONAL.index(around if around in _OPTIONAL else _ALWAYS) for around in _AROUND])
_FLAGS = _slots(list(dict.fromkeys(_OPTIONAL)))
_DECIDERS = np.array([_OPTIONAL.index(optional) for optional in dict.fromkeys(_OPTIONAL)])

#: Slots of lists, and names and slots of presence of what has no column.
_CLASSES, _SENSORS = slot_of(PerceivedObject, "classification"), slot_of(PerceivedObject, "sensorIdList")
_CORRELATIONS = slot_of(PerceivedObject, "lowerTriangularCorrelationMatrices")
_OTHERS = ("mapPosition", "perceivedObjects.+")
_OTHER_SLOTS = np.array([slot_of(PerceivedObject, "mapPosition?"), extension_slot(PerceivedObject)])
#: Places of ObjectClassWithConfidence: alternative, contents (of a VRU its alternative, then the subprofile).
_CLASS_WIDTH = width(ObjectClassWithConfidence)
_CONFIDENCE = slot_of(ObjectClassWithConfidence, "confidence")
_CARDINALITY = slot_of(ObjectClassWithConfidence, "objectClass.groupSubClass.clusterCardinalitySize")

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
        (else `ABSENT`), subclass (of a group its cardinality), confidence in percent
    sensors: (m, 2) by object: row in the table, sensor id
    correlations: (m, 5) by object: row in the table, and what `correlations` says
    """

    table: Values
    classes: Values
    sensors: Values
    correlations: Values = field(default_factory=lambda: np.zeros((0, 5), np.int64))

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
    #: (n,) POLAR or CARTESIAN; (n, 3) 0.1 m/s², a direction 0.1 deg
    acceleration_form = _Column()
    acceleration = _Column()
    acceleration_confidence = _Column()
    #: (n, 3) about z, y, x (yaw, pitch, roll), 0.1 deg
    angles = _Column()
    angles_confidence = _Column()
    #: (n,) about z, deg/s; place in AngularSpeedConfidence
    yaw_rate = _Column()
    yaw_rate_confidence = _Column()
    #: (n, 3) along x, y, z of the box: length, width, height, 0.1 m
    dimensions = _Column()
    dimensions_confidence = _Column()
    #: (n,) ms since the first detection; perception quality 0..15
    age = _Column()
    quality = _Column()

    @classmethod
    def empty(cls, n: int) -> PerceivedObjects:
        """n objects of which nothing is present, to be filled in."""
        table = np.full((n, len(_COLUMNS)), ABSENT, np.int64)
        return cls(table, np.zeros((0, 5), np.int64), np.zeros((0, 2), np.int64))

    def __len__(self) -> int:
        return len(self.table)

    def take(self, rows: Values) -> PerceivedObjects:
        """Some of the objects, by ascending row."""
        place = np.full(len(self), -1)
        place[rows] = np.arange(len(rows))
        lists = []
        for table in (self.classes, self.sensors, self.correlations):
            kept = table[place[table[:, 0]] >= 0]
            kept[:, 0] = place[kept[:, 0]]
            lists.append(kept)
        return PerceivedObjects(self.table[rows], *lists)


def to_rows(objects: PerceivedObjects, start: int) -> Values:
    """Rows of the objects and then of their lists, as flat values (see `layout`) that begin at slot `start`."""
    table, n = objects.table, len(objects)
    present = table != ABSENT
    needed = present.take(_LEAD, axis=1) & present.take(_OUTER, axis=1)
    if (stray := present > needed).any():
        row, column = np.argwhere(stray)[0].tolist()
        raise MessageError(f"perceivedObjects[{row}].{_COLUMNS[column][0]}: found a value, but its field is absent")
    classes, sensors = objects.classes, objects.sensors
    values = np.zeros(n * WIDTH + len(classes) * _CLASS_WIDTH + len(sensors), np.int64)
    rows = values[: n * WIDTH].reshape(n, WIDTH)
    rows[:, _VALUE] = np.where(needed, table, 0)
    rows[:, _FLAGS] = present.take(_DECIDERS, axis=1)
    if len(classes):
        first = n * WIDTH
        out = values[first : first + len(classes) * _CLASS_WIDTH].reshape(-1, _CLASS_WIDTH)
        _, kind, profile, subclass, confidence = classes.T
        if (kind == GROUP).any():
            raise MessageError("classification: found groupSubClass, which only plain values can express")
        vru = kind == VRU
        out[:, 0], out[:, _CONFIDENCE] = kind, confidence
        out[:, 1], out[:, 2] = np.where(vru, profile, subclass), np.where(vru, subclass, 0)
        _set_lists(rows, classes[:, 0], _CLASSES, start + first, _CLASS_WIDTH)
    if len(sensors):
        values[-len(sensors) :] = sensors[:, 1]
        _set_lists(rows, sensors[:, 0], _SENSORS, start + len(values) - len(sensors), 1)
    if len(objects.correlations):
        matrices = correlations.to_lists(objects.correlations, rows, _CORRELATIONS, start + len(values))
        return np.concatenate([values, matrices])
    return values


def _set_lists(rows: Values, owner: Values, slot: int, start: int, step: int) -> None:
    """Presence, counts and starts of lists whose elements follow each other by object."""
    if (owner[1:] < owner[:-1]).any() or not 0 <= owner[0] <= owner[-1] < len(rows):
        raise MessageError("perceivedObjects: found lists in another order than their objects, expected the same")
    counts = np.bincount(owner, minlength=len(rows))
    rows[:, slot - 1], rows[:, slot] = counts > 0, counts
    rows[:, slot + 1] = np.where(counts, start + step * (np.cumsum(counts) - counts), 0)


def from_rows(values: Values, start: int, n: int) -> tuple[PerceivedObjects, frozenset[str]]:
    """Objects from flat values, and the names of fields that have no column."""
    rows = values[start : start + n * WIDTH].reshape(n, WIDTH)
    table = rows.take(_VALUE, axis=1)
    table[rows.take(_PRESENCE, axis=1) == 0] = ABSENT
    owner, out = _lists(values, rows, _CLASSES, _CLASS_WIDTH)
    kind = out[:, 0]
    vru = kind == VRU
    subclass = np.where(vru, out[:, 2], out[:, 1])
    others = np.flatnonzero(rows.take(_OTHER_SLOTS, axis=1).any(axis=0))
    unread = {_OTHERS[other] for other in others.tolist()}
    profile = np.where(vru, out[:, 1], ABSENT)
    if (kind == GROUP).any():
        subclass[kind == GROUP] = out[kind == GROUP, _CARDINALITY]
        unread.add("groupSubClass")
    if (kind > OTHER).any() or (profile > ANIMAL).any():
        unread.add("objectClass.+")
    sensor_owner, sensors = _lists(values, rows, _SENSORS, 1)
    classes, sensor_ids = np.empty((len(owner), 5), np.int64), np.empty((len(sensor_owner), 2), np.int64)
    classes.T[:] = owner, kind, profile, subclass, out[:, _CONFIDENCE]
    sensor_ids.T[:] = sensor_owner, sensors[:, 0]
    cells, sound = correlations.from_lists(values, rows, _CORRELATIONS)
    if not sound:
        unread.add("lowerTriangularCorrelationMatrices")
    return PerceivedObjects(table, classes, sensor_ids, cells), frozenset(unread)


def _lists(values: Values, rows: Values, slot: int, step: int) -> tuple[Values, Values]:
    """Owners of all elements of lists, and the rows of these elements."""
    counts = rows[:, slot]
    owner = np.repeat(np.arange(len(rows)), counts)
    place = rows[owner, slot + 1]
    if len(owner) > np.count_nonzero(counts):
        place += step * (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts))
    return owner, values[place[:, None] + np.arange(step)]
