"""Boxes of objects, true or estimated: what the evaluator compares, and what pictures show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints, ascending, row_order


@dataclass(frozen=True, slots=True)
class Boxes:
    """n upright boxes of the truth or of an estimate, to be compared or drawn; never paired between groups.

    group:    (n,) int64, 0 or more: the frame, or a frame of one of several estimates
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

    def select(self, index: NDArray[np.integer] | NDArray[np.bool_] | slice) -> Boxes:
        """The rows selected by a mask, an index array or a slice; slices are views."""
        if isinstance(index, slice):
            return Boxes(*[getattr(self, field.name)[index] for field in fields(self)])
        rows = index.nonzero()[0] if index.dtype == bool else index
        return Boxes(*[getattr(self, field.name).take(rows, 0) for field in fields(self)])

    @classmethod
    def unnamed(cls, position: Floats, size: Floats, yaw: Floats) -> Boxes:
        """Boxes of one group without identity, to be drawn."""
        return cls(np.zeros(len(yaw), np.int64), np.full(len(yaw), -1), position, size, yaw)

    def in_group(self, group: Ints) -> Boxes:
        """The same boxes in other groups (n,)."""
        return replace(self, group=group)

    @classmethod
    def join(cls, parts: Sequence[Boxes]) -> Boxes:
        """All boxes of `parts`, in order."""
        empty = cls.unnamed(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return cls(*(np.concatenate([getattr(part, field.name) for part in (empty, *parts)]) for field in fields(cls)))

    def sorted(self) -> tuple[Boxes, Ints]:
        """The boxes sorted by group, id and position, and (n,) their original rows.

        Returns the same object if already sorted.
        """
        if ascending(self.id, self.group):
            return self, np.arange(len(self), dtype=np.int64)
        order = row_order(self.id, self.group, ties=lambda: self.position.T[::-1])
        return self.select(order), order
