"""Kinds of ASN.1 types (ITU-T X.680), as far as CAM and CPM need them.

A type is written once, in a field table, and compiled by `layout`. Constraints that decide the bits of an encoding are
the bounds of `Integer` and of sizes. `allowed`, `largest`, `Demanded` and `Absent` narrow the values further without
changing a bit; the codec checks both. Constraints that relate several fields are not checked, for example that both
vertical opening angles of a shape are present or none is.

Extensible types take values beyond their root, as X.691 says: `additions` of a sequence, a choice or an enumeration
are those that the version knows, None if there is no extension marker.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

#: The largest count and the most octets of an open type: longer ones would be fragmented (X.691, 11.9.3.8), and no
#: message that fits into a packet has one.
LONGEST = 16383


@dataclass(frozen=True, eq=False)
class Integer:
    """INTEGER (low..high), with ", ..." if extensible.

    allowed: ranges (first, last) of values, if fewer than low..high
    """

    low: int
    high: int
    extensible: bool = False
    allowed: tuple[tuple[int, int], ...] = ()

    def only(self, *ranges: int | tuple[int, int]) -> Integer:
        """The same bits, for fewer values: numbers, or ranges (first, last)."""
        allowed = tuple(item if isinstance(item, tuple) else (item, item) for item in ranges)
        return dataclasses.replace(self, allowed=allowed)


class Boolean(Integer):
    """BOOLEAN: an integer of one bit."""


BOOLEAN = Boolean(0, 1)


@dataclass(frozen=True, eq=False)
class Enumerated:
    """ENUMERATED, by names that are separated by spaces; the value is the place of the name."""

    names: str
    additions: str | None = None

    @property
    def root(self) -> tuple[str, ...]:
        return tuple(self.names.split())

    @property
    def known(self) -> tuple[str, ...]:
        """All names, those of additions at the end."""
        return (*self.root, *(self.additions or "").split())


@dataclass(frozen=True, eq=False)
class ListOf:
    """SEQUENCE (SIZE (low..high)) OF element, with ", ..." if extensible.

    largest: the largest count, if it is not `high`, or for an extensible size not unlimited
    """

    element: Type
    low: int
    high: int
    extensible: bool = False
    largest: int | None = None

    def sized(self, low: int, high: int, extensible: bool = False) -> ListOf:
        """A list of the same elements, with other bounds."""
        return dataclasses.replace(self, low=low, high=high, extensible=extensible, largest=None)

    def at_most(self, largest: int) -> ListOf:
        """The same bits, for fewer elements."""
        return dataclasses.replace(self, largest=largest)


class BitString(ListOf):
    """BIT STRING: encoded like a list of bits."""


class OctetString(ListOf):
    """OCTET STRING: encoded like a list of octets."""


_BIT, _OCTET = Integer(0, 1), Integer(0, 255)


def Bits(low: int, high: int | None = None, extensible: bool = False) -> BitString:
    """BIT STRING (SIZE (low..high))"""
    return BitString(_BIT, low, low if high is None else high, extensible)


def Octets(low: int, high: int) -> OctetString:
    """OCTET STRING (SIZE (low..high))"""
    return OctetString(_OCTET, low, high)


@dataclass(frozen=True, eq=False)
class Optional:
    """OPTIONAL"""

    type: Type


class Demanded(Optional):
    """Optional in the encoding, but a constraint demands it."""


class Absent(Optional):
    """Optional in the encoding, but a constraint forbids it."""


@dataclass(frozen=True, eq=False)
class Default(Optional):
    """DEFAULT: a value equal to the default is never encoded."""

    value: int


class Sequence:
    """SEQUENCE, by field name.

    additions: those behind the extension marker; None: there is no marker
    """

    def __init__(self, **fields: Field) -> None:
        self.fields: Mapping[str, Field] = fields
        self.additions: Mapping[str, Optional] | None = None

    def extensible(self, **additions: Optional) -> Sequence:
        """The sequence with an extension marker, and with the additions that the version knows."""
        sequence = copy(self)
        sequence.additions = additions
        return sequence

    def constrained(self, **fields: Field) -> Sequence:
        """The sequence with narrower types of some fields."""
        assert fields.keys() <= self.fields.keys()
        sequence = copy(self)
        sequence.fields = {**self.fields, **fields}
        return sequence


class Choice:
    """CHOICE, by name of the alternative.

    additions: those behind the extension marker; None: there is no marker
    """

    def __init__(self, **alternatives: Type) -> None:
        self.alternatives: Mapping[str, Type] = alternatives
        self.additions: Mapping[str, Type] | None = None

    def extensible(self, **additions: Type) -> Choice:
        """The choice with an extension marker, and with the additions that the version knows."""
        choice = copy(self)
        choice.additions = additions
        return choice

    @property
    def known(self) -> dict[str, Type]:
        """All alternatives, additions at the end."""
        return {**self.alternatives, **(self.additions or {})}


@dataclass(frozen=True, eq=False)
class Wrapped:
    """SEQUENCE of an identifier and an open type that it chooses; unknown identifiers choose octets.

    contents: type by identifier
    """

    id_name: str
    data_name: str
    id_type: Integer
    contents: Mapping[int, Type]


#: Octets whose meaning is unknown, of extensions that this version does not know.
UNKNOWN = OctetString(_OCTET, 1, LONGEST)

Type = Integer | Enumerated | ListOf | Sequence | Choice | Wrapped
Field = Type | Optional
