"""What the footers of Parquet files say, also of damaged ones.

Arrow ends the process when it is asked about a column of some damaged footers: its C++ code throws where Python cannot
catch. So the columns of row groups are read here. Source: parquet.thrift of Apache Parquet.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from mast_zenoh.run_folder.thrift import read_struct

#: Limits on a footer: its bytes, and its lists of row groups and of columns.
MAX_FOOTER_BYTES, MAX_LIST = 8_000_000, 100_000

# Fields of FileMetaData, RowGroup, ColumnChunk, ColumnMetaData and Statistics.
_GROUPS = 4
_CHUNKS, _N_ROWS = 1, 3
_OF_CHUNK = 3
_KIND, _PATH, _N_VALUES, _PACKED_BYTES, _FIRST_DATA, _DICTIONARY, _STATISTICS = 1, 3, 5, 7, 9, 11, 12
_MOST, _LEAST = 5, 6
#: Bytes of numbers, by the number of their type.
_WIDTHS = {1: 4, 2: 8}


class Chunk(NamedTuple):
    """A column in a row group.

    name: with those that it is in, joined by dots
    first_byte: of its pages in the file, 0 or less: it has none;  n_bytes: that they take
    least, most: of its values, if they are integers; NaN: not known
    """

    name: str
    n_values: int
    first_byte: int
    n_bytes: int
    least: float
    most: float


class Group(NamedTuple):
    """A row group. chunks: of its columns, in their order"""

    n_rows: int
    chunks: tuple[Chunk, ...]


class Footer(NamedTuple):
    """What a file says about itself. metadata: as Arrow knows it, to read the file with"""

    metadata: Any
    groups: tuple[Group, ...]

    def extents(self, column: str) -> NDArray[np.float64]:
        """(2, groups) the least and the largest number of a column; NaN: not known."""
        found = [[chunk[-2:] for chunk in group.chunks if chunk.name == column] for group in self.groups]
        return np.array([each[0] if each else (np.nan, np.nan) for each in found], np.float64).reshape(-1, 2).T


def read_footer(path: Path) -> Footer:
    """Read the footer of a file; raises OSError or ArrowException if it is broken or too large."""
    with parquet.ParquetFile(path, thrift_container_size_limit=MAX_LIST) as file:
        metadata = file.metadata
        names = [file.schema.column(index).path for index in range(len(file.schema))]
    with path.open("rb") as raw:
        n_bytes = raw.seek(-8, os.SEEK_END)
        size = int.from_bytes(raw.read(4), "little")
        if size > MAX_FOOTER_BYTES:
            raise pyarrow.ArrowInvalid(f"found a footer of {size} bytes, expected at most {MAX_FOOTER_BYTES}")
        raw.seek(-8 - size, os.SEEK_END)
        packed = raw.read(size)
    try:
        groups = tuple(map(_group, read_struct(packed, 0)[0].get(_GROUPS, ())))
    except (IndexError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise pyarrow.ArrowInvalid(f"a damaged footer: {error!r}") from None
    if len(groups) != metadata.num_row_groups or any(len(group.chunks) != len(names) for group in groups):
        raise pyarrow.ArrowInvalid(f"a damaged footer: not every row group has {len(names)} columns")
    n_rows = sum(group.n_rows for group in groups)
    if n_rows != metadata.num_rows:
        raise pyarrow.ArrowInvalid(f"found {n_rows} rows in its row groups, expected {metadata.num_rows}")
    packed_bytes = sum(max(0, chunk.n_bytes) for group in groups for chunk in group.chunks)
    if packed_bytes > n_bytes:  # one would be read again and again
        raise pyarrow.ArrowInvalid("found row groups that share their bytes, expected each to have its own")
    if len(set(names)) < len(names):
        raise pyarrow.ArrowInvalid("found two columns of one name")
    return Footer(metadata, groups)


def _group(fields: dict[int, Any]) -> Group:
    return Group(_whole(fields[_N_ROWS]), tuple(_chunk(chunk[_OF_CHUNK]) for chunk in fields[_CHUNKS]))


def _chunk(fields: dict[int, Any]) -> Chunk:
    first, dictionary = _whole(fields[_FIRST_DATA]), _whole(fields.get(_DICTIONARY, 0))
    statistics = fields.get(_STATISTICS, {})
    least, most = (_number(statistics.get(field), fields[_KIND]) for field in (_LEAST, _MOST))
    name = b".".join(fields[_PATH]).decode()
    start = dictionary if 0 < dictionary < first else first
    return Chunk(name, _whole(fields[_N_VALUES]), start, _whole(fields[_PACKED_BYTES]), least, most)


def _number(packed: bytes | None, kind: int) -> float:
    if packed is None or len(packed) != _WIDTHS.get(kind):
        return np.nan
    return int.from_bytes(packed, "little", signed=True)


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"found {value!r}, expected a whole number")
    return value
