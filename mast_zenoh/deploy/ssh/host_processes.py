"""The processes of a run's nodes on this host: started, signalled, seen. Imports nothing that takes time or memory."""

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

_UP = "mast-up"  # mast_zenoh.runtime.mesh.launcher_watch.UP; that module is not imported: the warden stays small
_PR_SET_PDEATHSIG = 1


class NodeProcess:
    """The process of a node.

    start: id of the command that has started it;  told: whether the launcher has been told of its end
    """

    def __init__(self, name: str, start: str, process: subprocess.Popen[bytes]) -> None:
        self.name = name
        self.start = start
        self.process = process
        self.told = False

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    @property
    def stands_still(self) -> bool:
        """Whether it is stopped by a signal, and so sees nothing (proc(5), field 3 of stat)."""
        try:
            return Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
        except OSError:
            return False

    def state(self) -> dict[str, Any]:
        """Its state as the launcher is told."""
        return {"node": self.name, "start": self.start, "pid": self.process.pid, "exit": self.process.poll()}


class HostProcesses:
    """The processes of a run on this host, by the name of their node.

    folder: of the run: a process works in it, writes to logs/NODE.log, and has tmp/NODE for temporary files
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._by_name: dict[str, NodeProcess] = {}

    def names(self) -> set[str]:
        """Of all nodes that were ever started."""
        return set(self._by_name)

    def states(self) -> list[dict[str, Any]]:
        """The states of all."""
        return [node.state() for node in self._by_name.values()]

    def running(self) -> bool:
        """Whether any has not ended."""
        return any(node.runs for node in self._by_name.values())

    def newly_ended(self) -> list[NodeProcess]:
        """Those that have ended, of which the launcher has not been told."""
        return [node for node in self._by_name.values() if not node.told and not node.runs]

    def see_launcher(self) -> bool:
        """Whether any that runs sees the launcher."""
        return any(
            (self._folder / "tmp" / node.name / _UP).exists() and node.runs and not node.stands_still
            for node in self._by_name.values()
        )

    def start(self, name: str, command: str, argv: list[str], env: dict[str, str]) -> dict[str, Any]:
        """Start the process of a node, as a command of the launcher asks; the answer to that: its pid, or an error."""
        before = self._by_name.get(name)
        if before is not None and before.runs:
            return {"error": f"{name} runs already"}
        own = self._folder / "tmp" / name
        shutil.rmtree(own, ignore_errors=True)  # of one that was killed
        own.mkdir(parents=True)
        with (self._folder / "logs" / f"{name}.log").open("ab") as log:
            try:
                process = subprocess.Popen(
                    argv,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    cwd=self._folder,
                    env={**os.environ, **env, "TMPDIR": str(own)},
                    start_new_session=True,
                    preexec_fn=_die_with_parent,  # this process has one thread
                )
            except OSError as error:
                return {"error": f"{name}: {error}"}
        self._by_name[name] = NodeProcess(name, command, process)
        return {"pid": process.pid}

    def signal(self, number: int, names: Iterable[str] | None = None) -> None:
        """Send a signal to those of these nodes that run; None: to all that run."""
        for name in self._by_name if names is None else names:
            node = self._by_name.get(name)
            if node is not None and node.runs:
                node.process.send_signal(number)

    def kill(self) -> None:
        """Kill all that run, and wait for their ends."""
        self.signal(signal.SIGKILL)
        for node in self._by_name.values():
            node.process.wait()


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
