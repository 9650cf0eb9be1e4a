"""The nodes of a run as processes of this machine."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.launch import forking
from mast_zenoh.launch.forking import Forked, ForkServer
from mast_zenoh.launch.supervisor import Child, Supervisor

#: One thread per node: many small arrays gain nothing from more, and the nodes share the machine.
ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_NODE = [sys.executable, "-P", "-m", "mast_zenoh.runtime"]  # -P: nothing from the working directory


class Process(Child):
    """A node as a process of this machine."""

    def __init__(self, name: str, spec: NodeSpec, log: IO[bytes], process: subprocess.Popen[bytes] | Forked) -> None:
        super().__init__(name, spec)
        self.log = log
        self.process = process

    @property
    def exit(self) -> int | None:
        return self.process.poll()

    def where(self) -> dict[str, Any]:
        return {"pid": self.process.pid}


class Processes(Supervisor[Process]):
    """Starts each node as a process in its own session, which Ctrl-C does not reach.

    The launcher holds a pipe to each node's standard input: it closes when the launcher ends, and the node leaves.

    inside: what to put before the command of a node; it must become that command, in the same process
    extra_arguments: additional arguments of a node's command
    zids: of all processes so far, so that nobody else counts as a node, whatever name it claims
    """

    def __init__(
        self,
        folder: Path,
        run: str,
        endpoint: str,
        inside: Callable[[str], list[str]] = lambda name: [],
        extra_arguments: Callable[[str], list[str]] = lambda name: [],
    ) -> None:
        super().__init__()
        self.folder = folder
        self.run = run
        self.endpoint = endpoint
        self.inside = inside
        self.extra_arguments = extra_arguments
        self._server: ForkServer | None = None
        self.zids: set[str] = set()

    def start(self, name: str, spec: NodeSpec) -> None:
        log = (self.folder / "logs" / f"{name}.log").open("ab", buffering=0)
        self.children[name] = Process(name, spec, log, self._spawn(name, spec, log))

    def command(self, name: str, spec: NodeSpec) -> list[str]:
        """The command that starts a node."""
        command = [*self.inside(name), *_NODE, spec.file, "--run-folder", str(self.folder), "--name", name]
        zid = "1" + secrets.token_hex(15)
        self.zids.add(zid)
        return [*command, "--endpoint", self.endpoint, "--run", self.run, "--zid", zid, *self.extra_arguments(name)]

    def _restart(self, child: Process) -> None:
        _close(child.process)
        child.process = self._spawn(child.name, child.spec, child.log)

    def end_now(self, child: Process) -> None:
        child.process.kill()
        child.process.wait()

    def _suspend(self, child: Process) -> None:
        child.process.send_signal(signal.SIGSTOP)

    def _resume(self, children: Iterable[Process]) -> None:
        for child in children:
            child.process.send_signal(signal.SIGCONT)

    def wait(self, child: Process, seconds: float) -> bool:
        try:
            child.process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def dispose(self, child: Process) -> None:
        _close(child.process)
        child.log.close()

    def end(self, grace_s: float) -> None:
        """End all nodes: resume them, close their inputs, wait, SIGTERM, SIGKILL."""
        self.resume(self.running())
        for child in self.running():
            _close(child.process)
        for action in ("wait", "terminate", "kill"):
            if action != "wait":
                for child in self.running():
                    child.notes.append(f"told to leave by {action}")
                    getattr(child.process, action)()
            deadline = time.monotonic() + grace_s
            for child in self.running():
                self.wait(child, max(0.0, deadline - time.monotonic()))
        for child in self.children.values():
            self.dispose(child)
        if self._server is not None:
            self._server.close()

    def _spawn(self, name: str, spec: NodeSpec, log: IO[bytes]) -> subprocess.Popen[bytes] | Forked:
        command = self.command(name, spec)
        if command[: len(_NODE)] == _NODE and forking.is_available():
            self._server = self._server or ForkServer(_environment())
            return self._server.start(command, self.folder, log)
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=self.folder,
            env=_environment(),
            start_new_session=True,
        )


def _environment() -> dict[str, str]:
    return {**os.environ, **ENVIRONMENT}


def _close(process: subprocess.Popen[bytes] | Forked) -> None:
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()
