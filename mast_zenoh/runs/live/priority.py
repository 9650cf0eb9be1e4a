"""The right of an observer to the processors: less than that of any node."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.mesh.hosting import LISTENER_NICENESS

#: Niceness of an observer, the greatest: no frame waits for it. An environment variable changes it.
_NICENESS, NICENESS = 19, "MAST_VIEWER_NICENESS"


def yield_processors() -> Callable[[], None]:
    """Let every other process go first. Only for a process with a session of its own.

    Linux shares processors between sessions before it looks at the niceness of processes, so the session's own
    niceness counts. Returns a function that ends it, as far as the system allows that.
    """
    value = os.environ.get(NICENESS, str(_NICENESS))
    if not value.isdigit() or int(value) > _NICENESS:
        raise ConfigurationError(f"{NICENESS}: found {value!r}, expected a number from 0 to {_NICENESS}")
    niceness = int(value)
    before = os.getpriority(os.PRIO_PROCESS, 0)
    os.nice(niceness)
    if niceness == _NICENESS and hasattr(os, "SCHED_IDLE"):  # any node that wakes up takes the processor at once
        _schedule(os.getpid(), os.SCHED_IDLE)
    _set_session(os.getpid(), niceness)
    return lambda: restore(os.getpid(), before)


def yield_to_nodes() -> Callable[[], None]:
    """Let nodes go first, in this thread alone: those of open sessions keep taking what arrives.

    Returns a function that ends it, as far as the system allows that.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    os.nice(LISTENER_NICENESS)
    _set_session(os.getpid(), LISTENER_NICENESS)
    return lambda: restore(os.getpid(), before)


def restore(process: int, niceness: int) -> None:
    """Take back that an observer yields, as far as the system allows that. process: its id

    Call it before you wait for an observer: beside busy processes, one that yields may never notice that its run ended.
    """
    _set_session(process, 0)
    if hasattr(os, "SCHED_IDLE") and os.sched_getscheduler(process) == os.SCHED_IDLE:
        _schedule(process, os.SCHED_OTHER)
    _set_niceness(process, niceness)


def _schedule(process: int, policy: int) -> None:
    """Set the scheduling policy of all threads."""
    for thread in _threads(process):
        with suppress(OSError):  # a container may forbid it; a thread may have ended
            os.sched_setscheduler(thread, policy, os.sched_param(0))


def _set_niceness(process: int, niceness: int) -> None:
    """Set the niceness of all threads."""
    for thread in _threads(process):
        with suppress(OSError):  # only a privileged process may lower it
            os.setpriority(os.PRIO_PROCESS, thread, niceness)


def _threads(process: int) -> list[int]:
    with suppress(OSError):  # not on every system; the process may have ended
        return [int(thread) for thread in os.listdir(f"/proc/{process}/task")]
    return [process]


def _set_session(process: int, niceness: int) -> None:
    with suppress(OSError):  # not on every system
        Path(f"/proc/{process}/autogroup").write_text(str(niceness))
