"""Nothing that a run has started is running any more."""

from __future__ import annotations

import json
from pathlib import Path

from mast_zenoh.checks.base import Check

NAME = "processes"
_PROC = Path("/proc")


def check_processes(folder: Path) -> Check:
    """No process of a run on a mesh is left: none that run.json names, and none that was started with its folder."""
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    if run.get("runtime") == "inproc":
        return Check.skipped(NAME, "the run was in one process")
    if not _PROC.is_dir():
        return Check.skipped(NAME, "this system does not show its processes under /proc")
    left = _running(str(folder), str(run.get("id", "")))
    if left:
        told = ", ".join(f"{name} ({pid})" for pid, name in sorted(left.items()))
        return Check(NAME, False, f"still running: {told}", {"checked": True, "left": sorted(left)})
    return Check(NAME, True, f"none of {len(run.get('nodes', {}))} nodes is left", {"checked": True, "left": []})


def _running(folder: str, run: str) -> dict[int, str]:
    """Processes whose command line names the folder and the id of a run, by their ids: the node that each is."""
    found = {}
    for entry in _PROC.iterdir():
        if not entry.name.isdigit():
            continue
        try:
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
        except (OSError, IndexError):
            continue  # it has just ended, or is not ours to see
        if state not in "ZX" and folder in words and run in words and "--name" in words:
            found[int(entry.name)] = words[words.index("--name") + 1]
    return found
