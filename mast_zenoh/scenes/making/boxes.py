"""Boxes of objects over the frames of a scene, as readers collect them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import CLASSES, Floats, Ints
from mast_zenoh.errors import SceneError


@dataclass(frozen=True, eq=False)
class Boxes:
    """N boxes in the world frame, in any order.

    frame:    (N,) int64, row of the scene's frames
    id:       (N,) int64, 0 or more, the same in all frames of an object
    position: (N, 3) m, middle of the box
    size:     (N, 3) m, length, width, height
    yaw:      (N,) rad
    class_id: (N,) uint8, index into CLASSES
    velocity: (N, 3) m/s; rows of NaN are computed from the positions
    """

    frame: Ints
    id: Ints
    position: Floats
    size: Floats
    yaw: Floats
    class_id: NDArray[np.uint8]
    velocity: Floats

    def __len__(self) -> int:
        return len(self.id)

    def select(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Boxes:
        """The boxes of the given rows, in that order."""
        return Boxes(*(getattr(self, field.name)[rows] for field in fields(self)))

    def rows_of(self, number: int) -> NDArray[np.intp]:
        """The rows of one object, in the order of the frames."""
        rows = np.flatnonzero(self.id == number)
        return rows[np.argsort(self.frame[rows], kind="stable")]

    def rows_by_frame(self, frames: int) -> list[NDArray[np.intp]]:
        """For each frame the rows of its boxes, by id."""
        order = np.lexsort((self.id, self.frame))
        return np.split(order, np.searchsorted(self.frame[order], np.arange(1, frames)))

    @classmethod
    def throughout(cls, number: int, position: Floats, size: Floats, yaw: Floats, class_id: int) -> Boxes:
        """Boxes of one object in all F frames.

        number: its id; position: (F, 3) m, middle; size: (3,) m l w h; yaw: (F,) rad
        """
        frames = len(position)
        return cls(
            frame=np.arange(frames),
            id=np.full(frames, number, np.int64),
            position=position,
            size=np.tile(size, (frames, 1)),
            yaw=yaw,
            class_id=np.full(frames, class_id, np.uint8),
            velocity=np.full((frames, 3), np.nan),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Boxes]) -> Boxes:
        """All boxes of the parts, in order."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def validate(self, name: str, frames: int) -> None:
        """Raise SceneError for the first box that cannot be.

        name: of the scene, for the message; frames: how many it has
        """
        n = len(self.id)
        for field, width in (("position", 3), ("size", 3), ("velocity", 3), ("frame", 0), ("yaw", 0), ("class_id", 0)):
            shape, expected = getattr(self, field).shape, (n, width) if width else (n,)
            if shape != expected:
                raise SceneError(f"{name}: {field} of the boxes has shape {shape}, expected {expected}")
        for field, invalid, expectation in (
            ("frame", (self.frame < 0) | (self.frame >= frames), f"0 to {frames - 1}"),
            ("id", self.id < 0, "0 or more"),
            ("position", ~np.isfinite(self.position).all(axis=1), "finite numbers"),
            ("size", ~(np.isfinite(self.size) & (self.size > 0)).all(axis=1), "finite numbers above 0"),
            ("yaw", ~np.isfinite(self.yaw), "a finite number"),
            ("velocity", np.isinf(self.velocity).any(axis=1), "finite numbers, or NaN"),
            ("class_id", self.class_id >= len(CLASSES), f"0 to {len(CLASSES) - 1}"),
        ):
            if invalid.any():
                row = int(np.flatnonzero(invalid)[0])
                place = f"frame {self.frame[row]}, object {self.id[row]}"
                raise SceneError(f"{name}: {place}: {field} is {getattr(self, field)[row]}, expected {expectation}")
        order = np.lexsort((self.id, self.frame))
        repeated = np.flatnonzero((np.diff(self.frame[order]) == 0) & (np.diff(self.id[order]) == 0))
        if len(repeated):
            row = order[repeated[0]]
            raise SceneError(
                f"{name}: frame {self.frame[row]}, object {self.id[row]}: found two boxes, expected one at most"
            )
