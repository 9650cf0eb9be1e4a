"""Compiles a field table into a program for the codec, and says where the flat values of a message hold each field.

The flat values of a message are one vector of int64. A type has a fixed number of slots, whatever is present:

| type | slots |
|---|---|
| integer, boolean, enumeration | the value; of an enumeration its place among the names |
| list, bit string, octet string | count; start: where in the vector its rows are, one after the other |
| sequence | its fields; optional ones after a slot that is 1 if they are present |
| choice | the number of the alternative; the alternative, or octets if it is unknown |
| open type | identifier; contents, or octets if it is unknown |

An extensible sequence has three more parts after its fields: the number of additions that its encoding lists, 0 if it
has none; the start of the unknown ones, three slots each for presence and octets; the known additions, like optional
fields.

Slots of what is absent are 0. So the objects of a message are a matrix with a column for each field, whatever optional
fields they have, and no field has to be looked for. A stream of values in the order of encoding would be shorter, but
would need a walk over each object.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np
import numpy.typing as npt

from mast_zenoh.v2x.asn1.asn1_types import (
    LONGEST,
    UNKNOWN,
    Absent,
    Choice,
    Default,
    Demanded,
    Enumerated,
    Field,
    Integer,
    ListOf,
    Optional,
    Sequence,
    Type,
    Wrapped,
)


class Op(IntEnum):
    """First number of each node of a program; `kernels/uper.pxd` repeats them."""

    INTEGER = 0
    ENUMERATED = 1
    LIST = 2
    SEQUENCE = 3
    CHOICE = 4
    WRAPPED = 5


class NodeKind(IntEnum):
    """Presence of a sequence's field; `kernels/uper.pxd` repeats them."""

    MANDATORY = 0
    DEFAULT = 1
    OPTIONAL = 2
    PRESENT = 3
    ABSENT = 4


_KINDS = {Default: NodeKind.DEFAULT, Optional: NodeKind.OPTIONAL, Demanded: NodeKind.PRESENT, Absent: NodeKind.ABSENT}


@dataclass(frozen=True)
class SlotPlace:
    """Place of a sequence's field in the slots of the sequence.

    slot: of the value;  a slot for presence is before it if `kind` >= OPTIONAL
    default: of a DEFAULT field
    """

    name: str
    type: Type
    kind: NodeKind
    slot: int
    default: int = 0

    @property
    def first(self) -> int:
        """The presence, or the value if there is no slot for presence."""
        return self.slot - (self.kind >= NodeKind.OPTIONAL)


@cache
def places(sequence: Sequence) -> tuple[SlotPlace, ...]:
    """Places of all fields, those of additions at the end."""
    result: list[SlotPlace] = []
    slot = 0
    fields: dict[str, Field] = {**sequence.fields, **(sequence.additions or {})}
    for name, field in fields.items():
        if len(result) == len(sequence.fields):
            slot += 2  # the number of additions, and the start of unknown ones
        type = field.type if isinstance(field, Optional) else field
        kind = _KINDS.get(field.__class__, NodeKind.MANDATORY)
        slot += kind >= NodeKind.OPTIONAL
        result.append(SlotPlace(name, type, kind, slot, field.value if isinstance(field, Default) else 0))
        slot += width(type)
    return tuple(result)


@cache
def extension_slot(sequence: Sequence) -> int:
    """The slot of the number of additions; the start of unknown ones follows."""
    root = places(sequence)[: len(sequence.fields)]
    return root[-1].slot + width(root[-1].type)


@cache
def width(type: Type) -> int:
    """Number of slots."""
    if isinstance(type, ListOf):
        return 2
    if isinstance(type, Sequence):
        places_ = places(type)
        after = extension_slot(type) + 2 * (type.additions is not None)
        return max(after, places_[-1].slot + width(places_[-1].type))
    if isinstance(type, Choice):
        return 1 + max([*map(width, type.known.values()), width(UNKNOWN) * (type.additions is not None)])
    if isinstance(type, Wrapped):
        return 1 + max(map(width, [*type.contents.values(), UNKNOWN]))
    return 1


def bits_of_range(low: int, high: int) -> int:
    """Bits of a constrained whole number (X.691, 11.5.7, unaligned)."""
    return (high - low).bit_length()


