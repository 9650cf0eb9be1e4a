"""Slow reference implementations of metrics, and small builders."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from shapely import affinity
from shapely.geometry import box as shapely_box

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Boxes


def boxes(position, size=(4.0, 2.0, 1.5), yaw=0.0, group=0, id=None) -> Boxes:
    """Boxes at (n, 2) or (n, 3) positions; the remaining values are broadcast."""
    position = np.asarray(position, float)
    position = position.reshape(-1, position.shape[-1] if position.size else 3)
    n = len(position)
    if position.shape[1] == 2:
        position = np.column_stack([position, np.zeros(n)])
    return Boxes(
        np.broadcast_to(np.asarray(group, np.int64), n).copy(),
        np.arange(n, dtype=np.int64) if id is None else np.asarray(id, np.int64),
        position,
        np.broadcast_to(np.asarray(size, float), (n, 3)).copy(),
        np.broadcast_to(np.asarray(yaw, float), n).copy(),
    )


def cars(*positions, id=None, **columns) -> ObjectStates:
    """Cars at bird's-eye positions."""
    position = np.array([[*p, 0.75] for p in positions], float).reshape(-1, 3)
    n = len(position)
    id = np.arange(n) if id is None else np.asarray(id)
    return ObjectStates.of(position, id=id, size=np.tile([4.5, 1.8, 1.5], (n, 1)), **columns)


def outline(all_boxes: Boxes, k: int):
    """The outline of box k from above."""
    length, width, _ = all_boxes.size[k]
    shape = affinity.rotate(
        shapely_box(-length / 2, -width / 2, length / 2, width / 2), all_boxes.yaw[k], origin=(0, 0), use_radians=True
    )
    return affinity.translate(shape, *all_boxes.position[k, :2])


def iou(a: Boxes, i: int, b: Boxes, j: int) -> float:
    """Intersection over union of two volumes, by shapely."""
    area = outline(a, i).intersection(outline(b, j)).area
    top = min(a.position[i, 2] + a.size[i, 2] / 2, b.position[j, 2] + b.size[j, 2] / 2)
    bottom = max(a.position[i, 2] - a.size[i, 2] / 2, b.position[j, 2] - b.size[j, 2] / 2)
    common = area * max(top - bottom, 0.0)
    return common / (a.size[i].prod() + b.size[j].prod() - common)


def best_pairs(distance: np.ndarray, gate: float) -> tuple[int, float]:
    """Number of pairs and total distance of the best matching, by brute force."""
    rows, columns = distance.shape
    for count in range(min(rows, columns), 0, -1):
        totals = [
            sum(distance[r, c] for r, c in zip(chosen, partner, strict=True))
            for chosen in combinations(range(rows), count)
            for partner in permutations(range(columns), count)
            if all(distance[r, c] <= gate for r, c in zip(chosen, partner, strict=True))
        ]
        if totals:
            return count, min(totals)
    return 0, 0.0
