"""Matching of tracks and truth objects for all frames at once: one-to-one pairs, and distances between sets."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.matching import greedy_matching, min_cost_matching
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.boxes import centre_distance, check_dimensions, iou_3d, pairs_within


class Assigner(ABC):
    """Pairs truth objects with tracks."""

    #: of the distance between the centres of a pair, which the RMSE is of: 2 in the bird's-eye view, 3 with the height
    dimensions: int = 2

    def assign(self, truth: Boxes, tracks: Boxes) -> Ints:
        """(m, 2) int64: matched rows of `truth` and of `tracks`, sorted by the former.

        Only boxes of one group are paired, each at most once. The pairs do not depend on the order of the rows.
        """
        if len(truth) == 0 or len(tracks) == 0:
            return np.zeros((0, 2), np.int64)
        (truth, truth_rows), (tracks, track_rows) = truth.sorted(), tracks.sorted()
        i, j = self._assign(truth, tracks)
        pairs = np.column_stack([truth_rows[i], track_rows[j]])
        return pairs[np.argsort(pairs[:, 0])]

    @abstractmethod
    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        """Rows of the pairs; both sides are sorted (`Boxes.sorted`) and not empty."""


class CenterDistanceAssigner(Assigner):
    """Optimal assignment on centre distance.

    gate_m: maximum distance between the centres of a pair
    dimensions: of that distance: 2 in the bird's-eye view, 3 with the height, so that an object at a false height is
        missed, and its track false

    Finds the most pairs within `gate_m` and, among these matchings, the least total distance. Equivalent to the
    Hungarian method on the cost matrix of each frame with prohibitive costs beyond the gate, but applied only to
    objects and tracks that compete.
    """

    def __init__(self, *, gate_m: float = 2.0, dimensions: int = 2) -> None:
        if not gate_m > 0.0:
            raise ValueError(f"gate_m: found {gate_m}, expected more than 0")
        self.gate_m = gate_m
        self.dimensions = check_dimensions(dimensions)

    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        i, j = pairs_within(truth, tracks, self.gate_m)
        distance = centre_distance(truth.position.take(i, 0), tracks.position.take(j, 0), self.dimensions)
        near = (distance <= self.gate_m).nonzero()[0]
        i, j, distance = i.take(near), j.take(near), distance.take(near)
        # The bonus of a pair exceeds any possible difference in distance, so that more pairs always win.
        max_pairs = min(np.bincount(boxes.group).max() for boxes in (truth, tracks))
        chosen = min_cost_matching(i, j, distance - (self.gate_m * (max_pairs + 1) + 1.0))
        return i[chosen], j[chosen]


class IoU3DGreedyAssigner(Assigner):
    """Greedy assignment on 3D overlap, best pair first, down to `threshold`.

    threshold: minimum intersection over union of a pair, 0 to 1
    """

    def __init__(self, *, threshold: float = 0.3) -> None:
        if not 0.0 < threshold <= 1.0:
            raise ValueError(f"threshold: found {threshold}, expected more than 0, at most 1")
        self.threshold = threshold

    def _assign(self, truth: Boxes, tracks: Boxes) -> tuple[Ints, Ints]:
        radius = [np.hypot(boxes.size[:, 0], boxes.size[:, 1]) / 2.0 for boxes in (truth, tracks)]
        i, j = pairs_within(truth, tracks, float(radius[0].max() + radius[1].max()))
        touching = centre_distance(truth.position[i], tracks.position[j]) <= radius[0][i] + radius[1][j]
        i, j = i[touching], j[touching]
        iou = iou_3d(truth.select(i), tracks.select(j))
        overlapping = iou >= self.threshold
        i, j = i[overlapping], j[overlapping]
        chosen = greedy_matching(i, j, -iou[overlapping])
        return i[chosen], j[chosen]


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