@cache
def least_bits(type: Type) -> int:
    """A lower bound of the bits of any value: it limits the memory that a forged count can demand."""
    if isinstance(type, Integer):
        bits = bits_of_range(type.low, type.high)
        return 1 + min(bits, 16) if type.extensible else bits
    if isinstance(type, Enumerated):
        bits = bits_of_range(0, len(type.root) - 1)
        return bits if type.additions is None else 1 + min(bits, 7)
    if isinstance(type, ListOf):
        if type.extensible:
            return 1
        return bits_of_range(type.low, type.high) + type.low * least_bits(type.element)
    if isinstance(type, Sequence):
        root = places(type)[: len(type.fields)]
        flags = (type.additions is not None) + sum(place.kind != NodeKind.MANDATORY for place in root)
        return flags + sum(least_bits(place.type) for place in root if place.kind == NodeKind.MANDATORY)
    if isinstance(type, Choice):
        return bits_of_range(0, len(type.alternatives) - 1) + (type.additions is not None)
    return bits_of_range(type.id_type.low, type.id_type.high) + 16


class EncodingProgram:
    """A message's type as a program: nodes of int64, each with the addresses of those that it consists of.

    The program begins with the address of the message, the address of unknown octets, and the slots of a message.

    | node | numbers after its op |
    |---|---|
    | INTEGER | low, high, bits, extensible, number of allowed ranges, these |
    | ENUMERATED (extensible) | number of root values, bits |
    | LIST | low, high, bits of the count, extensible, largest count; of the element: address, width, least bits |
    | SEQUENCE | number of fields, number of additions (-1: not extensible), extension slot, bits of presence; |
    | | of each field and addition: kind, slot, address, default |
    | CHOICE | root alternatives, bits, additions (-1: not extensible), addresses |
    | WRAPPED | address of the identifier, number of contents; of each: identifier, address |
    """

    def __init__(self, name: str, type: Type) -> None:
        self.name, self.type = name, type
        self._nodes: list[int] = [0, 0, width(type)]
        self._addresses: dict[Type, int] = {}
        self._nodes[:2] = [self._compile(type), self._compile(UNKNOWN)]
        self.program: npt.NDArray[np.int64] = np.array(self._nodes, np.int64)
        self.program.flags.writeable = False

    def _compile(self, type: Type) -> int:
        """Address of a type's node, which is appended once."""
        if type not in self._addresses:
            node = self._node(type)
            self._addresses[type] = len(self._nodes)
            self._nodes += node
        return self._addresses[type]

    def _node(self, type: Type) -> list[int]:
        if isinstance(type, Integer):
            bits = bits_of_range(type.low, type.high)
            ranges = [bound for range in type.allowed for bound in range]
            return [Op.INTEGER, type.low, type.high, bits, type.extensible, len(type.allowed), *ranges]
        if isinstance(type, Enumerated):
            n = len(type.root)
            if type.additions is None:
                return [Op.INTEGER, 0, n - 1, bits_of_range(0, n - 1), 0, 0]
            return [Op.ENUMERATED, n, bits_of_range(0, n - 1)]
        if isinstance(type, ListOf):
            element = [self._compile(type.element), width(type.element), least_bits(type.element)]
            assert element[2] > 0, "a list of elements without bits has no bound"
            largest = type.largest or (LONGEST if type.extensible else type.high)
            bits = bits_of_range(type.low, type.high)
            return [Op.LIST, type.low, type.high, bits, type.extensible, largest, *element]
        if isinstance(type, Sequence):
            fields = [
                number
                for place in places(type)
                for number in (place.kind, place.slot, self._compile(place.type), place.default)
            ]
            n_fields, root = len(type.fields), places(type)[: len(type.fields)]
            flags = sum(place.kind != NodeKind.MANDATORY for place in root)
            additions = -1 if type.additions is None else len(type.additions)
            return [Op.SEQUENCE, n_fields, additions, extension_slot(type), flags, *fields]
        if isinstance(type, Choice):
            n, additions = len(type.alternatives), -1 if type.additions is None else len(type.additions)
            return [Op.CHOICE, n, bits_of_range(0, n - 1), additions, *map(self._compile, type.known.values())]
        contents = [number for id, content in type.contents.items() for number in (id, self._compile(content))]
        return [Op.WRAPPED, self._compile(type.id_type), len(type.contents), *contents]


def slot_of(type: Type, path: str) -> int:
    """The slot of a field's value in the row of a type, for example "position.xCoordinate.value".

    Parts are names of fields and alternatives; "?" after a name: the slot of its presence instead.
    """
    slot = 0
    for part in path.split("."):
        if isinstance(type, Sequence):
            place = next(place for place in places(type) if place.name == part.rstrip("?"))
            slot, type = slot + (place.first if part.endswith("?") else place.slot), place.type
        else:
            assert isinstance(type, Choice)
            slot, type = slot + 1, type.known[part]
    return slot
