"""Parquet files that are there whole or not at all, also those too large for the memory."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet


class TableFile:
    """A Parquet file written piece by piece: there whole when the block ends, and not at all if it raises.

    Pieces are held until they make a row group, so a study needs no memory for its tables.
    """

    ROW_GROUP = 500_000

    def __init__(self, path: Path, schema: pyarrow.Schema) -> None:
        self._path, self._schema = path, schema
        self._beside = path.with_name(f".{path.name}.{os.getpid()}")
        self._held: list[pyarrow.Table] = []

    def __enter__(self) -> TableFile:
        self._writer = parquet.ParquetWriter(self._beside, self._schema, compression="zstd")
        return self

    def append(self, piece: pyarrow.Table) -> None:
        """Add rows; a column of the schema that they lack is null."""
        columns = [
            piece.column(field.name).cast(field.type)
            if field.name in piece.column_names
            else pyarrow.nulls(len(piece), field.type)
            for field in self._schema
        ]
        self._held.append(pyarrow.table(columns, schema=self._schema))
        if sum(map(len, self._held)) >= self.ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._held:
            self._writer.write_table(pyarrow.concat_tables(self._held).unify_dictionaries().combine_chunks())
        self._held = []

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._writer:
            if kind is None:
                self._flush()
        if kind is None:
            os.replace(self._beside, self._path)
        else:
            self._beside.unlink(missing_ok=True)


def write_parquet(path: Path, table: Any) -> None:
    """Write a table so that a reader finds the old one or the new one, whole."""
    with TableFile(path, table.schema) as file:
        file.append(table)
