"""Cooperative awareness message, TS 103 900 v2.3.1: bytes to integers in the standard's units, and back.

    message = Cam(station_id=7, generation_delta_time=1000, station_type=5, position=Position(520_000_000, 94_000_000))
    cam.decode(cam.encode(message))

What a message has besides, such as the low frequency container and containers of special vehicles, is checked, and in
its plain values (see `asn1.uper.to_plain`).

Field tables of the cooperative awareness message: TS 103 900 v2.3.1, annex A.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from mast_zenoh.v2x.asn1 import cdd, uper
from mast_zenoh.v2x.asn1.asn1_types import Absent, Choice, Integer, ListOf, Optional, Sequence, Type, Wrapped
from mast_zenoh.v2x.asn1.layout import EncodingProgram, slot_of
from mast_zenoh.v2x.asn1.uper import Values
from mast_zenoh.v2x.reference_position import Position

BasicVehicleContainerHighFrequency = Sequence(
    heading=cdd.Heading,
    speed=cdd.Speed,
    driveDirection=cdd.DriveDirection,
    vehicleLength=cdd.VehicleLength,
    vehicleWidth=cdd.VehicleWidth,
    longitudinalAcceleration=cdd.AccelerationComponent,
    curvature=cdd.Curvature,
    curvatureCalculationMode=cdd.CurvatureCalculationMode,
    yawRate=cdd.YawRate,
    accelerationControl=Optional(cdd.AccelerationControl),
    lanePosition=Optional(cdd.LanePosition),
    steeringWheelAngle=Optional(cdd.SteeringWheelAngle),
    lateralAcceleration=Optional(cdd.AccelerationComponent),
    verticalAcceleration=Optional(cdd.AccelerationComponent),
    performanceClass=Optional(cdd.PerformanceClass),
    cenDsrcTollingZone=Optional(cdd.CenDsrcTollingZone),
)
RSUContainerHighFrequency = Sequence(
    protectedCommunicationZonesRSU=Optional(cdd.ProtectedCommunicationZonesRSU)
).extensible()
HighFrequencyContainer = Choice(
    basicVehicleContainerHighFrequency=BasicVehicleContainerHighFrequency,
    rsuContainerHighFrequency=RSUContainerHighFrequency,
).extensible()
BasicVehicleContainerLowFrequency = Sequence(
    vehicleRole=cdd.VehicleRole,
    exteriorLights=cdd.ExteriorLights,
    pathHistory=cdd.Path,
)
LowFrequencyContainer = Choice(
    basicVehicleContainerLowFrequency=BasicVehicleContainerLowFrequency.constrained(pathHistory=cdd.Path.at_most(23))
).extensible()
PublicTransportContainer = Sequence(embarkationStatus=cdd.EmbarkationStatus, ptActivation=Optional(cdd.PtActivation))
SpecialTransportContainer = Sequence(
    specialTransportType=cdd.SpecialTransportType,
    lightBarSirenInUse=cdd.LightBarSirenInUse,
)
DangerousGoodsContainer = Sequence(dangerousGoodsBasic=cdd.DangerousGoodsBasic)
RoadWorksContainerBasic = Sequence(
    roadworksSubCauseCode=Optional(cdd.RoadworksSubCauseCode),
    lightBarSirenInUse=cdd.LightBarSirenInUse,
    closedLanes=Optional(cdd.ClosedLanes),
)
RescueContainer = Sequence(lightBarSirenInUse=cdd.LightBarSirenInUse)
EmergencyContainer = Sequence(
    lightBarSirenInUse=cdd.LightBarSirenInUse,
    incidentIndication=Optional(cdd.CauseCodeV2),
    emergencyPriority=Optional(cdd.EmergencyPriority),
)
SafetyCarContainer = Sequence(
    lightBarSirenInUse=cdd.LightBarSirenInUse,
    incidentIndication=Optional(cdd.CauseCodeV2),
    trafficRule=Optional(cdd.TrafficRule),
    speedLimit=Optional(cdd.SpeedLimit),
)
SpecialVehicleContainer = Choice(
    publicTransportContainer=PublicTransportContainer,
    specialTransportContainer=SpecialTransportContainer,
    dangerousGoodsContainer=DangerousGoodsContainer,
    roadWorksContainerBasic=RoadWorksContainerBasic,
    rescueContainer=RescueContainer,
    emergencyContainer=EmergencyContainer,
    safetyCarContainer=SafetyCarContainer,
).extensible()
CyclistTypeSpecificInformation = Sequence(
    vruSubProfileBicyclist=Optional(Integer(0, 10).only(0, 1, 5, (7, 10))),
    vruMovementControl=Optional(cdd.VruMovementControl),
).extensible()
TwoWheelerTypeSpecificInformation = Choice(cyclist=CyclistTypeSpecificInformation).extensible()
TwoWheelerContainer = Sequence(
    typeSpecificInformation=Optional(TwoWheelerTypeSpecificInformation),
    rollAngle=Optional(cdd.CartesianAngle),
    orientation=Optional(cdd.Wgs84Angle),
    stabilityChangeIndication=Optional(cdd.StabilityChangeIndication),
).extensible()
EHorizonLocationSharingContainer = Sequence(
    segmentAhead=cdd.PolygonalLine,
    nodeProbabilities=Optional(cdd.ConfidenceLevels),
    segmentBehind=cdd.PolygonalLine,
    laneLevelDetails=Optional(cdd.BasicLaneConfiguration),
    segmentSource=Optional(cdd.MetaInformation.constrained(confidenceValue=Absent(cdd.ConfidenceLevel))),
).extensible()
VeryLowFrequencyContainer = Sequence(
    vehicleHeight=Optional(cdd.VehicleHeight2),
    wiperStatus=Optional(cdd.WiperStatus),
    brakeControl=Optional(cdd.BrakeControl),
).extensible()
PathPredictionContainer = Sequence(pathPredictedList=cdd.PathPredictedList).extensible()
GeneralizedLanePositionsContainer = Sequence(generalizedLanePositions=cdd.GeneralizedLanePositions).extensible()
VehicleMovementControlContainer = Sequence(vehicleMovementControl=cdd.VehicleMovementControl).extensible()
# The identifier is extensible by itself, but not under the table that it chooses from (X.680, 50.11).
WrappedExtensionContainer = Wrapped(
    "containerId",
    "containerData",
    Integer(1, 16),
    {
        1: TwoWheelerContainer,
        2: EHorizonLocationSharingContainer,
        3: VeryLowFrequencyContainer,
        4: PathPredictionContainer,
        5: GeneralizedLanePositionsContainer,
        6: VehicleMovementControlContainer,
    },
)
WrappedExtensionContainers = ListOf(WrappedExtensionContainer, 1, 8, extensible=True)
CamParameters = Sequence(
    basicContainer=cdd.BasicContainer,
    highFrequencyContainer=HighFrequencyContainer,
    lowFrequencyContainer=Optional(LowFrequencyContainer),
    specialVehicleContainer=Optional(SpecialVehicleContainer),
).extensible(extensionContainers=Optional(WrappedExtensionContainers))
CamPayload = Sequence(generationDeltaTime=cdd.GenerationDeltaTime, camParameters=CamParameters)
CAM = Sequence(
    header=cdd.ItsPduHeader.constrained(protocolVersion=cdd.OrdinalNumber1B.only(2), messageId=cdd.MessageId.only(2)),
    cam=CamPayload,
)

#: The message as a program for the codec.
LAYOUT = EncodingProgram("CAM", CAM)


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
class Cam:
    """A message.

    generation_delta_time: TimestampIts modulo 65536, ms;  station_type: TrafficParticipantType
    vehicle: None for a roadside unit
    """

    station_id: int
    generation_delta_time: int
    station_type: int
    position: Position
    vehicle: VehicleMotion | None = None


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
_HIGH = _slots("/highFrequencyContainer").item()
_FIELDS_OF_MOTION = (
    "heading.headingValue heading.headingConfidence speed.speedValue speed.speedConfidence driveDirection "
    "vehicleLength.vehicleLengthValue vehicleLength.vehicleLengthConfidenceIndication vehicleWidth "
    "longitudinalAcceleration.value longitudinalAcceleration.confidence curvature.curvatureValue "
    "curvature.curvatureConfidence curvatureCalculationMode yawRate.yawRateValue yawRate.yawRateConfidence"
)
_MOTION = _HIGH + 1 + _slots(_FIELDS_OF_MOTION, BasicVehicleContainerHighFrequency)


def encode(message: Cam) -> bytes:
    """Bytes of a message; MessageError names the field that is outside its constraint."""
    return uper.encode(LAYOUT, to_values(message))


def decode(data: bytes) -> Cam:
    """A message from its bytes; MessageError names the field where they are not a canonical CAM."""
    return from_values(uper.decode(LAYOUT, data))


def to_values(message: Cam) -> Values:
    """Flat values of a message (see `layout`)."""
    values = np.zeros(LAYOUT.program[2].item(), np.int64)
    values[_HEADER] = (
        2, 2, message.station_id, message.generation_delta_time, message.station_type, *astuple(message.position),
    )  # fmt: skip
    if message.vehicle is None:
        values[_HIGH] = 1
    else:
        values[_MOTION] = astuple(message.vehicle)
    return values


def from_values(values: Values) -> Cam:
    """A message from its flat values."""
    header = values[_HEADER].tolist()
    vehicle = VehicleMotion(*values[_MOTION].tolist()) if values[_HIGH] == 0 else None
    return Cam(header[2], header[3], header[4], Position(*header[5:12]), vehicle)
