"""Rows of floating-car data in CSV."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.bounded_file import read_lines
from mast_zenoh.scenes.files.text_elements import TextElement

#: Columns of tables without prefixes, by SUMO's names of attributes.
_ALIASES = {
    "time": ("time", "t"),
    "id": ("id",),
    "type": ("type", "class"),
    "x": ("x", "x_front"),
    "y": ("y", "y_front"),
    "z": ("z", "z_front"),
    "angle": ("angle", "heading_deg_cw_from_north"),
    "speed": ("speed",),
    "length": ("length",),
    "width": ("width",),
    "height": ("height",),
}
_TIME = "timestep_time"
_PREFIXES = ("vehicle_", "person_")


def csv_rows(file: Path) -> Iterator[tuple[TextElement, bool, dict[str, TextElement]]]:
    """Time, whether it is a person, and the values by SUMO's names, of each row of a table.

    The columns are those of SUMO's tool xml2csv (timestep_time, vehicle_id, vehicle_x, …), or the same without
    prefixes. Rows of times without objects have no values. Raises SceneError with file, line and reason.
    """
    lines = read_lines(file)
    header = next(lines, "")
    delimiter = ";" if ";" in header else ","
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    names = [name.strip() for name in header.split(delimiter)]
    groups = _columns(names, file)
    time = groups[0][1]["time"]
    try:
        for number, fields in enumerate(reader, start=2):
            if len(fields) != len(names):
                raise SceneError(f"{file}: line {number}: found {len(fields)} fields, expected {len(names)}")
            now = TextElement(fields[time], file, f"line {number}: {names[time]}")
            present = next((group for group in groups if fields[group[1]["id"]]), None)
            if present is None:
                yield now, False, {}
                continue
            row = {
                name: TextElement(fields[column], file, f"line {number}: {names[column]}")
                for name, column in present[1].items()
                if name != "time" and fields[column]
            }
            yield now, present[0], row
    except csv.Error as error:
        raise SceneError(f"{file}: line {reader.line_num + 1}: not CSV: {error}") from error


def _columns(names: list[str], file: Path) -> list[tuple[bool, dict[str, int]]]:
    """For vehicles and for persons, the column of each value."""
    repeated = next((name for name, count in Counter(names).items() if count > 1), None)
    if repeated is not None:
        raise SceneError(f"{file}: line 1: found column {repeated!r} twice, expected it once")
    column = {name: index for index, name in enumerate(names)}
    groups: list[tuple[bool, dict[str, int]]] = []
    if _TIME in column:
        for prefix in _PREFIXES:
            group = {name: column[prefix + name] for name in _ALIASES if prefix + name in column}
            if "id" in group:
                groups.append((prefix == "person_", {"time": column[_TIME]} | group))
    else:
        group = {
            name: column[alias] for name, aliases in _ALIASES.items() for alias in reversed(aliases) if alias in column
        }
        if "id" in group and "time" in group:
            groups.append((False, group))
    if not groups:
        raise SceneError(
            f"{file}: line 1: found the columns {', '.join(names[:12])}, expected a time and an id: "
            "timestep_time and vehicle_id, or time and id"
        )
    return groups
