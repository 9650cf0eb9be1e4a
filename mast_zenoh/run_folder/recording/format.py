"""What a recording holds: channels, one per key, with metadata and a schema; and changes of the run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.messages import user_types
from mast_zenoh.messages.layout import DTYPE_NAME
from mast_zenoh.messages.schemas import BUILT_IN, Column, Schema
from mast_zenoh.run_folder import parse_json
from mast_zenoh.wiring.model import Wire, wire_key

PROFILE = "mast-zenoh"
ENCODING = "msgpack"
SCHEMA_ENCODING = "jsonschema"

#: Key of a schema's JSON with the whole definition of a user's message type, which readers need for decoding.
DEFINITION = "definition"

#: Last part of the topic for messages of a key without a valid header.
MALFORMED = "@malformed"


def wire_and_key(key: str) -> tuple[str, str]:
    """Sort key of keys: by wire, each before its tap legs."""
    return wire_key(key), key


def records_scans(wire: Wire, points: bool | None) -> bool:
    """Whether a wire is one of points that is recorded. points: whether all are; None: those with an interposer"""
    return wire.message == "points" and (bool(wire.interposers) if points is None else points)


def metadata(key: str, message: str, publisher: str, *, malformed: bool) -> dict[str, str]:
    """The metadata of a channel; MCAP metadata is text.

    publisher: the wire's publisher, which headers name, also on legs after an interposer
    """
    wire = wire_key(key)
    flags = {"tap": wire != key, "malformed": malformed}
    values = {"wire": wire, "publisher": publisher, "message": message}
    return values | {name: "true" if flag else "false" for name, flag in flags.items()}


def json_schema(schema: Schema) -> str:
    """The JSON Schema of a message type; `data` is bytes, which it has no type for."""
    integer = {"type": "integer", "minimum": 0}
    fields: dict[str, Any] = {
        "schema": {"const": schema.name},
        "version": {"const": schema.version},
        "source": {"type": "string", "description": "name of the node that made it"},
        "frame": integer | {"description": "index of the scene's frame that the message is about"},
        "time_ns": integer | {"description": "time of that frame in the scene", "unit": "ns"},
        "seq": integer | {"description": "counts the messages of one publisher on one wire, from 0"},
        "body": _object({column.name: _column(column) for column in schema.columns}),
    }
    content = {"title": schema.name, "description": schema.meaning} | _object(fields)
    if schema.name not in BUILT_IN:
        content[DEFINITION] = user_types.to_json(schema)
    return json.dumps(content, ensure_ascii=False)


def user_schema(content: bytes) -> Schema | None:
    """The user's message type that `json_schema` described; None: a built-in one.

    Raises ValueError for anything else.
    """
    try:
        definition = parse_json(content).get(DEFINITION)
        schema = None if definition is None else user_types.from_json(definition)
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{type(error).__name__}: {error}") from None
    if schema is not None and schema.name in BUILT_IN:
        raise ValueError(f"message type {schema.name!r}: found a definition, expected the built-in type")
    return schema


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


def _column(column: Column) -> dict[str, Any]:
    """The JSON Schema of a column.

    A column is [dtype, shape, data]; data: raw little-endian bytes in C order, or strings.
    """
    text = {"type": "array", "items": {"type": "string"}}
    data = text if column.dtype == "str" else {"type": "string", "contentEncoding": "binary"}
    shape = {
        "type": "array",
        "items": {"type": "integer", "minimum": 0},
        "description": ", ".join(map(str, column.shape)),
    }
    return {
        "type": "array",
        "prefixItems": [{"const": DTYPE_NAME[column.dtype]}, shape, data],
        "description": column.meaning,
        "unit": column.unit,
    }


#: Name of the metadata record of an event.
EVENT = "event"
#: Name of the metadata record before a chunk: the steps of messages not sent in their own frame, by place in the chunk.
STEPS = "steps"
#: The same for the sending order of messages that share key and frame with another one.
ORDER = "order"

#: Kinds of events: a node joins or leaves; the wiring changes (the first such event has the initial wiring).
JOINED, LEFT, REWIRED = "joined", "left", "rewired"


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """A change of the run after a frame.

    what:   JOINED, LEFT or REWIRED
    frame:  the latest frame when it happened; -1: before the first
    node, role: the node that joined or left
    wiring: the new wiring, as in wiring.json
    """

    what: str
    frame: int
    node: str = ""
    role: str = ""
    wiring: Mapping[str, Any] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """The event as MCAP metadata, which is text."""
        values = {"what": self.what, "frame": str(self.frame)}
        if self.what == REWIRED:
            return values | {"wiring": json.dumps(self.wiring, separators=(",", ":"))}
        return values | {"node": self.node, "role": self.role}

    @classmethod
    def from_metadata(cls, values: Mapping[str, str]) -> RecordedEvent:
        """The event that `to_metadata` wrote; raises KeyError or ValueError otherwise."""
        if values["what"] == REWIRED:
            wiring = parse_json(values["wiring"])
            if not isinstance(wiring, dict):
                raise ValueError("wiring: expected an object")
            return cls(REWIRED, int(values["frame"]), wiring=wiring)
        if values["what"] not in (JOINED, LEFT):
            raise ValueError(f"what: found {values['what'][:20]!r}, expected {JOINED}, {LEFT} or {REWIRED}")
        return cls(values["what"], int(values["frame"]), values["node"], values["role"])
