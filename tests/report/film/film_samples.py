"""The frames of the runs of which tests make films, their figures, and rows of their tables."""

import io
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet

from mast_zenoh.show.film.sheet import Sheet
from mast_zenoh.show.film.takes import Look
from mast_zenoh.show.film.writing import open_takes

#: Number of frames of the attacked run, and the first one under attack.
FRAMES, ATTACK = 30, 8


def sheet_of(run: Path, look: Look | None = None, against: Path | None = None, frames: range | None = None) -> Sheet:
    """The figure of a film of all frames."""
    look = look or Look()
    takes = open_takes(run, look, against)
    frames = frames or range(takes[0].first, takes[0].last + 1)
    return Sheet(takes, look, frames, (frames[0], frames[-1]))


def images(sheet: Sheet, frames: Iterable[int]) -> Iterator[np.ndarray]:
    """(height, width, 3) red, green and blue of some frames, drawn as for a film."""
    width, height = (round(inches * sheet.figure.dpi) for inches in sheet.figure.get_size_inches())
    for frame in frames:
        sheet.show(frame)
        file = io.BytesIO()
        sheet.figure.savefig(file, format="rgba")
        yield np.frombuffer(file.getvalue(), np.uint8).reshape(height, width, 4)[..., :3]


def rows_of(run: Path, table: str, **values: object) -> list[dict[str, object]]:
    """Rows of a table of the run with these values."""
    content = pyarrow.parquet.read_table(run / f"{table}.parquet").to_pylist()
    return [row for row in content if all(row[name] == value for name, value in values.items())]
