"""One channel per key: its name, its metadata, and a schema that tells other readers the fields of its messages."""

from __future__ import annotations

import json
from typing import Any

from mast_zenoh.messages.schemas import Column, Schema
from mast_zenoh.wiring.model import TAP

PROFILE = "mast-zenoh"
ENCODING = "msgpack"
SCHEMA_ENCODING = "jsonschema"

#: Ends the topic of the channel that keeps what came on a key and has no sound header.
MALFORMED = "@malformed"

_DTYPE = {"float64": "<f8", "int64": "<i8", "int32": "<i4", "uint8": "|u1", "str": "str"}


def wire_of(key: str) -> str:
    """The wire's own key of any of its legs' keys."""
    return key.split(f"/{TAP}/", 1)[0]


def wire_and_key(key: str) -> tuple[str, str]:
    """Sorts keys by wire, each before its tap legs."""
    return wire_of(key), key


def metadata(key: str, message: str, publisher: str, *, malformed: bool) -> dict[str, str]:
    """What a channel says of itself; MCAP metadata is text.

    publisher: who speaks on the wire; on the legs behind an interposer it is still the one that the header names
    """
    wire = wire_of(key)
    flags = {"tap": wire != key, "malformed": malformed}
    told = {"wire": wire, "publisher": publisher, "message": message}
    return told | {name: "true" if flag else "false" for name, flag in flags.items()}


def json_schema(schema: Schema) -> str:
    """The fields of one message type as JSON Schema; `data` is bytes, which JSON Schema has no type for."""
    whole = {"type": "integer", "minimum": 0}
    fields: dict[str, Any] = {
        "schema": {"const": schema.name},
        "version": {"const": schema.version},
        "source": {"type": "string", "description": "name of the node that made it"},
        "frame": whole | {"description": "index of the scene's frame that the message is about"},
        "time_ns": whole | {"description": "time of that frame in the scene", "unit": "ns"},
        "seq": whole | {"description": "counts the messages of one publisher on one wire, from 0"},
        "body": _object({column.name: _column(column) for column in schema.columns}),
    }
    return json.dumps({"title": schema.name, "description": schema.meaning} | _object(fields), ensure_ascii=False)


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}


def _column(column: Column) -> dict[str, Any]:
    """A column is [dtype, shape, data]: data are raw little-endian bytes in C order, or the strings themselves."""
    text = {"type": "array", "items": {"type": "string"}}
    data = text if column.dtype == "str" else {"type": "string", "contentEncoding": "binary"}
    shape = {
        "type": "array",
        "items": {"type": "integer", "minimum": 0},
        "description": ", ".join(map(str, column.shape)),
    }
    return {
        "type": "array",
        "prefixItems": [{"const": _DTYPE[column.dtype]}, shape, data],
        "description": column.meaning,
        "unit": column.unit,
    }
