"""Decodes messages of ROS 2 bags: types that are known, and a user's own types by their definition.

Definitions in a bag are compared with ours, and hashes, too: bytes are never read with the fields of another version.
Those of own types may come from anybody. rosbags makes Python classes and functions of them, in whose code names of
letters, digits and _ are all that is theirs; an element of an array is a line, so arrays have a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mast_ros2 import type_store
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from mast_datasets.rosbag_storage import Topic
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

#: Makes a message of a payload; raises MessageError for bytes that are none.
Decode = Callable[[bytes], Any]
#: Fields of types by name: pairs of a name and a description, as rosbags has them.
Fields = dict[str, list[tuple[str, Any]]]

#: Steps to a value in nested messages and lists.
Steps = tuple[str | int, ...]

_MAX_DEFINITION = 200_000
_MAX_ARRAYS = 1000  # elements of all arrays in a type that are no numbers


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
    """A type that is read by its definition, with attributes for its fields.

    place: of the bag, for messages;  of_map: fields of the types that the map defines, by name; they take precedence

    Raises ConfigurationError if neither the map nor the bag defines the type, and SceneError for a definition that is
    none.
    """

    def __init__(self, place: str, topic: Topic, of_map: Mapping[str, Fields]) -> None:
        self._name, known = topic.type, all_fields()
        self._store = get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = type_store.MOST_ELEMENTS
        try:
            if topic.definition:
                known |= parse_definition(topic.type, topic.definition)
            for defined in of_map.values():
                known |= defined
            self._fields = _needed(place, topic, known)
            self._store.register({kind: ([], fields) for kind, fields in self._fields.items()})
            self._store.get_msgdef(topic.type)
        except (TypesysError, ValueError, TypeError, SyntaxError, RecursionError) as error:
            raise SceneError(f"{place}: {topic.name}: {topic.type!r:.120} cannot be read: {error!s:.200}") from None

    def decode(self, payload: bytes) -> Any:
        """The message of a payload. Raises MessageError for bytes that are none."""
        try:
            return self._store.deserialize_cdr(payload, self._name)
        except SerdeError as error:
            raise MessageError(f"{self._name}: {len(payload)} bytes: {error}") from None

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


def _needed(place: str, topic: Topic, known: Fields) -> Fields:
    """The fields of a topic's type, and of all types in it.

    Raises ConfigurationError for a type that is not defined, and ValueError for arrays that are too long, or empty:
    every element takes a byte at least, so the work is bounded by the size of the message.
    """
    needed: Fields = {}
    missing, elements = [topic.type], 0
    while missing:
        kind = missing.pop()
        if kind not in known:
            raise ConfigurationError(
                f"{place}: {topic.name}: the bag has no definition of {kind!r:.120}: expected one under `types` of the "
                f"map{nearest(kind, list(known))}"
            )
        needed[kind] = known[kind]
        for _, (node, detail) in known[kind]:
            inner, length = ((node, detail), 1) if node in (Nodetype.BASE, Nodetype.NAME) else detail
            is_number = inner[0] == Nodetype.BASE and inner[1][0] != "string"
            if node == Nodetype.ARRAY:
                elements += 0 if is_number else length
                if length < 1 or elements > _MAX_ARRAYS:
                    raise ValueError(f"{kind} has a list of {length} elements, expected 1 to {_MAX_ARRAYS} in all")
            if inner[0] == Nodetype.NAME and inner[1] not in needed:
                missing.append(inner[1])
    return needed
