"""The processes of a run: start, watch, restart and end them. Ends only what it has started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from mast_zenoh.scenario import NodeSpec

MAX_RESTARTS = 5

#: One thread per node: many small arrays gain nothing from more, and the nodes share the machine.
_ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass
class Child:
    """A node's process and what became of it."""

    name: str
    spec: NodeSpec
    command: list[str]
    log: IO[bytes]
    process: subprocess.Popen[bytes]
    restarts: int = 0
    told: bool = False  # whether its end has been dealt with
    notes: list[str] = field(default_factory=list)

    @property
    def exit(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        return self.process.poll()

    @property
    def ended(self) -> str:
        """How it ended, in words."""
        return "; ".join([*self.notes, how_ended(self.exit)])


def how_ended(code: int | None) -> str:
    """An exit code in words."""
    if code is None:
        return "running"
    if code == 0:
        return "ok"
    return f"killed by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"exit code {code}"


class Supervisor:
    """Starts each node's file as a process of its own, in a session of its own (Ctrl-C is ours, not theirs).

    Each child's standard input is a pipe that we hold: when we end, however that may be, it closes, and they leave.
    """

    def __init__(self, folder: Path, run: str, endpoint: str) -> None:
        self.folder = folder
        self.run = run
        self.endpoint = endpoint
        self.children: dict[str, Child] = {}

    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node."""
        command = [sys.executable, spec.file, "--run-folder", str(self.folder), "--name", name]
        command += ["--endpoint", self.endpoint, "--run", self.run]
        log = (self.folder / "logs" / f"{name}.log").open("ab", buffering=0)
        self.children[name] = Child(name, spec, command, log, self._spawn(command, log))

    def restart(self, child: Child) -> bool:
        """Start a node again after its process has ended; False when it has been restarted too often."""
        if child.restarts >= MAX_RESTARTS:
            return False
        child.notes.append(how_ended(child.exit))
        child.restarts += 1
        child.told = False
        _close(child.process)
        child.process = self._spawn(child.command, child.log)
        return True

    def newly_ended(self) -> list[Child]:
        """Children whose processes have ended since the last call."""
        ended = [child for child in self.children.values() if not child.told and child.exit is not None]
        for child in ended:
            child.told = True
        return ended

    def running(self) -> list[Child]:
        """Children whose processes run."""
        return [child for child in self.children.values() if child.exit is None]

    def end(self, grace_s: float) -> None:
        """End all: close their inputs, wait, SIGTERM, SIGKILL."""
        for child in self.running():
            assert child.process.stdin is not None
            child.process.stdin.close()
        for action in ("wait", "terminate", "kill"):
            if action != "wait":
                for child in self.running():
                    child.notes.append(f"told to leave by {action}")
                    getattr(child.process, action)()
            deadline = time.monotonic() + grace_s
            for child in self.running():
                try:
                    child.process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
        for child in self.children.values():
            _close(child.process)
            child.log.close()

    def to_json(self, reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The `nodes` part of run.json; `reports` are what the nodes themselves handed in."""
        return {
            name: {
                "role": child.spec.role,
                "pid": child.process.pid,
                "exit": child.exit,
                "ended": child.ended,
                "restarts": child.restarts,
                "log": f"logs/{name}.log",
                **{
                    key: reports.get(name, {}).get(key)
                    for key in ("last_frame", "cpu_s", "rejected", "foreign", "failures")
                },
            }
            for name, child in self.children.items()
        }

    def _spawn(self, command: list[str], log: IO[bytes]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            cwd=self.folder,
            env={**os.environ, **_ENVIRONMENT},
            start_new_session=True,
        )


def _close(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()
