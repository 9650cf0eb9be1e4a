"""Field tables of the ITS common data dictionary: TS 102 894-2 v2.4.1, as far as only CAM uses it; see `cdd`."""

from __future__ import annotations

from string import ascii_letters

from mast_zenoh.v2x.asn1.asn1_types import (
    BOOLEAN,
    Bits,
    Choice,
    Default,
    Enumerated,
    Integer,
    ListOf,
    Octets,
    Optional,
    Sequence,
)
from mast_zenoh.v2x.asn1.cdd import (
    Altitude,
    AltitudeConfidence,
    ConfidenceLevel,
    HeadingValue,
    Latitude,
    Longitude,
    MapPosition,
    PosConfidenceEllipse,
    SemiAxisLength,
    TimestampIts,
    TrafficParticipantType,
    Wgs84AngleValue,
)

GenerationDeltaTime = Integer(0, 65_535)  # ms, the time modulo 65536
PositionConfidenceEllipse = Sequence(
    semiMajorAxisLength=SemiAxisLength,
    semiMinorAxisLength=SemiAxisLength,
    semiMajorAxisOrientation=Wgs84AngleValue,
)
ReferencePositionWithConfidence = Sequence(
    latitude=Latitude,
    longitude=Longitude,
    positionConfidenceEllipse=PositionConfidenceEllipse,
    altitude=Altitude,
)
BasicContainer = Sequence(
    stationType=TrafficParticipantType,
    referencePosition=ReferencePositionWithConfidence,
).extensible()
HeadingConfidence = Integer(1, 127)  # 0.1 deg; 126: out of range, 127: unavailable
Heading = Sequence(headingValue=HeadingValue, headingConfidence=HeadingConfidence)
DriveDirection = Enumerated("forward backward unavailable")
VehicleLengthValue = Integer(1, 1023)  # 0.1 m; 1022: out of range, 1023: unavailable
VehicleLengthConfidenceIndication = Enumerated(
    "noTrailerPresent trailerPresentWithKnownLength trailerPresentWithUnknownLength trailerPresenceIsUnknown "
    "unavailable"
)
VehicleLength = Sequence(
    vehicleLengthValue=VehicleLengthValue,
    vehicleLengthConfidenceIndication=VehicleLengthConfidenceIndication,
)
CurvatureValue = Integer(-1023, 1023)  # 1e-4 / m; -1023 and 1022: out of range, 1023: unavailable
CurvatureConfidence = Enumerated(
    "onePerMeter-0-00002 onePerMeter-0-0001 onePerMeter-0-0005 onePerMeter-0-002 onePerMeter-0-01 "
    "onePerMeter-0-1 outOfRange unavailable"
)
Curvature = Sequence(curvatureValue=CurvatureValue, curvatureConfidence=CurvatureConfidence)
CurvatureCalculationMode = Enumerated("yawRateUsed yawRateNotUsed unavailable", additions="")
YawRateValue = Integer(-32_766, 32_767)  # 0.01 deg/s; -32766 and 32766: out of range, 32767: unavailable
YawRateConfidence = Enumerated(
    "degSec-000-01 degSec-000-05 degSec-000-10 degSec-001-00 degSec-005-00 degSec-010-00 degSec-100-00 "
    "outOfRange unavailable"
)
YawRate = Sequence(yawRateValue=YawRateValue, yawRateConfidence=YawRateConfidence)
AccelerationControl = Bits(7)
LanePosition = Integer(-1, 14)
SteeringWheelAngleValue = Integer(-511, 512)  # 1.5 deg; -511 and 511: out of range, 512: unavailable
SteeringWheelAngleConfidence = Integer(1, 127)
SteeringWheelAngle = Sequence(
    steeringWheelAngleValue=SteeringWheelAngleValue,
    steeringWheelAngleConfidence=SteeringWheelAngleConfidence,
)
PerformanceClass = Integer(0, 7)
ProtectedZoneId = Integer(0, 134_217_727)
CenDsrcTollingZone = Sequence(
    protectedZoneLatitude=Latitude,
    protectedZoneLongitude=Longitude,
    cenDsrcTollingZoneId=Optional(ProtectedZoneId),
).extensible()
ProtectedZoneType = Enumerated("permanentCenDsrcTolling", additions="temporaryCenDsrcTolling")
ProtectedZoneRadius = Integer(1, 255, extensible=True)
ProtectedCommunicationZone = Sequence(
    protectedZoneType=ProtectedZoneType,
    expiryTime=Optional(TimestampIts),
    protectedZoneLatitude=Latitude,
    protectedZoneLongitude=Longitude,
    protectedZoneRadius=Optional(ProtectedZoneRadius),
    protectedZoneId=Optional(ProtectedZoneId),
).extensible()
ProtectedCommunicationZonesRSU = ListOf(ProtectedCommunicationZone, 1, 16)
VehicleRole = Enumerated(
    "default publicTransport specialTransport dangerousGoods roadWork rescue emergency safetyCar agriculture "
    "commercial military roadOperator taxi uvar rfu1 rfu2"
)
ExteriorLights = Bits(8)
DeltaLatitude = Integer(-131_071, 131_072)  # 1e-7 deg; 131072: unavailable
DeltaLongitude = Integer(-131_071, 131_072)  # 1e-7 deg; 131072: unavailable
DeltaAltitude = Integer(-12_700, 12_800)  # 0.01 m; 12800: unavailable
DeltaReferencePosition = Sequence(
    deltaLatitude=DeltaLatitude,
    deltaLongitude=DeltaLongitude,
    deltaAltitude=DeltaAltitude,
)
PathDeltaTime = Integer(1, 65_535, extensible=True)  # 0.01 s
PathPoint = Sequence(pathPosition=DeltaReferencePosition, pathDeltaTime=Optional(PathDeltaTime))
Path = ListOf(PathPoint, 0, 40)
EmbarkationStatus = BOOLEAN
PtActivationType = Integer(0, 255)
PtActivationData = Octets(1, 20)
PtActivation = Sequence(ptActivationType=PtActivationType, ptActivationData=PtActivationData)
SpecialTransportType = Bits(4)
LightBarSirenInUse = Bits(2)
DangerousGoodsBasic = Enumerated(
    "explosives1 explosives2 explosives3 explosives4 explosives5 explosives6 flammableGases nonFlammableGases "
    "toxicGases flammableLiquids flammableSolids substancesLiableToSpontaneousCombustion "
    "substancesEmittingFlammableGasesUponContactWithWater oxidizingSubstances organicPeroxides "
    "toxicSubstances infectiousSubstances radioactiveMaterial corrosiveSubstances "
    "miscellaneousDangerousSubstances"
)
RoadworksSubCauseCode = Integer(0, 255)
HardShoulderStatus = Enumerated("availableForStopping closed availableForDriving")
DrivingLaneStatus = Bits(1, 13)
ClosedLanes = Sequence(
    innerhardShoulderStatus=Optional(HardShoulderStatus),
    outerhardShoulderStatus=Optional(HardShoulderStatus),
    drivingLaneStatus=Optional(DrivingLaneStatus),
).extensible()
SubCauseCodeType = Integer(0, 255)
_CAUSES = (
    "trafficCondition1 accident2 roadworks3 detectedRoadworks4 impassability5 adhesion6 aquaplaning7 "
    "hazardousLocation-SurfaceCondition9 hazardousLocation-ObstacleOnTheRoad10 hazardousLocation-AnimalOnTheRoad11 "
    "humanPresenceOnTheRoad12 wrongWayDriving14 rescueRecoveryAndMaintenanceWorkInProgress15 "
    "adverseWeatherCondition-Wind17 adverseWeatherCondition-Visibility18 adverseWeatherCondition-Precipitation19 "
    "violence20 slowVehicle26 dangerousEndOfQueue27 publicTransportVehicleApproaching28 dontPanic42 vehicleBreakdown91 "
    "postCrash92 humanProblem93 stationaryVehicle94 emergencyVehicleApproaching95 hazardousLocation-DangerousCurve96 "
    "collisionRisk97 signalViolation98 dangerousSituation99 railwayLevelCrossing100"
)
_CAUSE_NAMES = {int(name.lstrip(ascii_letters + "-")): name for name in _CAUSES.split()}
CauseCodeChoice = Choice(**{_CAUSE_NAMES.get(code, f"reserved{code}"): SubCauseCodeType for code in range(129)})
CauseCodeV2 = Sequence(ccAndScc=CauseCodeChoice).extensible()
EmergencyPriority = Bits(2)
TrafficRule = Enumerated("noPassing noPassingForTrucks passToRight passToLeft", additions="passToLeftOrRight")
SpeedLimit = Integer(1, 255)
VruMovementControl = Integer(0, 15)
StabilityLossProbability = Integer(0, 63)
DeltaTimeTenthOfSecond = Integer(0, 127)  # 0.1 s
StabilityChangeIndication = Sequence(
    lossProbability=StabilityLossProbability,
    actionDeltaTime=DeltaTimeTenthOfSecond,
).extensible()
DeltaPosition = Sequence(deltaLatitude=DeltaLatitude, deltaLongitude=DeltaLongitude)
DeltaPositions = ListOf(DeltaPosition, 1, 32, extensible=True, largest=100)
DeltaReferencePositions = ListOf(DeltaReferencePosition, 1, 32, extensible=True, largest=100)
GeoPositionWoAltitude = Sequence(latitude=Latitude, longitude=Longitude)
GeoPositionsWoAltitude = ListOf(GeoPositionWoAltitude, 1, 8, extensible=True)
GeoPositionWAltitude = Sequence(latitude=Latitude, longitude=Longitude, altitude=Altitude)
GeoPositionsWAltitude = ListOf(GeoPositionWAltitude, 1, 8, extensible=True)
PolygonalLine = Choice(
    deltaPositions=DeltaPositions,
    deltaPositionsWithAltitude=DeltaReferencePositions,
    absolutePositions=GeoPositionsWoAltitude,
    absolutePositionsWithAltitude=GeoPositionsWAltitude,
).extensible()
ConfidenceLevels = ListOf(ConfidenceLevel, 1, 32, extensible=True)
Direction = Integer(0, 3)
LaneWidth = Integer(0, 1023)  # 0.01 m
RoadSectionId = Integer(0, 8, extensible=True)
BasicLaneInformation = Sequence(
    laneNumber=LanePosition,
    direction=Direction,
    laneWidth=Optional(LaneWidth),
    connectingLane=Optional(LanePosition),
    connectingRoadSection=Optional(RoadSectionId),
).extensible()
BasicLaneConfiguration = ListOf(BasicLaneInformation, 1, 16, extensible=True)
SensorTypes = Bits(16, extensible=True)
StoredInformationType = Bits(8, extensible=True)
MetaInformation = Sequence(
    usedDetectionInformation=SensorTypes,
    usedStoredInformation=StoredInformationType,
    confidenceValue=Optional(ConfidenceLevel),
).extensible()
VehicleHeight2 = Integer(1, 62)
WiperStatus = Integer(0, 7)
BrakeControl = Bits(3, extensible=True)
DeltaTimeTenSeconds = Integer(0, 127)  # 10 s
DeltaTimeSecond = Integer(0, 86_400)  # s
PathDeltaTimeChoice = Choice(
    deltaTimeHighPrecision=DeltaTimeTenthOfSecond,
    deltaTimeBigRange=DeltaTimeTenSeconds,
).extensible(deltaTimeMidRange=DeltaTimeSecond)
StandardLength9b = Integer(0, 511)  # 0.1 m
PathPointPredicted = Sequence(
    deltaLatitude=DeltaLatitude,
    deltaLongitude=DeltaLongitude,
    horizontalPositionConfidence=Optional(PosConfidenceEllipse),
    deltaAltitude=Default(DeltaAltitude, 12800),
    altitudeConfidence=Default(AltitudeConfidence, 15),
    pathDeltaTime=Optional(PathDeltaTimeChoice),
    symmetricAreaOffset=Optional(StandardLength9b),
    asymmetricAreaOffset=Optional(StandardLength9b),
).extensible()
PathPredicted = ListOf(
    PathPointPredicted, 1, 16
)  # as a part of PathPredicted2, whose constraint ends the extensibility
UsageIndication = Enumerated(
    "noIndication specialUse rescueOperation",
    additions="railroad fixedRoute restrictedRoute adasAd navigation",
)
PathPredicted2 = Sequence(
    pathPredicted=PathPredicted,
    usageIndication=UsageIndication,
    confidenceLevel=ConfidenceLevel,
).extensible()
PathPredictedList = ListOf(PathPredicted2, 1, 16, extensible=True)
LaneType = Integer(0, 31)
LanePositionAndType = Sequence(
    transversalPosition=LanePosition,
    laneType=Default(LaneType, 0),
    direction=Default(Direction, 0),
).extensible()
LanePositionWithLateralDetails = Sequence(
    transversalPosition=LanePosition,
    laneType=Default(LaneType, 0),
    direction=Default(Direction, 0),
    distanceToLeftBorder=StandardLength9b,
    distanceToRightBorder=StandardLength9b,
).extensible()
TrafficIslandPosition = Sequence(oneSide=LanePositionAndType, otherSide=LanePositionAndType).extensible()
LanePositionOptions = Choice(
    simplelanePosition=LanePosition,
    simpleLaneType=LaneType,
    detailedlanePosition=LanePositionAndType,
    lanePositionWithLateralDetails=LanePositionWithLateralDetails,
    trafficIslandPosition=TrafficIslandPosition,
).extensible()
GeneralizedLanePosition = Sequence(
    lanePositionBased=LanePositionOptions,
    mapBased=Optional(MapPosition),
    confidence=MetaInformation,
).extensible()
GeneralizedLanePositions = ListOf(GeneralizedLanePosition, 1, 4)
PedalPositionValue = Integer(0, 11)
PedalStatus = Sequence(pedalPositionValue=PedalPositionValue).extensible()
SaeAutomationLevel = Integer(0, 5)
AutomationControl = Bits(6, extensible=True)
AccelerationControlExtension = Bits(3, extensible=True)
VehicleMovementControl = Sequence(
    accelerationPedalStatus=PedalStatus,
    brakePedalStatus=PedalStatus,
    saeAutomationLevel=Optional(SaeAutomationLevel),
    automationControl=Optional(AutomationControl),
    accelerationControl=Optional(AccelerationControl),
    accelerationControlExtension=Optional(AccelerationControlExtension),
).extensible()
