"""Still objects beside the ways of road users, which no agent reports: hedges, signs and poles, and kerbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.sensing.raycast import Walls

#: What stands beside roads, `StillObjects.kind`. A sign is two objects: its plate and its post.
KINDS = ("hedge", "sign", "post", "pole")
#: By kind: share of light that is reflected (trees: Wehr and Lohr 1999, table 1; others assumed).
_REFLECTIVITY = (0.6, 1.0, 0.3, 0.3)
#: m, (l, w, h) from and to, and of the lower edge above the ground: usual sizes, assumed; in the order of placement.
_SIZES = {
    "hedge": ((3.0, 0.6, 0.8), (12.0, 1.5, 2.2), 0.0),
    "kerb": ((6.0, 0.15, 0.1), (25.0, 0.3, 0.15), 0.0),
    "sign": ((0.05, 0.6, 0.6), (0.05, 0.9, 0.9), 2.0),
    "pole": ((0.15, 0.15, 5.0), (0.25, 0.25, 8.0), 0.0),
}
_ROW = {name: row for row, name in enumerate((*KINDS, "kerb"))}
_POST_M = 0.08
#: Attempts to find a place; m, from a way to the farthest place; m, around a point whose neighbours show the way.
_TRIES, _BESIDE_M, _AROUND_M = 30, 8.0, 6.0
#: m, side of cells whose points of what moves become one.
_CELL_M = 0.5


class StillObjects(NamedTuple):
    """n boxes that stand on the ground or hang above it, and kerbs.

    position: (n, 3) m, middle, world frame;  size: (n, 3) m;  yaw: (n,) rad;  kind: (n,) rows of KINDS
    reflectivity: (n,) 0 to 1;  kerbs: as low walls
    """

    position: Floats
    size: Floats
    yaw: Floats
    kind: Ints
    reflectivity: Floats
    kerbs: Walls


@dataclass(kw_only=True, eq=False)
class Clutter:
    """Places still objects near what moves, along its ways, where they never touch it or a building.

    Ways are those of the frames that are played, so runs of other lengths have other clutter.

    hedges, kerbs, signs, poles: how many, 0 to 1000; fewer where there is no room
    gap_m: m, at least, to what moves and to buildings

    Raises ValueError for a number that is not as described.
    """

    hedges: int = 12
    kerbs: int = 16
    signs: int = 8
    poles: int = 12
    gap_m: float = 0.4

    def __post_init__(self) -> None:
        counts = dict(hedges=self.hedges, kerbs=self.kerbs, signs=self.signs, poles=self.poles)
        check("a whole number", **counts)
        check("0 to 1000", **counts)
        check("0 or more, finite", gap_m=self.gap_m)

    def place(
        self,
        occupied: Floats,
        radius: Floats,
        buildings: Sequence[Floats],
        extent: Floats,
        random: np.random.Generator,
        ground_m: float = 0.0,
    ) -> StillObjects:
        """The still objects of a scene; the same for the same arguments.

        occupied: (k, 2) m, where objects and agents are at any time, and the radius (k,) m that each takes up
        buildings: outlines, each (c, 2) m;  extent: (2, 2) m, the lowest and the highest x and y
        """
        ways, reach = _sparse(occupied, radius)
        area = _FreeArea(ways, reach + self.gap_m, buildings, self.gap_m, extent)
        placed: list[tuple[float, ...]] = []
        counts = (self.hedges, self.kerbs, self.signs, self.poles)
        for (name, (least, most, above)), count in zip(_SIZES.items(), counts, strict=True):
            for _ in range(count if len(ways) else 0):
                size = random.uniform(least, most)
                if (pose := area.find(size, random)) is not None:
                    (x, y), yaw = pose
                    placed.append((x, y, ground_m + above + size[2] / 2, *size, yaw, _ROW[name]))
                    if name == "sign":
                        placed.append((x, y, ground_m + above / 2, _POST_M, _POST_M, above, yaw, _ROW["post"]))
        columns = np.array(placed, np.float64).reshape(-1, 8)
        is_kerb = columns[:, 7] == _ROW["kerb"]
        boxes, kerbs = columns[~is_kerb], columns[is_kerb]
        half = kerbs[:, 3:4] / 2 * np.stack([np.cos(kerbs[:, 6]), np.sin(kerbs[:, 6])], axis=1)
        walls = Walls(kerbs[:, :2] - half, kerbs[:, :2] + half, ground_m + kerbs[:, 5])
        kind = boxes[:, 7].astype(np.int64)
        return StillObjects(boxes[:, :3], boxes[:, 3:6], boxes[:, 6], kind, np.array(_REFLECTIVITY)[kind], walls)


def _sparse(occupied: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """One point for all of a cell, and a radius around it that contains all that they take up."""
    cells, of = np.unique(np.floor(occupied / _CELL_M), axis=0, return_inverse=True)
    largest = np.zeros(len(cells))
    np.maximum.at(largest, of.reshape(-1), radius)
    return (cells + 0.5) * _CELL_M, largest + _CELL_M / np.sqrt(2.0)


class _FreeArea(NamedTuple):
    """Where there may be still objects: away from discs around `ways` and from buildings, within an extent."""

    ways: Floats
    reach: Floats
    buildings: Sequence[Floats]
    gap_m: float
    extent: Floats

    def find(self, size: Floats, random: np.random.Generator) -> tuple[Floats, float] | None:
        """A free place (2,) m and yaw for a box; every attempt draws as many random numbers."""
        for _ in range(_TRIES):
            row = int(random.integers(len(self.ways)))
            aside, angle = random.uniform(-1.0, 1.0), random.uniform(0.0, np.pi)
            here = self.ways[row]
            near = self.ways[np.abs(self.ways - here).max(axis=1) < _AROUND_M] - here
            if len(near) > 1:  # along the way
                x, y = near.T
                angle = 0.5 * np.arctan2(2.0 * np.sum(x * y), np.sum(x * x) - np.sum(y * y))
            away = self.reach[row] + size[1] / 2 + abs(aside) * _BESIDE_M
            position = here + np.copysign(away, aside) * np.array([-np.sin(angle), np.cos(angle)])
            if self._free(position, size, angle):
                return position, float(angle)
        return None

    def _free(self, position: Floats, size: Floats, yaw: float) -> bool:
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        corners = position + np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * size[:2] / 2 @ turn.T
        if (corners < self.extent[0]).any() or (corners > self.extent[1]).any():
            return False
        beyond = np.maximum(np.abs((self.ways - position) @ turn) - size[:2] / 2, 0.0)
        if (np.hypot(*beyond.T) < self.reach).any():
            return False
        return not any(self._meets(outline, position, size, turn) for outline in self.buildings)

    def _meets(self, outline: Floats, position: Floats, size: Floats, turn: Floats) -> bool:
        """Whether a box, larger by the gap, meets an outline or is in it."""
        start = (outline - position) @ turn
        span = np.roll(start, -1, axis=0) - start
        half = size[:2] / 2 + self.gap_m
        slope = np.where(np.abs(span) < 1e-12, 1e-12, span)
        one, other = (-half - start) / slope, (half - start) / slope  # slabs: where an edge enters and leaves the box
        enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
        crosses = (start[:, 1] > 0.0) != (start[:, 1] + span[:, 1] > 0.0)  # of a ray along x from the middle
        ahead = start[:, 0] - start[:, 1] * span[:, 0] / slope[:, 1] > 0.0
        return bool((np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)).any() or (crosses & ahead).sum() % 2)
