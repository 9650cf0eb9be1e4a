"""Points: the returns of one scan of a lidar, as a detector gets them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints

#: float32 columns: as exact as lidars are, in half the bytes of float64.
Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Points:
    """n returns of one scan.

    position:  (n, 3) float32, m, in the frame of the lidar at the time of the scan: its own motion is removed, that of
               the objects is not
    intensity: (n,) float32, 0 to 1; 1: a surface that reflects all light towards the lidar
    time_s:    (n,) float32, s, of each firing, from the time of the scan
    channel:   (n,) uint8, of the beam, from the lowest up

    No two returns have the same `time_s` and `channel`, except in recorded scans without them: there all are 0.
    """

    position: Singles
    intensity: Singles
    time_s: Singles
    channel: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.position)

    @classmethod
    def of(cls, position: Floats | Singles) -> Points:
        """Points at positions (n, 3) m, of which nothing else is known."""
        n, none = len(position), np.zeros(len(position), np.float32)
        return cls(np.asarray(position, np.float32).reshape(n, 3), none, none, np.zeros(n, np.uint8))

    @classmethod
    def empty(cls) -> Points:
        """No points."""
        return cls.of(np.zeros((0, 3)))

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """The points of several scans or parts of one, in their order."""
        parts = [cls.empty(), *parts]
        return cls(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)))

    @classmethod
    def from_columns(cls, columns: Mapping[str, NDArray[np.generic]]) -> Points:
        """The points of the columns of a message."""
        return cls(*(columns[each.name] for each in fields(cls)))  # type: ignore[arg-type]  # by name

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """The columns by name."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def select(self, rows: Bools | Ints | slice) -> Points:
        """The points selected by a mask, an index array or a slice."""
        return Points(*(getattr(self, each.name)[rows] for each in fields(self)))

    def read_only(self) -> Points:
        """The same points, whose columns cannot be written to."""
        points = self.select(slice(None))
        for column in points.columns().values():
            column.flags.writeable = False
        return points

    def turned(self, rotation: Floats) -> Points:
        """The same points in axes to which `rotation` (3, 3) turns from those that they are in."""
        return replace(self, position=self.position @ rotation.T.astype(np.float32))

    def range_m(self) -> Singles:
        """(n,) float32, m, from the lidar."""
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", self.position, self.position)))

    def keys(self) -> Ints:
        """(n,) int64, the same number for the same beam of two scans with the same timing."""
        return np.ascontiguousarray(self.time_s).view(np.int32).astype(np.int64) * 256 + self.channel
