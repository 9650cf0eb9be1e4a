"""Reads the points of lidars: of files, and of the bytes of messages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.recorded_scans import MAX_POINTS
from mast_zenoh.sensing import Points

#: m: no lidar reaches further.
MAX_RANGE_M = 10_000.0
_BIN = np.dtype("<f4")
_BIN_COLUMNS = 4  # x, y, z, intensity


def read_bin(path: Path) -> Points:
    """The points of a file of KITTI: x, y, z, m, and intensity, 0 to 1, float32 each. What else is known of none is 0.

    Raises SceneError for a file that is missing, cut off or too large, and for numbers that cannot be.
    """
    row = _BIN_COLUMNS * _BIN.itemsize
    try:
        size = path.stat().st_size
        if size % row or size > MAX_POINTS * row:
            expected = f"expected {row} for each point (x, y, z, intensity in float32), at most {MAX_POINTS} points"
            raise SceneError(f"{path}: found {size} bytes, {expected}")
        values = np.fromfile(path, _BIN).reshape(-1, _BIN_COLUMNS)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from error
    return checked(replace(Points.of(values[:, :3]), intensity=values[:, 3]), path)


def checked(points: Points, place: object) -> Points:
    """The points, ordered by firing, then by channel.

    place: of them, for messages. Raises SceneError for the first number that cannot be.
    """
    for name, values, least, most in (
        ("x, y, z", points.position, -MAX_RANGE_M, MAX_RANGE_M),
        ("intensity", points.intensity[:, None], 0.0, 1.0),
    ):
        invalid = ~((values >= least) & (values <= most)).all(axis=1)  # so is NaN
        if invalid.any():
            row = int(invalid.argmax())
            found = f"found {values[row].tolist()}, expected numbers from {least:g} to {most:g}"
            raise SceneError(f"{place}: point {row}: {name}: {found}")
    return points.select(np.lexsort((points.channel, points.time_s)))
