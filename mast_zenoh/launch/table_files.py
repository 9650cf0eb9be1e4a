"""Writes the tables that nodes hand in part by part, while a run goes on."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.mesh.control.results import EVALUATOR, MAX_TABLES, TABLES, TablePart
from mast_zenoh.run_folder import replacing, subfolder

#: Limit on the columns in memory that one node may hand in while a run goes on, bytes.
MAX_HANDED_IN = 64 << 30


class TableFiles:
    """The tables of all nodes; each part is a row group of its file.

    A file gets its name when it is closed, at any end of the run but that of a killed launcher: one that is there is
    whole, and has all rows up to then.

    written: (node, table) of all tables;  refused: of those that are not written, a sentence
    incomplete: by node, why a part of its tables was not taken: later parts are missing, too
    problem: the first error of the operating system, after which nothing is written
    """

    def __init__(self, folder: Path) -> None:
        self.written: set[tuple[str, str]] = set()
        self.refused: dict[tuple[str, str], str] = {}
        self.incomplete: dict[str, str] = {}
        self.problem: Exception | None = None
        self._folder = folder
        self._files: dict[tuple[str, str], tuple[ExitStack, Any]] = {}  # with their writers
        self._process: dict[str, str] = {}  # by node, the current one
        self._numbers: dict[tuple[str, str], int] = {}  # by node and process, of its next part
        self._bytes: dict[str, int] = {}  # by node

    def add(self, node: str, process: str, part: TablePart) -> None:
        """Write a part; one that is repeated is ignored. A node's new process begins its tables again.

        Raises MessageError for a part that is out of order, or of a process that was replaced.
        """
        expected = self._numbers.setdefault((node, process), 0)
        if part.number < expected:
            return
        replaced = expected > 0 and self._process[node] != process
        if part.number > expected or replaced:
            found = "a part of a process that was replaced" if replaced else f"part {part.number}"
            problem = f"table {part.table}: found {found}, expected part {expected}"
            if not replaced:
                self.incomplete.setdefault(node, problem)
            raise MessageError(problem)
        if self._process.get(node) != process:
            self.discard(node)
            self._process[node] = process
        self._numbers[node, process] += 1
        key = node, part.table
        if self.problem is None and key not in self.refused:
            try:
                self._write(key, part)
            except (OSError, MemoryError, ImportError, RunFolderError) as error:  # not the table's fault
                self.problem = error
            except Exception as error:  # Arrow has many error classes, and users write tables
                self.refused[key] = " ".join(str(error).split())[:200]

    def discard(self, node: str) -> None:
        """Remove the tables of a node's process that was replaced."""
        for key in [key for key in self._files if key[0] == node]:
            file, _ = self._files.pop(key)
            self.written.discard(key)
            with suppress(_Discarded), file:
                raise _Discarded

    def close(self) -> None:
        """Complete all files."""
        while self._files:
            _, (file, _) = self._files.popitem()
            try:
                file.close()
            except Exception as error:  # of several types, if the disk is full
                self.problem = self.problem or error

    def _write(self, key: tuple[str, str], part: TablePart) -> None:
        node, table = key
        self._bytes[node] = self._bytes.get(node, 0) + sum(column.nbytes for column in part.columns.values())
        if self._bytes[node] > MAX_HANDED_IN:
            raise ValueError(f"found more than {MAX_HANDED_IN >> 30} GiB of tables, expected at most as much")
        if key not in self._files and sum(of == node for of, _ in self._files) >= MAX_TABLES:
            raise ValueError(f"found more than {MAX_TABLES} tables, expected at most as many")
        from pyarrow import parquet  # for which no process that writes no table should wait

        from mast_zenoh.run_folder.tables import to_arrow

        rows = to_arrow(part.columns)
        if key not in self._files:
            with ExitStack() as opening:
                path = subfolder(self._folder, *_place_of(node, table)) / f"{table}.parquet"
                new = opening.enter_context(replacing(path))
                writer = opening.enter_context(parquet.ParquetWriter(new, rows.schema))
                self._files[key] = opening.pop_all(), writer
            self.written.add(key)
        self._files[key][1].write_table(rows, row_group_size=max(1, rows.num_rows))


class _Discarded(Exception):
    """Ends the writing of a table that is not wanted."""


def _place_of(node: str, table: str) -> tuple[str, ...]:
    """The folder of a node's table in the run folder: its chunks."""
    return () if node == EVALUATOR and table in TABLES else ("results", node)
