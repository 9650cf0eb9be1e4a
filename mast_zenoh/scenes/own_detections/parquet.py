"""Detections as a Parquet table with a row for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.files.class_names import class_of
from mast_zenoh.scenes.own_detections.rows import DetectionRows

_NEEDED = ("frame", "agent", "x", "y", "z", "l", "w", "h", "yaw")
#: Position covariance, m²; all six or none.
_COVARIANCE = ("xx", "xy", "xz", "yy", "yz", "zz")
_OPTIONAL = ("score", "class", "truth_id", *_COVARIANCE)


def read_parquet(path: Path, agents: Sequence[str], first_frame: int) -> DetectionRows:
    """The detections in a Parquet file, see docs/scenes.md.

    first_frame: number of the scene's first frame in the file. A frame without rows has no detections.
    Raises SceneError with the column and the row.
    """
    table = _open(path)
    for name in _NEEDED:
        if name not in table.column_names:
            raise SceneError(f"{path}: column {name} is missing{nearest(name, table.column_names)}")
    columns = {name: _numbers(path, table, name) for name in ("x", "y", "z", "l", "w", "h", "yaw")}
    count, given = table.num_rows, set(table.column_names)
    classes = _texts(path, table, "class") if "class" in given else ["unknown"] * count
    return DetectionRows(
        place=[f"row {row}" for row in range(count)],
        frame=_whole_numbers(path, table, "frame") - first_frame,
        agent=_rows_of_agents(path, _texts(path, table, "agent"), agents),
        position=np.column_stack([columns[name] for name in ("x", "y", "z")]),
        size=np.column_stack([columns[name] for name in ("l", "w", "h")]),
        yaw=columns["yaw"],
        score=_numbers(path, table, "score") if "score" in given else np.ones(count),
        class_id=np.array([class_of(name) for name in classes], np.uint8),
        covariance=_covariance(path, table),
        truth_id=_whole_numbers(path, table, "truth_id") if "truth_id" in given else np.full(count, -1, np.int64),
    )


def _open(path: Path) -> Any:
    import pyarrow  # takes 0.15 s, and every run imports this module

    from mast_zenoh.unpacking import parquet

    try:
        table = parquet.read(path, (*_NEEDED, *_OPTIONAL))
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise SceneError(f"{path}: cannot be read as Parquet: {error}") from error
    repeated = [name for name in table.column_names if table.column_names.count(name) > 1]
    if repeated:
        raise SceneError(f"{path}: column {repeated[0]} occurs twice")
    return table


def _numbers(path: Path, table: Any, name: str) -> NDArray[np.float64]:
    import pyarrow

    column = table[name]
    if column.null_count:
        raise SceneError(f"{path}: column {name} has {column.null_count} empty values")
    try:
        return np.asarray(column.cast(pyarrow.float64()).to_numpy(), np.float64)
    except (ValueError, pyarrow.ArrowException) as error:
        raise SceneError(f"{path}: column {name} is not of numbers: {error}") from error


def _whole_numbers(path: Path, table: Any, name: str) -> NDArray[np.int64]:
    values = _numbers(path, table, name)
    invalid = np.flatnonzero(~((values == np.round(values)) & (np.abs(values) < 2**53)))
    if len(invalid):
        raise SceneError(f"{path}: row {invalid[0]}: {name} is {values[invalid[0]]}, expected a whole number")
    return values.astype(np.int64)


def _texts(path: Path, table: Any, name: str) -> list[str]:
    import pyarrow

    column = table[name]
    if column.null_count:
        raise SceneError(f"{path}: column {name} has {column.null_count} empty values")
    try:
        values: list[str] = column.cast(pyarrow.string()).to_pylist()
    except (ValueError, pyarrow.ArrowException) as error:
        raise SceneError(f"{path}: column {name} is not of text: {error}") from error
    return values


def _rows_of_agents(path: Path, names: Sequence[str], agents: Sequence[str]) -> NDArray[np.int64]:
    rows = {name: row for row, name in enumerate(agents)}
    for row, name in enumerate(names):
        if name not in rows:
            raise SceneError(
                f"{path}: row {row}: agent is {name!r}, which the scene does not have{nearest(name, agents)}"
            )
    return np.array([rows[name] for name in names], np.int64)


def _covariance(path: Path, table: Any) -> NDArray[np.float64]:
    """(n, 3, 3) m²; zero without these columns."""
    given = [name for name in _COVARIANCE if name in table.column_names]
    if not given:
        return np.zeros((table.num_rows, 3, 3))
    if len(given) < len(_COVARIANCE):
        raise SceneError(f"{path}: covariance has the columns {', '.join(given)}, expected {', '.join(_COVARIANCE)}")
    xx, xy, xz, yy, yz, zz = (_numbers(path, table, name) for name in _COVARIANCE)
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
