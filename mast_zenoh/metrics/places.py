"""Positions of many frames, and nearest-neighbour search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.boxes import Boxes, centre_distance, pairs_within


@dataclass(frozen=True, slots=True)
class Places:
    """n positions, which are never paired between groups.

    group: (n,) int64; position: (n, 3) m, world frame
    """

    group: Ints
    position: Floats

    def boxes(self) -> Boxes:
        """The positions as boxes without extent."""
        n = len(self.group)
        return Boxes(self.group, np.zeros(n, np.int64), self.position, np.zeros((n, 3)), np.zeros(n))

    def select(self, mask: Bools | Ints) -> Places:
        """The positions selected by a mask or an index array."""
        return Places(self.group[mask], self.position[mask])


def nearest(places: Places, among: Places, radius: float) -> tuple[Ints, Floats]:
    """Nearest row of `among` in the group of each of n positions, and its distance m.

    The distance is that in the bird's-eye view. -1 and inf if none is within `radius` m.
    """
    row, distance = np.full(len(places.group), -1, np.int64), np.full(len(places.group), np.inf)
    i, j = pairs_within(places.boxes(), among.boxes(), radius)
    pair_distance = centre_distance(places.position[i], among.position[j])
    order = np.lexsort((j, pair_distance, i))
    first = np.ones(len(i), bool)
    first[1:] = np.diff(i[order]) != 0
    best = order[first]
    row[i[best]], distance[i[best]] = j[best], pair_distance[best]
    return row, distance
