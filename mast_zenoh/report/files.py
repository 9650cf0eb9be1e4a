"""Reads the files of a run folder for the report, each by a function that raises for what it cannot use."""

from __future__ import annotations

import json
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
from mast_zenoh.scenes.recording import Recording

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

_ATTACKS = (
    *("interposer", "role", "frame", "effect"),
    *("before_x", "before_y", "before_z", "after_x", "after_y", "after_z"),
)


def rows(table: Table, mask: Bools) -> Table:
    """The rows of a table that a mask (n,) picks."""
    return {name: column[mask] for name, column in table.items()}


class Reader:
    """Reads files of one folder, and notes in `missing` those that are absent or unreadable, one sentence each."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: list[str] = []

    def read(self, name: str, reader: Callable[[Path], Any], lack: str, default: Any) -> Any:
        """What `reader` makes of a file; `default` where it cannot. lack: what the report is without, in words."""
        path = self.folder / name
        try:
            return reader(path)
        except FileNotFoundError:
            self.missing.append(f"{name} is absent: {lack}.")
        except (OSError, ValueError, KeyError, MastError, pyarrow.ArrowException) as error:
            reason = str(error).removeprefix(f"{path}: ")
            self.missing.append(f"{name} cannot be read ({reason}): {lack}.")
        return default

    def read_if_there(self, name: str, reader: Callable[[Path], Any], lack: str, default: Any) -> Any:
        """The same for a file that not every run has: nothing is missing where it is absent."""
        return self.read(name, reader, lack, default) if (self.folder / name).is_file() else default


def json_object(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object."""
    data = json.loads(path.read_text("utf-8"))
    if not isinstance(data, dict):
        raise ValueError(f"found {type(data).__name__}, expected an object")
    return data


def scene(path: Path) -> Recording:
    """The recorded scene."""
    if not path.is_file():
        raise FileNotFoundError(path)
    return Recording.load(path)


def table(columns: tuple[str, ...], agent: str = "", *, optional: tuple[str, ...] = ()) -> Callable[[Path], Table]:
    """A reader of a Parquet table: these columns, of the rows of one agent if any; `optional` ones where they are."""

    def read(path: Path) -> Table:
        content = read_arrow(path)
        absent = sorted(set(columns) - set(content.column_names))
        if absent:
            raise ValueError(f"found no column {', '.join(absent)}")
        there = (*columns, *(name for name in optional if name in content.column_names))
        if not agent:
            return from_arrow(content.select(there))
        return from_arrow(content.select(there), from_arrow(content.select(["agent"]))["agent"] == agent)

    return read


def effects(path: Path) -> Table:
    """The measured effects of interposers, links included."""
    if "interposer" not in pyarrow.parquet.read_schema(path).names:
        raise ValueError("of an older version: what adversaries reported about themselves, not what was measured")
    return table(_ATTACKS, optional=("before_subscriber", "message", "wire"))(path)


def node_results(folder: Path) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """By node, what it left in results/<node>/: names of files."""
    if not folder.is_dir():
        return ()
    nodes = sorted(path for path in folder.iterdir() if path.is_dir())
    return tuple((path.name, tuple(sorted(file.name for file in path.iterdir()))) for path in nodes)


def column(of: Table, name: str) -> NDArray[np.float64]:
    """A column as numbers."""
    return np.asarray(of[name], np.float64)
