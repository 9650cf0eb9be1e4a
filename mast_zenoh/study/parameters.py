"""The columns that the parameters of a study's grids add to its tables, each of one type."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pyarrow

from mast_zenoh.study.definition import Study

Value = int | float | str


def parameters(study: Study) -> dict[str, dict[str, Value]]:
    """By parameter, the value of each configuration that has it, by the configuration's label.

    Numbers where all values of the parameter are numbers, else text. A configuration whose run does not sweep the
    parameter is absent.
    """
    result: dict[str, dict[str, Any]] = {}
    for each in study.configurations:
        for name, value in each.point:
            result.setdefault(name, {})[each.label] = value
    return {name: values if _numeric(values) else _as_text(values) for name, values in result.items()}


def _numeric(values: dict[str, Any]) -> bool:
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values.values())


def _as_text(values: dict[str, Any]) -> dict[str, Value]:
    return {label: str(value) for label, value in values.items()}


class ParameterColumns:
    """A column per parameter, after the first column of a table; null where a configuration does not have it.

    A parameter that is named like a column of the table, as a metric of the user may be, is called `grid.<name>`.
    """

    def __init__(self, study: Study, taken: Collection[str]) -> None:
        """taken: the names of the table's own columns."""
        self._values = {f"grid.{name}" if name in taken else name: each for name, each in parameters(study).items()}
        self._types = {name: pyarrow.array(list(each.values())).type for name, each in self._values.items()}

    def schema(self, own: pyarrow.Schema) -> pyarrow.Schema:
        """That of the whole table; own: that of its own columns."""
        fields = [pyarrow.field(name, self._column(name, "", 0).type) for name in self._values]
        return pyarrow.schema([own.field(0), *fields, *list(own)[1:]])

    def add(self, table: pyarrow.Table, configuration: str) -> pyarrow.Table:
        """The table, all of whose rows are of one configuration, with these columns."""
        for place, name in enumerate(self._values, 1):
            table = table.add_column(place, name, self._column(name, configuration, len(table)))
        return table

    def _column(self, name: str, configuration: str, rows: int) -> pyarrow.Array:
        value = pyarrow.scalar(self._values[name].get(configuration), self._types[name])
        column = pyarrow.repeat(value, rows)
        return column.dictionary_encode() if pyarrow.types.is_string(column.type) else column
