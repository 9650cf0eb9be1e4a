"""Poses and numbers of the files, in a right-handed world.

A pose is [x, y, z, roll, yaw, pitch] in m and degrees. OpenCOOD (x_to_world in transformation_utils.py) turns it into
the matrix Rz(yaw) Ry(-pitch) Rx(-roll) of a frame with y to the right. Inverting y on both sides gives the same
rotation with y to the left: Rz(-yaw) Ry(-pitch) Rx(roll).
"""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.files.elements import Element

#: Limit on coordinates, m, and on angles, degrees.
MAX_COORDINATE = 1e7
_FLIP = np.array([1.0, -1.0, 1.0])


def numbers(element: Element, count: int) -> list[float]:
    """`count` finite numbers, m or degrees, none beyond `MAX_COORDINATE`."""
    values = element.value
    # Element checks one at a time, which is slow for the many thousands of a scene, so it only words the refusals.
    if not (
        type(values) is list
        and len(values) == count
        and all(type(value) is float or type(value) is int for value in values)
        and all(-MAX_COORDINATE <= value <= MAX_COORDINATE for value in values)
    ):
        return [part.number(-MAX_COORDINATE, MAX_COORDINATE) for part in element.elements(count)]
    return values


def pose(element: Element, left_handed: bool) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of [x, y, z, roll, yaw, pitch], or of a 4 x 4 matrix.

    left_handed: whether y is to the right in the file
    """
    if isinstance(element.value, list) and len(element.value) == 4:
        position, rotation = element.rigid()
        if np.abs(position).max() > MAX_COORDINATE:
            element.fail(f"a position of at most {MAX_COORDINATE:g} m")
        if left_handed:
            rotation = rotation * np.outer(_FLIP, _FLIP)
    else:
        values = numbers(element, 6)
        position, rotation = np.array(values[:3]), rotations(np.array([values[3:]]), left_handed)[0]
    return (position * _FLIP if left_handed else position), rotation


def positions(place: Floats, left_handed: bool) -> Floats:
    """(n, 3) m with y to the left."""
    return place * _FLIP if left_handed else place


def rotations(angle: Floats, left_handed: bool) -> Floats:
    """(n, 3, 3) active rotations of angles (n, 3), roll, yaw and pitch in degrees.

    left_handed: whether y is to the right in the file
    """
    roll, yaw, pitch = np.moveaxis(angle * (math.pi / 180.0), -1, 0)
    if left_handed:
        yaw = -yaw
    else:
        roll = -roll
    cr, sr, cy, sy, cp, sp = np.cos(roll), np.sin(roll), np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    # Rz(yaw) Ry(-pitch) Rx(roll)
    rows = [
        [cy * cp, -cy * sp * sr - sy * cr, -cy * sp * cr + sy * sr],
        [sy * cp, -sy * sp * sr + cy * cr, -sy * sp * cr - cy * sr],
        [sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
