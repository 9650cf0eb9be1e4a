"""Reads label and calibration files of the DAIR family: V2X-Seq-SPD, DAIR-V2X-C, RCooper.

Yu et al.: DAIR-V2X, CVPR 2022; Yu et al.: V2X-Seq, CVPR 2023; Hao et al.: RCooper, CVPR 2024.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.elements import Element, read_json

MAX_LABELS = 5_000  # in one file
MAX_EXTENT_M = 1e8  # of a coordinate

#: Types by class, in lower case. A van is a car; three wheels and a motor count as a motorcycle.
_TYPES = {
    "car": ("car", "van"),
    "truck": ("truck",),
    "bus": ("bus",),
    "motorcycle": ("motorcycle", "motorcyclist", "tricycle", "tricyclist"),
    "bicycle": ("bicycle", "bicyclist", "cyclist"),
    "pedestrian": ("pedestrian", "barrowlist"),
}
CLASS_OF_TYPE = {name: CLASS_INDEX[label] for label, group in _TYPES.items() for name in group}
#: Types that are not road users, in lower case.
LEFT_OUT = ("trafficcone", "traffic_cone")

# Signs of the corners of `world_8_points`: four at the bottom, then four at the top, each from the front left
# clockwise (seen from above).
_CORNERS = np.array([[x, y, z] for z in (-1, 1) for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]) / 2
_MAX_CORNER_ERROR_M = 0.5  # between the corners in a file and those of an upright box; cars lean on slopes


def read_labels(path: Path) -> list[Element]:
    """The labels of a frame, without those of types that are `LEFT_OUT`."""
    labels = read_json(path).elements()
    if len(labels) > MAX_LABELS:
        raise SceneError(f"{path}: found {len(labels)} labels, expected at most {MAX_LABELS}")
    return [label for label in labels if type_of(label) not in LEFT_OUT]


def type_of(label: Element) -> str:
    """The type of a label, in lower case."""
    return label["type"].text().lower()


def class_of(label: Element) -> int:
    """Index into CLASSES of the type of a label, 0 (unknown) for unlisted types."""
    return CLASS_OF_TYPE.get(type_of(label), 0)


def number(element: Element, low: float = -MAX_EXTENT_M, high: float = MAX_EXTENT_M) -> float:
    """A finite number, which some files of the family write as text."""
    value = element.value
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            element.fail("a number")
        if not math.isfinite(value) or not low <= value <= high:
            element.fail(f"a finite number from {low:g} to {high:g}")
        return value
    return element.number(low, high)


def location(label: Element) -> Floats:
    """(3,) m, middle of the box of a label."""
    return np.array([number(label["3d_location"][axis]) for axis in "xyz"])


def dimensions(label: Element) -> Floats:
    """(3,) m, length, width and height of a label, 0 or more."""
    return np.array([number(label["3d_dimensions"][side], 0.0) for side in "lwh"])


def box(label: Element) -> tuple[Floats, Floats, float]:
    """Position (3,) m, size (3,) m and yaw rad of a label, from its eight corners if it has them."""
    corners = label.get("world_8_points")
    if corners is not None:
        return _box_of_corners(corners)
    size = dimensions(label)
    if size.min() <= 0:
        label["3d_dimensions"].fail("3 numbers above 0")
    return location(label), size, number(label["rotation"])


def _box_of_corners(element: Element) -> tuple[Floats, Floats, float]:
    """The upright box nearest to eight corners, see `_CORNERS`."""
    corners = element.matrix(8, 3)
    if np.abs(corners).max() > MAX_EXTENT_M:
        element.fail(f"numbers from {-MAX_EXTENT_M:g} to {MAX_EXTENT_M:g}")
    forward, left = corners[0] - corners[3], corners[0] - corners[1]
    size = np.array([np.linalg.norm(forward), np.linalg.norm(left), np.linalg.norm(corners[4] - corners[0])])
    if size.min() <= 0:
        element.fail("8 corners of a box with sizes above 0")
    position, yaw = corners.mean(axis=0), math.atan2(forward[1], forward[0])
    upright = position + (_CORNERS * size) @ rotation_from_yaw(yaw).T
    if np.abs(upright - corners).max() > _MAX_CORNER_ERROR_M:
        element.fail("8 corners of an upright box: 4 at the bottom, 4 at the top, each from the front left clockwise")
    return position, size, yaw


def track_of(label: Element, key: str = "track_id") -> str:
    """The name of a label's track: text, or a number as text; empty if the label has none."""
    element = label.get(key)
    if element is None:
        return ""
    name = str(element.integer()) if isinstance(element.value, (int, float)) else element.text()
    if not 1 <= len(name) <= 100:
        element.fail("a name of 1 to 100 characters")
    return name


def read_transform(path: Path) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3), active, of a calibration file: of the first frame in the second.

    The file has `rotation` (3 x 3) and `translation` (3, or 3 x 1), at the top or in an object `transform`.
    """
    root = read_json(path)
    inner = root.get("transform")
    root = root if inner is None else inner
    translation = root["translation"].elements(3)
    rows = [row.elements(1)[0] if isinstance(row.value, list) else row for row in translation]
    return np.array([number(row) for row in rows]), root["rotation"].rotation()
