"""Flat values of a message (see `layout`) as dicts and lists, for export.

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

from typing import Any

from mast_zenoh.v2x.asn1.asn1_types import (
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
)
from mast_zenoh.v2x.asn1.codec_kernels import Values
from mast_zenoh.v2x.asn1.layout import EncodingProgram, NodeKind, extension_slot, places, width
from mast_zenoh.v2x.asn1.uper import unknown_name


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
