"""Unaligned packed encoding rules (UPER, ITU-T X.691): flat values (see `layout`) to bytes and back.

Encodings are canonical: whatever decodes encodes to the same bytes again. Encodings that are longer than needed,
non-zero padding and trailing bytes are refused. Unknown extension additions, alternatives and containers are kept as
octets. Refused because they are not supported: fragments (lengths over 16383), more than 64 additions, integers of
more than 8 octets.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1.asn1_types import LONGEST, Choice, Enumerated, Integer, ListOf, Sequence, Type, Wrapped
from mast_zenoh.v2x.asn1.codec_kernels import CodecFault, Refusal, Values, decode_values, encode_values
from mast_zenoh.v2x.asn1.layout import EncodingProgram, NodeKind, places


def encode(layout: EncodingProgram, values: Values) -> bytes:
    """Bytes of a message; MessageError names the field that is outside its constraint."""
    data, refusal = encode_values(layout.program, np.ascontiguousarray(values, np.int64))
    if data is None:
        assert refusal is not None
        raise MessageError(f"cannot encode this {layout.name}: {_explanation(layout, refusal)}")
    return data


def decode(layout: EncodingProgram, data: bytes) -> Values:
    """Flat values of a message; MessageError names the field where bytes are not a canonical encoding."""
    values, refusal = decode_values(layout.program, data)
    if values is None:
        assert refusal is not None
        raise MessageError(f"not a {layout.name} of {len(data)} bytes: {_explanation(layout, refusal)}")
    return values


def _explanation(layout: EncodingProgram, refusal: Refusal) -> str:
    """Path of the offending field, what was found and what was expected."""
    fault, found, numbers = refusal
    path, type, kind = _location(layout.type, numbers)
    return f"{path or 'message'}: {_TEXTS[CodecFault(fault)](found, type, kind)}"


def _location(type: Type, numbers: tuple[int, ...]) -> tuple[str, Type | None, NodeKind | None]:
    """Path, type (None: unknown octets) and presence of a field."""
    path: list[str] = []
    kind, at = None, type
    for number in numbers:
        kind = None
        if isinstance(at, ListOf):
            path.append(f"[{number}]")
            at = at.element
        elif isinstance(at, Sequence):
            if number >= len(places(at)):
                return _joined([*path, unknown_name(number - len(at.fields))]), None, None
            place = places(at)[number]
            path.append(f".{place.name}")
            at, kind = place.type, place.kind
        elif isinstance(at, Choice):
            names = list(at.known)
            if number >= len(names):
                return _joined([*path, unknown_name(number - len(at.alternatives))]), None, None
            path.append(f".{names[number]}")
            at = at.known[names[number]]
        else:
            assert isinstance(at, Wrapped)
            path.append(f".{at.data_name}")
            if number >= len(at.contents):
                return _joined(path), None, None
            at = list(at.contents.values())[number]
    return _joined(path), at, kind


def unknown_name(number: int) -> str:
    """Name of an addition that this version does not know, counted from 0 behind the extension marker."""
    return f"+{number}"


def _joined(path: list[str]) -> str:
    return "".join(part if part[0] in ".[" else f".{part}" for part in path).removeprefix(".")


def _expected(type: Type | None) -> str:
    """The values of a type, for messages."""
    if isinstance(type, Integer):
        ranges = type.allowed or ((type.low, type.high),)
        return " or ".join(f"{a}..{b}" if a < b else f"{a}" for a, b in ranges)
    if isinstance(type, Enumerated):
        return f"one of {', '.join(type.known)}"
    if isinstance(type, Choice):
        return f"one of {', '.join(list(type.known)[:9])}{', ...' if len(type.known) > 9 else ''}"
    if isinstance(type, ListOf):
        largest = type.largest or (LONGEST if type.extensible else type.high)
        if type.extensible:
            return f"{type.low}..{type.high} or, as an extension, 0..{largest}"
        return f"{type.low}..{largest}"
    return f"1..{LONGEST}"


Text = Callable[[int, Type | None, NodeKind | None], str]

_TEXTS: dict[CodecFault, Text] = {
    CodecFault.TRUNCATED: lambda found, type, kind: f"the bytes end here, {found} bits are left and more are needed",
    CodecFault.TRAILING: lambda found, type, kind: f"found {found} trailing bytes, expected none",
    CodecFault.PADDING: lambda found, type, kind: f"found {found} padding bits that are not all 0",
    CodecFault.RANGE: lambda found, type, kind: f"found {found}, expected {_expected(type)}",
    CodecFault.COUNT: lambda found, type, kind: f"found {found} elements, expected {_expected(type)}",
    CodecFault.PRESENCE: lambda found, type, kind: f"found presence {found}, expected {_presence(found, kind)}",
    CodecFault.LONGER: lambda found, type, kind: f"{found} is encoded longer than needed, expected the shortest form",
    CodecFault.FRAGMENTED: lambda found, type, kind: f"found a fragmented length, expected at most {LONGEST}",
    CodecFault.OPEN_LENGTH: lambda found, type, kind: (
        f"found a length of {found} octets, which differs from the contents"
    ),
    CodecFault.NO_ADDITION: lambda found, type, kind: (
        f"found a list of {found} extension additions that are all absent"
    ),
    CodecFault.ADDITIONS: lambda found, type, kind: (
        "found an extension addition after the 64th, which is not supported"
    ),
    CodecFault.WIDE_INTEGER: lambda found, type, kind: f"found an integer of {found} octets, expected 1..8",
    CodecFault.ROWS: lambda found, type, kind: f"found rows at slot {found}, which is outside the values",
}


def _presence(found: int, kind: NodeKind | None) -> str:
    if kind == NodeKind.PRESENT:
        return "1: the field is mandatory here"
    if kind == NodeKind.ABSENT:
        return "0: the field is not allowed here"
    return "0: it is behind the listed additions" if found == 1 else "0 or 1"
