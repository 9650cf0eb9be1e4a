"""The right of an observer to the processors: less than that of any node."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.runtime.mesh.hosting import LISTENER_NICENESS

#: Niceness of an observer, the greatest: no frame waits for it. An environment variable changes it.
_NICENESS, NICENESS = 19, "MAST_VIEWER_NICENESS"


def yield_processors() -> None:
    """Let every other process go first. Only for a process with a session of its own.

    Linux shares processors between sessions before it looks at the niceness of processes, so the session's own
    niceness counts.
    """
    value = os.environ.get(NICENESS, str(_NICENESS))
    if not value.isdigit() or int(value) > _NICENESS:
        raise ConfigurationError(f"{NICENESS}: found {value!r}, expected a number from 0 to {_NICENESS}")
    niceness = int(value)
    os.nice(niceness)
    if niceness == _NICENESS and hasattr(os, "SCHED_IDLE"):  # any node that wakes up takes the processor at once
        with suppress(PermissionError):  # a container may forbid it
            for thread in os.listdir("/proc/self/task"):
                os.sched_setscheduler(int(thread), os.SCHED_IDLE, os.sched_param(0))
    _set_session(niceness)


def yield_to_nodes() -> None:
    """Let nodes go first, in this thread alone: those of open sessions keep taking what arrives."""
    os.nice(LISTENER_NICENESS)
    _set_session(LISTENER_NICENESS)


def _set_session(niceness: int) -> None:
    with suppress(OSError):  # not on every system
        Path("/proc/self/autogroup").write_text(str(niceness))
