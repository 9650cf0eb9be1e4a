"""The table of a tracker's tracks: one row of numbers per track, with their headings; and which are duplicates.

Selecting, appending and copying are single operations on one array. Whole numbers (ids, classes, rows) are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.matching import neighbours
from mast_zenoh.arrays.states import CLASSES, Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.kernels import table_columns as columns

#: Columns of the table, see `kernels.table_columns`.
MEAN, COVARIANCE = slice(0, columns.P), slice(columns.P, columns.YAW)
XX, XY, YX, YY = columns.XX, columns.XY, columns.XX + 9, columns.YY
YAW, YAW_VARIANCE, TURN = columns.YAW, columns.YAW_VARIANCE, columns.TURN
LATERAL_RESIDUAL, ODDS = columns.LATERAL_RESIDUAL, columns.ODDS
HITS, MISSES, VOTES = columns.HITS, columns.MISSES, slice(columns.VOTES, columns.CLASS)
RECORD = slice(HITS, VOTES.stop)
CLASS, CONFIRMED, AGE = columns.CLASS, columns.CONFIRMED, columns.AGE
ID, ROW, WIDTH = columns.ID, columns.ROW, columns.WIDTH
SCORE, SPAN, DUE = columns.SCORE, columns.SPAN, columns.DUE
LASTING = slice(columns.LASTING_XX, columns.LASTING_YY + 1)

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


#: m/s along its axis above which an object is taken to move forward.
FORWARD = 2.0

#: Limit on the accumulated votes for one direction, in measurements.
TURN_LIMIT = 5.0


def correct_heading(tracks: Floats, yaw: Floats, variance: float) -> None:
    """Correct the headings by measured ones (n,) of `variance` rad^2.

    A measured heading may be reversed: its axis corrects the heading, its direction is one vote on which end is the
    front. Headings in the table may exceed a full turn.
    """
    innovation = yaw - tracks[:, YAW]
    half_turns = np.rint(innovation * (1.0 / np.pi))
    innovation -= np.pi * half_turns
    before = tracks[:, YAW_VARIANCE]
    gain = before / (before + variance)
    tracks[:, YAW] += gain * innovation
    tracks[:, YAW_VARIANCE] = variance * gain
    tracks[:, TURN] += 1.0 - 2.0 * (half_turns % 2.0)


@kernel
def resolve_headings_and_store(table: Floats, rows: Ints, tracks: Floats, forward: float, limit: float) -> None:
    """Vote on the front ends of corrected tracks (k, WIDTH), then write them to the `rows` (k,) of the table.

    The vote is by the speed along the heading; outvoted tracks are reversed.

    forward: m/s, speed above which to vote; limit: on the accumulated votes
    """
    along = (planar(tracks[:, 6:8]) * np.exp(-1j * tracks[:, YAW])).real
    turn = tracks[:, TURN]
    turn += along > forward
    turn -= along < -forward
    tracks[:, YAW] += np.pi * (turn < 0.0)
    tracks[:, TURN] = np.minimum(np.abs(turn), limit)
    table[rows] = tracks


#: Two boxes count as one object below this fraction of the distance at which they touch; boxes are inexact.
ONE_OBJECT = 0.6


@kernel
def overlap(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats, share: float) -> Bools:
    """Whether boxes (p,) and others at `offset` (p, 2) m overlap too far.

    Objects that overlap so far cannot be distinct: along both axes of the box, the centres are nearer than `share`
    (ONE_OBJECT) of the distance at which the boxes touch. size, other_size: (p, 3) m; yaw, other_yaw: (p,) rad
    """
    cosine, sine = np.cos(yaw), np.sin(yaw)
    along = np.abs(cosine * offset[:, 0] + sine * offset[:, 1])
    across = np.abs(cosine * offset[:, 1] - sine * offset[:, 0])
    c, s = np.abs(np.cos(other_yaw - yaw)), np.abs(np.sin(other_yaw - yaw))
    length = size[:, 0] + c * other_size[:, 0] + s * other_size[:, 1]
    width = size[:, 1] + s * other_size[:, 0] + c * other_size[:, 1]
    return np.asarray((along < 0.5 * share * length) & (across < 0.5 * share * width))


def duplicates(t: Floats) -> Bools:
    """Confirmed tracks (n,) that overlap a better track.

    Footprints of road users do not overlap; two tracks whose footprints do follow the same object. A measured track is
    better than a coasting one, then the older is better.
    """
    duplicate = np.zeros(len(t), bool)
    rows = t[:, CONFIRMED].nonzero()[0]
    if len(rows) < 2:
        return duplicate
    mean = t.take(rows, 0)
    yaw = mean[:, YAW]
    i, j, _, _ = neighbours(mean, mean, ONE_OBJECT * mean[:, 3])
    distinct = i != j
    if not np.count_nonzero(distinct):
        return duplicate
    i, j = i[distinct], j[distinct]
    same = overlap(mean[j, :2] - mean[i, :2], mean[i, 3:6], yaw[i], mean[j, 3:6], yaw[j], ONE_OBJECT)
    i, j = i[same], j[same]
    coasts = mean[:, ROW] < 0.0
    worse = np.where((coasts[i] > coasts[j]) | ((coasts[i] == coasts[j]) & (i > j)), i, j)
    duplicate[rows[worse]] = True
    return duplicate


def duplicated(t: Floats, boxes: Floats, yaw: Floats, i: Ints, j: Ints, explained: Bools) -> Ints:
    """Which of p gated pairs are of a measured track and a measurement of the same object that no track explains.

    boxes: (m, >= 6) measurements x y z l w h, yaw: (m,) rad; i, j: (p,) rows of tracks and of measurements
    explained: (m,) whether a track explains the measurement
    """
    rows = (~explained[j] & (t[i, ROW] >= 0.0)).nonzero()[0]
    if len(rows) == 0:
        return np.zeros(0, np.int64)
    mean, j = t[i[rows]], j[rows]
    state = boxes[j]
    offset = state[:, :2] - mean[:, :2]
    return np.asarray(rows[overlap(offset, mean[:, 3:6], mean[:, YAW], state[:, 3:6], yaw[j], ONE_OBJECT)])
