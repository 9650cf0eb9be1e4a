"""Matching of tracks and truth objects for all frames at once: one-to-one pairs, and distances between sets.

Boxes and positions of many frames: pairs, nearest neighbours, overlap, and look-up of rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes, intersection_area
from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.matching import greedy_matching, min_cost_matching
from mast_zenoh.arrays.states import Bools, Floats, Ints, row_order, within_runs
from mast_zenoh.kernels import kernel


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
        check("more than 0", gate_m=gate_m)
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
        check("more than 0", c=self.c)
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


def pairs_within(a: Boxes | Places, b: Boxes | Places, radius: float) -> tuple[Ints, Ints]:
    """Rows (i, j) of all pairs in a group at most `radius` m apart.

    The distance is between centres in the bird's-eye view. Sorted by i, then j. Rounding may add slightly more
    distant pairs: callers apply their own limit.
    """
    if len(a) == 0 or len(b) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return pairs_in_groups(a.group, a.position, b.group, b.position, radius)


@kernel
def pairs_in_groups(
    a_group: Ints, a_position: Floats, b_group: Ints, b_position: Floats, radius: float
) -> tuple[Ints, Ints]:
    """Nearby pairs as in `pairs_within`; neither side is empty."""
    # Groups are placed side by side along x, farther apart than the radius: for each box of `a` the candidates are a
    # range of the boxes of `b`, sorted by x.
    x = [a_position[:, 0], b_position[:, 0]]
    x_min = min(x[0].min(), x[1].min())
    span = max(x[0].max(), x[1].max()) - x_min + 2.0 * radius + 1.0
    key = [(group * span) + (at - x_min) for group, at in zip((a_group, b_group), x, strict=True)]
    limit = radius * (1.0 + 1e-9) + 1e-9 + 1e-15 * span * float(max(a_group.max(), b_group.max()) + 1)
    by_x = np.argsort(key[1], kind="stable")
    sorted_key = key[1][by_x]
    first = np.searchsorted(sorted_key, key[0] - limit, side="left")
    count = np.searchsorted(sorted_key, key[0] + limit, side="right") - first
    i = np.repeat(np.arange(len(a_group)), count)
    j = by_x[within_runs(count) + np.repeat(first, count)]
    near = np.abs(a_position[i, 1] - b_position[j, 1]) <= limit
    i, j = i[near], j[near]
    near = (a_group[i] == b_group[j]) & (centre_distance(a_position[i], b_position[j]) <= limit)
    i, j = i[near], j[near]
    order = row_order(j, i)
    return i[order], j[order]


def centre_distance(a: Floats, b: Floats, dimensions: int = 2) -> Floats:
    """Distance (n,) m between positions (n, 3): 2 in the bird's-eye view, 3 with the height."""
    ground: Floats = np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1])
    return ground if dimensions == 2 else np.hypot(ground, a[:, 2] - b[:, 2])


def check_dimensions(dimensions: int) -> int:
    """The dimensions of a distance; raises ValueError unless 2 or 3."""
    if dimensions not in (2, 3):
        raise ValueError(f"dimensions: found {dimensions}, expected 2 (bird's-eye view) or 3")
    return dimensions


def iou_3d(a: Boxes, b: Boxes) -> Floats:
    """Volume intersection over union (n,), 0 to 1, of box i of `a` and box i of `b`.

    Groups are ignored.
    The intersection is the exact area of the overlap of the rotated rectangles seen from above, times the overlap
    of the heights.
    """
    top = np.minimum(a.position[:, 2] + a.size[:, 2] / 2.0, b.position[:, 2] + b.size[:, 2] / 2.0)
    bottom = np.maximum(a.position[:, 2] - a.size[:, 2] / 2.0, b.position[:, 2] - b.size[:, 2] / 2.0)
    intersection = birdseye_intersection(a, b) * np.maximum(top - bottom, 0.0)
    union = a.size.prod(axis=1) + b.size.prod(axis=1) - intersection
    iou: Floats = np.divide(intersection, union, out=np.zeros(len(a)), where=union > 0.0)
    return iou


