"""Reads the files of a run folder; each reader raises if its file is unusable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools
from mast_zenoh.errors import MastError
from mast_zenoh.launch.tables import from_arrow, read_arrow
from mast_zenoh.run_files import check_plain, read_object
from mast_zenoh.scenes.recording import Recording

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

_ATTACKS = (
    *("interposer", "role", "frame", "effect"),
    *("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"),
)


def rows(table: Table, mask: Bools) -> Table:
    """The rows of a table selected by a mask (n,)."""
    return {name: column[mask] for name, column in table.items()}


class Reader:
    """Reads files of a folder.

    missing: absent and unreadable files, one sentence each
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: list[str] = []

    def read(self, name: str, reader: Callable[[Path], Any], consequence: str, default: Any) -> Any:
        """Read a file; returns `default` on failure, with its `consequence` in `missing`."""
        path = self.folder / name
        try:
            return reader(path)
        except FileNotFoundError:
            self.missing.append(f"{name} is absent: {consequence}.")
        except (OSError, ValueError, KeyError, MastError, pyarrow.ArrowException) as error:
            reason = str(error).removeprefix(f"{path}: ")
            self.missing.append(f"{name} cannot be read ({reason}): {consequence}.")
        return default

    def read_optional(self, name: str, reader: Callable[[Path], Any], consequence: str, default: Any) -> Any:
        """Like `read`, for a file that not every run has: its absence is not reported."""
        return self.read(name, reader, consequence, default) if (self.folder / name).is_file() else default


def json_object(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object."""
    path.lstat()  # raises FileNotFoundError
    return read_object(path)


def scene(path: Path) -> Recording:
    """The recorded scene."""
    return Recording.load(check_plain(path))


def table(columns: tuple[str, ...], agent: str = "", *, optional: tuple[str, ...] = ()) -> Callable[[Path], Table]:
    """A reader of columns of a Parquet table, some `optional`, for one agent if given."""

    def read(path: Path) -> Table:
        content = read_arrow(path)
        missing = sorted(set(columns) - set(content.column_names))
        if missing:
            raise ValueError(f"found no column {', '.join(missing)}")
        present = (*columns, *(name for name in optional if name in content.column_names))
        if not agent:
            return from_arrow(content.select(present))
        return from_arrow(content.select(present), from_arrow(content.select(["agent"]))["agent"] == agent)

    return read


def effects(path: Path) -> Table:
    """The measured effects of interposers, links included."""
    if "interposer" not in pyarrow.parquet.read_schema(check_plain(path)).names:
        raise ValueError("of an older version: what adversaries reported about themselves, not what was measured")
    return table(_ATTACKS, optional=("before_subscriber", "message", "wire"))(path)


def node_results(folder: Path) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """The names of each node's files in results/<node>/."""
    if not folder.is_dir():
        return ()
    nodes = sorted(path for path in folder.iterdir() if path.is_dir())
    return tuple((path.name, tuple(sorted(file.name for file in path.iterdir()))) for path in nodes)


def column(table: Table, name: str) -> NDArray[np.float64]:
    """A column as numbers."""
    return np.asarray(table[name], np.float64)
