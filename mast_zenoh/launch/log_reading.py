"""Reads the logs in a run folder, of a finished run or of one that goes on."""

from __future__ import annotations

import heapq
import os
import re
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import IO, NamedTuple

from mast_zenoh.errors import RunFolderError, nearest
from mast_zenoh.launch import liveness
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.run_folder import json_or_empty

#: Bytes of a line; a longer one is continued on the next.
MAX_LINE = 1 << 16
#: Bytes that are read of one log, and of all logs of a run: the last ones. Lines that follow are always read.
MAX_LOG_BYTES = 16 << 20
MAX_LOGS_BYTES = 32 << 20
#: The beginning of an entry: `2026-11-22 10:58:43,888`. Lines without belong to the entry before, such as tracebacks.
_TIME = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} ")


class LogLine(NamedTuple):
    """A line of a node's log; bytes that are not UTF-8 are replaced by their codes, `\\xff`."""

    node: str
    text: str


class RunLogs:
    """The logs of one run folder.

    folder: of the run;  node: only this one's log; None: all, also of nodes that join later
    problems: by log, why it could not be read, or not from its beginning
    Raises RunFolderError for a folder that is no run folder, and for an unknown node.
    """

    def __init__(self, folder: Path, node: str | None = None) -> None:
        self.problems: dict[str, str] = {}
        self._folder = folder
        self._node = node
        self._logs: dict[str, _Log] = {}
        if not (folder / "logs").is_dir() and not (folder / "run.json").is_file():
            raise RunFolderError(f"{folder}: has no logs and no run.json: expected the folder of a run")
        nodes = self._record().get("nodes")
        known = {path.stem for path in self._paths()} | (set(nodes) if isinstance(nodes, dict) else set())
        if node is not None and node not in known:
            raise RunFolderError(f"{folder}: has no node {node!r}{nearest(node, known)}")

    @property
    def running(self) -> bool:
        """Whether the run goes on; False if that cannot be known."""
        record = self._record()
        return liveness.current_record(record).get("status") == RUNNING

    def new_lines(self, *, partial: bool) -> Iterator[LogLine]:
        """The lines since the last call, in the order of their times.

        partial: also what follows the last line feed of a log
        """
        paths = [path for path in self._paths() if self._node in (None, path.stem)]
        most = min(MAX_LOG_BYTES, MAX_LOGS_BYTES // max(len(paths), 1))
        for path in paths:
            if path.stem not in self._logs:
                self._logs[path.stem] = _Log(path, most)
        entries = [self._entries(node, log, partial=partial) for node, log in sorted(self._logs.items())]
        for _, node, line in heapq.merge(*entries, key=itemgetter(0)):
            yield LogLine(node, line.decode("utf-8", "backslashreplace"))

    def _entries(self, node: str, log: _Log, *, partial: bool) -> Iterator[tuple[bytes, str, bytes]]:
        try:
            for time, line in log.new_lines(partial=partial):
                yield time, node, line
        except OSError as error:
            self.problems[f"logs/{log.path.name}"] = error.strerror or str(error)
        else:
            if log.skipped:
                self.problems[f"logs/{log.path.name}"] = f"its first {log.skipped} bytes are left out: it is too long"

    def _paths(self) -> list[Path]:
        logs = self._folder / "logs"
        return [path for path in logs.glob("*.log") if path.is_file() and not path.is_symlink() | logs.is_symlink()]

    def _record(self) -> dict[str, object]:
        return json_or_empty(self._folder / "run.json")


class _Log:
    """A log file, read from where the last call stopped.

    most: bytes that are read at first, its last ones;  skipped: bytes before them
    time: of the entry that was read last
    """

    def __init__(self, path: Path, most: int) -> None:
        self.path = path
        self.skipped = 0
        self.time = b""
        self._most = most
        self._position: int | None = None

    def new_lines(self, *, partial: bool) -> Iterator[tuple[bytes, bytes]]:
        """(time, line) of each line since the last call."""
        with self.path.open("rb") as file:
            if self._position is None:
                self._position = self.skipped = self._first_line(file)
            file.seek(self._position)
            while line := file.readline(MAX_LINE):
                if not line.endswith(b"\n") and len(line) < MAX_LINE and not partial:
                    return  # the rest of it comes later
                self._position += len(line)
                if begun := _TIME.match(line):
                    self.time = begun.group()
                yield self.time, line.removesuffix(b"\n")

    def _first_line(self, file: IO[bytes]) -> int:
        """Where the first line begins that is read."""
        beginning = max(os.fstat(file.fileno()).st_size - self._most, 0)
        file.seek(beginning)
        return beginning + (len(file.readline(MAX_LINE)) if beginning else 0)
