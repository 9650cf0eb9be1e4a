"""Runs in their own processes, their results, and an observer."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh

from mast_zenoh.config import bundle
from mast_zenoh.mesh.session import open_client

MAST = (sys.executable, "-m", "mast_zenoh")


def eventually(condition: Callable[[], Any], what: str, seconds: float = 120.0) -> Any:
    """Wait until `condition` is true and return its value; fail at the deadline."""
    pause, deadline = threading.Event(), time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {seconds:.0f} s: {what}"
        pause.wait(0.05)
    return value


class Launched:
    """A command that writes a run folder, in its own process."""

    def __init__(self, out: Path, *command: str, **environment: str) -> None:
        self.out = out
        self.process = subprocess.Popen(
            [*command, str(out)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=out.parent,
            env={**os.environ, "PYTHONFAULTHANDLER": "1", **environment},
        )

    def record(self) -> dict[str, Any]:
        """run.json, or {} before it exists."""
        path = self.out / "run.json"
        return json.loads(path.read_text()) if path.is_file() else {}

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Like `eventually`, but fail early when the process exits."""

        def come() -> Any:
            assert self.process.poll() is None, self.process.communicate()[0]
            return condition()

        return eventually(come, what)

    def started(self) -> dict[str, Any]:
        """run.json, once it names the nodes."""
        self.until(lambda: self.record().get("nodes"), "run.json names the nodes")
        return self.record()

    def at_frame(self, frame: int) -> dict[str, Any]:
        """run.json, once an open run has reached a frame."""
        record = self.started()
        with closing(Observer(record, "clock")) as observer:
            eventually(lambda: observer.frame() >= frame, f"{frame} clocks")
        return record

    def recorded(self) -> bool:
        """Whether the recorder has reported: frames are played."""
        path = self.out / "messages.mcap"
        return path.is_file() and path.stat().st_size > 0

    def pids(self) -> list[int]:
        """The nodes' process ids."""
        return [node["pid"] for node in self.record()["nodes"].values()]

    def end(self, seconds: float = 150.0) -> tuple[int, str]:
        """(exit code, output) after it ends; a stuck process prints its stack."""
        try:
            output, _ = self.process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)
            pytest.fail(f"not ended within {seconds:.0f} s: {self.process.communicate(timeout=10.0)[0]}")
        return self.process.returncode, output

    def ended(self, code: int = 0) -> str:
        """Its output, after it has ended with this exit code."""
        found, output = self.end()
        assert found == code, f"exit code {found}: {output}"
        return output

    def interrupted(self) -> str:
        """Its output, after Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        return self.ended(130)

    def kill(self) -> None:
        """Kill it unless it has ended."""
        with self.process:
            self.process.kill()


class Observer:
    """An observer on a run's open mesh that sees every message."""

    def __init__(self, record: dict[str, Any], keys: str = "**") -> None:
        self.prefix = f"mast/{record['id']}/"
        self.samples: list[tuple[str, zenoh.Sample]] = []
        self.session = open_client(record["endpoint"])
        handler = zenoh.handlers.Callback(self._take, indirect=False)
        self._subscriber = self.session.declare_subscriber(self.prefix + keys, handler)

    def _take(self, sample: zenoh.Sample) -> None:
        self.samples.append((str(sample.key_expr).removeprefix(self.prefix), sample))

    def publisher(self, key: str) -> zenoh.Publisher:
        """A publisher of a key, which blocks if the mesh is congested."""
        return self.session.declare_publisher(self.prefix + key, congestion_control=zenoh.CongestionControl.BLOCK)

    def frame(self) -> int:
        """The number of clocks received."""
        return sum(key == "clock" for key, _ in self.samples)

    def close(self) -> None:
        self.session.close()


def alive(pids: list[int]) -> list[int]:
    """The process ids that are still running."""

    def runs(pid: int) -> bool:
        try:
            return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False

    return [pid for pid in pids if runs(pid)]


def shared_packages() -> str:
    """A `.pth` file by which another environment has our sources, and what is installed in ours."""
    return "\n".join([str(bundle.ROOT), *(path for path in sys.path if path.endswith("site-packages"))])
