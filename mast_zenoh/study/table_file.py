"""Writes Parquet files atomically, including files larger than memory."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet


class TableFile:
    """A Parquet file written in pieces.

    It is complete when the block ends, and absent if the block raises.
    Pieces are buffered up to one row group, so memory use does not grow with the table.
    """

    ROW_GROUP = 500_000

    def __init__(self, path: Path, schema: pyarrow.Schema) -> None:
        self._path, self._schema = path, schema
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}")
        self._pending: list[pyarrow.Table] = []

    def __enter__(self) -> TableFile:
        self._temporary.unlink(missing_ok=True)  # a link there would be followed
        self._writer = parquet.ParquetWriter(self._temporary, self._schema, compression="zstd")
        return self

    def append(self, piece: pyarrow.Table) -> None:
        """Append rows; columns of the schema that they lack are null."""
        columns = [
            piece.column(field.name).cast(field.type)
            if field.name in piece.column_names
            else pyarrow.nulls(len(piece), field.type)
            for field in self._schema
        ]
        self._pending.append(pyarrow.table(columns, schema=self._schema))
        if sum(map(len, self._pending)) >= self.ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._pending:
            self._writer.write_table(pyarrow.concat_tables(self._pending).unify_dictionaries().combine_chunks())
        self._pending = []

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._writer:
            if kind is None:
                self._flush()
        if kind is None:
            os.replace(self._temporary, self._path)
        else:
            self._temporary.unlink(missing_ok=True)


def write_parquet(path: Path, table: Any) -> None:
    """Write a table atomically: a reader finds the complete old or new file."""
    with TableFile(path, table.schema) as file:
        file.append(table)
