"""One-to-one matching of tracks and truth objects, for all frames at once."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, min_cost_matching
from mast_zenoh.arrays.states import Ints
from mast_zenoh.metrics.boxes import Boxes, centre_distance, check_dimensions, pairs_within
from mast_zenoh.metrics.overlap import iou_3d


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
