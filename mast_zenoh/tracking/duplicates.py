"""Duplicate detection: the footprints of distinct road users do not overlap."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import CONFIRMED, ROW, YAW

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
