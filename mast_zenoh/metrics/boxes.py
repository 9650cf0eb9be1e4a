"""Boxes of many frames at once, and which of them are near each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mast_zenoh.states import Floats, Ints


@dataclass(frozen=True, slots=True)
class Boxes:
    """n upright boxes. Boxes of different groups (frames, estimators) never meet.

    group:    (n,) int64, 0 or more
    id:       (n,) int64, identity of the object or track
    position: (n, 3) m, centre, world frame
    size:     (n, 3) m, length width height
    yaw:      (n,) rad
    """

    group: Ints
    id: Ints
    position: Floats
    size: Floats
    yaw: Floats

    def __len__(self) -> int:
        return len(self.id)

    def select(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> Boxes:
        """The rows that a mask or an index array picks."""
        return Boxes(*(getattr(self, field.name)[index] for field in fields(self)))

    def in_group(self, group: Ints) -> Boxes:
        """The same boxes in other groups (n,)."""
        return replace(self, group=group)

    @classmethod
    def join(cls, parts: Sequence[Boxes]) -> Boxes:
        """All boxes of `parts`, in order."""
        empty = cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return cls(*(np.concatenate([getattr(part, field.name) for part in (empty, *parts)]) for field in fields(cls)))

    def order(self) -> Ints:
        """(n,) rows by group, id and position: how ties are broken, whatever the order of the rows."""
        return np.lexsort((*self.position.T[::-1], self.id, self.group)).astype(np.int64)


def pairs_within(a: Boxes, b: Boxes, radius: float) -> tuple[Ints, Ints]:
    """Rows (i, j) of all pairs of one group whose centres are at most `radius` m apart in the bird's-eye view.

    Sorted by i, then j. May hold pairs that are farther apart by rounding: callers apply their own limit.
    """
    if len(a) == 0 or len(b) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    # Groups are laid out along a third axis, farther apart than the radius: one search serves all frames.
    reach = radius * (1.0 + 1e-9) + 1e-9
    trees = [cKDTree(np.column_stack([x.position[:, :2], x.group * (2.0 * reach + 1.0)])) for x in (a, b)]
    found = trees[0].sparse_distance_matrix(trees[1], reach, output_type="ndarray")
    i, j = found["i"].astype(np.int64), found["j"].astype(np.int64)
    order = np.lexsort((j, i))
    return i[order], j[order]


def centre_distance(a: Floats, b: Floats) -> Floats:
    """(n,) m: bird's-eye distance of (n, 3) positions."""
    return np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1])
