"""Decodes messages of ROS 2 bags: types that are known, and a user's own types by their definition.

Known types of a bag have the hash of ours, so bytes are never read with the fields of another version. Of own types,
rosbags makes Python classes and functions, in whose code names of letters, digits and _ are all that is theirs; an
element of an array is a line, so arrays have a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mast_ros2 import type_store
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

#: Makes a message of a payload; raises MessageError for bytes that are none.
Decode = Callable[[bytes], Any]
#: Constants and fields of types by name, as rosbags has them.
Fields = dict[str, Any]
#: Steps to a value in nested messages and lists.
Steps = tuple[str | int, ...]

_MAX_DEFINITION = 200_000  # characters
_MAX_ARRAYS = 1000  # elements of all arrays in a type that are no numbers


def parse_definition(name: str, text: str) -> Fields:
    """The fields of a type, and of types in it, from a `.msg` text. Raises ValueError for a text that is none."""
    if len(text) > _MAX_DEFINITION:
        raise ValueError(f"a definition of {len(text)} characters, expected at most {_MAX_DEFINITION}")
    try:
        return {kind: ([], fields) for kind, (_, fields) in get_types_from_msg(text, name).items()}
    except Exception as error:  # of the parser, which raises many kinds
        words = " ".join(str(error).split())
        raise ValueError(f"the definition of {name!r:.120} cannot be read: {words:.200}") from None


def _defined(connection: Connection) -> Fields:
    definition = connection.msgdef
    is_text = definition.format == MessageDefinitionFormat.MSG
    return parse_definition(connection.msgtype, definition.data) if is_text else {}


def known_decoder(place: str, connection: Connection) -> Decode:
    """How to decode a type that is known. Raises SceneError if the bag has another version of it. place: of the bag"""
    name, store = connection.msgtype, get_typestore(Stores.EMPTY)
    try:
        store.fielddefs = _defined(connection)
        theirs = {connection.digest, store.hash_rihs01(name) if store.fielddefs else ""}
    except Exception as error:  # a definition may lack types, or contain itself
        raise SceneError(f"{place}: {connection.topic}: {error!s:.300}") from None
    if others := theirs - {"", type_store.type_hash(name)}:
        raise SceneError(
            f"{place}: {connection.topic}: the bag has another version of {name}: found the hash "
            f"{', '.join(sorted(others)):.200}, expected {type_store.type_hash(name)}; `fields` in the map reads any"
        )
    return lambda payload: type_store.decode(name, payload)


class OwnType:
    """A type that is read by its definition, with attributes for its fields.

    place: of the bag, for messages;  of_map: fields of the types that the map defines, by name; they take precedence

    Raises ConfigurationError if neither the map nor the bag defines the type, and SceneError for a definition that is
    none.
    """

    def __init__(self, place: str, connection: Connection, of_map: Fields) -> None:
        self._name, self._store = connection.msgtype, get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = type_store.MOST_ELEMENTS
        try:
            known = {**type_store.STORE.fielddefs, **_defined(connection), **of_map}
            self._store.register(_needed(f"{place}: {connection.topic}", self._name, known))
            self._store.get_msgdef(self._name)
        except ConfigurationError:
            raise
        except Exception as error:  # of rosbags, for a type that cannot be
            name = f"{place}: {connection.topic}: {self._name!r:.120}"
            raise SceneError(f"{name} cannot be read: {error!s:.200}") from None

    def decode(self, payload: bytes) -> Any:
        """The message of a payload. Raises MessageError for bytes that are none."""
        try:
            return self._store.deserialize_cdr(payload, self._name)
        except SerdeError as error:
            raise MessageError(f"{self._name}: {len(payload)} bytes: {error}") from None

    def check_paths(self, paths: Mapping[str, Steps]) -> None:
        """Raise ValueError unless `list` leads to a list of messages, and the others to something in these."""
        kind, detail = self._at(self._name, paths["list"])
        if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or detail[0][0] != Nodetype.NAME:
            raise ValueError(f"{'.'.join(map(str, paths['list']))} of {self._name} is no list of messages")
        for name, path in paths.items():
            if name != "list":
                self._at(str(detail[0][1]), path)

    def _at(self, name: str, path: Steps) -> Any:
        """The description of what is at a path in a type."""
        kind: Nodetype = Nodetype.NAME
        detail: Any = name
        for step in path:
            is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            if is_list and isinstance(step, int):
                kind, detail = detail[0]
                continue
            fields = dict(self._store.fielddefs[detail][1]) if kind == Nodetype.NAME else {}
            if step not in fields:
                known = ", ".join(fields) or ("a number" if is_list else "no step")
                where = f"{'.'.join(map(str, path))} of {name}"
                raise ValueError(f"{where}: found no {step!r}, expected one of {known}{nearest(str(step), fields)}")
            kind, detail = fields[step]
        return kind, detail


def _needed(place: str, name: str, known: Fields) -> Fields:
    """The fields of a type, and of all types in it.

    Raises ConfigurationError for a type that is not defined, and ValueError for arrays that are too long, or empty:
    every element takes a byte at least, so the work is bounded by the size of the message.
    """
    needed: Fields = {}
    missing, elements = [name], 0
    while missing:
        kind = missing.pop()
        if kind not in known:
            expected = f"expected one under `types` of the map{nearest(kind, list(known))}"
            raise ConfigurationError(f"{place}: the bag has no definition of {kind!r:.120}: {expected}")
        needed[kind] = known[kind]
        for _, (node, detail) in known[kind][1]:
            inner, length = ((node, detail), 1) if node in (Nodetype.BASE, Nodetype.NAME) else detail
            if node == Nodetype.ARRAY:
                elements += length if inner[0] == Nodetype.NAME or inner[1][0] == "string" else 0
                if length < 1 or elements > _MAX_ARRAYS:
                    raise ValueError(f"{kind} has a list of {length} elements, expected 1 to {_MAX_ARRAYS} in all")
            if inner[0] == Nodetype.NAME and inner[1] not in needed:
                missing.append(inner[1])
    return needed
