"""What several adversaries see, joined to one row per object."""

from __future__ import annotations

import numpy as np

from mast_zenoh.attacks.ordering import canonical_order
from mast_zenoh.states import Ints, ObjectStates
from mast_zenoh.tracking.neighbours import neighbours


def cluster_centres(objects: ObjectStates, source: Ints, radius_m: float) -> ObjectStates:
    """What several adversaries see, joined to one row per object: mean position and velocity, the rest of one member.

    source (n,) int64 says who saw each row. The nearest two rows of different sources are joined first, as long as
    they are at most `radius_m` apart in the bird's-eye view and the cluster has at most one row per source.
    """
    if len(objects) == 0:
        return objects
    order = canonical_order(objects, source)
    position, source = objects.position.take(order, 0), source.take(order)
    i, j, dx, dy = neighbours(position, position, np.full(len(objects), radius_m))
    others = ((i < j) & (source[i] != source[j])).nonzero()[0]
    i, j = i.take(others), j.take(others)
    nearest = np.lexsort((j, i, (dx * dx + dy * dy).take(others)))
    label = list(range(len(objects)))
    members = [[row] for row in label]
    sources = [{s} for s in source.tolist()]
    for p, q in zip(i.take(nearest).tolist(), j.take(nearest).tolist(), strict=True):
        a, b = sorted((label[p], label[q]))
        if sources[a].isdisjoint(sources[b]):  # false as well when both are in one cluster already
            sources[a] |= sources[b]
            members[a] += members[b]
            for row in members[b]:
                label[row] = a
    by_member = np.argsort(label, kind="stable")
    head = np.asarray(label).take(by_member)
    start = np.flatnonzero(np.diff(head, prepend=-1))  # a cluster is called by its first row
    rows = order.take(by_member)
    both = np.concatenate([objects.position.take(rows, 0), objects.velocity.take(rows, 0)], axis=1)
    mean = np.add.reduceat(both, start) / np.diff(start, append=len(rows))[:, None]
    return objects.select(order.take(head.take(start))).with_(position=mean[:, :3], velocity=mean[:, 3:])
