"""The right of an observer to the processors: less than that of any node."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runtime.mesh.hosting import LISTENER_NICENESS

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
    is_idle = niceness == _NICENESS and hasattr(os, "SCHED_IDLE")
    if is_idle:  # any node that wakes up takes the processor at once
        _schedule(os.SCHED_IDLE)
    _set_session(niceness)

    def restore() -> None:
        _set_session(0)
        if is_idle:
            _schedule(os.SCHED_OTHER)
        _set_niceness(before)

    return restore


def yield_to_nodes() -> Callable[[], None]:
    """Let nodes go first, in this thread alone: those of open sessions keep taking what arrives.

    Returns a function that ends it, as far as the system allows that.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    os.nice(LISTENER_NICENESS)
    _set_session(LISTENER_NICENESS)

    def restore() -> None:
        _set_session(0)
        _set_niceness(before)

    return restore


def _schedule(policy: int) -> None:
    """Set the scheduling policy of all threads."""
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):  # a container may forbid it; a thread may have ended
            os.sched_setscheduler(int(thread), policy, os.sched_param(0))


def _set_niceness(niceness: int) -> None:
    """Set the niceness of all threads."""
    tasks = Path("/proc/self/task")  # not on every system
    for thread in os.listdir(tasks) if tasks.is_dir() else ("0",):
        with suppress(OSError):  # only a privileged process may lower it
            os.setpriority(os.PRIO_PROCESS, int(thread), niceness)


def _set_session(niceness: int) -> None:
    with suppress(OSError):  # not on every system
        Path("/proc/self/autogroup").write_text(str(niceness))
