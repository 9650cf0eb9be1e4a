"""Unaligned packed encoding rules (UPER, ITU-T X.691): flat values (see `layout`) to bytes and back.

Encodings are canonical: whatever decodes encodes to the same bytes again. Encodings that are longer than needed,
non-zero padding and trailing bytes are refused. Unknown extension additions, alternatives and containers are kept as
octets. Refused because they are not supported: fragments (lengths over 16383), more than 64 additions, integers of
more than 8 octets.

Kernels that encode and decode along a program: ITU-T X.691 (02/2021), unaligned, as one canonical encoding.

`layout` describes programs and flat values. Without compiled kernels, there is no version: ConfigurationError.

Flat values of a message (see `layout`) as dicts and lists, for export.

| type | plain |
|---|---|
| sequence | dict; absent fields have no key; fields with a DEFAULT always have one |
| list | list |
| choice | dict of one key |
| integer, boolean | int, bool |
| enumeration | name |
| bit string, octet string | text of 0 and 1, text of hexadecimal digits |
| open type | its contents; hexadecimal digits if the identifier is unknown |
| unknown addition | key or name "+N", counted from 0 behind the extension marker; hexadecimal digits |

An unknown addition of None is the last one that the encoding lists, if that is absent.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from mast_zenoh.errors import MessageError
from mast_zenoh.kernels import kernel, missing
from mast_zenoh.v2x.asn1.asn1_types import (
    LONGEST,
    UNKNOWN,
    BitString,
    Boolean,
    Choice,
    Enumerated,
    Integer,
    ListOf,
    OctetString,
    Sequence,
    Type,
    Wrapped,
)
from mast_zenoh.v2x.asn1.layout import EncodingProgram, NodeKind, extension_slot, places, width

Values = npt.NDArray[np.int64]


class CodecFault(IntEnum):
    """What is wrong with bytes or values; `kernels/uper.pxd` repeats them."""

    TRUNCATED = 1
    TRAILING = 2
    PADDING = 3
    RANGE = 4
    COUNT = 5
    PRESENCE = 6
    LONGER = 7
    FRAGMENTED = 8
    OPEN_LENGTH = 9
    NO_ADDITION = 10
    ADDITIONS = 11
    WIDE_INTEGER = 12
    ROWS = 13


#: Why a kernel refuses bytes or values: the fault, the offending number, and the numbers of fields, elements and
#: alternatives on the way to it.
Refusal = tuple[int, int, tuple[int, ...]]


@kernel
def decode_values(program: Values, data: bytes) -> tuple[Values | None, Refusal | None]:
    """The flat values of a message, or why it is refused."""
    raise missing("reading CPMs and CAMs")


@kernel
def encode_values(program: Values, values: Values) -> tuple[bytes | None, Refusal | None]:
    """The bytes of a message, or why its flat values are refused."""
    raise missing("writing CPMs and CAMs")


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


def to_plain(layout: EncodingProgram, values: Values) -> Any:
    """A message's flat values as dicts and lists."""
    return _to_plain(layout.type, values.tolist(), 0)


def _to_plain(type: Type, values: list[int], slot: int) -> Any:
    value = values[slot]
    if isinstance(type, Integer):
        return bool(value) if isinstance(type, Boolean) else value
    if isinstance(type, Enumerated):
        return type.known[value] if value < len(type.known) else unknown_name(value - len(type.root))
    if isinstance(type, ListOf):
        count, start, step = value, values[slot + 1], width(type.element)
        elements = [_to_plain(type.element, values, start + step * row) for row in range(count)]
        if isinstance(type, BitString):
            return "".join(map(str, elements))
        return bytes(elements).hex() if isinstance(type, OctetString) else elements
    if isinstance(type, Sequence):
        return _fields(type, values, slot)
    if isinstance(type, Choice):
        names = list(type.known)
        if value < len(names):
            return {names[value]: _to_plain(type.known[names[value]], values, slot + 1)}
        return {unknown_name(value - len(type.alternatives)): _to_plain(UNKNOWN, values, slot + 1)}
    return {type.id_name: value, type.data_name: _to_plain(type.contents.get(value, UNKNOWN), values, slot + 1)}


def _fields(type: Sequence, values: list[int], slot: int) -> dict[str, Any]:
    plain = {
        place.name: _to_plain(place.type, values, slot + place.slot)
        for place in places(type)
        if place.kind < NodeKind.OPTIONAL or values[slot + place.first]
    }
    if type.additions is not None:
        known = len(type.additions)
        n, start = values[slot + extension_slot(type)], values[slot + extension_slot(type) + 1]
        for addition in range(known, n):
            row = start + 3 * (addition - known)
            if values[row]:
                plain[unknown_name(addition)] = _to_plain(UNKNOWN, values, row + 1)
            elif addition == n - 1:
                plain[unknown_name(addition)] = None
    return plain
