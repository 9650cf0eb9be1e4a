"""Whether there is room for what a run writes."""

from __future__ import annotations

import os
from pathlib import Path

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import DiskFull

#: Logs, tables, figures, and what is not to be taken from everybody else.
_ALWAYS = 64 << 20

#: Of a recording, by frame and node, on the large side: tracks and detections of some fifty objects.
_RECORDED = 16 << 10


def needed(resolved: Resolved) -> int:
    """Bytes that a run may need in its folder."""
    recorded = any(spec.role == "recorder" for spec in resolved.nodes.values())
    return _ALWAYS + (_RECORDED * resolved.frames * len(resolved.nodes) if recorded else 0)


def check(place: Path, needed: int) -> None:
    """Raise DiskFull when the file system of a place, which may not be there yet, has less room."""
    there = place.absolute()
    while not there.exists():
        there = there.parent
    found = os.statvfs(there)
    free = found.f_bavail * found.f_frsize
    if free < needed:
        raise DiskFull(f"{place}: {free >> 20} MiB are free, {needed >> 20} MiB may be needed; name another with --out")
