"""Shapes of obstacles in CommonRoad scenarios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.files.xml_elements import XmlElement

_MAX_COORDINATE_M = 1e8
_MAX_SIZE_M = 1000.0
_SHAPES = ("rectangle", "circle", "polygon")


@dataclass(frozen=True, eq=False)
class Outline:
    """The box around a shape, in the obstacle's frame.

    size: (2,) m, length and width; centre: (2,) m, its middle; yaw: rad
    """

    size: Floats
    centre: Floats
    yaw: float


def read_outline(shape: XmlElement) -> Outline:
    """The box around the only shape of an obstacle: a rectangle, or the box of a circle or polygon."""
    shapes = [child for child in shape.children if child.tag in _SHAPES]
    if len(shapes) != 1 or len(shape.children) != 1:
        names = ", ".join(child.tag for child in shape.children[:10]) or "nothing"
        shape.fail(f"found {names}, expected one of {', '.join(_SHAPES)}")
    (part,) = shapes
    if part.tag == "polygon":
        corners = read_polygon(part)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if (high <= low).any():
            part.fail("found a polygon without area, expected one with")
        return Outline(high - low, (low + high) / 2, 0.0)
    centre = part.get_child("center")
    middle = np.zeros(2) if centre is None else read_point(centre)
    if part.tag == "circle":
        return Outline(np.full(2, 2 * _length(part.child("radius"))), middle, 0.0)
    angle = part.get_child("orientation")
    yaw = 0.0 if angle is None else angle.text.number(-1e3, 1e3)
    return Outline(np.array([_length(part.child("length")), _length(part.child("width"))]), middle, yaw)


def read_polygon(polygon: XmlElement) -> Floats:
    """Corners (k, 2) m of a polygon, without repeating the first."""
    corners = np.array([read_point(child) for child in polygon.children if child.tag == "point"]).reshape(-1, 2)
    if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        polygon.fail(f"found {len(corners)} different corners, expected 3 or more")
    return corners


def read_point(point: XmlElement) -> Floats:
    """(2,) m of an element with <x> and <y>."""
    return np.array([point.child(axis).text.number(-_MAX_COORDINATE_M, _MAX_COORDINATE_M) for axis in ("x", "y")])


def _length(element: XmlElement) -> float:
    value = element.text.number(0.0, _MAX_SIZE_M)
    if value == 0.0:
        element.text.fail("a length above 0")
    return value
