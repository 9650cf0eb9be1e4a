"""Collective perception message, TS 103 324 v2.1.1: bytes to columns of integers in the standard's units, and back.

    message = Cpm(station_id=7, reference_time=690_000_000_000, position=Position(520_000_000, 94_000_000), objects=...)
    cpm.decode(cpm.encode(message))

Positions of objects are relative to the reference position (see `perceived_objects`). What a message has besides, such
as sensors, perception regions and map positions, is checked, and in its plain values (see `asn1.uper.to_plain`).

Field tables of the collective perception message: TS 103 324 v2.1.1, clause 7 and annex A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1 import cdd, uper
from mast_zenoh.v2x.asn1.asn1_types import BOOLEAN, Absent, Demanded, Integer, ListOf, Optional, Sequence, Wrapped
from mast_zenoh.v2x.asn1.layout import EncodingProgram, slot_of, width
from mast_zenoh.v2x.asn1.uper import Values
from mast_zenoh.v2x.perceived_objects import PerceivedObjects, from_rows, to_rows
from mast_zenoh.v2x.reference_position import Position

MessageRateRange = Sequence(messageRateMin=cdd.MessageRateHz, messageRateMax=cdd.MessageRateHz)
ManagementContainer = Sequence(
    referenceTime=cdd.TimestampIts,
    referencePosition=cdd.ReferencePosition,
    segmentationInfo=Optional(cdd.MessageSegmentationInfo),
    messageRateRange=Optional(MessageRateRange),
).extensible()
TrailerDataSet = ListOf(
    cdd.TrailerData.constrained(
        frontOverhang=Absent(cdd.StandardLength1B),
        rearOverhang=Absent(cdd.StandardLength1B),
        trailerWidth=Absent(cdd.VehicleWidth),
    ),
    1,
    8,
    extensible=True,
)
OriginatingVehicleContainer = Sequence(
    orientationAngle=cdd.Wgs84Angle,
    pitchAngle=Optional(cdd.CartesianAngle),
    rollAngle=Optional(cdd.CartesianAngle),
    trailerDataSet=Optional(TrailerDataSet),
).extensible()
OriginatingRsuContainer = Sequence(mapReference=Optional(cdd.MapReference)).extensible()
SensorInformation = Sequence(
    sensorId=cdd.Identifier1B,
    sensorType=cdd.SensorType,
    perceptionRegionShape=Optional(cdd.Shape),
    perceptionRegionConfidence=Optional(cdd.ConfidenceLevel),
    shadowingApplies=BOOLEAN,
).extensible()
SensorInformationContainer = ListOf(SensorInformation, 1, 128, extensible=True)
PerceivedObjectIds = ListOf(cdd.Identifier2B, 0, 255, extensible=True)
PerceptionRegion = Sequence(
    measurementDeltaTime=cdd.DeltaTimeMilliSecondSigned,
    perceptionRegionConfidence=cdd.ConfidenceLevel,
    perceptionRegionShape=cdd.Shape,
    shadowingApplies=BOOLEAN,
    sensorIdList=Optional(cdd.SequenceOfIdentifier1B),
    numberOfPerceivedObjects=Optional(cdd.CardinalNumber1B),
    perceivedObjectIds=Optional(PerceivedObjectIds),
).extensible()
PerceptionRegionContainer = ListOf(PerceptionRegion, 1, 256, extensible=True)
_ObjectList = ListOf(cdd.PerceivedObject.constrained(objectId=Demanded(cdd.Identifier2B)), 0, 255, extensible=True)
PerceivedObjectContainer = Sequence(
    numberOfPerceivedObjects=cdd.CardinalNumber1B,
    perceivedObjects=_ObjectList,
).extensible()
WrappedCpmContainer = Wrapped(
    "containerId",
    "containerData",
    Integer(1, 16),
    {
        1: OriginatingVehicleContainer,
        2: OriginatingRsuContainer,
        3: SensorInformationContainer,
        4: PerceptionRegionContainer,
        5: PerceivedObjectContainer,
    },
)
# The constraint that excludes two kinds of originating station ends the extensibility of the list (X.680, 50.11).
ConstraintWrappedCpmContainers = ListOf(WrappedCpmContainer, 1, 8)
CpmPayload = Sequence(
    managementContainer=ManagementContainer,
    cpmContainers=ConstraintWrappedCpmContainers,
).extensible()
CollectivePerceptionMessage = Sequence(
    header=cdd.ItsPduHeader.constrained(protocolVersion=cdd.OrdinalNumber1B.only(2), messageId=cdd.MessageId.only(14)),
    payload=CpmPayload,
)

#: The message as a program for the codec.
LAYOUT = EncodingProgram("CPM", CollectivePerceptionMessage)


#: Identifiers of containers.
VEHICLE, RSU, OBJECTS = 1, 2, 5


@dataclass(frozen=True, eq=False)
class Cpm:
    """A message.

    reference_time: TimestampIts, ms
    objects: None if there is no container of perceived objects
    known_objects: all that the station knows when it sends, 255 or more as 255; None: as many as `objects`
    vehicle: orientation, 0.1 deg clockwise from north, and its confidence; None if the station is no vehicle
    rsu: whether there is a container of a roadside unit
    segment: number of this message, from 1, and of all that hold the same picture
    """

    station_id: int
    reference_time: int
    position: Position
    objects: PerceivedObjects | None = None
    known_objects: int | None = None
    vehicle: tuple[int, int] | None = None
    rsu: bool = False
    segment: tuple[int, int] | None = None


_MANAGEMENT = "payload.managementContainer"
_REFERENCE = f"{_MANAGEMENT}.referencePosition"
#: Slots of a message in the order of `to_values`.
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
_CONTAINERS = slot_of(LAYOUT.type, "payload.cpmContainers")
_CONTAINER_WIDTH = width(WrappedCpmContainer)
_ORIENTATION = slot_of(OriginatingVehicleContainer, "orientationAngle.value")
_KNOWN = slot_of(PerceivedObjectContainer, "numberOfPerceivedObjects")
_LIST = slot_of(PerceivedObjectContainer, "perceivedObjects")


def encode(message: Cpm) -> bytes:
    """Bytes of a message; MessageError names the field that is outside its constraint."""
    return uper.encode(LAYOUT, to_values(message))


def decode(data: bytes) -> Cpm:
    """A message from its bytes; MessageError names the field where they are not a canonical CPM."""
    return from_values(uper.decode(LAYOUT, data))


def to_values(message: Cpm) -> Values:
    """Flat values of a message (see `layout`)."""
    ids = [VEHICLE] * (message.vehicle is not None) + [RSU] * message.rsu + [OBJECTS] * (message.objects is not None)
    first = LAYOUT.program[2].item()
    first_object = first + len(ids) * _CONTAINER_WIDTH
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
    for slot, id in zip(range(first, first_object, _CONTAINER_WIDTH), ids, strict=True):
        values[slot] = id
        content = slot + 1
        if id == VEHICLE and message.vehicle:
            values[content + _ORIENTATION : content + _ORIENTATION + 2] = message.vehicle
        elif id == OBJECTS and message.objects is not None:
            n = len(message.objects)
            values[content + _KNOWN] = min(n if message.known_objects is None else message.known_objects, 255)
            values[content + _LIST], values[content + _LIST + 1] = n, first_object if n else 0
    return values


def from_values(values: Values) -> Cpm:
    """A message from its flat values."""
    header = values[_HEADER].tolist()
    parts: dict[int, int] = {}
    n, first = values[_CONTAINERS : _CONTAINERS + 2].tolist()
    for slot in range(first, first + n * _CONTAINER_WIDTH, _CONTAINER_WIDTH):
        id = values[slot].item()
        if id in parts:
            raise MessageError(f"payload.cpmContainers: found two containers with identifier {id}, expected one")
        parts[id] = slot + 1
    objects, known = None, None
    if slot := parts.get(OBJECTS, 0):
        known = values[slot + _KNOWN].item()
        count, start = values[slot + _LIST : slot + _LIST + 2].tolist()
        objects = from_rows(values, start, count)
    vehicle = None
    if slot := parts.get(VEHICLE, 0):
        vehicle = tuple(values[slot + _ORIENTATION : slot + _ORIENTATION + 2].tolist())
    segment = (header[12], header[13]) if header[11] else None
    return Cpm(header[2], header[3], Position(*header[4:11]), objects, known, vehicle, RSU in parts, segment)
