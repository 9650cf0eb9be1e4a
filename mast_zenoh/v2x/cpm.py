"""Collective perception message, TS 103 324 v2.1.1: bytes to columns of integers in the standard's units, and back.

    message = Cpm(station_id=7, reference_time=690_000_000_000, position=Position(520_000_000, 94_000_000), objects=...)
    cpm.decode(cpm.encode(message))

Positions of objects are relative to the reference position (see `perceived_objects`). What a message has besides, such
as perception regions and map positions, is in its plain values (see `plain`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1 import uper
from mast_zenoh.v2x.asn1.codec_kernels import Values
from mast_zenoh.v2x.asn1.cpm_fields import (
    LAYOUT,
    CpmPayload,
    ManagementContainer,
    OriginatingRsuContainer,
    OriginatingVehicleContainer,
    PerceivedObjectContainer,
    SensorInformation,
    WrappedCpmContainer,
)
from mast_zenoh.v2x.asn1.layout import extension_slot, slot_of, width
from mast_zenoh.v2x.perceived_objects import ABSENT, PerceivedObjects, from_rows, to_rows
from mast_zenoh.v2x.reference_position import Position

#: Identifiers of containers.
VEHICLE, RSU, SENSORS, REGIONS, OBJECTS = range(1, 6)


@dataclass(frozen=True, eq=False)
class Cpm:
    """A message.

    reference_time: TimestampIts, ms
    objects: None if there is no container of perceived objects
    known_objects: all that the station knows when it sends, 255 or more as 255; None: as many as `objects`
    vehicle: orientation, 0.1 deg clockwise from north, and its confidence; None if the station is no vehicle
    rsu: whether there is a container of a roadside unit
    segment: number of this message, from 1, and of all that hold the same picture
    sensors: (m, 4) id, type, confidence level or `ABSENT`, 1 if shadowing applies
    unread: names of fields of a decoded message that have no place here
    """

    station_id: int
    reference_time: int
    position: Position
    objects: PerceivedObjects | None = None
    known_objects: int | None = None
    vehicle: tuple[int, int] | None = None
    rsu: bool = False
    segment: tuple[int, int] | None = None
    sensors: Values = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    unread: frozenset[str] = frozenset()


_MANAGEMENT = "payload.managementContainer"
_REFERENCE = f"{_MANAGEMENT}.referencePosition"
#: Slots of a message in the order of `_header`.
_HEADER = np.array(
    [
        slot_of(LAYOUT.type, path)
        for path in (
            "header.protocolVersion",
            "header.messageId",
            "header.stationId",
            f"{_MANAGEMENT}.referenceTime",
            f"{_REFERENCE}.latitude",
            f"{_REFERENCE}.longitude",
            f"{_REFERENCE}.altitude.altitudeValue",
            f"{_REFERENCE}.altitude.altitudeConfidence",
            f"{_REFERENCE}.positionConfidenceEllipse.semiMajorConfidence",
            f"{_REFERENCE}.positionConfidenceEllipse.semiMinorConfidence",
            f"{_REFERENCE}.positionConfidenceEllipse.semiMajorOrientation",
            f"{_MANAGEMENT}.segmentationInfo?",
            f"{_MANAGEMENT}.segmentationInfo.thisMsgNo",
            f"{_MANAGEMENT}.segmentationInfo.totalMsgNo",
        )
    ]
)
_RATE = slot_of(LAYOUT.type, f"{_MANAGEMENT}.messageRateRange?")
_CONTAINERS = slot_of(LAYOUT.type, "payload.cpmContainers")
_CONTAINER_WIDTH, _SENSOR_WIDTH = width(WrappedCpmContainer), width(SensorInformation)
_ORIENTATION = slot_of(OriginatingVehicleContainer, "orientationAngle.value")
_KNOWN = slot_of(PerceivedObjectContainer, "numberOfPerceivedObjects")
_LIST = slot_of(PerceivedObjectContainer, "perceivedObjects")
_SENSOR = np.array(
    [
        slot_of(SensorInformation, path)
        for path in ("sensorId", "sensorType", "perceptionRegionConfidence", "shadowingApplies")
    ]
)
#: Slots that are not 0 if there are extension additions, which no version of CPM has yet.
_EXTENSIONS = np.array(
    [
        slot_of(LAYOUT.type, "payload") + extension_slot(CpmPayload),
        slot_of(LAYOUT.type, _MANAGEMENT) + extension_slot(ManagementContainer),
    ]
)
_CONTENT_EXTENSIONS = {
    VEHICLE: extension_slot(OriginatingVehicleContainer),
    RSU: extension_slot(OriginatingRsuContainer),
    OBJECTS: extension_slot(PerceivedObjectContainer),
}
_VEHICLE_OPTIONS = {
    name: slot_of(OriginatingVehicleContainer, f"{name}?") for name in ("pitchAngle", "rollAngle", "trailerDataSet")
}
_SENSOR_CONFIDENCE, _SENSOR_SHAPE = (
    slot_of(SensorInformation, path) for path in ("perceptionRegionConfidence?", "perceptionRegionShape?")
)
_SENSOR_EXTENSION = extension_slot(SensorInformation)


def encode(message: Cpm) -> bytes:
    """Bytes of a message; MessageError names the field that is outside its constraint."""
    return uper.encode(LAYOUT, to_values(message))


def decode(data: bytes) -> Cpm:
    """A message from its bytes; MessageError names the field where they are not a canonical CPM."""
    return from_values(uper.decode(LAYOUT, data))


def to_values(message: Cpm) -> Values:
    """Flat values of a message (see `layout`)."""
    sensors = message.sensors
    ids = [VEHICLE] * (message.vehicle is not None) + [RSU] * message.rsu + [SENSORS] * (len(sensors) > 0)
    ids += [OBJECTS] * (message.objects is not None)
    first = LAYOUT.program[2].item()
    first_sensor = first + len(ids) * _CONTAINER_WIDTH
    first_object = first_sensor + len(sensors) * _SENSOR_WIDTH
    rows = np.zeros(0, np.int64) if message.objects is None else to_rows(message.objects, first_object)
    values = np.zeros(first_object + len(rows), np.int64)
    values[first_object:] = rows
    position = message.position
    values[_HEADER] = (
        2, 14, message.station_id, message.reference_time, position.latitude, position.longitude, position.altitude,
        position.altitude_confidence, position.semi_major, position.semi_minor, position.orientation,
        message.segment is not None, *(message.segment or (0, 0)),
    )  # fmt: skip
    values[_CONTAINERS], values[_CONTAINERS + 1] = len(ids), first
    for slot, id in zip(range(first, first_sensor, _CONTAINER_WIDTH), ids, strict=True):
        values[slot] = id
        content = slot + 1
        if id == VEHICLE and message.vehicle:
            values[content + _ORIENTATION : content + _ORIENTATION + 2] = message.vehicle
        elif id == SENSORS:
            values[content : content + 2] = len(sensors), first_sensor
            table = values[first_sensor:first_object].reshape(-1, _SENSOR_WIDTH)
            present = sensors[:, 2] != ABSENT
            table[:, _SENSOR] = np.where(present[:, None] | (np.arange(4) != 2), sensors, 0)
            table[:, _SENSOR_CONFIDENCE] = present
        elif id == OBJECTS and message.objects is not None:
            n = len(message.objects)
            values[content + _KNOWN] = min(n if message.known_objects is None else message.known_objects, 255)
            values[content + _LIST], values[content + _LIST + 1] = n, first_object if n else 0
    return values


def from_values(values: Values) -> Cpm:
    """A message from its flat values."""
    header = values[_HEADER].tolist()
    unread = {"messageRateRange"} if values[_RATE] else set()
    parts: dict[int, int] = {}
    n, first = values[_CONTAINERS : _CONTAINERS + 2].tolist()
    for slot in range(first, first + n * _CONTAINER_WIDTH, _CONTAINER_WIDTH):
        id = values[slot].item()
        if id in parts:
            raise MessageError(f"payload.cpmContainers: found two containers with identifier {id}, expected one")
        parts[id] = slot + 1
    unread |= {f"container {id}" for id in parts if id not in (VEHICLE, RSU, SENSORS, OBJECTS)}
    if values[_EXTENSIONS].any() or any(
        values[slot + _CONTENT_EXTENSIONS[id]] for id, slot in parts.items() if id in _CONTENT_EXTENSIONS
    ):
        unread.add("+")
    objects, known = None, None
    if slot := parts.get(OBJECTS, 0):
        known = values[slot + _KNOWN].item()
        count, start = values[slot + _LIST : slot + _LIST + 2].tolist()
        objects, of_objects = from_rows(values, start, count)
        unread |= of_objects
    vehicle = None
    if slot := parts.get(VEHICLE, 0):
        vehicle = tuple(values[slot + _ORIENTATION : slot + _ORIENTATION + 2].tolist())
        unread |= {name for name, place in _VEHICLE_OPTIONS.items() if values[slot + place]}
    if (slot := parts.get(RSU, 0)) and values[slot]:
        unread.add("mapReference")
    sensors = np.zeros((0, 4), np.int64)
    if slot := parts.get(SENSORS, 0):
        count, start = values[slot : slot + 2].tolist()
        table = values[start : start + count * _SENSOR_WIDTH].reshape(-1, _SENSOR_WIDTH)
        sensors = table[:, _SENSOR]
        sensors[table[:, _SENSOR_CONFIDENCE] == 0, 2] = ABSENT
        if table[:, _SENSOR_SHAPE].any():
            unread.add("perceptionRegionShape")
        if table[:, _SENSOR_EXTENSION].any():
            unread.add("sensorInformation.+")
    segment = (header[12], header[13]) if header[11] else None
    return Cpm(
        header[2], header[3], Position(*header[4:11]), objects, known, vehicle, RSU in parts, segment, sensors,
        frozenset(unread),
    )  # fmt: skip
