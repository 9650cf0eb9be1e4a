"""How far each agent's tracks are from what the other agents report of the same objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.integrity.base import Batch

#: Tracks of an object, at least, for a middle that one liar cannot move far.
MEMBERS = 3
#: m, standard deviation of the part of an offset that the covariances do not show: boxes seen from two sides.
FLOOR_M = 0.1
#: Variance of the median of normal errors, relative to that of their mean.
MEDIAN = np.pi / 2


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Offsets of k tracks from the middle of their clusters.

    row:    (k,) int64, rows of the tracks
    offset: (k, 2) m, of the track's position from the middle
    information: (k, 2, 2) 1/m^2, inverse covariance of the offset of an honest agent
    """

    row: Ints
    offset: Floats
    information: Floats


def offsets(batch: Batch, weight: Floats) -> Offsets:
    """Offsets of the tracks of all agents with a vote, from the median of their clusters.

    weight: (a,) of each agent's vote; agents without one are left out

    The median, coordinate by coordinate, is near the honest majority's position wherever a single liar is.
    """
    votes = (weight > 0.0)[batch.agent]
    members = np.bincount(batch.labels[votes], minlength=batch.clusters)
    rows = np.flatnonzero(votes & (members[batch.labels] >= MEMBERS))
    if len(rows) == 0:
        return Offsets(rows, np.zeros((0, 2)), np.zeros((0, 2, 2)))
    labels, position = batch.labels[rows], batch.states.position[rows, :2]
    cluster, size = np.unique(labels, return_counts=True)
    order = np.searchsorted(cluster, labels)
    first = np.cumsum(size) - size
    middle = np.empty((len(cluster), 2))
    for axis in range(2):
        by_value = position[np.lexsort((position[:, axis], order)), axis]
        middle[:, axis] = 0.5 * (by_value[first + (size - 1) // 2] + by_value[first + size // 2])
    covariance = batch.states.covariance[rows, :2, :2]
    mean = np.zeros((len(cluster), 2, 2))
    np.add.at(mean, order, covariance)
    mean *= (MEDIAN / size**2)[:, None, None]
    total = covariance + mean[order] + FLOOR_M**2 * np.eye(2)
    return Offsets(rows, position - middle[order], np.linalg.inv(total))
