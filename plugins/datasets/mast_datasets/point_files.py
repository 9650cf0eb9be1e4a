"""Reads the points of lidars from BIN and PCD files, and from columns of any format."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_datasets.files import read_pieces
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.recorded_scans import MAX_POINTS, RecordedScans
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Points

#: m: no lidar reaches further.
MAX_RANGE_M = 10_000.0
#: Limit on the numbers of a point.
MAX_FIELDS = 100
_BIN = np.dtype("<f4")
_BIN_COLUMNS = 4  # x, y, z, intensity
#: Limits on a PCD file and its header, bytes.
_MAX_PCD_BYTES, _MAX_HEADER = 200 * MAX_POINTS, 10_000
_MAX_RATIO = 100  # of bytes by the header to bytes in the file; LZF reaches 88, and a number in text has two characters
#: Names that drivers give to intensities, times and channels.
_NAMES = (("intensity", "i", "reflectivity"), ("t", "time", "time_stamp"), ("ring", "channel", "line"))
_MAX_TIME_S = 1.0  # from the time of the scan; larger ones are no firing times


def read_bin(path: Path) -> Points:
    """The points of a KITTI file: x, y, z, m, and intensity, 0 to 1, float32 each. It has no times and channels: all 0.

    Raises SceneError for a file that is missing, cut off or too large, and for numbers that cannot be.
    """
    row = _BIN_COLUMNS * _BIN.itemsize
    try:
        size = path.stat().st_size
        if not path.is_file():  # a pipe would be waited for
            raise OSError("not a regular file")
        if size % row or size > MAX_POINTS * row:
            expected = f"expected {row} for each point (x, y, z, intensity in float32), at most {MAX_POINTS} points"
            raise SceneError(f"{path}: found {size} bytes, {expected}")
        values = np.fromfile(path, _BIN).reshape(-1, _BIN_COLUMNS)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from error
    return checked(replace(Points.of(values[:, :3]), intensity=values[:, 3]), path)


def read_pcd(path: Path) -> Points:
    """The points of a PCD file (Point Cloud Library) as text, binary or compressed, with fields x, y and z.

    Times, channels and intensities are read, too. Intensities are of 255 if some are above 1; without a column of them,
    the red of `rgb` is taken, as Open3D writes it.

    Raises SceneError for a file that is missing, cut off or too large, for a header that its data contradict, and for
    numbers that cannot be; ConfigurationError if pypcd4 is not installed.
    """
    try:
        from pypcd4.pypcd4 import Encoding, MetaData, PointCloud  # takes 0.1 s, and few need it
    except ModuleNotFoundError as error:
        missing = f"{error.name} is not installed, expected pip install 'mast-zenoh-datasets[pcd]'"
        raise ConfigurationError(f"{path}: {missing}") from None
    head, mark, rest = b"".join(read_pieces(path, _MAX_PCD_BYTES)).partition(b"\nDATA ")
    kind, _, data = rest.partition(b"\n")
    if not mark or len(head) + len(kind) > _MAX_HEADER:
        raise SceneError(f"{path}: found no line DATA in {_MAX_HEADER} bytes, expected the header of a PCD file")
    place = "header"
    try:
        header = MetaData.parse_header([*head.decode().split("\n"), f"DATA {kind.decode()}"])
        count, several = header.points, sum(header.count)
        if count > MAX_POINTS or count != header.width * header.height or several > MAX_FIELDS:
            found = f"{count} points in {header.height} rows of {header.width}, {several} numbers each"
            raise ValueError(f"found {found}, expected at most {MAX_POINTS} points of {MAX_FIELDS}")
        place, size = "data", count * header.build_dtype().itemsize
        is_compressed = header.data not in (Encoding.ASCII, Encoding.BINARY)
        if size > _MAX_RATIO * len(data) or (is_compressed and count and data[4:8] != size.to_bytes(4, "little")):
            raise ValueError(f"found {len(data)} bytes, expected {size} of {count} points, or as many unpacked")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # The header that has been checked, so that the data alone are from the file.
            file: Any = BytesIO(header.compose_header().encode() + data)
            cloud = PointCloud.from_fileobj(file)
        rows = np.atleast_1d(cloud.pc_data)
        if len(rows) != count:
            raise ValueError(f"found {len(rows)} points, expected {count}")
    except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, Warning) as error:
        raise SceneError(f"{path}: {place}: {' '.join(str(error).split()):.300}") from error
    values = {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()}
    if "rgb" in values and values["rgb"].itemsize == 4:
        values.setdefault("intensity", values["rgb"].view(np.uint32) >> 16 & 255)
    bright = bool((values.get("intensity", np.zeros(0)) > 1).any())
    return points_of_columns(values, path, 255.0 if bright else 1.0)


@np.errstate(over="ignore", invalid="ignore")
def points_of_columns(values: Mapping[str, NDArray[Any]], place: object, most_intensity: float) -> Points:
    """The points of columns (n,) by name, without those at 0, 0, 0 and those that are no numbers, which are no returns.

    place: of them, for messages;  most_intensity: becomes 1, as do all above

    Times are s if floating point, else ns. Times and channels are kept together, or neither.

    Raises SceneError for numbers that cannot be.
    """
    for axis in "xyz":
        if axis not in values or values[axis].dtype.kind != "f":
            named = ", ".join(f"{name} ({column.dtype})" for name, column in values.items())
            raise SceneError(f"{place}: found the fields {named or 'none'}, expected x, y and z of floating point")
    position = np.stack([values[axis].astype(np.float32) for axis in "xyz"], axis=1)
    kept = np.isfinite(position).all(axis=1) & position.any(axis=1)
    none = np.zeros(len(position), np.float32)
    share, time_s, channel = (next((values[n] for n in names if n in values), none)[kept] for names in _NAMES)
    share = np.clip(share / most_intensity, 0.0, 1.0).astype(np.float32)
    time_s = (time_s * (1.0 if time_s.dtype.kind == "f" else 1e-9)).astype(np.float32)
    known = bool(time_s.any() and (np.abs(time_s) <= _MAX_TIME_S).all() and ((channel >= 0) & (channel < 256)).all())
    if not known:
        time_s = channel = none[kept]
    return checked(Points(position[kept], share, time_s, channel.astype(np.uint8)), place)


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


@dataclass(kw_only=True, eq=False)
class PointFiles:
    """Base class of scenes with files of points, one for each agent and frame.

    recorded_points: whether the points that lidars recorded are read: a scenario with `points` detects objects in them
    """

    recorded_points: bool = False

    def with_points(
        self, recording: Recording, place: Path, *files: Iterable[Path], read: Callable[[Path], Points] = read_pcd
    ) -> Recording:
        """The recording, with the points in the files of its first agents if they are wanted.

        place: of the files, for messages;  files: of an agent, one for each frame, and perhaps more
        """
        if not self.recorded_points:
            return recording
        frames = len(recording)
        scans = {row: map(read, islice(of_agent, frames)) for row, of_agent in enumerate(files)}
        return replace(recording, scans=RecordedScans.of(place, frames, len(recording.agents), scans))
