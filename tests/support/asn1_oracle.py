"""asn1tools as a second encoder of CAM and CPM, made from ETSI's modules in the folder of recorded data."""

import os
from functools import cache
from pathlib import Path
from typing import Any

import asn1tools

from mast_zenoh.v2x.asn1.asn1_types import (
    BitString,
    Choice,
    Default,
    Enumerated,
    ListOf,
    OctetString,
    Optional,
    Sequence,
    Type,
    Wrapped,
)

FOLDER = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data") / "etsi_asn1"

#: Where asn1tools 0.169 deviates from X.691, written so that it does not: what it reads, and what it should.
REWRITES = (
    ("WrappedCpmContainers::= SEQUENCE SIZE(1..8,...) OF", "WrappedCpmContainers::= SEQUENCE SIZE(1..8) OF"),
    ("ExtensionContainerId ::= INTEGER (1..16,...)", "ExtensionContainerId ::= INTEGER (1..16)"),
    ("(unknown|passengerCar..tram|agricultural)", "(0..14)"),
    ("(unavailable | bicyclist | e-scooter | pedelec | speed-pedelec | roadbike | childrensbike)", "(0..10)"),
    ("SequenceOfCartesianPosition3d (SIZE(3..16,...))", "SEQUENCE (SIZE(3..16,...)) OF CartesianPosition3d"),
    ("DeltaAltitude DEFAULT unavailable", "DeltaAltitude DEFAULT 12800"),
    ("DEFAULT traffic,", "DEFAULT 0,"),
    ("DEFAULT sameDirection,", "DEFAULT 0,"),
    ("PathPredicted::= SEQUENCE (SIZE(1..16,..., 17..40))", "PathPredicted::= SEQUENCE (SIZE(1..16))"),
)  # fmt: skip

#: Names of the types of containers, which asn1tools encodes by themselves.
CONTAINERS = {
    "CPM": (
        "OriginatingVehicleContainer", "OriginatingRsuContainer", "SensorInformationContainer",
        "PerceptionRegionContainer", "PerceivedObjectContainer",
    ),
    "CAM": (
        "TwoWheelerContainer", "EHorizonLocationSharingContainer", "VeryLowFrequencyContainer",
        "PathPredictionContainer", "GeneralizedLanePositionsContainer", "VehicleMovementControlContainer",
    ),
}  # fmt: skip
ROOTS = {"CPM": "CollectivePerceptionMessage", "CAM": "CAM"}


@cache
def specification(message: str) -> Any:
    """asn1tools' codec; message: CPM or CAM."""
    files = sorted([*FOLDER.glob(f"*{message}*.asn"), *FOLDER.glob("*CDD.asn")])
    text = "\n".join(file.read_text(encoding="latin-1") for file in files)
    for found, replaced in REWRITES:
        text = text.replace(found, replaced)
    return asn1tools.compile_string(text, "uper")


def encode(message: str, type: Type, plain: Any) -> bytes:
    """The bytes that asn1tools makes of plain values."""
    return bytes(specification(message).encode(ROOTS[message], to_asn1tools(message, type, plain)))


def decode(message: str, type: Type, data: bytes) -> Any:
    """The plain values that asn1tools reads from bytes."""
    return from_asn1tools(message, type, specification(message).decode(ROOTS[message], data))


def _inner(field: Any) -> Type:
    return field.type if isinstance(field, Optional) else field


def to_asn1tools(message: str, type: Type, plain: Any) -> Any:
    """Plain values in the notation of asn1tools."""
    if isinstance(type, BitString):
        return int(plain.ljust(-(-len(plain) // 8) * 8, "0"), 2).to_bytes(-(-len(plain) // 8)), len(plain)
    if isinstance(type, OctetString):
        return bytes.fromhex(plain)
    if isinstance(type, ListOf):
        return [to_asn1tools(message, type.element, element) for element in plain]
    if isinstance(type, Sequence):
        fields = {**type.fields, **(type.additions or {})}
        return {name: to_asn1tools(message, _inner(fields[name]), value) for name, value in plain.items()}
    if isinstance(type, Choice):
        ((name, value),) = plain.items()
        return name, to_asn1tools(message, type.known[name], value)
    if isinstance(type, Wrapped):
        id = plain[type.id_name]
        inner = to_asn1tools(message, type.contents[id], plain[type.data_name])
        data = specification(message).encode(CONTAINERS[message][id - 1], inner)
        return {type.id_name: id, type.data_name: bytes(data)}
    return plain


def from_asn1tools(message: str, type: Type, value: Any) -> Any:
    """Values of asn1tools as plain ones."""
    if isinstance(type, BitString):
        octets, n = value
        return bin(int.from_bytes(b"\x01" + octets))[3:][:n]
    if isinstance(type, OctetString):
        return value.hex()
    if isinstance(type, ListOf):
        return [from_asn1tools(message, type.element, element) for element in value]
    if isinstance(type, Sequence):
        fields = {**type.fields, **(type.additions or {})}
        defaults = {name: _default(field) for name, field in fields.items() if isinstance(field, Default)}
        return defaults | {name: from_asn1tools(message, _inner(fields[name]), inner) for name, inner in value.items()}
    if isinstance(type, Choice):
        name, inner = value
        return {name: from_asn1tools(message, type.known[name], inner)}
    if isinstance(type, Wrapped):
        id = value[type.id_name]
        inner = specification(message).decode(CONTAINERS[message][id - 1], value[type.data_name])
        return {type.id_name: id, type.data_name: from_asn1tools(message, type.contents[id], inner)}
    return value


def _default(field: Default) -> Any:
    return field.type.known[field.value] if isinstance(field.type, Enumerated) else field.value
