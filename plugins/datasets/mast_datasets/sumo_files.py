"""Files of the traffic simulator SUMO: steps of traces, types of vehicles, buildings."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from mast_datasets.files import Coordinate, Element, Side, Speed, XmlElement, closed_outline, read_lines, read_xml
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError

#: Columns of tables without prefixes, by SUMO's names of attributes.
_ALIASES = {
    "time": ("time", "t"),
    "type": ("type", "class"),
    "x": ("x", "x_front"),
    "y": ("y", "y_front"),
    "z": ("z", "z_front"),
    "angle": ("angle", "heading_deg_cw_from_north"),
    **{name: (name,) for name in ("id", "speed", "length", "width", "height", "vehicle")},
}
_TIME = "timestep_time"


class TraceRow(Struct):
    """What a trace says of one object at one time, by SUMO's names; angle: degrees clockwise from north."""

    id: Annotated[str, Meta(min_length=1, max_length=200)]
    x: Coordinate
    y: Coordinate
    angle: Annotated[float, Meta(ge=-360, le=720)]
    z: Annotated[float, Meta(ge=-1e5, le=1e5)] | None = None
    speed: Speed | None = None
    type: str | None = None
    vehicle: str = ""
    length: Side | None = None
    width: Side | None = None
    height: Side | None = None


#: A time, and for each object whether it is a person, and what can be read as a `Row`.
Step = tuple[Element, list[tuple[bool, Element]]]


def read_steps(file: Path) -> Iterator[Step]:
    """The time steps of a trace, in the order of the file. Raises SceneError with file, line and reason."""
    if file.name.removesuffix(".gz").endswith(".csv"):
        for _, group in groupby(_csv_rows(file), key=lambda row: row[0].value):
            first, *more = group
            yield first[0], [(person, row) for _, person, row in (first, *more) if row.value]
        return
    for step in read_xml(file, "fcd-export", ("timestep",)):
        if step.tag == "timestep":
            kinds = ("vehicle", "person")
            yield step["time"], [(kind == "person", row) for kind in kinds for row in step.several(kind)]


def _csv_rows(file: Path) -> Iterator[tuple[Element, bool, Element]]:
    """Time, whether it is a person, and the values by SUMO's names, of each row of a table.

    The columns are those of SUMO's tool xml2csv (timestep_time, vehicle_id, vehicle_x, …), or the same without
    prefixes. Rows of times without objects have no values.
    """
    lines = read_lines(file)
    header = next(lines, "")
    delimiter = ";" if ";" in header else ","
    names = [name.strip() for name in header.split(delimiter)]
    if len(set(names)) < len(names):
        raise SceneError(f"{file}: line 1: found the columns {', '.join(names[:12])}, expected each once")
    reader = csv.DictReader(lines, names, delimiter=delimiter, strict=True, skipinitialspace=True)
    groups = _columns(names, file)
    time = groups[0][1]["time"]
    try:
        for row in reader:
            place = f"line {reader.line_num + 1}"  # after the header
            if None in row or None in row.values():
                raise SceneError(f"{file}: {place}: found another number of fields, expected {len(names)}")
            person, columns = next((group for group in groups if row[group[1]["id"]]), (False, {}))
            values = {name: row[column].strip() for name, column in columns.items() if row[column].strip()}
            yield Element(row[time].strip(), file, f"{place}: {time}"), person, Element(values, file, place)
    except csv.Error as error:
        raise SceneError(f"{file}: line {reader.line_num + 1}: not CSV: {error}") from error


def _columns(names: list[str], file: Path) -> list[tuple[bool, dict[str, str]]]:
    """For vehicles and for persons, the column of each value."""
    groups = []
    for prefix in ("vehicle_", "person_") if _TIME in names else ("",):
        aliases = _ALIASES if not prefix else {name: (prefix + name,) for name in _ALIASES} | {"time": (_TIME,)}
        columns = {name: alias for name, known in aliases.items() for alias in reversed(known) if alias in names}
        if columns.keys() >= {"id", "time"}:
            groups.append((prefix == "person_", columns))
    if not groups:
        raise SceneError(
            f"{file}: line 1: found the columns {', '.join(names[:12])}, expected a time and an id: "
            "timestep_time and vehicle_id, or time and id"
        )
    return groups


_DEFAULT_CLASS = "passenger"
#: Default length, width and height m of vehicle classes ("Vehicle Type Parameter Defaults" in SUMO's documentation),
#: and the class of objects. Classes that are not here have the size of passenger cars.
_CAR, _TRUCK, _OTHER = (5.0, 1.8, 1.5), (6.5, 2.16, 2.86), "unknown"
VEHICLE_CLASSES: Mapping[str, tuple[tuple[float, float, float], str]] = {
    **dict.fromkeys(
        ("passenger", "private", "taxi", "hov", "evehicle", "vip", "authority", "army", "ignoring"), (_CAR, "car")
    ),
    **dict.fromkeys(("custom1", "custom2"), (_CAR, _OTHER)),
    **dict.fromkeys(("delivery", "emergency"), (_TRUCK, "truck")),
    "truck": ((7.1, 2.4, 2.4), "truck"),
    "trailer": ((16.5, 2.55, 4.0), "truck"),
    "bus": ((12.0, 2.5, 3.4), "bus"),
    "coach": ((14.0, 2.6, 4.0), "bus"),
    "motorcycle": ((2.2, 0.9, 1.5), "motorcycle"),
    "moped": ((2.1, 0.8, 1.7), "motorcycle"),
    "bicycle": ((1.6, 0.65, 1.7), "bicycle"),
    "pedestrian": ((0.215, 0.478, 1.719), "pedestrian"),
    "tram": ((22.0, 2.4, 3.2), _OTHER),
    "rail_urban": ((109.5, 3.0, 3.6), _OTHER),
    "rail": ((135.0, 2.84, 3.75), _OTHER),
    "rail_electric": ((200.0, 2.95, 3.89), _OTHER),
    "rail_fast": ((200.0, 2.95, 3.89), _OTHER),
    "ship": ((17.0, 4.0, 4.0), _OTHER),
}
#: Types that exist without a definition.
_BUILT_IN = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_TAXITYPE": "taxi",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_BIKETYPE": "bicycle",
}


