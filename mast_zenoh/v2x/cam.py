"""Cooperative awareness message, TS 103 900 v2.3.1: bytes to integers in the standard's units, and back.

    message = Cam(station_id=7, generation_delta_time=1000, station_type=5, position=Position(520_000_000, 94_000_000))
    cam.decode(cam.encode(message))

What a message has besides, such as options of the high frequency container and containers of special vehicles, is in
its plain values (see `plain`).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field

import numpy as np

from mast_zenoh.v2x.asn1 import uper
from mast_zenoh.v2x.asn1.asn1_types import Optional, Sequence, Type
from mast_zenoh.v2x.asn1.cam_fields import (
    LAYOUT,
    BasicVehicleContainerHighFrequency,
    BasicVehicleContainerLowFrequency,
    CamParameters,
    RSUContainerHighFrequency,
)
from mast_zenoh.v2x.asn1.cdd_awareness import BasicContainer, PathPoint
from mast_zenoh.v2x.asn1.codec_kernels import Values
from mast_zenoh.v2x.asn1.layout import extension_slot, slot_of, width
from mast_zenoh.v2x.perceived_objects import ABSENT
from mast_zenoh.v2x.reference_position import Position


@dataclass(frozen=True)
class VehicleMotion:
    """Mandatory fields of BasicVehicleContainerHighFrequency; the defaults are "unavailable".

    heading: 0.1 deg clockwise from north;  speed: 0.01 m/s;  drive_direction: 0 forward, 1 backward
    length, width: 0.1 m;  acceleration: longitudinal, 0.1 m/s²;  curvature: 1e-4 / m;  yaw_rate: 0.01 deg/s
    length_confidence, curvature_confidence, curvature_mode, yaw_rate_confidence: places in their enumerations
    """

    heading: int = 3601
    heading_confidence: int = 127
    speed: int = 16383
    speed_confidence: int = 127
    drive_direction: int = 2
    length: int = 1023
    length_confidence: int = 4
    width: int = 62
    acceleration: int = 161
    acceleration_confidence: int = 102
    curvature: int = 1023
    curvature_confidence: int = 7
    curvature_mode: int = 2
    yaw_rate: int = 32767
    yaw_rate_confidence: int = 8


@dataclass(frozen=True, eq=False)
class VehicleStatus:
    """BasicVehicleContainerLowFrequency.

    role: place in VehicleRole;  lights: ExteriorLights, its first bit the highest of eight
    path: (m, 4) points relative to the position, the youngest first: latitude and longitude 1e-7 deg, altitude 0.01 m,
        time 0.01 s or `ABSENT`
    """

    role: int = 0
    lights: int = 0
    path: Values = field(default_factory=lambda: np.zeros((0, 4), np.int64))


@dataclass(frozen=True, eq=False)
class Cam:
    """A message.

    generation_delta_time: TimestampIts modulo 65536, ms;  station_type: TrafficParticipantType
    vehicle: None for a roadside unit;  status: what a vehicle sends every 0.5 s
    unread: names of fields of a decoded message that have no place here
    """

    station_id: int
    generation_delta_time: int
    station_type: int
    position: Position
    vehicle: VehicleMotion | None = None
    status: VehicleStatus | None = None
    unread: frozenset[str] = frozenset()


def _slots(paths: str, type: Type = LAYOUT.type) -> Values:
    """Slots of fields; "/" stands for the parameters of a CAM."""
    return np.array([slot_of(type, path.replace("/", _PARAMETERS)) for path in paths.split()])


_PARAMETERS = "cam.camParameters."
_HEADER = _slots(
    "header.protocolVersion header.messageId header.stationId cam.generationDeltaTime /basicContainer.stationType "
    "/basicContainer.referencePosition.latitude /basicContainer.referencePosition.longitude "
    "/basicContainer.referencePosition.altitude.altitudeValue "
    "/basicContainer.referencePosition.altitude.altitudeConfidence "
    "/basicContainer.referencePosition.positionConfidenceEllipse.semiMajorAxisLength "
    "/basicContainer.referencePosition.positionConfidenceEllipse.semiMinorAxisLength "
    "/basicContainer.referencePosition.positionConfidenceEllipse.semiMajorAxisOrientation"
)
_HIGH, _LOW, _LOW_PRESENT = _slots("/highFrequencyContainer /lowFrequencyContainer /lowFrequencyContainer?").tolist()
_FIELDS_OF_MOTION = (
    "heading.headingValue heading.headingConfidence speed.speedValue speed.speedConfidence driveDirection "
    "vehicleLength.vehicleLengthValue vehicleLength.vehicleLengthConfidenceIndication vehicleWidth "
    "longitudinalAcceleration.value longitudinalAcceleration.confidence curvature.curvatureValue "
    "curvature.curvatureConfidence curvatureCalculationMode yawRate.yawRateValue yawRate.yawRateConfidence"
)
_MOTION = _HIGH + 1 + _slots(_FIELDS_OF_MOTION, BasicVehicleContainerHighFrequency)
#: Slots that are not 0 if a message has what `Cam` has no place for, by name.
_UNREAD = {
    "specialVehicleContainer": _slots("/specialVehicleContainer?").item(),
    "extensionContainers": slot_of(LAYOUT.type, _PARAMETERS[:-1]) + extension_slot(CamParameters),
    "basicContainer.+": slot_of(LAYOUT.type, f"{_PARAMETERS}basicContainer") + extension_slot(BasicContainer),
}


def _options(container: Sequence) -> dict[str, int]:
    """Slots that are not 0 if a high frequency container has options, by name."""
    options = {
        name: _HIGH + 1 + slot_of(container, f"{name}?")
        for name, type in container.fields.items()
        if isinstance(type, Optional)
    }
    return options if container.additions is None else options | {"+": _HIGH + 1 + extension_slot(container)}


_UNREAD_BY_STATION = {
    0: _options(BasicVehicleContainerHighFrequency),
    1: _options(RSUContainerHighFrequency),
}
_STATUS = _LOW + 1 + _slots("vehicleRole exteriorLights pathHistory", BasicVehicleContainerLowFrequency)
_ROLE, _LIGHTS, _PATH = _STATUS.tolist()
_POINT_WIDTH = width(PathPoint)
_POINT = _slots(
    "pathPosition.deltaLatitude pathPosition.deltaLongitude pathPosition.deltaAltitude pathDeltaTime", PathPoint
)
_TIME = slot_of(PathPoint, "pathDeltaTime?")


def encode(message: Cam) -> bytes:
    """Bytes of a message; MessageError names the field that is outside its constraint."""
    return uper.encode(LAYOUT, to_values(message))


def decode(data: bytes) -> Cam:
    """A message from its bytes; MessageError names the field where they are not a canonical CAM."""
    return from_values(uper.decode(LAYOUT, data))


def to_values(message: Cam) -> Values:
    """Flat values of a message (see `layout`)."""
    first = LAYOUT.program[2].item()
    n_points = 0 if message.status is None else len(message.status.path)
    values = np.zeros(first + n_points * _POINT_WIDTH + 8 * (message.status is not None), np.int64)
    values[_HEADER] = (
        2, 2, message.station_id, message.generation_delta_time, message.station_type, *astuple(message.position),
    )  # fmt: skip
    if message.vehicle is None:
        values[_HIGH] = 1
    else:
        values[_MOTION] = astuple(message.vehicle)
    if message.status is not None:
        path = message.status.path
        values[_LOW_PRESENT], values[_ROLE] = 1, message.status.role
        values[_LIGHTS], values[_LIGHTS + 1] = 8, len(values) - 8
        values[-8:] = [(message.status.lights >> bit) & 1 for bit in range(7, -1, -1)]
        values[_PATH], values[_PATH + 1] = n_points, first * (n_points > 0)
        table = values[first : first + n_points * _POINT_WIDTH].reshape(-1, _POINT_WIDTH)
        present = path[:, 3] != ABSENT
        table[:, _POINT] = np.where(present[:, None] | (np.arange(4) < 3), path, 0)
        table[:, _TIME] = present
    return values


def from_values(values: Values) -> Cam:
    """A message from its flat values."""
    header = values[_HEADER].tolist()
    station = values[_HIGH].item()
    options = _UNREAD | _UNREAD_BY_STATION.get(station, {})
    unread = {name for name, slot in options.items() if values[slot]}
    if station not in _UNREAD_BY_STATION:
        unread.add("highFrequencyContainer.+")
    vehicle = VehicleMotion(*values[_MOTION].tolist()) if station == 0 else None
    status = None
    if values[_LOW_PRESENT] and values[_LOW]:
        unread.add("lowFrequencyContainer.+")
    elif values[_LOW_PRESENT]:
        start = values[_LIGHTS + 1].item()
        lights = int("".join(map(str, values[start : start + 8].tolist())), 2)
        n, start = values[_PATH : _PATH + 2].tolist()
        table = values[start : start + n * _POINT_WIDTH].reshape(-1, _POINT_WIDTH)
        path = table[:, _POINT]
        path[table[:, _TIME] == 0, 3] = ABSENT
        status = VehicleStatus(values[_ROLE].item(), lights, path)
    return Cam(header[2], header[3], header[4], Position(*header[5:12]), vehicle, status, frozenset(unread))
