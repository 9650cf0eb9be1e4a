"""The table of a tracker's tracks: one row of numbers per track.

Selecting, appending and copying are single operations on one array. Whole numbers (ids, classes, rows) are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES, Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.kernels import table_columns as columns

#: Columns of the table, see `kernels.table_columns`.
MEAN, COVARIANCE = slice(0, columns.P), slice(columns.P, columns.YAW)
XX, XY, YY = columns.XX, columns.XY, columns.YY
YAW, YAW_VARIANCE, TURN = columns.YAW, columns.YAW_VARIANCE, columns.TURN
LATERAL_RESIDUAL, ODDS = columns.LATERAL_RESIDUAL, columns.ODDS
HITS, MISSES, VOTES = columns.HITS, columns.MISSES, slice(columns.VOTES, columns.CLASS)
RECORD = slice(HITS, VOTES.stop)
CLASS, CONFIRMED, AGE = columns.CLASS, columns.CONFIRMED, columns.AGE
ID, ROW, WIDTH = columns.ID, columns.ROW, columns.WIDTH
SCORE, SPAN, DUE = columns.SCORE, columns.SPAN, columns.DUE

assert len(CLASSES) == columns.N_CLASSES, "each class has a column of votes"
_ONE_VOTE = np.eye(len(CLASSES))
_KNOWN = np.zeros(256, np.int64)
_KNOWN[: len(CLASSES)] = np.arange(len(CLASSES))


def empty(n: int) -> Floats:
    """n rows of zeros."""
    return np.zeros((n, WIDTH))


def covariances(tracks: Floats) -> Floats:
    """Covariances (n, 9, 9), a view."""
    return tracks[:, COVARIANCE].reshape(len(tracks), 9, 9)


def classes_of(tracks: Floats) -> Ints:
    """Classes (n,) int64."""
    return tracks[:, CLASS].astype(np.int64)


def planar(vectors: Floats) -> NDArray[np.complex128]:
    """Planar vectors (n, 2) as complex numbers x + i y (n,), a view."""
    return np.asarray(vectors.view(np.complex128)[:, 0])


def columns_of(tracks: Floats, score: Floats) -> tuple[Any, ...]:
    """The columns of `ObjectStates`, in their order; score: (n,)."""
    return (
        tracks[:, ID].astype(np.int64),
        tracks[:, 0:3].copy(),
        tracks[:, 6:9].copy(),
        tracks[:, 3:6].copy(),
        wrap_angle(tracks[:, YAW]),
        covariances(tracks).copy(),
        score,
        tracks[:, CLASS].astype(np.uint8),
    )


@kernel
def next_table(tracks: Floats, keep: Bools, report: Bools, new: Floats) -> tuple[Floats, Floats]:
    """The tracks (n, WIDTH) to keep, with new ones (k, WIDTH) after them, and a copy of those to keep and report."""
    return np.concatenate([tracks[keep], new]), tracks[keep & report]


def known_class(class_id: NDArray[np.uint8]) -> Ints:
    """(n,) int64: class indices, with invalid ones replaced by unknown."""
    return np.asarray(_KNOWN.take(class_id))


def update_class(tracks: Floats, class_id: Ints) -> None:
    """Count a vote for a class (n,) of each track; the class with most votes wins.

    In a tie, the lower index wins.
    """
    votes = tracks[:, VOTES]
    votes += _ONE_VOTE.take(class_id, 0)
    tracks[:, CLASS] = votes.argmax(axis=1)
