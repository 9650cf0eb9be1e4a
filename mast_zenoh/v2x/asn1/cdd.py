"""Field tables of the ITS common data dictionary: TS 102 894-2 v2.4.1, as far as CPM or both CPM and CAM use it.

Names are those of the standard. Units follow the type. "out of range" means that or beyond; confidences are half
widths of 95 % intervals.
"""

from __future__ import annotations

from mast_zenoh.v2x.asn1.asn1_types import Absent, Bits, Choice, Enumerated, Integer, ListOf, Optional, Sequence

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
