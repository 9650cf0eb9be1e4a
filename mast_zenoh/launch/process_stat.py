"""What Linux says of a process. Imports nothing slow: the supervisor on a host uses it too."""

from __future__ import annotations

import os
from pathlib import Path


def stat_of(pid: int | str) -> list[str]:
    """The fields of /proc/PID/stat from the third one, the state; [] for a process that has ended, or is unknown."""
    try:
        # The name, in parentheses, may itself contain spaces and parentheses (proc(5)).
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return []


def began(pid: int) -> str | None:
    """When a process began, in clock ticks since boot; None if there is none, or it is a zombie.

    This identifies it, since process ids are reused.
    """
    fields = stat_of(pid)
    return None if not fields or fields[0] in "ZX" else fields[19]


def processor_time_s(pid: int) -> float | None:
    """The processor time that a process has used, s, in all its threads; None if it has ended, or is unknown."""
    fields = stat_of(pid)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") if len(fields) > 12 else None
