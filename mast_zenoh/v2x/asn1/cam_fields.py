"""Field tables of the cooperative awareness message: TS 103 900 v2.3.1, annex A."""

from __future__ import annotations

from mast_zenoh.v2x.asn1.asn1_types import Absent, Choice, Integer, ListOf, Optional, Sequence, Wrapped
from mast_zenoh.v2x.asn1.cdd import (
    AccelerationComponent,
    CartesianAngle,
    ConfidenceLevel,
    ItsPduHeader,
    MessageId,
    OrdinalNumber1B,
    Speed,
    VehicleWidth,
    Wgs84Angle,
)
from mast_zenoh.v2x.asn1.cdd_awareness import (
    AccelerationControl,
    BasicContainer,
    BasicLaneConfiguration,
    BrakeControl,
    CauseCodeV2,
    CenDsrcTollingZone,
    ClosedLanes,
    ConfidenceLevels,
    Curvature,
    CurvatureCalculationMode,
    DangerousGoodsBasic,
    DriveDirection,
    EmbarkationStatus,
    EmergencyPriority,
    ExteriorLights,
    GeneralizedLanePositions,
    GenerationDeltaTime,
    Heading,
    LanePosition,
    LightBarSirenInUse,
    MetaInformation,
    Path,
    PathPredictedList,
    PerformanceClass,
    PolygonalLine,
    ProtectedCommunicationZonesRSU,
    PtActivation,
    RoadworksSubCauseCode,
    SpecialTransportType,
    SpeedLimit,
    StabilityChangeIndication,
    SteeringWheelAngle,
    TrafficRule,
    VehicleHeight2,
    VehicleLength,
    VehicleMovementControl,
    VehicleRole,
    VruMovementControl,
    WiperStatus,
    YawRate,
)
from mast_zenoh.v2x.asn1.layout import EncodingProgram

BasicVehicleContainerHighFrequency = Sequence(
    heading=Heading,
    speed=Speed,
    driveDirection=DriveDirection,
    vehicleLength=VehicleLength,
    vehicleWidth=VehicleWidth,
    longitudinalAcceleration=AccelerationComponent,
    curvature=Curvature,
    curvatureCalculationMode=CurvatureCalculationMode,
    yawRate=YawRate,
    accelerationControl=Optional(AccelerationControl),
    lanePosition=Optional(LanePosition),
    steeringWheelAngle=Optional(SteeringWheelAngle),
    lateralAcceleration=Optional(AccelerationComponent),
    verticalAcceleration=Optional(AccelerationComponent),
    performanceClass=Optional(PerformanceClass),
    cenDsrcTollingZone=Optional(CenDsrcTollingZone),
)
RSUContainerHighFrequency = Sequence(
    protectedCommunicationZonesRSU=Optional(ProtectedCommunicationZonesRSU)
).extensible()
HighFrequencyContainer = Choice(
    basicVehicleContainerHighFrequency=BasicVehicleContainerHighFrequency,
    rsuContainerHighFrequency=RSUContainerHighFrequency,
).extensible()
BasicVehicleContainerLowFrequency = Sequence(
    vehicleRole=VehicleRole,
    exteriorLights=ExteriorLights,
    pathHistory=Path,
)
LowFrequencyContainer = Choice(
    basicVehicleContainerLowFrequency=BasicVehicleContainerLowFrequency.constrained(pathHistory=Path.at_most(23))
).extensible()
PublicTransportContainer = Sequence(embarkationStatus=EmbarkationStatus, ptActivation=Optional(PtActivation))
SpecialTransportContainer = Sequence(
    specialTransportType=SpecialTransportType,
    lightBarSirenInUse=LightBarSirenInUse,
)
DangerousGoodsContainer = Sequence(dangerousGoodsBasic=DangerousGoodsBasic)
RoadWorksContainerBasic = Sequence(
    roadworksSubCauseCode=Optional(RoadworksSubCauseCode),
    lightBarSirenInUse=LightBarSirenInUse,
    closedLanes=Optional(ClosedLanes),
)
RescueContainer = Sequence(lightBarSirenInUse=LightBarSirenInUse)
EmergencyContainer = Sequence(
    lightBarSirenInUse=LightBarSirenInUse,
    incidentIndication=Optional(CauseCodeV2),
    emergencyPriority=Optional(EmergencyPriority),
)
SafetyCarContainer = Sequence(
    lightBarSirenInUse=LightBarSirenInUse,
    incidentIndication=Optional(CauseCodeV2),
    trafficRule=Optional(TrafficRule),
    speedLimit=Optional(SpeedLimit),
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
    vruMovementControl=Optional(VruMovementControl),
).extensible()
TwoWheelerTypeSpecificInformation = Choice(cyclist=CyclistTypeSpecificInformation).extensible()
TwoWheelerContainer = Sequence(
    typeSpecificInformation=Optional(TwoWheelerTypeSpecificInformation),
    rollAngle=Optional(CartesianAngle),
    orientation=Optional(Wgs84Angle),
    stabilityChangeIndication=Optional(StabilityChangeIndication),
).extensible()
EHorizonLocationSharingContainer = Sequence(
    segmentAhead=PolygonalLine,
    nodeProbabilities=Optional(ConfidenceLevels),
    segmentBehind=PolygonalLine,
    laneLevelDetails=Optional(BasicLaneConfiguration),
    segmentSource=Optional(MetaInformation.constrained(confidenceValue=Absent(ConfidenceLevel))),
).extensible()
VeryLowFrequencyContainer = Sequence(
    vehicleHeight=Optional(VehicleHeight2),
    wiperStatus=Optional(WiperStatus),
    brakeControl=Optional(BrakeControl),
).extensible()
PathPredictionContainer = Sequence(pathPredictedList=PathPredictedList).extensible()
GeneralizedLanePositionsContainer = Sequence(generalizedLanePositions=GeneralizedLanePositions).extensible()
VehicleMovementControlContainer = Sequence(vehicleMovementControl=VehicleMovementControl).extensible()
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
    basicContainer=BasicContainer,
    highFrequencyContainer=HighFrequencyContainer,
    lowFrequencyContainer=Optional(LowFrequencyContainer),
    specialVehicleContainer=Optional(SpecialVehicleContainer),
).extensible(extensionContainers=Optional(WrappedExtensionContainers))
CamPayload = Sequence(generationDeltaTime=GenerationDeltaTime, camParameters=CamParameters)
CAM = Sequence(
    header=ItsPduHeader.constrained(protocolVersion=OrdinalNumber1B.only(2), messageId=MessageId.only(2)),
    cam=CamPayload,
)

#: The message as a program for the codec.
LAYOUT = EncodingProgram("CAM", CAM)
