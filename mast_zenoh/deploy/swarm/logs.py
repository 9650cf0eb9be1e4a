"""Appends the logs of tasks and services to files."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

_AT_A_TIME = 4  # commands to the engine
_LOG_S = 30.0


def keep_logs(wanted: Iterable[tuple[str, Path, str]]) -> None:
    """`keep_log` for each (task, path, refused), several at a time."""
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        list(pool.map(lambda arguments: keep_log(*arguments), wanted))


def keep_log(task: str, path: Path, refused: str = "") -> None:
    """Append a task's or service's log to a file, or `refused`: why it did not start."""
    with path.open("ab") as log:
        if refused:
            log.write(f"{refused}\n".encode())
            return
        try:
            subprocess.run(
                ["docker", "service", "logs", "--raw", task],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                check=False,
                timeout=_LOG_S,
                start_new_session=True,
            )
        except subprocess.TimeoutExpired:
            log.write(b"(Docker did not return all of it)\n")
