"""Checks that the disk has room for the files of a run."""

from __future__ import annotations

import os
from pathlib import Path

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import DiskFull

#: Bytes for logs, tables and figures, and a reserve for other programs.
_ALWAYS = 64 << 20

#: Bytes of a recording per frame and node, generously: tracks and detections of some fifty objects.
_RECORDED = 16 << 10


def needed(resolved: Resolved) -> int:
    """Bytes that a run may need in its folder."""
    recorded = any(spec.role == "recorder" for spec in resolved.nodes.values())
    return _ALWAYS + (_RECORDED * resolved.frames * len(resolved.nodes) if recorded else 0)


def check(place: Path, needed: int) -> None:
    """Raise DiskFull if a path's file system has less space; the path may not exist."""
    folder = place.absolute()
    while not folder.exists():
        folder = folder.parent
    status = os.statvfs(folder)
    free = status.f_bavail * status.f_frsize
    if free < needed:
        raise DiskFull(f"{place}: {free >> 20} MiB are free, {needed >> 20} MiB may be needed; name another with --out")
