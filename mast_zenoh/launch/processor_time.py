"""The processor time of a process of this machine. Imports nothing slow: the supervisor on a host uses it too."""

from __future__ import annotations

import os
from pathlib import Path


def processor_time_s(pid: int) -> float | None:
    """The processor time that a process has used, s, in all its threads; None if it has ended, or is unknown."""
    try:
        # The name, in parentheses, may itself contain spaces and parentheses (proc(5)).
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError):
        return None
