"""Random V2X messages as plain values, and damaged bytes of messages."""

from typing import Any

import numpy as np

from mast_zenoh.v2x.asn1.asn1_types import (
    UNKNOWN,
    Absent,
    BitString,
    Boolean,
    Choice,
    Default,
    Demanded,
    Enumerated,
    Integer,
    ListOf,
    OctetString,
    Optional,
    Sequence,
    Type,
)


class MessageMaker:
    """Draws plain values of a type.

    presence: the share of optional fields that are present
    beyond: also draw what is beyond the root of extensible types: sizes, numbers, unknown additions and containers
    """

    def __init__(self, random: np.random.Generator, presence: float, beyond: bool) -> None:
        self.random, self.presence, self.beyond = random, presence, beyond

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def extends(self) -> bool:
        return self.beyond and self.chance(0.05)

    def integer(self, type: Integer) -> int:
        if type.extensible and self.extends():
            beyond = int(self.random.integers(-(1 << 63), 1 << 63, dtype=np.int64)) >> int(self.random.integers(0, 60))
            return beyond if not type.low <= beyond <= type.high else type.high + 1
        ranges = type.allowed or ((type.low, type.high),)
        low, high = ranges[self.random.integers(len(ranges))]
        return int(
            self.random.choice([low, high, self.random.integers(low, high + 1), self.random.integers(low, high + 1)])
        )

    def count(self, type: ListOf) -> int:
        if type.extensible and type.high <= 40 and self.extends():
            return int(self.random.choice([0, type.high + 1])) if type.low else type.high + 1
        largest = min(type.largest or type.high, 40)
        return min(largest, type.low + int(self.random.geometric(0.4)) - 1 if self.chance(0.95) else largest)

    def draw(self, type: Type) -> Any:
        """A value of a type."""
        if isinstance(type, Integer):
            value = self.integer(type)
            return bool(value) if isinstance(type, Boolean) else value
        if isinstance(type, Enumerated):
            if type.additions is not None and self.extends():
                return f"+{self.random.integers(len(type.known) - len(type.root), 64)}"
            return str(self.random.choice(type.known))
        if isinstance(type, ListOf):
            if type is UNKNOWN:
                return self.random.bytes(int(self.random.choice([1, 2, 127, 128, 300]))).hex()
            elements = [self.draw(type.element) for _ in range(self.count(type))]
            if isinstance(type, BitString):
                return "".join(map(str, elements))
            return bytes(elements).hex() if isinstance(type, OctetString) else elements
        if isinstance(type, Sequence):
            return self.sequence(type)
        if isinstance(type, Choice):
            if type.additions is not None and self.extends():
                return {f"+{self.random.integers(len(type.additions), 64)}": self.draw(UNKNOWN)}
            name = str(self.random.choice(list(type.known)))
            return {name: self.draw(type.known[name])}
        unknown = [id for id in range(type.id_type.low, type.id_type.high + 1) if id not in type.contents]
        id = int(self.random.choice(unknown if self.extends() else list(type.contents)))
        return {type.id_name: id, type.data_name: self.draw(type.contents.get(id, UNKNOWN))}

    def sequence(self, type: Sequence) -> dict[str, Any]:
        plain = {}
        for name, field in {**type.fields, **(type.additions or {})}.items():
            if isinstance(field, Absent):
                continue
            if isinstance(field, Default):
                plain[name] = self.draw(field.type)
            elif not isinstance(field, Optional) or isinstance(field, Demanded) or self.chance(self.presence):
                plain[name] = self.draw(field.type if isinstance(field, Optional) else field)
        if type.additions is not None and self.extends():
            first = len(type.additions)
            numbers = np.flatnonzero(self.random.random(64) < 0.1)
            plain |= {f"+{number}": self.draw(UNKNOWN) for number in numbers.tolist() if number >= first}
        return plain


def damaged(random: np.random.Generator, data: bytes) -> bytes:
    """Bytes of a message with some bits flipped, octets inserted, removed, repeated or cut off."""
    octets = bytearray(data)
    for _ in range(random.geometric(0.5)):
        place = int(random.integers(0, len(octets) + 1))
        kind = random.integers(0, 5)
        if kind == 0 and place < len(octets):
            octets[place] ^= 1 << random.integers(0, 8)
        elif kind == 1:
            octets[place:place] = random.bytes(random.integers(1, 4))
        elif kind == 2:
            del octets[place : place + random.integers(1, 4)]
        elif kind == 3 and place < len(octets):
            octets[place] = random.choice([0, 0x7F, 0x80, 0xBF, 0xC0, 0xFF])
        elif kind == 4:
            octets += octets[place : place + 40]
    return bytes(octets)
