"""Table columns for the parameters of a study's grids, each of one type."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pyarrow

from mast_zenoh.study.definition import Study

Value = int | float | str


def parameters(study: Study) -> dict[str, dict[str, Value]]:
    """The values of each parameter by configuration label.

    A parameter whose values are not all numbers has text. Configurations of runs that do not sweep the parameter are
    absent.
    """
    result: dict[str, dict[str, Any]] = {}
    for configuration in study.configurations:
        for name, value in configuration.point:
            result.setdefault(name, {})[configuration.label] = value
    return {name: values if _numeric(values) else _as_text(values) for name, values in result.items()}


def _numeric(values: dict[str, Any]) -> bool:
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values.values())


def _as_text(values: dict[str, Any]) -> dict[str, Value]:
    return {label: str(value) for label, value in values.items()}


class ParameterColumns:
    """Inserts a column per parameter after a table's first column.

    Values are null where a parameter does not apply. A parameter with the same name as one of the table's columns
    (user-defined metrics add columns) becomes `grid.<name>`.
    """

    def __init__(self, study: Study, reserved: Collection[str]) -> None:
        """reserved: names of the table's own columns."""
        self._values = {
            f"grid.{name}" if name in reserved else name: column for name, column in parameters(study).items()
        }
        self._types = {name: pyarrow.array(list(column.values())).type for name, column in self._values.items()}

    def schema(self, table_schema: pyarrow.Schema) -> pyarrow.Schema:
        """`table_schema` with the parameter columns added."""
        fields = [pyarrow.field(name, self._column(name, "", 0).type) for name in self._values]
        return pyarrow.schema([table_schema.field(0), *fields, *list(table_schema)[1:]])

    def add(self, table: pyarrow.Table, configuration: str) -> pyarrow.Table:
        """`table` with the parameter columns added; all its rows belong to one configuration."""
        for position, name in enumerate(self._values, 1):
            table = table.add_column(position, name, self._column(name, configuration, len(table)))
        return table

    def _column(self, name: str, configuration: str, rows: int) -> pyarrow.Array:
        value = pyarrow.scalar(self._values[name].get(configuration), self._types[name])
        column = pyarrow.repeat(value, rows)
        return column.dictionary_encode() if pyarrow.types.is_string(column.type) else column
