"""Object ids from names of tracks, or by linking boxes; nearest centres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import Bools, Floats, Ints

_MAX_DIGITS = 15  # of a name that is kept as an id


def numbered(names: Sequence[str]) -> Ints:
    """Ids (n,) of tracks: their names if all are whole numbers, otherwise from 1 in the order of the names."""
    distinct = sorted(set(names))
    if all(len(name) <= _MAX_DIGITS and name.isascii() and name.isdigit() for name in distinct):
        return np.array([int(name) for name in names], np.int64)
    index = {name: number for number, name in enumerate(distinct, start=1)}
    return np.array([index[name] for name in names], np.int64)


def linked(frame: Ints, position: Floats, class_id: Ints, times_ns: Ints, radius_m: float) -> Ints:
    """Ids (n,) of boxes without any, from 1.

    frame: (n,) ascending, row of times_ns (F,); position: (n, 3) m; class_id: (n,)

    A box continues the track of the box in the frame before that has the same class and is the nearest on the ground,
    within `radius_m` of where its last two positions lead. The closest pairs are linked first. Tracks never bridge a
    frame without a box.
    """
    ids = np.zeros(len(frame), np.int64)
    velocity = np.zeros((len(frame), 2))
    count = 0
    before = np.zeros(0, np.intp)
    for index in range(len(times_ns)):
        now = np.flatnonzero(frame == index)
        elapsed = (times_ns[index] - times_ns[index - 1]) / 1e9 if index else 1.0
        predicted = position[before, :2] + velocity[before] * elapsed
        distance = np.linalg.norm(position[now, None, :2] - predicted[None], axis=2)
        distance[class_id[now, None] != class_id[None, before]] = np.inf
        for row, column in zip(*_closest(distance, radius_m), strict=True):
            box, last = now[row], before[column]
            ids[box] = ids[last]
            velocity[box] = (position[box, :2] - position[last, :2]) / elapsed
        new = now[ids[now] == 0]
        ids[new] = count + 1 + np.arange(len(new))
        count += len(new)
        before = now
    return ids


def matched(labels: Floats, boxes: Floats, radius_m: float) -> Bools:
    """Which boxes (n, 3) have a label (m, 3) of their own, the nearest within a radius on the ground.

    The closest pairs are matched first.
    """
    distance = np.linalg.norm(boxes[:, None, :2] - labels[None, :, :2], axis=2)
    found: Bools = np.zeros(len(boxes), bool)
    found[_closest(distance, radius_m)[0]] = True
    return found


def _closest(distance: Floats, radius_m: float) -> tuple[Ints, Ints]:
    """Rows and columns of the pairs within a radius, one to one, the closest first."""
    row, column = np.nonzero(distance <= radius_m)
    chosen = greedy_matching(row.astype(np.int64), column.astype(np.int64), distance[row, column])
    return row[chosen], column[chosen]
