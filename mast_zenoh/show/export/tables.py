"""All objects of a run as one table, as CSV or Parquet."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.csv
import pyarrow.parquet

from mast_zenoh.arrays.states import COVARIANCE_ORDER
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.show.export.columns import class_names, standard_deviations

#: Frames that are written together.
_BATCH = 50

_INT, _FLOAT, _TEXT = pyarrow.int64(), pyarrow.float64(), pyarrow.string()
_VECTORS = {"position": ("x", "y", "z"), "velocity": ("vx", "vy", "vz"), "size": ("l", "w", "h")}
SCHEMA = pyarrow.schema(
    [
        *(("frame", _INT), ("time_ns", _INT), ("agent", _TEXT), ("estimate", _TEXT), ("id", _INT), ("class", _TEXT)),
        *((axis, _FLOAT) for axes in _VECTORS.values() for axis in axes),
        *(("yaw", _FLOAT), ("score", _FLOAT)),
        *((f"std_{name}", _FLOAT) for name in COVARIANCE_ORDER),
        *(("outcome", _TEXT), ("match_id", _INT), ("points", _INT)),
    ]
)


def write_csv(run: Run, path: Path) -> None:
    """Write the table as CSV; what is not known is empty."""
    with pyarrow.csv.CSVWriter(path, SCHEMA) as writer:
        _write(run, writer)


def write_parquet(run: Run, path: Path) -> None:
    """Write the table as Parquet; what is not known is null."""
    with pyarrow.parquet.ParquetWriter(path, SCHEMA, compression="zstd") as writer:
        _write(run, writer)


def _write(run: Run, writer: Any) -> None:
    every = frames_of(run)
    while batch := list(islice(every, _BATCH)):
        writer.write_table(pyarrow.concat_tables(table for frame in batch for table in _tables(frame)))


def _tables(frame: Frame) -> Iterator[Any]:
    """A table for each series of a frame."""
    for series, states in frame.objects.items():
        n, outcomes = len(states), frame.outcomes[series]
        columns: dict[str, Any] = {
            "frame": np.full(n, frame.index),
            "time_ns": np.full(n, frame.time_ns),
            "agent": [series.agent] * n,
            "estimate": [series.estimator] * n,
            "id": states.id,
            "class": class_names(states),
            "yaw": states.yaw,
            "outcome": outcomes.names,
            "match_id": pyarrow.array(outcomes.match_id, _INT, mask=outcomes.match_id < 0),
        }
        for name, axes in _VECTORS.items():
            columns |= dict(zip(axes, getattr(states, name).T, strict=True))
        if series == TRUTH:
            columns["points"] = frame.points.max(axis=1, initial=0)
        else:
            deviations = standard_deviations(states)
            columns["score"] = states.score
            columns |= {f"std_{name}": deviations[:, k] for k, name in enumerate(COVARIANCE_ORDER)}
        yield pyarrow.table(
            [
                pyarrow.array(columns[field.name], field.type, from_pandas=True)
                if field.name in columns
                else pyarrow.nulls(n, field.type)
                for field in SCHEMA
            ],
            schema=SCHEMA,
        )
