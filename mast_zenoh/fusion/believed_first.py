"""Clusters that agents which are not believed cannot change."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.ordering import by_agent
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.fusion.base import Clusterer

#: m, in the bird's-eye view, between the middles of a cluster of believed agents and one of others of the same object.
RADIUS_M = 2.0


def believed_first(clusterer: Clusterer, states: ObjectStates, agent: Ints, believed: Bools) -> Ints:
    """(n,) the cluster of each track, as `Clusterer.cluster` numbers them.

    believed: (n,) tracks of agents that are believed; they are clustered as if there were no others, whose clusters
    join the nearest of theirs

    So a suspended agent cannot divide the objects of others by tracks beside them.
    """
    if believed.all():
        return clusterer.cluster(states, agent)
    labels = np.full(len(states), -1, np.int64)
    groups = [np.flatnonzero(believed), np.flatnonzero(~believed)]
    count = 0
    middles: list[Floats] = []
    for rows in groups:
        own = clusterer.cluster(states.select(rows), agent[rows]) if len(rows) else np.zeros(0, np.int64)
        size = int(own.max(initial=-1)) + 1
        middle = (
            np.stack([np.bincount(own, states.position[rows, axis], size) for axis in range(2)], axis=-1)
            / np.maximum(np.bincount(own, minlength=size), 1)[:, None]
        )
        middles.append(middle)
        labels[rows] = own + count
        count += size
    i, j, dx, dy = neighbours(middles[1], middles[0], np.full(len(middles[1]), RADIUS_M))
    chosen = greedy_matching(i, j, np.hypot(dx, dy))
    joined = np.arange(count)
    joined[len(middles[0]) + i[chosen]] = j[chosen]
    labels = joined[labels]
    # Numbered by the least member, (agent, id), of each.
    order = by_agent(states, agent)
    _, first, inverse = np.unique(labels[order], return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first, kind="stable"), kind="stable")
    result = np.empty(len(states), np.int64)
    result[order] = number[inverse.ravel()]
    return result
