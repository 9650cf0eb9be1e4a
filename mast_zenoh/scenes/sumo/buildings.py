"""Outlines of buildings from SUMO's files of polygons."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.files.text_elements import TextElement
from mast_zenoh.scenes.files.xml_elements import XmlElement, read_xml

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
