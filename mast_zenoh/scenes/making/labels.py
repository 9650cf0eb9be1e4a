"""Labelled boxes of a data set, collected one by one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.elements import Element
from mast_zenoh.scenes.files.matrices import MAX_COORDINATE_M
from mast_zenoh.scenes.making.boxes import Boxes

#: Limits on one scene: a single object, and all of its boxes.
MAX_SIZE_M = 200.0
MAX_BOXES = 5_000_000


def read_point(element: Element) -> Floats:
    """(3,) m, of a list of coordinates."""
    return np.array([value.number(-MAX_COORDINATE_M, MAX_COORDINATE_M) for value in element.elements(3)])


def read_size(element: Element) -> Floats:
    """(3,) m, of a list of length, width and height."""
    size = element.size()
    if size.max() > MAX_SIZE_M:
        element.fail(f"3 numbers above 0, at most {MAX_SIZE_M:g}")
    return size


class Labels:
    """Boxes in the world frame, of tracks that the data set names by text.

    path: of the file or folder that they are from, for messages
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tracks: list[str] = []
        self._frames: list[int] = []
        self._positions: list[Floats] = []
        self._sizes: list[Floats] = []
        self._yaws: list[float] = []
        self._classes: list[int] = []

    def add(self, frame: int, track: str, position: Floats, size: Floats, yaw: float, class_id: int) -> None:
        """Add a box. Raises SceneError if there are too many.

        frame: row of the scene's frames; position: (3,) m, middle of the box; size: (3,) m l w h; yaw: rad
        """
        if len(self._tracks) >= MAX_BOXES:
            raise SceneError(f"{self._path}: found more than {MAX_BOXES} boxes, expected at most that many")
        self._tracks.append(track)
        self._frames.append(frame)
        self._positions.append(position)
        self._sizes.append(size)
        self._yaws.append(yaw)
        self._classes.append(class_id)

    def boxes(self, others: Iterable[str] = ()) -> tuple[Boxes, dict[str, int]]:
        """All boxes, and the id of each track. others: tracks without boxes that need an id, too

        If all names are whole numbers, these are the ids; otherwise tracks are numbered from 1, in the order of their
        names.
        """
        names = sorted({*self._tracks, *others})
        numbers = [int(name) for name in names if len(name) <= 15 and name.isascii() and name.isdigit()]
        keep = len(numbers) == len(names) == len(set(numbers))
        ids = dict(zip(names, numbers if keep else range(1, len(names) + 1), strict=True))
        n = len(self._tracks)
        return Boxes(
            frame=np.array(self._frames, np.int64),
            id=np.array([ids[track] for track in self._tracks], np.int64),
            position=np.array(self._positions).reshape(n, 3),
            size=np.array(self._sizes).reshape(n, 3),
            yaw=np.array(self._yaws, np.float64),
            class_id=np.array(self._classes, np.uint8),
            velocity=np.full((n, 3), np.nan),
        ), ids
