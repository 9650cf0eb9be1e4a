"""Correlations of a perceived object's components: LowerTriangularPositiveSemidefiniteMatrix, TS 102 894-2 v2.4.1.

They are a table (c, 5): row of the object, number of its matrix from 0, components i < j as in MatrixIncludedComponents
(0 to 2 position, 3 to 5 velocity, 6 to 8 acceleration, 9 to 11 angles about z, y, x, 12 yaw rate), and 100 times the
correlation, 101 if it is unavailable. A matrix has all pairs of its components, in ascending order.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x.asn1.codec_kernels import Values

COMPONENTS = 13
#: Slots of a matrix: count and start of the bits of its components, and of its columns.
_WIDTH = 4


def from_lists(values: Values, rows: Values, slot: int) -> tuple[Values, bool]:
    """The table of all objects, and whether all matrices have the shape that their components say; others are left out.

    rows: of the objects;  slot: of the list of matrices
    """
    cells: list[tuple[int, int, int, int, int]] = []
    sound = True
    for row in np.flatnonzero(rows[:, slot]).tolist():
        n_matrices, first = rows[row, slot : slot + 2].tolist()
        for number in range(n_matrices):
            place = first + _WIDTH * number
            n_bits, bits, n_columns, columns = values[place : place + _WIDTH].tolist()
            included = np.flatnonzero(values[bits : bits + n_bits]).tolist()
            lengths = values[columns : columns + 2 * n_columns : 2].tolist()
            starts = values[columns + 1 : columns + 2 * n_columns : 2].tolist()
            if n_bits != COMPONENTS or lengths != list(range(len(included) - 1, 0, -1)):
                sound = False
                continue
            for column, start in enumerate(starts):
                others = included[column + 1 :]
                found = values[start : start + len(others)].tolist()
                cells += [(row, number, included[column], j, cell) for j, cell in zip(others, found, strict=True)]
    return np.array(cells, np.int64).reshape(-1, 5), sound


def to_lists(table: Values, rows: Values, slot: int, start: int) -> Values:
    """Rows of the matrices, as flat values that begin at slot `start`; presence, count and start are set in `rows`."""
    matrices: dict[int, list[Values]] = {}
    for key in dict.fromkeys(map(tuple, table[:, :2].tolist())):
        row, number = key
        if not 0 <= row < len(rows) or number != len(matrices.setdefault(row, [])):
            raise MessageError(
                f"perceivedObjects[{row}]: found correlation matrix {number}, expected ascending numbers"
            )
        cells = table[(table[:, :2] == key).all(axis=1), 2:]
        included = np.unique(cells[:, :2])
        pairs = included[np.array(np.triu_indices(len(included), 1))].T
        if not np.array_equal(cells[:, :2], pairs) or included[0] < 0 or included[-1] >= COMPONENTS:
            raise MessageError(
                f"perceivedObjects[{row}].lowerTriangularCorrelationMatrices[{number}]: found other pairs than all of "
                f"its components 0..{COMPONENTS - 1} in ascending order"
            )
        matrices[row].append(cells)
    block: list[int] = []
    for row, of_object in matrices.items():
        rows[row, slot - 1 : slot + 2] = 1, len(of_object), start + len(block)
        place = len(block)
        block += [0] * (_WIDTH * len(of_object))
        for cells in of_object:
            included = np.unique(cells[:, :2])
            n_columns, mask = len(included) - 1, np.isin(np.arange(COMPONENTS), included)
            columns = start + len(block) + COMPONENTS
            block[place : place + _WIDTH] = COMPONENTS, start + len(block), n_columns, columns
            place += _WIDTH
            block += mask.astype(int).tolist()
            cell = columns + 2 * n_columns
            for length in range(n_columns, 0, -1):
                block += [length, cell]
                cell += length
            block += cells[:, 2].tolist()
    return np.array(block, np.int64)
