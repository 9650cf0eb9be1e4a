"""Ends processes that a node's code has started, and that would outlive the node. Linux only: it reads /proc.

A node is the leader of a session. What it starts is in that session, unless it begins another one; then it is known by
the variable RUN in its environment, unless it has removed that as well.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection
from pathlib import Path

RUN = "MAST_RUN"  #: of the environment of all nodes of a run: its id

_ROUNDS, _ROUND_S = 100, 0.02  # a killed process may have started another one meanwhile


def end_own_strays() -> None:
    """End what this process has started, if a launcher has started it in a session of its own."""
    if sys.platform == "linux" and RUN in os.environ and os.getsid(0) == os.getpid():
        _end(lambda place: _session(place) == os.getpid())


def end_strays(run: str, groups: Collection[int]) -> None:
    """End all processes that have a run in their environment. To be called when its nodes have ended.

    groups: process groups of its nodes; what is left of them has been killed
    """
    mark = f"{RUN}={run}".encode()
    if sys.platform == "linux":
        _end(lambda place: mark in (place / "environ").read_bytes().split(b"\0"), groups)


def _end(is_stray: Callable[[Path], bool], groups: Collection[int] = ()) -> None:
    """Kill all processes of which this is true, given their folder in /proc; not this one."""
    ending = {-group for group in groups}
    for _ in range(_ROUNDS):
        strays = _strays(is_stray)
        for pid in strays:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        ending = {pid for pid in ending.union(strays) if _has_children(pid)}
        if not (strays or ending):
            return
        threading.Event().wait(_ROUND_S)


def _has_children(pid: int) -> bool:
    """Whether this process has a child with this id (or in a group, if negative) that runs; takes notice of others."""
    try:
        while os.waitpid(pid, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def _session(place: Path) -> int:
    """The session of a process; 0 if it has ended, and its parent has not taken notice."""
    fields = (place / "stat").read_text().rpartition(")")[2].split()
    return 0 if fields[0] in "ZX" else int(fields[3])


def _strays(is_stray: Callable[[Path], bool]) -> list[int]:
    pids = []
    for place in Path("/proc").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if place.name.isdigit() and int(place.name) != os.getpid() and is_stray(place):
                pids.append(int(place.name))
    return pids
