"""Starts, signals and observes the processes of a run's nodes on this host.

Imports nothing slow or large.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_UP = "mast-up"  # mast_zenoh.runtime.mesh.hosting.UP; that module is not imported: the warden stays small
_PR_SET_PDEATHSIG = 1


class NodeProcess:
    """The process of a node.

    start: id of the command that started it;  reported: whether its end has been reported to the launcher
    """

    def __init__(self, name: str, start: str, process: subprocess.Popen[bytes]) -> None:
        self.name = name
        self.start = start
        self.process = process
        self.reported = False

    @property
    def runs(self) -> bool:
        """Whether it is running."""
        return self.process.poll() is None

    @property
    def is_stopped(self) -> bool:
        """Whether a signal has stopped it (proc(5), field 3 of stat)."""
        try:
            return Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
        except OSError:
            return False

    def state(self) -> dict[str, Any]:
        """Its state, in the form for the launcher."""
        return {"node": self.name, "start": self.start, "pid": self.process.pid, "exit": self.process.poll()}


class HostProcesses:
    """The processes of a run on this host, by the name of their node.

    folder: the run's folder: the processes' working directory, with logs/NODE.log, and tmp/NODE for temporary files
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._by_name: dict[str, NodeProcess] = {}

    def names(self) -> set[str]:
        """The names of all nodes that were ever started."""
        return set(self._by_name)

    def states(self) -> list[dict[str, Any]]:
        """The states of all processes."""
        return [node.state() for node in self._by_name.values()]

    def running(self) -> bool:
        """Whether any process is running."""
        return any(node.runs for node in self._by_name.values())

    def newly_ended(self) -> list[NodeProcess]:
        """Processes whose end has not been reported to the launcher."""
        return [node for node in self._by_name.values() if not node.reported and not node.runs]

    def see_launcher(self) -> bool:
        """Whether any running process sees the launcher."""
        return any(
            (self._folder / "tmp" / node.name / _UP).exists() and node.runs and not node.is_stopped
            for node in self._by_name.values()
        )

    def start(self, name: str, command: str, argv: list[str], env: dict[str, str]) -> dict[str, Any]:
        """Start a node's process on the launcher's command; returns its pid or an error."""
        former = self._by_name.get(name)
        if former is not None and former.runs:
            return {"error": f"{name} is already running"}
        temporary_folder = self._folder / "tmp" / name
        shutil.rmtree(temporary_folder, ignore_errors=True)  # left by a killed process
        temporary_folder.mkdir(parents=True)
        with (self._folder / "logs" / f"{name}.log").open("ab") as log:
            try:
                process = subprocess.Popen(
                    argv,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    cwd=self._folder,
                    env={**os.environ, **env, "TMPDIR": str(temporary_folder)},
                    start_new_session=True,
                    preexec_fn=_die_with_parent,  # this process has one thread
                )
            except OSError as error:
                return {"error": f"{name}: {error}"}
        self._by_name[name] = NodeProcess(name, command, process)
        return {"pid": process.pid}

    def signal(self, number: int, names: Iterable[str] | None = None) -> None:
        """Send a signal to the running ones of these nodes; None: to all running nodes."""
        for name in self._by_name if names is None else names:
            node = self._by_name.get(name)
            if node is not None and node.runs:
                node.process.send_signal(number)

    def kill(self) -> None:
        """Kill all running processes, and wait until they have ended."""
        self.signal(signal.SIGKILL)
        for node in self._by_name.values():
            node.process.wait()


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
