"""Sort orders that do not depend on the original order of the rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Ints, ObjectStates
from mast_zenoh.kernels import kernel

#: Number of rows up to which sorting is faster than checking whether they are sorted.
_FEW = 256


def row_order(*keys: NDArray[Any], ties: Callable[[], Iterable[NDArray[Any]]] | None = None) -> Ints:
    """(n,) row indices sorting by `keys` (n,), then by those of `ties`; the last comes first.

    The same as `np.lexsort((*ties(), *keys))`, but faster if the rows are sorted already or no two keys are equal.
    """
    if len(keys) > 1 and len(keys[0]) > _FEW:
        if ascending(*keys):
            return np.arange(len(keys[0]), dtype=np.int64)
        order = keys[-1].argsort(kind="stable")
        if ascending(*[key.take(order) for key in keys]):
            return order.astype(np.int64)
    order, tied = sorted_rows(keys)
    if tied and ties is not None:
        order = np.lexsort((*ties(), *keys))
    return order.astype(np.int64, copy=False)


@kernel
def sorted_rows(keys: tuple[NDArray[Any], ...]) -> tuple[Ints, bool]:
    """(n,) row indices that sort by `keys` (n,), the last comes first, and whether two rows have the same."""
    order = np.lexsort(keys)
    ordered = [key.take(order) for key in keys]
    equal = np.ones(max(len(order) - 1, 0), bool)
    for key in ordered:
        equal &= key[1:] == key[:-1]
    return order, bool(np.count_nonzero(equal))


def ascending(*keys: NDArray[Any]) -> bool:
    """Whether rows are in strictly ascending order of `keys` (n,), last key first."""
    n = max(len(keys[0]) - 1, 0)
    later, equal = np.zeros(n, bool), np.ones(n, bool)
    for key in keys[::-1]:
        later |= equal & (key[1:] > key[:-1])
        equal &= key[1:] == key[:-1]
    return bool(later.all())


def within_runs(count: Ints) -> Ints:
    """0 to count - 1 for each of k runs of rows, one run after the other: (sum of count,)."""
    return np.asarray(np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count))


def by_agent(states: ObjectStates, agent: Ints) -> Ints:
    """(n,) row indices that sort tracks by (agent, id); by position where a faulty source uses an id twice.

    agent: (n,)
    """
    return row_order(states.id, agent, ties=lambda: states.position.T)


def canonical_order(objects: ObjectStates, source: Ints | None = None) -> Ints:
    """(n,) row indices that sort objects by their columns, then by source.

    The order of the columns is position, velocity, size, yaw, score, class and id.

    The id comes last because objects converted from detections only have row numbers as ids.
    source: (n,) int64, where each row came from. Draws and matches made in this order are the same for every
    permutation of the rows.
    """
    o = objects

    def ties() -> list[NDArray[Any]]:
        keys = [*o.position.T[1:], *o.velocity.T, *o.size.T, o.yaw, o.score, o.class_id, o.id]
        return ([] if source is None else [source]) + keys[::-1]

    return row_order(o.position[:, 0], ties=ties)
