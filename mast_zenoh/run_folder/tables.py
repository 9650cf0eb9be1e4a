"""Tables: columns by name, in memory and as Parquet files."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools
from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder import check_plain, open_plain
from mast_zenoh.run_folder.parquet_footers import Footer, read_footer
from mast_zenoh.run_folder.unpacking import MAX_TABLE_BYTES, check_expanded, read_parquet, read_row_group

#: Columns of text get this type at once, because `dictionary_encode` would load all of Arrow's compute functions.
_TEXT = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())


class _NoPandas(MetaPathFinder):
    """Hides pandas, as if it were not installed."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> None:
        if fullname == "pandas":
            raise ModuleNotFoundError("pandas is not needed here", name=fullname)


def _hide_pandas() -> None:
    """Keep pyarrow from loading pandas, which takes 0.3 s and is not needed here.

    pyarrow looks for pandas at its first conversion, and again when it is really needed.
    """
    if "pandas" not in sys.modules:
        finder = _NoPandas()
        sys.meta_path.insert(0, finder)
        try:
            pyarrow.array([0])
        finally:
            sys.meta_path.remove(finder)


_hide_pandas()


def read_table(path: Path) -> dict[str, NDArray[Any]]:
    """Read a table as columns; raises RunFolderError if it is missing or broken."""
    try:
        with _naming(path):
            return from_arrow(read_arrow(path))
    except FileNotFoundError as error:
        raise RunFolderError(f"{path}: {error}") from None


def read_arrow(path: Path) -> Any:
    """Read a Parquet file as an Arrow table.

    Raises OSError, RunFolderError or ArrowException if it is missing, broken or too large when unpacked.
    """
    return read_parquet(check_plain(path))


def to_arrow(columns: Mapping[str, Any]) -> Any:
    """Columns as an Arrow table: text as a dictionary, a NaN as a missing value."""

    def arrow(values: Any) -> Any:
        # As a NumPy array of text, every item would be as wide as the longest.
        strings = isinstance(values, (list, tuple)) and any(isinstance(value, str) for value in values)
        array = np.fromiter(values, object, len(values)) if strings else np.asarray(values)
        if array.dtype.kind == "U":
            array = array.astype(object)
        if array.dtype.kind == "O":
            try:
                return pyarrow.array(array, _TEXT)
            except (pyarrow.ArrowException, TypeError):  # some items are not text
                return pyarrow.array([str(value) for value in array], _TEXT)
        return pyarrow.array(array, from_pandas=True)

    return pyarrow.table({name: arrow(values) for name, values in columns.items()})


def from_arrow(table: Any, rows: NDArray[Any] | slice = slice(None)) -> dict[str, NDArray[Any]]:
    """The inverse of `to_arrow`, for some rows.

    Text becomes arrays of str, a missing number NaN. Raises ArrowInvalid if text would take too much memory.
    """
    columns: dict[str, NDArray[Any]] = {}
    for name in table.column_names:
        column = table.column(name).unify_dictionaries().combine_chunks()
        if not pyarrow.types.is_dictionary(column.type):
            columns[name] = column.to_numpy(zero_copy_only=False)[rows]
            continue
        check_expanded(table.column(name))
        if column.null_count:
            columns[name] = np.array([text or "" for text in column.to_pylist()], str)[rows]
        else:
            columns[name] = np.array([*column.dictionary.to_pylist(), ""], str)[column.indices.to_numpy()[rows]]
    return columns


