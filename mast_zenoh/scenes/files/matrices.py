"""Poses that data sets store as 4 x 4 matrices."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.files.elements import Element

#: Limit on a coordinate, m: far beyond any map projection, and its square is far below the limit of a number.
MAX_COORDINATE_M = 1e8
_LAST = np.array([0.0, 0.0, 0.0, 1.0])
_ROUNDING = 1e-6  # of the last row of a matrix, and of a symmetric one


def read_pose(element: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix that is a list of 4 rows.

    Raises SceneError, with the place in the file, unless it is a rotation and a translation.
    """
    for row in element.elements(4):
        for value in row.elements(4):
            value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M)
    return element.rigid()


def read_listed_pose(element: Element) -> tuple[Floats, Floats]:
    """Position (3,) m and rotation (3, 3) of a 4 x 4 matrix: a list of 4 rows, or of 16 numbers.

    Writers of lists disagree on their order. It is by rows if the last four numbers are 0, 0, 0, 1, and by columns if
    every fourth number is. Both are true without a translation: then the matrix must be symmetric, or be 4 rows.
    """
    if not isinstance(element.value, list) or len(element.value) not in (4, 16):
        element.fail("4 rows of 4 numbers, or 16 numbers")
    if len(element.value) == 4:
        return read_pose(element)
    numbers = [value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M) for value in element.elements()]
    matrix = np.array(numbers).reshape(4, 4)
    by_rows, by_columns = (bool(np.abs(end - _LAST).max() <= _ROUNDING) for end in (matrix[3], matrix[:, 3]))
    if not by_rows and not by_columns:
        element.fail("16 numbers of a 4 x 4 matrix whose last row is 0, 0, 0, 1")
    if by_rows and by_columns and np.abs(matrix - matrix.T).max() > _ROUNDING:
        element.fail("4 rows of 4 numbers: without a translation, the order of 16 numbers cannot be known")
    rows = matrix if by_rows else matrix.T
    return Element(rows.tolist(), element.path, element.place).rigid()
