"""Two things that cannot both be there: the footprints of road users do not overlap."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.tracking.tracks import CONFIRMED, ROW, YAW

#: Share of the distance at which two boxes touch, below which they are one object: boxes are only so exact.
ONE_OBJECT = 0.6


def overlap(offset: Floats, size: Floats, yaw: Floats, other_size: Floats, other_yaw: Floats, share: float) -> Bools:
    """(p,) whether boxes and others at `offset` (p, 2) m from them overlap so far that both cannot be there.

    size, other_size: (p, 3) m; yaw, other_yaw: (p,) rad. True where, along both axes of the box, the centres are nearer
    than `share` of the distance at which the boxes touch; `share` is ONE_OBJECT.
    """
    cosine, sine = np.cos(yaw), np.sin(yaw)
    along = np.abs(cosine * offset[:, 0] + sine * offset[:, 1])
    across = np.abs(cosine * offset[:, 1] - sine * offset[:, 0])
    c, s = np.abs(np.cos(other_yaw - yaw)), np.abs(np.sin(other_yaw - yaw))
    length = size[:, 0] + c * other_size[:, 0] + s * other_size[:, 1]
    width = size[:, 1] + s * other_size[:, 0] + c * other_size[:, 1]
    return np.asarray((along < 0.5 * share * length) & (across < 0.5 * share * width))


def duplicates(t: Floats) -> Bools:
    """(n,) which confirmed tracks are where a better one is: one measured now before one that coasts, then the older.

    The footprints of road users do not overlap; where those of two tracks do, both follow one object.
    """
    bad = np.zeros(len(t), bool)
    rows = t[:, CONFIRMED].nonzero()[0]
    if len(rows) < 2:
        return bad
    mean = t.take(rows, 0)
    yaw = mean[:, YAW]
    i, j, _, _ = neighbours(mean, mean, ONE_OBJECT * mean[:, 3])
    others = i != j
    if not np.count_nonzero(others):
        return bad
    i, j = i[others], j[others]
    same = overlap(mean[j, :2] - mean[i, :2], mean[i, 3:6], yaw[i], mean[j, 3:6], yaw[j], ONE_OBJECT)
    i, j = i[same], j[same]
    coasts = mean[:, ROW] < 0.0
    worse = np.where((coasts[i] > coasts[j]) | ((coasts[i] == coasts[j]) & (i > j)), i, j)
    bad[rows[worse]] = True
    return bad
