"""Decodes messages of ROS 2 bags: types that are known, and a user's own types by their definition.

Definitions in a bag are compared with ours, and hashes, too: bytes are never read with the fields of another version.
Own types are read field by field, without generating code, because a definition may come from anybody.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_msg

from mast_datasets.rosbag_storage import Topic
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest
from mast_zenoh.ros2 import type_store

#: Makes a message of a payload; raises MessageError for bytes that are none.
Decode = Callable[[bytes], Any]
#: Fields of types by name: pairs of a name and a description, as rosbags has them.
Fields = dict[str, list[tuple[str, Any]]]

#: Steps to a value in nested messages and lists.
Steps = tuple[str | int, ...]

_MAX_DEPTH = 20
_MAX_DEFINITION = 200_000
_NUMBERS = {
    **{f"{sign}int{bits}": f"{sign[:1] or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
    **dict.fromkeys(("bool", "byte", "char", "octet"), "u1"),
    "float32": "f4",
    "float64": "f8",
}


def parse_definition(name: str, text: str) -> Fields:
    """The fields of a type, and of types in it, from a definition in the language of `.msg` files.

    Raises ValueError for a text that is none.
    """
    if len(text) > _MAX_DEFINITION:
        raise ValueError(f"a definition of {len(text)} characters, expected at most {_MAX_DEFINITION}")
    try:
        parsed = get_types_from_msg(text, name)
    except (TypesysError, ValueError, AssertionError, KeyError, RecursionError) as error:
        raise ValueError(
            f"the definition of {name!r:.120} cannot be read: {' '.join(str(error).split()):.200}"
        ) from None
    return {kind: list(fields) for kind, (_, fields) in parsed.items()}


def all_fields() -> Fields:
    """The fields of all types that are known."""
    return {kind: list(fields) for kind, (_, fields) in type_store.STORE.fielddefs.items()}


def known_decoder(place: str, topic: Topic) -> Decode:
    """How to decode a type that is known. place: of the bag, for messages

    Raises SceneError if the bag has another version of it.
    """
    ours = all_fields()
    if topic.definition:
        try:
            theirs = parse_definition(topic.type, topic.definition)
        except ValueError as error:
            raise SceneError(f"{place}: {topic.name}: {error}") from None
        for kind, fields in theirs.items():
            if _normal(fields) != _normal(ours.get(kind, [])):
                names = ", ".join(f"{name}" for name, _ in fields)
                expected = ", ".join(f"{name}" for name, _ in ours.get(kind, []))
                raise SceneError(
                    f"{place}: {topic.name}: the bag has another version of {kind}: found the fields {names:.300}, "
                    f"expected {expected or 'no such type'}; `fields` in the map reads any version"
                )
    if topic.hash.startswith("RIHS01_") and topic.hash != type_store.type_hash(topic.type):
        raise SceneError(
            f"{place}: {topic.name}: the bag has another version of {topic.type}: found the hash {topic.hash!r:.80}, "
            f"expected {type_store.type_hash(topic.type)}"
        )
    return lambda payload: type_store.decode(topic.type, payload)


def _normal(fields: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return [(name.lower(), description) for name, description in fields] or [_FILLER]


_FILLER = ("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))


class OwnType:
    """A type that is read by its definition, as nested dicts and lists.

    place: of the bag, for messages;  of_map: fields of the types that the map defines, by name; they take precedence

    Raises ConfigurationError if neither the map nor the bag defines the type, and SceneError for a definition that is
    none.
    """

    def __init__(self, place: str, topic: Topic, of_map: Mapping[str, Fields]) -> None:
        self._name, self._fields = topic.type, all_fields()
        if topic.definition:
            try:
                self._fields |= parse_definition(topic.type, topic.definition)
            except ValueError as error:
                raise SceneError(f"{place}: {topic.name}: {error}") from None
        for defined in of_map.values():
            self._fields |= defined
        _check_nesting(place, topic, self._fields, topic.type, 0, set())

    def decode(self, payload: bytes) -> Any:
        """The message of a payload. Raises MessageError for bytes that are none."""
        return _Reader(self._fields, payload).message(self._name)

    def element_of(self, path: Steps) -> str:
        """The type of the elements of the list at a path. Raises ValueError if there is no list of messages."""
        kind, detail = self._at(self._name, path)
        if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or detail[0][0] != Nodetype.NAME:
            raise ValueError(f"{_written(path)} of {self._name} is no list of messages")
        return str(detail[0][1])

    def check_path(self, name: str, path: Steps) -> None:
        """Raise ValueError if a type of this name has nothing at a path."""
        self._at(name, path)

    def _at(self, name: str, path: Steps) -> Any:
        """The description of what is at a path in a type."""
        description: Any = (Nodetype.NAME, name)
        for step in path:
            kind, detail = description
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and isinstance(step, int):
                description = detail[0]
                continue
            fields = dict(self._fields[detail]) if kind == Nodetype.NAME else {}
            if step not in fields:
                known = ", ".join(fields) or ("a number" if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else "no step")
                hint = nearest(str(step), fields)
                raise ValueError(f"{_written(path)} of {name}: found no {step!r}, expected one of {known}{hint}")
            description = fields[step]
        return description


def _written(path: Steps) -> str:
    return ".".join(map(str, path))


def _check_nesting(place: str, topic: Topic, fields: Fields, kind: str, depth: int, checked: set[str]) -> None:
    """Raise ConfigurationError for a type that is not defined, and SceneError for one that contains itself."""
    if kind not in fields:
        raise ConfigurationError(
            f"{place}: {topic.name}: the bag has no definition of {kind!r:.120}: expected one under `types` of the map"
            f"{nearest(kind, list(fields))}"
        )
    if depth > _MAX_DEPTH:
        raise SceneError(f"{place}: {topic.name}: {topic.type!r} has types in types, deeper than {_MAX_DEPTH}")
    for _, description in fields[kind]:
        is_single = description[0] in (Nodetype.BASE, Nodetype.NAME)
        inner = description if is_single else description[1][0]
        if not is_single and description[1][1] < 0:
            raise SceneError(f"{place}: {topic.name}: {kind} has a list of {description[1][1]} elements")
        if inner[0] == Nodetype.NAME:
            if inner[1] not in checked:
                _check_nesting(place, topic, fields, inner[1], depth + 1, checked)
        elif inner[1][0] not in _NUMBERS and inner[1][0] != "string":
            raise SceneError(f"{place}: {topic.name}: {kind} has a field of type {inner[1][0]}, which cannot be read")
    checked.add(kind)  # after its fields, so that one that contains itself is too deep


class _Reader:
    """Reads values from CDR, of either byte order.

    Every value takes a byte at least, so its work is bounded by the size of the message.
    """

    def __init__(self, fields: Fields, payload: bytes) -> None:
        if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
            raise MessageError(f"found {payload[:4]!r}, expected the header of CDR")
        self._fields, self._content, self._at = fields, payload[4:], 0
        self._order = "<" if payload[1] else ">"

    def message(self, kind: str) -> Any:
        """The fields of a whole message. Raises MessageError."""
        try:
            value = self._named(kind)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise MessageError(f"{kind}: {len(self._content)} bytes: {error}") from None
        if self._at + 3 < len(self._content):
            raise MessageError(f"{kind}: found {len(self._content)} bytes, expected {self._at}")
        return value

    def _named(self, kind: str) -> dict[str, Any]:
        return {name: self._value(description) for name, description in self._fields[kind] or [_FILLER]}

    def _value(self, description: Any) -> Any:
        kind, detail = description
        if kind == Nodetype.NAME:
            return self._named(detail)
        if kind == Nodetype.BASE:
            return self._text() if detail[0] == "string" else self._numbers(detail[0], 1)[0].item()
        inner, count = detail
        if kind == Nodetype.SEQUENCE:
            count = int(self._numbers("uint32", 1)[0])
            if count > type_store.MOST_ELEMENTS:
                raise ValueError(f"found {count} elements, expected at most {type_store.MOST_ELEMENTS}")
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            return self._numbers(inner[1][0], count) if count else np.zeros(0)
        return list(self._elements(inner, count))

    def _elements(self, inner: Any, count: int) -> Iterator[Any]:
        for _ in range(count):
            if self._at >= len(self._content):
                raise ValueError(f"found {len(self._content)} bytes, expected more elements")
            yield self._value(inner)

    def _numbers(self, name: str, count: int) -> Any:
        dtype = np.dtype(self._order + _NUMBERS[name])
        self._at += -self._at % dtype.itemsize
        if count * dtype.itemsize > len(self._content) - self._at:
            raise ValueError(f"found {len(self._content)} bytes, expected {count} values of {name} at byte {self._at}")
        values = np.frombuffer(self._content, dtype, count, self._at)
        self._at += values.nbytes
        return values

    def _text(self) -> str:
        length = int(self._numbers("uint32", 1)[0])
        if not 0 < length <= len(self._content) - self._at:
            raise ValueError(
                f"found a text of {length} bytes at byte {self._at}, expected 1 or more, within the message"
            )
        text = self._content[self._at : self._at + length - 1].decode()
        self._at += length
        return text
