"""Sizes and classes of SUMO's vehicle types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.text_elements import TextElement
from mast_zenoh.scenes.files.xml_elements import XmlElement, read_xml

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
        values.append(otherwise if value is None else positive(value))
    return values[0], values[1], values[2]


def positive(value: TextElement) -> float:
    """A size above 0, m."""
    number = value.number(0.0, MAX_SIZE_M)
    if number == 0.0:
        value.fail("a size above 0")
    return number


def sizes(types: Sequence[VehicleType]) -> Floats:
    """(N, 3) m."""
    return np.array([kind.size for kind in types]).reshape(-1, 3)
