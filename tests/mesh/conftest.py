"""Real processes on a real mesh, and a fixture that fails the test which leaves anything of it behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh

from mast_zenoh.runtime.session import open_client


def eventually(condition: Callable[[], Any], what: str, seconds: float = 60.0) -> Any:
    """Wait until `condition` is true and return its value; fail when the deadline passes."""
    pause, deadline = threading.Event(), time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {seconds:.0f} s: {what}"
        pause.wait(0.02)
    return value


class Launched:
    """`mast run` as a user starts it, in a process of its own."""

    def __init__(self, out: Path, *arguments: str) -> None:
        self.out = out
        self.process = subprocess.Popen(
            [sys.executable, "-m", "mast_zenoh", "run", *arguments, "--no-report", "--out", str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=out.parent,
        )

    def record(self) -> dict[str, Any]:
        """run.json; empty while there is none."""
        path = self.out / "run.json"
        return json.loads(path.read_text()) if path.is_file() else {}

    def started(self) -> dict[str, Any]:
        """run.json, as soon as it names the processes."""

        def ready() -> dict[str, Any] | None:
            assert self.process.poll() is None, self.process.communicate()[0]
            record = self.record()
            return record if record.get("nodes") else None

        return eventually(ready, "run.json names the nodes")

    def pids(self) -> list[int]:
        """The nodes' process ids."""
        return [node["pid"] for node in self.record()["nodes"].values()]

    def end(self, seconds: float = 90.0) -> tuple[int, str]:
        """(exit code, output) when it has ended by itself."""
        output, _ = self.process.communicate(timeout=seconds)
        return self.process.returncode, output


class Observer:
    """A stranger on the mesh of a run: sees what every subscriber of an open mesh can see."""

    def __init__(self, record: dict[str, Any], keys: str = "**") -> None:
        self.prefix = f"mast/{record['id']}/"
        self.samples: list[tuple[str, zenoh.Sample]] = []
        self.session = open_client(record["endpoint"])
        handler = zenoh.handlers.Callback(self._take, indirect=False)
        self._subscriber = self.session.declare_subscriber(self.prefix + keys, handler)

    def _take(self, sample: zenoh.Sample) -> None:
        self.samples.append((str(sample.key_expr).removeprefix(self.prefix), sample))

    def frame(self) -> int:
        """How many clocks it has seen."""
        return sum(key == "clock" for key, _ in self.samples)

    def close(self) -> None:
        self.session.close()


def alive(pids: list[int]) -> list[int]:
    """Those of the processes that still run."""

    def runs(pid: int) -> bool:
        try:
            return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False

    return [pid for pid in pids if runs(pid)]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[..., Launched]]:
    """Starts runs; ends those that the test has left running."""
    runs: list[Launched] = []

    def start(*arguments: str) -> Launched:
        runs.append(Launched(tmp_path / f"run_{len(runs)}", *arguments))
        return runs[-1]

    yield start
    for run in runs:
        if run.process.poll() is None:
            run.process.kill()
            run.process.communicate()


@pytest.fixture(autouse=True)
def nothing_is_left_behind(tmp_path: Path) -> Iterator[None]:
    """Fails the test that leaves a process, a thread or a socket file."""
    threads = set(threading.enumerate())
    sockets = set(Path("/tmp").glob("**/*.sock"))
    yield

    def processes() -> list[psutil.Process]:
        mine = []
        for process in psutil.process_iter(["cmdline"]):
            if process.pid != os.getpid() and any(str(tmp_path) in word for word in process.info["cmdline"] or ()):
                mine.append(process)
        return mine

    deadline = time.monotonic() + 5.0
    while processes() and time.monotonic() < deadline:
        threading.Event().wait(0.05)
    left = processes()
    for process in left:
        process.kill()
    assert not left, f"processes left behind: {left}"
    assert not (new := set(threading.enumerate()) - threads), f"threads left behind: {new}"
    assert not (files := set(Path("/tmp").glob("**/*.sock")) - sockets), f"sockets left: {files}"
