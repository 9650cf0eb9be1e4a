"""How far each agent's tracks are from what the other agents report of the same objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch
from mast_zenoh.integrity.clusters import ClusterBoxes

#: Tracks of an object, at least, for a middle that one liar cannot move far.
MEMBERS = 3
#: m, standard deviation of the part of an offset that the covariances do not show: boxes seen from two sides.
FLOOR_M = 0.1
#: m, between two clusters: nearer ones may have swapped members.
CROWD_M = 3.5
#: Variance of the median of normal errors, relative to that of their mean.
MEDIAN = np.pi / 2


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Offsets of the tracks of a agents from the middle of their c clusters.

    valid:  (c, a) whether the agent has a track in the cluster, and the cluster a middle
    offset: (c, a, 2) m, of the track's position from the middle
    information: (c, a, 2, 2) 1/m^2, inverse covariance of the offset of an honest agent
    """

    valid: Bools
    offset: Floats
    information: Floats


def offsets(batch: Batch, boxes: ClusterBoxes, vote: Bools) -> Offsets:
    """Offsets of the tracks of agents with a vote from the median of their clusters.

    boxes: of the clusters; vote: (a,) whether an agent counts

    The median, coordinate by coordinate, is near the honest majority's position wherever a single liar is. Clusters
    with fewer than MEMBERS tracks have no middle, nor have those nearer than CROWD_M to another one.
    """
    present = batch.reported & vote
    members = present.sum(axis=1)
    lonely = np.ones(batch.clusters, np.bool_)
    i, j, _, _ = neighbours(boxes.position, boxes.position, np.full(batch.clusters, CROWD_M))
    lonely[i[i != j]] = False
    valid = present & (lonely & (members >= MEMBERS))[:, None]
    if not valid.any():
        return Offsets(valid, np.zeros((*valid.shape, 2)), np.zeros((*valid.shape, 2, 2)))
    position = batch.states.position[batch.member, :2]
    ordered = np.sort(np.where(present[..., None], position, np.inf), axis=1)
    low, high = (np.maximum(row, 0)[:, None, None] for row in ((members - 1) // 2, members // 2))
    middle = 0.5 * (np.take_along_axis(ordered, low, axis=1) + np.take_along_axis(ordered, high, axis=1))
    covariance = np.where(present[..., None, None], batch.states.covariance[batch.member, :2, :2], 0.0)
    spread = covariance.sum(axis=1, keepdims=True) * (MEDIAN / np.maximum(members, 1) ** 2)[:, None, None, None]
    total = np.where(valid[..., None, None], covariance + spread + FLOOR_M**2 * np.eye(2), np.eye(2))
    offset = np.where(valid[..., None], position - middle, 0.0)
    return Offsets(valid, offset, np.linalg.inv(total))
