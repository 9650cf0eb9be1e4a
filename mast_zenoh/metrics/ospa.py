"""OSPA and GOSPA distances between truth objects and tracks, for all frames.

Sources: Schuhmacher, Vo and Vo, A consistent metric for performance evaluation of multi-object filters (2008);
Rahmathullah, Garcia-Fernandez and Svensson, Generalized optimal sub-pattern assignment metric (2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import min_cost_matching
from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.boxes import Boxes, centre_distance, check_dimensions, pairs_within


@dataclass(frozen=True, slots=True, kw_only=True)
class SetDistance:
    """Parameters of OSPA and GOSPA.

    c: m, cut-off distance: the cost of a missed or false object
    p: order of the mean: larger values give outliers more weight
    alpha: of GOSPA, above 0 up to 2: a missed or false object costs c^p / alpha; at 2 it separates exactly into
           localisation, missed and false
    dimensions: of the distance of centres: 2 in the bird's-eye view, 3 with the height
    Raises ValueError for invalid values.
    """

    c: float = 5.0
    p: float = 2.0
    alpha: float = 2.0
    dimensions: int = 2

    def __post_init__(self) -> None:
        if not self.c > 0.0:
            raise ValueError(f"c: found {self.c}, expected more than 0")
        if not 1.0 <= self.p < np.inf:
            raise ValueError(f"p: found {self.p}, expected 1 or more")
        if not 0.0 < self.alpha <= 2.0:
            raise ValueError(f"alpha: found {self.alpha}, expected more than 0, at most 2")
        check_dimensions(self.dimensions)

    def of(self, truth: Boxes, tracks: Boxes, n_groups: int) -> tuple[Floats, Floats]:
        """OSPA and GOSPA of every group, both (n_groups,) m; 0 for two empty sets.

        With X the smaller set of m and Y the larger of n objects, d the distance of centres, and the least sum S over
        one-to-one assignments of X into Y of min(d, c)^p:
        OSPA = ((S + c^p (n - m)) / n)^(1/p), GOSPA = (S + c^p / alpha (n - m))^(1/p).
        """
        truth, tracks = (boxes.sorted()[0] for boxes in (truth, tracks))
        counts = [np.bincount(boxes.group, minlength=n_groups) for boxes in (truth, tracks)]
        smaller, larger = np.minimum(*counts), np.maximum(*counts)
        cutoff = self.c**self.p
        saving = self._saving(truth, tracks, n_groups)
        ospa = np.divide(cutoff * larger - saving, larger, out=np.zeros(n_groups), where=larger > 0)
        gospa = cutoff * smaller - saving + cutoff / self.alpha * (larger - smaller)
        root = 1.0 / self.p
        return np.maximum(ospa, 0.0) ** root, np.maximum(gospa, 0.0) ** root

    def _saving(self, truth: Boxes, tracks: Boxes, n_groups: int) -> Floats:
        """Saving (n_groups,) m^p of the best assignment: c^p · m - S.

        The saving is over an assignment with all pairs c apart. Only pairs nearer than c contribute.
        """
        i, j = pairs_within(truth, tracks, self.c)
        distance = centre_distance(truth.position.take(i, 0), tracks.position.take(j, 0), self.dimensions)
        near = (distance < self.c).nonzero()[0]
        i, j = i.take(near), j.take(near)
        saving = self.c**self.p - distance.take(near) ** self.p
        chosen = min_cost_matching(i, j, -saving)
        return np.bincount(truth.group[i[chosen]], saving[chosen], minlength=n_groups).astype(np.float64)
