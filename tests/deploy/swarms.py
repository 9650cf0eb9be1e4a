"""A swarm of this one machine, for as long as tests need it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from containers import built

from mast_zenoh.deploy.docker import docker


@contextmanager
def swarm() -> Iterator[str]:
    """The tag of an image of these sources, while there is a swarm; one that is there already stays.

    Skips the test where there is no engine, and fails where there must be one: see containers.py.
    """
    tag = built()
    made = docker("info", "--format", "{{.Swarm.LocalNodeState}}").strip() == "inactive"
    if made:
        docker("swarm", "init", "--advertise-addr", "127.0.0.1")
    try:
        yield tag
    finally:
        if made:
            docker("swarm", "leave", "--force")


def eventually(condition: Callable[[], bool], what: str, seconds: float = 120.0) -> None:
    """Wait until it is so; fail when the deadline passes."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds:.0f} s: {what}"
        threading.Event().wait(0.2)