class VehicleType(NamedTuple):
    """Length, width and height m, and the class as an index into CLASSES."""

    size: tuple[float, float, float]
    class_id: int


def type_of_class(name: str) -> VehicleType:
    """The default type of a class of vehicles, which need not be known."""
    size, kind = VEHICLE_CLASSES.get(name, (_CAR, _OTHER))
    return VehicleType(size, CLASS_INDEX[kind])


class VehicleTypes:
    """The types that vehicles of a trace can have, by name.

    files: with definitions `<vType …>`; read when a type is looked up that cannot be known without them
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files
        self._defined: dict[str, VehicleType] | None = None

    def find(self, element: Element, row: TraceRow, person: bool) -> VehicleType:
        """The type of what a row of a trace describes, with the size that the row says, if it says one.

        element: the row, for the message. Raises SceneError for a type that is not defined.
        """
        if row.type is None:
            return type_of_class("pedestrian") if person else element.fail("a type")
        base = row.type.partition("@")[0]  # a vehicle with parameters of its own has the type "type@vehicle"
        if row.length is None:
            return self._of_name(element, base)
        if row.width is None or row.height is None:
            element.fail("a width and a height beside the length")
        kind = type_of_class(base) if base in VEHICLE_CLASSES else self._of_name(element, base)
        return VehicleType((row.length, row.width, row.height), kind.class_id)

    def _of_name(self, element: Element, name: str) -> VehicleType:
        if name in _BUILT_IN:
            return type_of_class(_BUILT_IN[name])
        if self._defined is None:
            self._defined = _read_types(self._files)
        if name in self._defined or name in VEHICLE_CLASSES:
            return self._defined.get(name) or type_of_class(name)
        searched = ", ".join(file.name for file in self._files[:10]) or "no file *.rou.xml or *.add.xml"
        return element["type"].fail(f"a vehicle class, or the id of a vType (searched: {searched})")


def _read_types(files: Sequence[Path]) -> dict[str, VehicleType]:
    types: dict[str, VehicleType] = {}
    for file in files:
        for element in read_xml(file, None, ("vType",)):
            if element.tag != "vType":
                continue
            name = element["id"].text()
            default = type_of_class(element.value.get("vClass", _DEFAULT_CLASS))
            values = [element.get(side) for side in ("length", "width", "height")]
            parts = zip(values, default.size, strict=True)
            length, width, height = (value.read(Side) if value else usual for value, usual in parts)
            kind = VehicleType((length, width, height), default.class_id)
            if types.setdefault(name, kind) != kind:
                element.refuse(f"vType {name!r} is already defined with another size or class, expected it once")
    return types


_Corner = Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
_MAX_HEIGHT_M = 1000.0
_HEIGHT = re.compile(r"(\d{1,4}(?:\.\d{1,6})?)\s*m?", re.ASCII)


def read_buildings(
    files: Sequence[Path], route: Floats, radius: float, default_height: float
) -> tuple[list[Floats], list[float]]:
    """Outlines (k, 2) m and heights m of the buildings with a corner within `radius` m of a route (F, 2) m.

    A building is a `<poly>` whose type begins with "building". Its height is that of its parameter "height", if it has
    one that is a number, with or without "m"; otherwise the default.
    """
    from scipy.spatial import cKDTree  # takes 0.2 s, and every run imports this module

    near = cKDTree(route)
    outlines, heights = [], []
    for file in files:
        for element in read_xml(file, None, ("poly",)):
            if element.tag != "poly" or not str(element.value.get("type")).startswith("building"):
                continue
            outline = _outline(element)
            distance, _ = near.query(outline)
            if np.min(distance) <= radius:
                outlines.append(outline)
                heights.append(_height(element, default_height))
    return outlines, heights


def _outline(element: XmlElement) -> Floats:
    if element.value.get("geo") in ("1", "true", "True"):
        element.refuse(
            "found geo coordinates, expected positions in m: write the file with polyconvert and the network"
        )
    shape = element["shape"]
    points = [point.split(",") for point in shape.text().split()]
    corners = Element(points, shape.path, shape.place).read(list[_Corner])
    return closed_outline(np.array([corner[:2] for corner in corners]).reshape(-1, 2), element)


def _height(element: XmlElement, default: float) -> float:
    for parameter in element.several("param"):
        match = _HEIGHT.fullmatch(parameter["value"].text().strip())
        if parameter["key"].text() == "height" and match and float(match[1]) > 0:
            return min(float(match[1]), _MAX_HEIGHT_M)
    return default
