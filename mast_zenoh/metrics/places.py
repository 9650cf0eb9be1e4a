"""Places of many frames at once, and which of others is nearest to each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.boxes import Boxes, centre_distance, pairs_within


@dataclass(frozen=True, slots=True)
class Places:
    """n places: group (n,) int64 (places of different groups never meet) and position (n, 3) m, world frame."""

    group: Ints
    position: Floats

    def boxes(self) -> Boxes:
        """As boxes without extent."""
        n = len(self.group)
        return Boxes(self.group, np.zeros(n, np.int64), self.position, np.zeros((n, 3)), np.zeros(n))

    def select(self, mask: Bools | Ints) -> Places:
        """The places that a mask or an index array picks."""
        return Places(self.group[mask], self.position[mask])


def nearest(places: Places, among: Places, radius: float) -> tuple[Ints, Floats]:
    """For each of n places the row of the nearest of `among` in its group, -1 if none is within `radius` m, and the
    bird's-eye distance to it, m (inf)."""
    row, distance = np.full(len(places.group), -1, np.int64), np.full(len(places.group), np.inf)
    i, j = pairs_within(places.boxes(), among.boxes(), radius)
    apart = centre_distance(places.position[i], among.position[j])
    order = np.lexsort((j, apart, i))
    first = np.ones(len(i), bool)
    first[1:] = np.diff(i[order]) != 0
    best = order[first]
    row[i[best]], distance[i[best]] = j[best], apart[best]
    return row, distance