def birdseye_intersection(a: Boxes, b: Boxes) -> Floats:
    """(n,) m^2: intersection area of the outlines of box i of `a` and box i of `b`.

    See `mast_zenoh.arrays.boxes`.
    """
    return intersection_area((b.position - a.position)[:, :2], a.size, a.yaw, b.size, b.yaw)


@dataclass(frozen=True, slots=True)
class Places:
    """n positions, which are never paired between groups.

    group: (n,) int64; position: (n, 3) m, world frame
    """

    group: Ints
    position: Floats

    def __len__(self) -> int:
        return len(self.group)

    @classmethod
    def of_rows(
        cls, table: Mapping[str, NDArray[Any]], rows: Bools | Ints | slice = slice(None), when: str = ""
    ) -> Places:
        """By frame, x and y, at z = 0, of some rows of a table. when: prefix of the columns, such as "after_"."""
        x, y = (np.asarray(table[f"{when}{axis}"][rows], np.float64) for axis in "xy")
        return cls(np.asarray(table["frame"][rows], np.int64), np.stack([x, y, np.zeros(len(x))], axis=1))


def nearest(places: Places, among: Places, radius: float) -> tuple[Ints, Floats]:
    """Nearest row of `among` in the group of each of n positions, and its distance m.

    The distance is that in the bird's-eye view. -1 and inf if none is within `radius` m.
    """
    row, distance = np.full(len(places.group), -1, np.int64), np.full(len(places.group), np.inf)
    i, j = pairs_within(places, among, radius)
    pair_distance = centre_distance(places.position[i], among.position[j])
    order = np.lexsort((j, pair_distance, i))
    first = np.ones(len(i), bool)
    first[1:] = np.diff(i[order]) != 0
    best = order[first]
    row[i[best]], distance[i[best]] = j[best], pair_distance[best]
    return row, distance


#: Limit of combined codes, so that they fit int64.
_MAX_CODE = 1 << 62


def find(keys: tuple[Ints, ...], among: tuple[Ints, ...]) -> Ints:
    """For each row of the columns `keys`, the last equal row of `among` (n,); -1: none."""
    n = len(keys[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip(keys, among, strict=True)])
    key_codes, among_codes = codes[:n], codes[n:]
    order = among_codes.argsort(kind="stable")
    row = order[np.searchsorted(among_codes[order], key_codes, side="right") - 1]
    return np.where(among_codes[row] == key_codes, row, -1)


def _codes(columns: Sequence[Ints]) -> Ints:
    """A number for each row of integer `columns` (n,), equal only for equal rows."""
    code, size = np.zeros(len(columns[0]), np.int64), 1
    for column in columns:
        low = int(column.min())
        span = int(column.max()) - low + 1
        if size * span > _MAX_CODE:  # too large a range to combine: use ranks instead
            low, span, column = 0, len(column), np.unique(column, return_inverse=True)[1]
            size, code = len(code), np.unique(code, return_inverse=True)[1]
        code = code * span + (column - low)
        size *= span
    return code


def occurs(keys: tuple[Ints, ...], among: tuple[Ints, ...]) -> Bools:
    """Whether each row of the columns `keys` is a row of `among` (n,)."""
    return np.asarray(find(keys, among) >= 0)


def latest(keys: tuple[Ints, ...], until: Ints, among: tuple[Ints, ...], when: Ints) -> Ints:
    """Latest equal row of `among` for each row of the columns `keys`; -1: none.

    Rows count if `when` <= `until` (n,).
    """
    n = len(keys[0])
    if n == 0 or len(among[0]) == 0:
        return np.full(n, -1, np.int64)
    codes = _codes([np.concatenate(both) for both in zip((*keys, until), (*among, when), strict=True)])
    key_codes, among_codes = codes[:n], codes[n:]
    order = among_codes.argsort(kind="stable")
    row = order[np.maximum(np.searchsorted(among_codes[order], key_codes, side="right") - 1, 0)]
    same = when[row] <= until
    for column, among_column in zip(keys, among, strict=True):
        same &= among_column[row] == column
    return np.where(same, row, -1)
