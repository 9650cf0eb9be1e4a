"""Checks that no process of a run is left running."""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.checks.base import Check
from mast_zenoh.run_files import read_object

NAME = "processes"
_PROC = Path("/proc")


def check_processes(folder: Path) -> Check:
    """Check that no process has the id and folder of the run on its command line."""
    run = read_object(folder / "run.json")
    if run.get("runtime") == "inproc":
        return Check.skipped(NAME, "the run was a single process")
    if not _PROC.is_dir():
        return Check.skipped(NAME, "this system does not show its processes under /proc")
    remaining = _running(str(folder), str(run.get("id", "")))
    if remaining:
        processes = ", ".join(f"{name} ({pid})" for pid, name in sorted(remaining.items()))
        return Check(NAME, False, f"still running: {processes}", {"checked": True, "left": sorted(remaining)})
    return Check(NAME, True, f"none of {len(run.get('nodes', {}))} nodes is left", {"checked": True, "left": []})


def _running(folder: str, run: str) -> dict[int, str]:
    """Node names by process id, of processes with this folder and run id."""
    nodes = {}
    for entry in _PROC.iterdir():
        if not entry.name.isdigit():
            continue
        try:
            arguments = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
        except (OSError, IndexError):
            continue  # it has just ended, or belongs to another user
        if state not in "ZX" and folder in arguments and run in arguments and "--name" in arguments:
            nodes[int(entry.name)] = arguments[arguments.index("--name") + 1]
    return nodes