def as_read(columns: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Columns as `read_table` would return them from a file."""
    return from_arrow(to_arrow(columns))


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn errors of a broken file, not of one that is missing, into RunFolderError."""
    try:
        yield
    except FileNotFoundError:
        raise
    except (OSError, ValueError, LookupError, pyarrow.ArrowException) as error:
        raise RunFolderError(f"{path}: {error}") from None


class _Known(NamedTuple):
    """What is known of a file before its rows are read.

    file: which one it is;  least, most: (groups,) first and last frame of each row group, NaN: unknown
    """

    file: tuple[int, ...]
    footer: Footer
    schema: Any
    least: NDArray[Any]
    most: NDArray[Any]


#: Row groups that stay in memory for the next frames, and the bytes of one at most.
_RECENT_GROUPS, _RECENT_BYTES = 2, 64 << 20


class TableFile:
    """A Parquet file from which wanted rows are read when they are asked for, so it may be of any length.

    The footer is read once, and the newest row groups stay in memory. If the file is replaced, the new one is read.

    Raises FileNotFoundError where there is none; RunFolderError if it is no plain file, is broken, has not the columns,
    or if a row group, or all wanted rows, are too large when unpacked. A new object has read nothing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known: _Known | None = None
        self._recent: tuple[tuple[Any, Any], ...] = ()

    @property
    def columns(self) -> list[str]:
        """The names of the columns."""
        with _naming(self.path):
            return list(self._now().schema.names)

    @property
    def n_rows(self) -> int:
        """The number of rows that the footer claims; that of a damaged file may claim any."""
        with _naming(self.path):
            return int(self._now().footer.metadata.num_rows)

    @property
    def last_frame(self) -> float:
        """The largest frame that the footer claims; NaN: it does not say, or there is no row."""
        with _naming(self.path):
            most = self._now().most
            return float(most.max()) if len(most) else float("nan")

    def rows(self, columns: Sequence[str], frames: range | None = None, agent: str = "") -> dict[str, NDArray[Any]]:
        """The rows of some frames and of an agent, by default of all, in their order, as columns.

        Columns `frame` and `agent` decide. Only row groups that by the footer may have these frames are read.
        """
        parts, size = list[dict[str, NDArray[Any]]](), 0
        for part in self.parts(columns, frames, agent):
            parts.append(part)
            size += sum(column.nbytes for column in part.values())
            self._check(size)
        with _naming(self.path):
            nothing = from_arrow(self._now().schema.empty_table().select(columns))
        return {name: np.concatenate([part[name] for part in (nothing, *parts)]) for name in columns}

    def parts(
        self, columns: Sequence[str], frames: range | None = None, agent: str = ""
    ) -> Iterator[dict[str, NDArray[Any]]]:
        """The same rows as those of `rows`, one row group after the other."""
        with _naming(self.path):
            for table, chosen in self._groups(columns, frames, agent):
                yield from_arrow(table.select(columns), chosen)

    def arrow(self, columns: Sequence[str], frames: range | None = None) -> Any:
        """The same rows as those of `rows`, as an Arrow table, in which text is as it is in the file."""
        groups, size = [], 0
        with _naming(self.path):
            for table, chosen in self._groups(columns, frames):
                wanted = table.select(columns)
                groups.append(wanted if chosen.all() else wanted.filter(pyarrow.array(chosen)))
                size += groups[-1].nbytes
                self._check(size)
            return pyarrow.concat_tables(groups) if groups else self._now().schema.empty_table().select(columns)

    def _groups(self, columns: Sequence[str], frames: range | None, agent: str = "") -> Iterator[tuple[Any, Bools]]:
        """The row groups that may have wanted rows, with these columns at least, and which rows are wanted."""
        known = self._now()
        deciding = ["frame"] * (frames is not None) + ["agent"] * bool(agent)
        names = tuple(dict.fromkeys([*columns, *deciding]))
        if missing := sorted(set(names) - set(known.schema.names)):
            raise RunFolderError(f"{self.path}: found no column {', '.join(missing)}")
        for group in range(len(known.least)):
            if frames is None or not (known.least[group] >= frames.stop or known.most[group] < frames.start):
                table = self._group(known, group, names)
                yield table, _chosen(table, frames, agent)

    def _check(self, size: int) -> None:
        if size > MAX_TABLE_BYTES:
            wanted = f"found {size} bytes in the wanted rows or more, expected at most {MAX_TABLE_BYTES}"
            raise RunFolderError(f"{self.path}: {wanted}")

    def _now(self) -> _Known:
        with open_plain(self.path) as file:
            status = os.fstat(file.fileno())
        current = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
        if self._known is None or self._known.file != current:
            footer = read_footer(self.path)
            schema = footer.metadata.schema.to_arrow_schema()
            self._known = _Known(current, footer, schema, *footer.extents("frame"))
        return self._known

    def _group(self, known: _Known, group: int, names: tuple[str, ...]) -> Any:
        """Some columns of a row group as an Arrow table, in which text is a dictionary if it is in the file."""
        wanted = known.file, group, names
        for recent, table in self._recent:
            if recent == wanted:
                return table
        if self._now() is not known:
            raise RunFolderError(f"{self.path}: found another file than before: it was replaced while it was read")
        table = read_row_group(self.path, group, names, known.footer)
        if table.nbytes <= _RECENT_BYTES:
            self._recent = ((wanted, table), *self._recent)[:_RECENT_GROUPS]
        return table


def _chosen(table: Any, frames: range | None, agent: str) -> Bools:
    """Which rows of an Arrow table are of some frames and of an agent; the footer of a file may say anything."""
    chosen = np.ones(len(table), bool)
    if frames is not None:
        frame = from_arrow(table.select(["frame"]))["frame"]
        if frame.dtype.kind not in "iuf":
            raise pyarrow.ArrowInvalid(f"column frame: found {table.schema.field('frame').type}, expected numbers")
        frame = frame.astype(np.float64)
        chosen &= (frame >= frames.start) & (frame < frames.stop) & ((frame - frames.start) % frames.step == 0)
    if agent:
        chosen &= from_arrow(table.select(["agent"]))["agent"] == agent
    return chosen
