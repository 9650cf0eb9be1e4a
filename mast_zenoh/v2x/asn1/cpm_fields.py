"""Field tables of the collective perception message: TS 103 324 v2.1.1, clause 7 and annex A."""

from __future__ import annotations

from mast_zenoh.v2x.asn1.asn1_types import BOOLEAN, Absent, Demanded, Integer, ListOf, Optional, Sequence, Wrapped
from mast_zenoh.v2x.asn1.cdd import (
    CardinalNumber1B,
    CartesianAngle,
    ConfidenceLevel,
    DeltaTimeMilliSecondSigned,
    Identifier1B,
    Identifier2B,
    ItsPduHeader,
    MapReference,
    MessageId,
    MessageRateHz,
    MessageSegmentationInfo,
    OrdinalNumber1B,
    PerceivedObject,
    ReferencePosition,
    SensorType,
    SequenceOfIdentifier1B,
    Shape,
    StandardLength1B,
    TimestampIts,
    TrailerData,
    VehicleWidth,
    Wgs84Angle,
)
from mast_zenoh.v2x.asn1.layout import EncodingProgram

MessageRateRange = Sequence(messageRateMin=MessageRateHz, messageRateMax=MessageRateHz)
ManagementContainer = Sequence(
    referenceTime=TimestampIts,
    referencePosition=ReferencePosition,
    segmentationInfo=Optional(MessageSegmentationInfo),
    messageRateRange=Optional(MessageRateRange),
).extensible()
TrailerDataSet = ListOf(
    TrailerData.constrained(
        frontOverhang=Absent(StandardLength1B), rearOverhang=Absent(StandardLength1B), trailerWidth=Absent(VehicleWidth)
    ),
    1,
    8,
    extensible=True,
)
OriginatingVehicleContainer = Sequence(
    orientationAngle=Wgs84Angle,
    pitchAngle=Optional(CartesianAngle),
    rollAngle=Optional(CartesianAngle),
    trailerDataSet=Optional(TrailerDataSet),
).extensible()
OriginatingRsuContainer = Sequence(mapReference=Optional(MapReference)).extensible()
SensorInformation = Sequence(
    sensorId=Identifier1B,
    sensorType=SensorType,
    perceptionRegionShape=Optional(Shape),
    perceptionRegionConfidence=Optional(ConfidenceLevel),
    shadowingApplies=BOOLEAN,
).extensible()
SensorInformationContainer = ListOf(SensorInformation, 1, 128, extensible=True)
PerceivedObjectIds = ListOf(Identifier2B, 0, 255, extensible=True)
PerceptionRegion = Sequence(
    measurementDeltaTime=DeltaTimeMilliSecondSigned,
    perceptionRegionConfidence=ConfidenceLevel,
    perceptionRegionShape=Shape,
    shadowingApplies=BOOLEAN,
    sensorIdList=Optional(SequenceOfIdentifier1B),
    numberOfPerceivedObjects=Optional(CardinalNumber1B),
    perceivedObjectIds=Optional(PerceivedObjectIds),
).extensible()
PerceptionRegionContainer = ListOf(PerceptionRegion, 1, 256, extensible=True)
PerceivedObjects = ListOf(PerceivedObject.constrained(objectId=Demanded(Identifier2B)), 0, 255, extensible=True)
PerceivedObjectContainer = Sequence(
    numberOfPerceivedObjects=CardinalNumber1B,
    perceivedObjects=PerceivedObjects,
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
    header=ItsPduHeader.constrained(protocolVersion=OrdinalNumber1B.only(2), messageId=MessageId.only(14)),
    payload=CpmPayload,
)

#: The message as a program for the codec.
LAYOUT = EncodingProgram("CPM", CollectivePerceptionMessage)
