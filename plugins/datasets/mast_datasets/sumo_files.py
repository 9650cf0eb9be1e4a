"""Files of the traffic simulator SUMO: steps of traces, types of vehicles, buildings."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import Path

import numpy as np

from mast_datasets.files import TextElement, read_lines
from mast_datasets.xml_files import XmlElement, read_xml
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError

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
    "vehicle": ("vehicle",),
}
_TIME = "timestep_time"
_PREFIXES = ("vehicle_", "person_")

#: Values of one object by SUMO's names; looking up one that is missing raises SceneError.
Row = Mapping[str, TextElement]
#: A time, and for each object whether it is a person, and its values.
Step = tuple[TextElement, Iterator[tuple[bool, Row]]]


def csv_rows(file: Path) -> Iterator[tuple[TextElement, bool, Row]]:
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
            values = {
                name: TextElement(fields[column], file, f"line {number}: {names[column]}")
                for name, column in present[1].items()
                if name != "time" and fields[column]
            }
            yield now, present[0], _Row(values, f"{file}: line {number}: column")
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


_MAX_NAMES = 12  # in a message
_MAX_OBJECTS = 100_000  # at one time


def read_steps(file: Path) -> Iterator[Step]:
    """The time steps of a trace, in the order of the file. Raises SceneError with file, line and reason."""
    return _csv_steps(file) if file.name.removesuffix(".gz").endswith(".csv") else _xml_steps(file)


def _xml_steps(file: Path) -> Iterator[Step]:
    for step in read_xml(file, "fcd-export", ("timestep",)):
        if step.tag == "timestep":
            parts = (part for part in step.children if part.tag in ("vehicle", "person"))
            yield step.attribute("time"), ((part.tag == "person", _xml_row(part)) for part in parts)


def _xml_row(part: XmlElement) -> Row:
    values = {name: part.attribute(name) for name in part.attributes}
    return _Row(values, f"{part.path}: {part.place}: attribute")


def _csv_steps(file: Path) -> Iterator[Step]:
    """The rows of a table, grouped by equal times."""
    for _, group in groupby(csv_rows(file), key=lambda row: row[0].value):
        rows = list(islice(group, _MAX_OBJECTS + 1))
        time = rows[0][0]
        if len(rows) > _MAX_OBJECTS:
            time.fail(f"at most {_MAX_OBJECTS} objects at one time")
        yield time, ((person, row) for _, person, row in rows if row)


class _Row(dict[str, TextElement]):
    """Values by name; a missing one is refused. place: for the message."""

    def __init__(self, values: Mapping[str, TextElement], place: str) -> None:
        super().__init__(values)
        self._place = place

    def __missing__(self, name: str) -> TextElement:
        raise SceneError(f"{self._place} {name} is missing; found {', '.join(list(self)[:_MAX_NAMES]) or 'none'}")


MAX_SIZE_M = 1000.0
_MAX_TYPES = 100_000
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


@dataclass(frozen=True)
class VehicleType:
    """Length, width and height m, and the class as an index into CLASSES."""

    size: tuple[float, float, float]
    class_id: int


def type_of_class(name: str) -> VehicleType:
    """The default type of a class of vehicles, which need not be known."""
    size, kind = VEHICLE_CLASSES.get(name, (_CAR, _OTHER))
    return VehicleType(size, CLASS_INDEX[kind])


class VehicleTypes:
    """The types that vehicles of a trace can have, by name.

    files: with definitions `<vType …>`; read when a type is looked up that is not built in, and not a class itself
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files
        self._defined: dict[str, VehicleType] | None = None

    def find(self, name: TextElement) -> VehicleType:
        """The type that a trace names. Raises SceneError if it is not defined."""
        base = name.text().partition("@")[0]  # a vehicle with parameters of its own has the type "type@vehicle"
        if base in _BUILT_IN:
            return type_of_class(_BUILT_IN[base])
        if self._defined is None:
            self._defined = _read_types(self._files)
        if base in self._defined:
            return self._defined[base]
        if base in VEHICLE_CLASSES:
            return type_of_class(base)
        searched = ", ".join(file.name for file in self._files[:10]) or "no file *.rou.xml or *.add.xml"
        return name.fail(f"a vehicle class, or the id of a vType (searched: {searched})")


def _read_types(files: Sequence[Path]) -> dict[str, VehicleType]:
    types: dict[str, VehicleType] = {}
    for file in files:
        for element in read_xml(file, None, ("vType",)):
            if element.tag != "vType":
                continue
            name = element.attribute("id").text()
            kind = _type(element)
            if types.setdefault(name, kind) != kind:
                element.fail(f"vType {name!r} is already defined with another size or class, expected it once")
            if len(types) > _MAX_TYPES:
                raise SceneError(f"{file}: found more than {_MAX_TYPES} vTypes, expected at most as many")
    return types


def _type(element: XmlElement) -> VehicleType:
    kind = element.get_attribute("vClass")
    default = type_of_class(_DEFAULT_CLASS if kind is None else kind.text())
    return VehicleType(read_size(element, default.size), default.class_id)


def read_size(element: XmlElement, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Length, width and height m of an element's attributes, each one the default if it is missing."""
    values = []
    for name, otherwise in zip(("length", "width", "height"), default, strict=True):
        value = element.get_attribute(name)
        values.append(otherwise if value is None else value.positive(MAX_SIZE_M))
    return values[0], values[1], values[2]


def sizes(types: Sequence[VehicleType]) -> Floats:
    """(N, 3) m."""
    return np.array([kind.size for kind in types]).reshape(-1, 3)


_MAX_CORNERS = 10_000
_MAX_BUILDINGS = 20_000  # near the route
_MAX_COORDINATE_M = 1e8
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
            if element.tag != "poly" or not element.attributes.get("type", "").startswith("building"):
                continue
            outline = _outline(element)
            distance, _ = near.query(outline)
            if np.min(distance) <= radius:
                outlines.append(outline)
                heights.append(_height(element, default_height))
            if len(outlines) > _MAX_BUILDINGS:
                element.fail(f"found more than {_MAX_BUILDINGS} buildings near the route, expected at most as many")
    return outlines, heights


def _outline(element: XmlElement) -> Floats:
    if element.attributes.get("geo") in ("1", "true", "True"):
        element.fail("found geo coordinates, expected positions in m: write the file with polyconvert and the network")
    shape = element.attribute("shape")
    points = shape.text().split()
    if len(points) > _MAX_CORNERS:
        element.fail(f"found {len(points)} corners, expected at most {_MAX_CORNERS}")
    corners = np.array([_point(text, shape) for text in points]).reshape(-1, 2)
    if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        element.fail(f"found {len(corners)} different corners, expected 3 or more")
    return corners


def _point(text: str, shape: TextElement) -> list[float]:
    numbers = text.split(",")
    if len(numbers) not in (2, 3):
        TextElement(text, shape.path, shape.place).fail("a point x,y or x,y,z")
    return [
        TextElement(number, shape.path, shape.place).number(-_MAX_COORDINATE_M, _MAX_COORDINATE_M)
        for number in numbers[:2]
    ]


def _height(element: XmlElement, default: float) -> float:
    for child in element.children:
        match = _HEIGHT.fullmatch(child.attributes.get("value", "").strip())
        if child.tag == "param" and child.attributes.get("key") == "height" and match and float(match[1]) > 0:
            return min(float(match[1]), _MAX_HEIGHT_M)
    return default
