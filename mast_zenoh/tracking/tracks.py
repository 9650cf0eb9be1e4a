"""The table of a tracker's tracks: one row of numbers per track.

Selecting, appending and copying are single operations on one array. Whole numbers (ids, classes, rows) are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel

#: Columns: the state (9) and its covariance (81, by rows).
MEAN = slice(0, 9)
COVARIANCE = slice(9, 90)
#: Variances and covariance of the horizontal position.
XX, XY, YY = 9, 10, 19
#: rad, rad^2; and votes, >= 0, for this heading against the opposite one.
YAW, YAW_VARIANCE, TURN = 90, 91, 92
#: m, running mean of the lateral residual: measured to the left of predicted position.
ASIDE = 93
#: Odds of existence, p / (1 - p).
ODDS = 94
#: Decaying counts of hits, misses and votes for each class.
HITS, MISSES, VOTES = 95, 96, slice(97, 97 + len(CLASSES))
RECORD = slice(HITS, VOTES.stop)
CLASS = VOTES.stop
#: 1 once it has been confirmed, else 0.
CONFIRMED = CLASS + 1
#: s since the last measurement.
AGE = CLASS + 2
ID = CLASS + 3
#: Row of the last input, -1 if the track coasts.
ROW = CLASS + 4
WIDTH = CLASS + 5

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


def to_states(tracks: Floats) -> ObjectStates:
    """The tracks as object states."""
    return ObjectStates(*to_columns(tracks))


@kernel
def to_columns(tracks: Floats) -> tuple[Any, ...]:
    """The columns of `ObjectStates`, in their order."""
    odds = tracks[:, ODDS]
    return (
        tracks[:, ID].astype(np.int64),
        tracks[:, 0:3].copy(),
        tracks[:, 6:9].copy(),
        tracks[:, 3:6].copy(),
        wrap_angle(tracks[:, YAW]),
        covariances(tracks).copy(),
        odds / (1.0 + odds),
        tracks[:, CLASS].astype(np.uint8),
    )


def known_class(class_id: NDArray[np.uint8]) -> Ints:
    """(n,) int64: class indices, with invalid ones replaced by unknown."""
    return np.asarray(_KNOWN.take(class_id))


@kernel
def vote(tracks: Floats, class_id: Ints) -> None:
    """Count a vote for a class (n,) of each track; the majority is its class, the lower index in a tie."""
    votes = tracks[:, VOTES]
    votes += _ONE_VOTE.take(class_id, 0)
    tracks[:, CLASS] = votes.argmax(axis=1)
