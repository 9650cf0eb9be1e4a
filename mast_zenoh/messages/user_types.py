"""User-defined message types, known to the codec while their scenario is used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from mast_zenoh.messages.layout import LAYOUTS, BodyLayout
from mast_zenoh.messages.schemas import BUILT_IN, MAX_COLUMNS, SCHEMAS, Column, Schema


def use(schemas: Iterable[Schema]) -> None:
    """Make the codec know these message types in addition to the built-in ones, and no others."""
    wanted = {schema.name: schema for schema in schemas}
    for name in SCHEMAS.keys() - BUILT_IN.keys() - wanted.keys():
        del SCHEMAS[name], LAYOUTS[name]
    for name, schema in wanted.items():
        if SCHEMAS.get(name) != schema:
            SCHEMAS[name], LAYOUTS[name] = schema, BodyLayout(schema)


def to_json(schema: Schema) -> dict[str, Any]:
    """A message type as JSON values, as scenario.json and recordings hold it."""
    return asdict(schema)


def from_json(data: Mapping[str, Any]) -> Schema:
    """The message type that `to_json` wrote.

    Raises ValueError, KeyError or TypeError for anything else.
    """
    columns = data["columns"]
    if len(columns) > MAX_COLUMNS:
        raise ValueError(f"{len(columns)} columns, expected at most {MAX_COLUMNS}")
    return Schema(**{**data, "columns": tuple(Column(**column) for column in columns)})
