"""Real processes on a real mesh, and fixtures that fail on leftovers."""

import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from launched import MAST, Launched


@pytest.fixture
def launch(start: Callable[..., Launched]) -> Callable[..., Launched]:
    """Starts `mast run` like a user."""
    return lambda *words: start(*MAST, "run", *words, "--no-report", "--out")


@pytest.fixture(autouse=True)
def nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fails if a test leaves a process, a thread or a socket file behind."""
    threads = set(threading.enumerate())

    def processes() -> list[psutil.Process]:
        children = []
        for process in psutil.process_iter(["cmdline"]):
            if process.pid != os.getpid() and any(str(tmp_path) in word for word in process.info["cmdline"] or ()):
                children.append(process)
        return children

    with tempfile.TemporaryDirectory(prefix="mast_", dir="/tmp") as own:  # short, as socket paths are limited
        monkeypatch.setenv("TMPDIR", own)
        monkeypatch.setattr(tempfile, "tempdir", None)
        yield
        monkeypatch.undo()
        deadline = time.monotonic() + 5.0
        while processes() and time.monotonic() < deadline:
            threading.Event().wait(0.05)
        files = list(Path(own).glob("**/*.sock"))
    left = processes()
    for process in left:
        process.kill()
    assert not left, f"processes left behind: {left}"
    assert not (new := set(threading.enumerate()) - threads), f"threads left behind: {new}"
    assert not files, f"sockets left: {files}"
