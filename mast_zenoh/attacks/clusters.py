"""Clusters the observations of several adversaries."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.clustering import merge_pairs, pairs_near
from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Ints, ObjectStates


def cluster_centres(objects: ObjectStates, source: Ints, radius_m: float) -> ObjectStates:
    """Merge the observations of several adversaries into one row per object.

    Position and velocity are means; other columns come from one member.

    source (n,) int64: the observer of each row. The nearest two rows of different sources are merged first, if they
    are at most `radius_m` apart in the bird's-eye view and the cluster has at most one row per source.
    """
    if len(objects) == 0:
        return objects
    order = canonical_order(objects, source)
    position, source = objects.position.take(order, 0)[:, :2], source.take(order)
    i, j, squared = pairs_near(position, radius_m)
    pairs = (source.take(i) != source.take(j)).nonzero()[0]
    label = merge_pairs(position, source, i.take(pairs), j.take(pairs), squared.take(pairs), np.inf)
    by_member = label.argsort(kind="stable")
    rows, size = order.take(by_member), np.bincount(label)
    start = size.cumsum() - size
    motion = np.concatenate([objects.position.take(rows, 0), objects.velocity.take(rows, 0)], axis=1)
    mean = np.add.reduceat(motion, start) / size[:, None]
    return objects.select(rows.take(start)).with_(position=mean[:, :3], velocity=mean[:, 3:])
