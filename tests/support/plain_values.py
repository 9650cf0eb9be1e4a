"""Flat values of a message from dicts and lists, for tests: the inverse of `v2x.asn1.uper.to_plain`."""

from typing import Any

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1.asn1_types import (
    UNKNOWN,
    BitString,
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
from mast_zenoh.v2x.asn1.uper import Values, unknown_name


def from_plain(layout: EncodingProgram, plain: Any) -> Values:
    """Flat values of a message; MessageError names the field of the wrong kind. `uper.encode` checks constraints."""
    values = [0] * width(layout.type)
    _Writer(values).write(layout.type, 0, plain, layout.name)
    return np.array(values, np.int64)


class _Writer:
    """Appends rows to flat values."""

    def __init__(self, values: list[int]) -> None:
        self.values = values

    def reserve(self, n: int) -> int:
        """Start of n new slots."""
        start = len(self.values)
        self.values += [0] * n
        return start if n else 0

    def write(self, type: Type, slot: int, plain: Any, path: str) -> None:
        """Set the row that begins at a slot."""
        if isinstance(type, Integer):
            self.values[slot] = int(_checked(plain, int, path))
            if not -(1 << 63) <= plain < 1 << 63:
                raise MessageError(f"{path}: found {plain}, expected an integer of 64 bits")
        elif isinstance(type, Enumerated):
            self.values[slot] = _place_of(type.known, len(type.root), _checked(plain, str, path), path)
        elif isinstance(type, ListOf):
            elements = _elements(type, plain, path)
            step = width(type.element)
            start = self.reserve(step * len(elements))
            self.values[slot], self.values[slot + 1] = len(elements), start
            for row, element in enumerate(elements):
                self.write(type.element, start + step * row, element, f"{path}[{row}]")
        elif isinstance(type, Sequence):
            self.fields(type, slot, _checked(plain, dict, path), path)
        elif isinstance(type, Choice):
            if len(_checked(plain, dict, path)) != 1:
                raise MessageError(f"{path}: found keys {list(plain)}, expected one")
            ((name, content),) = plain.items()
            index = _place_of(tuple(type.known), len(type.alternatives), name, path)
            self.values[slot] = index
            self.write(type.known.get(name, UNKNOWN), slot + 1, content, f"{path}.{name}")
        else:
            self.wrapped(type, slot, _checked(plain, dict, path), path)

    def wrapped(self, type: Wrapped, slot: int, plain: dict[str, Any], path: str) -> None:
        if plain.keys() != {type.id_name, type.data_name}:
            raise MessageError(f"{path}: found keys {list(plain)}, expected {type.id_name} and {type.data_name}")
        self.write(type.id_type, slot, plain[type.id_name], f"{path}.{type.id_name}")
        content = type.contents.get(plain[type.id_name], UNKNOWN)
        self.write(content, slot + 1, plain[type.data_name], f"{path}.{type.data_name}")

    def fields(self, type: Sequence, slot: int, plain: dict[str, Any], path: str) -> None:
        unknown = {name: value for name, value in plain.items() if name not in {place.name for place in places(type)}}
        for place in places(type):
            if place.name in plain:
                if place.kind >= NodeKind.OPTIONAL:
                    self.values[slot + place.first] = 1
                self.write(place.type, slot + place.slot, plain[place.name], f"{path}.{place.name}")
            elif place.kind == NodeKind.DEFAULT:
                self.values[slot + place.slot] = place.default
            elif place.kind == NodeKind.MANDATORY:
                raise MessageError(f"{path}: found no {place.name}, expected it")
        if type.additions is None:
            if unknown:
                raise MessageError(f"{path}: found keys {list(unknown)}, expected {list(type.fields)}")
            return
        known = len(type.additions)
        numbers = [_place_of((), 0, name, path) for name in unknown]
        if any(number < known for number in numbers):
            raise MessageError(f"{path}: found keys {list(unknown)}, expected {unknown_name(known)} or later")
        n = max([number + 1 for number in numbers], default=known * any(name in plain for name in type.additions))
        start = self.reserve(3 * (n - known)) if n > known else 0
        extension = slot + extension_slot(type)
        self.values[extension], self.values[extension + 1] = n, start
        for number, (name, octets) in zip(numbers, unknown.items(), strict=True):
            if octets is not None:
                row = start + 3 * (number - known)
                self.values[row] = 1
                self.write(UNKNOWN, row + 1, octets, f"{path}.{name}")


def _checked(plain: Any, expected: type, path: str) -> Any:
    if not isinstance(plain, expected):
        raise MessageError(f"{path}: found {type(plain).__name__}, expected {expected.__name__}")
    return plain


def _place_of(names: tuple[str, ...], n_root: int, name: str, path: str) -> int:
    """Number of a name, or of an unknown addition."""
    if name in names:
        return names.index(name)
    if isinstance(name, str) and name.startswith("+") and name[1:].isdecimal():
        return n_root + int(name[1:])
    raise MessageError(f"{path}: found {name!r}, expected one of {', '.join(names) or '+0, +1, ...'}")


def _elements(type: ListOf, plain: Any, path: str) -> list[Any]:
    """Elements of a list or string."""
    if isinstance(type, BitString):
        if set(_checked(plain, str, path)) - {"0", "1"}:
            raise MessageError(f"{path}: found {plain!r}, expected 0 and 1 only")
        return [int(bit) for bit in plain]
    if isinstance(type, OctetString):
        try:
            return list(bytes.fromhex(_checked(plain, str, path)))
        except ValueError:
            raise MessageError(f"{path}: found {plain!r}, expected pairs of hexadecimal digits") from None
    elements: list[Any] = _checked(plain, list, path)
    return elements
