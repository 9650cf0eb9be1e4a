"""Field tables of the ITS common data dictionary, TS 102 894-2 v2.4.1, as far as CPM and CAM use them;
those of CAM come last.

Names are those of the standard. Units follow the type. "out of range" means that or beyond; confidences are half
widths of 95 % intervals.
"""

from __future__ import annotations

from string import ascii_letters

from mast_zenoh.v2x.asn1.asn1_types import (
    BOOLEAN,
    Absent,
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

OrdinalNumber1B = Integer(0, 255)
MessageId = Integer(0, 255)
StationId = Integer(0, 4_294_967_295)
ItsPduHeader = Sequence(protocolVersion=OrdinalNumber1B, messageId=MessageId, stationId=StationId)
TimestampIts = Integer(0, 4_398_046_511_103)  # ms since 2004-01-01T00:00:00Z, TAI
Latitude = Integer(-900_000_000, 900_000_001)  # 1e-7 deg; 900000001: unavailable
Longitude = Integer(-1_800_000_000, 1_800_000_001)  # 1e-7 deg; 1800000001: unavailable
SemiAxisLength = Integer(0, 4095)  # 0.01 m; 4094: out of range, 4095: unavailable
HeadingValue = Integer(0, 3601)  # 0.1 deg clockwise from north; 3601: unavailable
PosConfidenceEllipse = Sequence(
    semiMajorConfidence=SemiAxisLength,
    semiMinorConfidence=SemiAxisLength,
    semiMajorOrientation=HeadingValue,
)
AltitudeValue = Integer(-100_000, 800_001)  # 0.01 m above the WGS84 ellipsoid; 800001: unavailable
AltitudeConfidence = Enumerated(
    "alt-000-01 alt-000-02 alt-000-05 alt-000-10 alt-000-20 alt-000-50 alt-001-00 alt-002-00 alt-005-00 "
    "alt-010-00 alt-020-00 alt-050-00 alt-100-00 alt-200-00 outOfRange unavailable"
)
Altitude = Sequence(altitudeValue=AltitudeValue, altitudeConfidence=AltitudeConfidence)
ReferencePosition = Sequence(
    latitude=Latitude,
    longitude=Longitude,
    positionConfidenceEllipse=PosConfidenceEllipse,
    altitude=Altitude,
)
CardinalNumber3b = Integer(1, 8)
OrdinalNumber3b = Integer(1, 8)
MessageSegmentationInfo = Sequence(totalMsgNo=CardinalNumber3b, thisMsgNo=OrdinalNumber3b)
MessageRateHz = Sequence(mantissa=Integer(1, 100), exponent=Integer(-5, 2))
Wgs84AngleValue = Integer(0, 3601)  # 0.1 deg clockwise from north; 3601: unavailable
Wgs84AngleConfidence = Integer(1, 127)  # 0.1 deg; 126: out of range, 127: unavailable
Wgs84Angle = Sequence(value=Wgs84AngleValue, confidence=Wgs84AngleConfidence)
CartesianAngleValue = Integer(0, 3601)  # 0.1 deg; 3601: unavailable
AngleConfidence = Integer(1, 127)  # 0.1 deg; 126: out of range, 127: unavailable
CartesianAngle = Sequence(value=CartesianAngleValue, confidence=AngleConfidence)
StandardLength1B = Integer(0, 255)  # 0.1 m
VehicleWidth = Integer(1, 62)  # 0.1 m; 61: out of range, 62: unavailable
Identifier1B = Integer(0, 255)
TrailerData = Sequence(
    refPointId=Identifier1B,
    hitchPointOffset=StandardLength1B,
    frontOverhang=Optional(StandardLength1B),
    rearOverhang=Optional(StandardLength1B),
    trailerWidth=Optional(VehicleWidth),
    hitchAngle=CartesianAngle,
).extensible()
Identifier2B = Integer(0, 65_535)
RoadSegmentReferenceId = Sequence(region=Optional(Identifier2B), id=Identifier2B)
IntersectionReferenceId = Sequence(region=Optional(Identifier2B), id=Identifier2B)
MapReference = Choice(roadsegment=RoadSegmentReferenceId, intersection=IntersectionReferenceId)
SensorType = Integer(0, 31)
CartesianCoordinate = Integer(-32_768, 32_767)  # 0.01 m
CartesianPosition3d = Sequence(
    xCoordinate=CartesianCoordinate,
    yCoordinate=CartesianCoordinate,
    zCoordinate=Optional(CartesianCoordinate),
)
StandardLength12b = Integer(0, 4095)  # 0.1 m
RectangularShape = Sequence(
    shapeReferencePoint=Optional(CartesianPosition3d),
    semiLength=StandardLength12b,
    semiBreadth=StandardLength12b,
    orientation=Optional(CartesianAngleValue),
    height=Optional(StandardLength12b),
)
CircularShape = Sequence(
    shapeReferencePoint=Optional(CartesianPosition3d),
    radius=StandardLength12b,
    height=Optional(StandardLength12b),
)
SequenceOfCartesianPosition3d = ListOf(CartesianPosition3d, 1, 16, extensible=True)
PolygonalShape = Sequence(
    shapeReferencePoint=Optional(CartesianPosition3d),
    polygon=SequenceOfCartesianPosition3d.sized(3, 16, extensible=True),
    height=Optional(StandardLength12b),
)
EllipticalShape = Sequence(
    shapeReferencePoint=Optional(CartesianPosition3d),
    semiMajorAxisLength=StandardLength12b,
    semiMinorAxisLength=StandardLength12b,
    orientation=Optional(CartesianAngleValue),
    height=Optional(StandardLength12b),
)
RadialShape = Sequence(
    shapeReferencePoint=Optional(CartesianPosition3d),
    range=StandardLength12b,
    horizontalOpeningAngleStart=CartesianAngleValue,
    horizontalOpeningAngleEnd=CartesianAngleValue,
    verticalOpeningAngleStart=Optional(CartesianAngleValue),
    verticalOpeningAngleEnd=Optional(CartesianAngleValue),
)
CartesianCoordinateSmall = Integer(-3094, 1001)  # 0.01 m
RadialShapeDetails = Sequence(
    range=StandardLength12b,
    horizontalOpeningAngleStart=CartesianAngleValue,
    horizontalOpeningAngleEnd=CartesianAngleValue,
    verticalOpeningAngleStart=Optional(CartesianAngleValue),
    verticalOpeningAngleEnd=Optional(CartesianAngleValue),
)
RadialShapesList = ListOf(RadialShapeDetails, 1, 16, extensible=True)
RadialShapes = Sequence(
    refPointId=Identifier1B,
    xCoordinate=CartesianCoordinateSmall,
    yCoordinate=CartesianCoordinateSmall,
    zCoordinate=Optional(CartesianCoordinateSmall),
    radialShapesList=RadialShapesList,
)
Shape = Choice(
    rectangular=RectangularShape,
    circular=CircularShape,
    polygonal=PolygonalShape,
    elliptical=EllipticalShape,
    radial=RadialShape,
    radialShapes=RadialShapes,
).extensible()
ConfidenceLevel = Integer(1, 101)  # percent; 101: unavailable
DeltaTimeMilliSecondSigned = Integer(-2048, 2047)  # ms
SequenceOfIdentifier1B = ListOf(Identifier1B, 1, 128, extensible=True)
CardinalNumber1B = Integer(0, 255)
CartesianCoordinateLarge = Integer(-131_072, 131_071)  # 0.01 m; -131072 and 131071: out of range
CoordinateConfidence = Integer(1, 4096)  # 0.01 m; 4095: out of range, 4096: unavailable
CartesianCoordinateWithConfidence = Sequence(value=CartesianCoordinateLarge, confidence=CoordinateConfidence)
CartesianPosition3dWithConfidence = Sequence(
    xCoordinate=CartesianCoordinateWithConfidence,
    yCoordinate=CartesianCoordinateWithConfidence,
    zCoordinate=Optional(CartesianCoordinateWithConfidence),
)
SpeedValue = Integer(0, 16_383)  # 0.01 m/s; 16382: out of range, 16383: unavailable
SpeedConfidence = Integer(1, 127)  # 0.01 m/s; 126: out of range, 127: unavailable
Speed = Sequence(speedValue=SpeedValue, speedConfidence=SpeedConfidence)
VelocityComponentValue = Integer(-16_383, 16_383)  # 0.01 m/s; -16383 and 16382: out of range, 16383: unavailable
VelocityComponent = Sequence(value=VelocityComponentValue, confidence=SpeedConfidence)
VelocityPolarWithZ = Sequence(
    velocityMagnitude=Speed,
    velocityDirection=CartesianAngle,
    zVelocity=Optional(VelocityComponent),
)
VelocityCartesian = Sequence(
    xVelocity=VelocityComponent,
    yVelocity=VelocityComponent,
    zVelocity=Optional(VelocityComponent),
)
Velocity3dWithConfidence = Choice(polarVelocity=VelocityPolarWithZ, cartesianVelocity=VelocityCartesian)
AccelerationMagnitudeValue = Integer(0, 161)  # 0.1 m/s²; 160: out of range, 161: unavailable
AccelerationConfidence = Integer(0, 102)  # 0.1 m/s²; 101: out of range, 102: unavailable
AccelerationMagnitude = Sequence(
    accelerationMagnitudeValue=AccelerationMagnitudeValue,
    accelerationConfidence=AccelerationConfidence,
)
AccelerationValue = Integer(-160, 161)  # 0.1 m/s²; -160 and 160: out of range, 161: unavailable
AccelerationComponent = Sequence(value=AccelerationValue, confidence=AccelerationConfidence)
AccelerationPolarWithZ = Sequence(
    accelerationMagnitude=AccelerationMagnitude,
    accelerationDirection=CartesianAngle,
    zAcceleration=Optional(AccelerationComponent),
)
AccelerationCartesian = Sequence(
    xAcceleration=AccelerationComponent,
    yAcceleration=AccelerationComponent,
    zAcceleration=Optional(AccelerationComponent),
)
Acceleration3dWithConfidence = Choice(
    polarAcceleration=AccelerationPolarWithZ,
    cartesianAcceleration=AccelerationCartesian,
)
EulerAnglesWithConfidence = Sequence(
    zAngle=CartesianAngle,
    yAngle=Optional(CartesianAngle),
    xAngle=Optional(CartesianAngle),
)
CartesianAngularVelocityComponentValue = Integer(-255, 256)  # deg/s; -255 and 255: out of range, 256: unavailable
AngularSpeedConfidence = Enumerated(
    "degSec-01 degSec-02 degSec-05 degSec-10 degSec-20 degSec-50 outOfRange unavailable"
)
CartesianAngularVelocityComponent = Sequence(
    value=CartesianAngularVelocityComponentValue,
    confidence=AngularSpeedConfidence,
)
MatrixIncludedComponents = Bits(13, extensible=True)
CorrelationCellValue = Integer(-100, 101)  # 0.01; 101: unavailable
CorrelationColumn = ListOf(CorrelationCellValue, 1, 13, extensible=True)
LowerTriangularPositiveSemidefiniteMatrixColumns = ListOf(CorrelationColumn, 1, 13, extensible=True)
LowerTriangularPositiveSemidefiniteMatrix = Sequence(
    componentsIncludedIntheMatrix=MatrixIncludedComponents,
    matrix=LowerTriangularPositiveSemidefiniteMatrixColumns,
)
LowerTriangularPositiveSemidefiniteMatrices = ListOf(LowerTriangularPositiveSemidefiniteMatrix, 1, 4)
ObjectDimensionValue = Integer(1, 256)  # 0.1 m; 255: out of range, 256: unavailable
ObjectDimensionConfidence = Integer(1, 32)  # 0.1 m; 31: out of range, 32: unavailable
ObjectDimension = Sequence(value=ObjectDimensionValue, confidence=ObjectDimensionConfidence)
ObjectPerceptionQuality = Integer(0, 15)  # 0: none, 15: full
VruSubProfilePedestrian = Integer(0, 15)
VruSubProfileBicyclist = Integer(0, 15)
VruSubProfileMotorcyclist = Integer(0, 15)
VruSubProfileAnimal = Integer(0, 15)
VruProfileAndSubprofile = Choice(
    pedestrian=VruSubProfilePedestrian,
    bicyclistAndLightVruVehicle=VruSubProfileBicyclist,
    motorcyclist=VruSubProfileMotorcyclist,
    animal=VruSubProfileAnimal,
).extensible()
VruClusterProfiles = Bits(4)
VruClusterInformation = Sequence(
    clusterId=Optional(Identifier1B),
    clusterBoundingBoxShape=Optional(Shape),
    clusterCardinalitySize=CardinalNumber1B,
    clusterProfiles=Optional(VruClusterProfiles),
).extensible()
OtherSubClass = Integer(0, 255)
ObjectClass = Choice(
    vehicleSubClass=Integer(0, 14).only(0, (5, 11), 14),
    vruSubClass=VruProfileAndSubprofile,
    groupSubClass=VruClusterInformation.constrained(clusterBoundingBoxShape=Absent(Shape)),
    otherSubClass=OtherSubClass,
).extensible()
ObjectClassWithConfidence = Sequence(objectClass=ObjectClass, confidence=ConfidenceLevel)
ObjectClassDescription = ListOf(ObjectClassWithConfidence, 1, 8)
LongitudinalLanePositionValue = Integer(0, 32_767)
LongitudinalLanePositionConfidence = Integer(0, 1023)
LongitudinalLanePosition = Sequence(
    longitudinalLanePositionValue=LongitudinalLanePositionValue,
    longitudinalLanePositionConfidence=LongitudinalLanePositionConfidence,
)
MapPosition = Sequence(
    mapReference=Optional(MapReference),
    laneId=Optional(Identifier1B),
    connectionId=Optional(Identifier1B),
    longitudinalLanePosition=Optional(LongitudinalLanePosition),
).extensible()
PerceivedObject = Sequence(
    objectId=Optional(Identifier2B),
    measurementDeltaTime=DeltaTimeMilliSecondSigned,
    position=CartesianPosition3dWithConfidence,
    velocity=Optional(Velocity3dWithConfidence),
    acceleration=Optional(Acceleration3dWithConfidence),
    angles=Optional(EulerAnglesWithConfidence),
    zAngularVelocity=Optional(CartesianAngularVelocityComponent),
    lowerTriangularCorrelationMatrices=Optional(LowerTriangularPositiveSemidefiniteMatrices),
    objectDimensionZ=Optional(ObjectDimension),
    objectDimensionY=Optional(ObjectDimension),
    objectDimensionX=Optional(ObjectDimension),
    objectAge=Optional(Integer(0, 2047)),
    objectPerceptionQuality=Optional(ObjectPerceptionQuality),
    sensorIdList=Optional(SequenceOfIdentifier1B),
    classification=Optional(ObjectClassDescription),
    mapPosition=Optional(MapPosition),
).extensible()
TrafficParticipantType = Integer(0, 255)


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
