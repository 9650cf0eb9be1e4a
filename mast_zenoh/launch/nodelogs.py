"""Log files of nodes that run in the launcher's process."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TextIO

_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


class NodeLogs(logging.Handler):
    """Context manager that appends records of logger `mast.<node>` to <node>.log.

    A file is created at the first record.

    failure: why the logs are incomplete; None if nothing was lost
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter(_FORMAT))
        self.failure: OSError | None = None
        self._folder = folder
        self._files: dict[str, TextIO] = {}
        self._logger = logging.getLogger("mast")

    def __enter__(self) -> NodeLogs:
        self._logger.addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        for file in self._files.values():
            try:
                file.close()
            except OSError as error:
                self.failure = self.failure or error

    def emit(self, record: logging.LogRecord) -> None:
        """Append a record to its node's file."""
        node = record.name.removeprefix("mast.")
        try:
            if node not in self._files:
                self._files[node] = (self._folder / f"{node}.log").open("a", encoding="utf-8")
            print(self.format(record), file=self._files[node], flush=True)
        except OSError as error:  # must not fail the handler that logs
            self.failure = self.failure or error
