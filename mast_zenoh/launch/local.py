"""Runs a resolved scenario on this machine: as processes on a mesh of its own, or in this process."""

from __future__ import annotations

import os
import secrets
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from mast_zenoh import checks
from mast_zenoh.errors import (
    BackendError,
    Interrupted,
    MastError,
)
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import steps
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.launching import Launch
from mast_zenoh.launch.signals import stop_signals
from mast_zenoh.resolved import Resolved
from mast_zenoh.runtime import results
from mast_zenoh.runtime.inproc import InProcess


@dataclass
class Run:
    """A run that has ended: its folder, its run.json, and why it failed, if it did."""

    folder: Path
    record: dict[str, Any]
    error: MastError | None = None


def run(
    resolved: Resolved,
    out: Path | None = None,
    *,
    runtime: str = "mesh",
    endpoint: str | None = None,
    listen: str = "tcp/127.0.0.1:0",
    secure: str = "open",
    engine: Engine | None = None,
    prepare: Callable[[Launch], None] = lambda launch: None,
    console: Console | None = None,
) -> Run:
    """Run a scenario and write its run folder; what goes wrong is in the result and in run.json.

    endpoint: of a router that is there already; None: one in this process, listening at `listen`
    secure:   one of `security.levels.LEVELS`; above "open", who takes part gets certificates for this run alone
    engine:   where the nodes live, if not here as processes: it brings its own router
    prepare:  called with what will launch the run on its mesh, before it does
    Raises RunFolderError, DiskFull and, of the engine, BackendError and EngineError before anything is started.
    """
    console = console or Console(quiet=True)
    where = f"engine {engine.name}" if engine else "one process" if runtime == "inproc" else "processes of this machine"
    steps.check(resolved, where, unplugs=engine is not None and engine.unplugs)
    if engine is not None:
        engine.check(resolved, secure)
    folder = run_folder.create(out, resolved.name)
    resolved.write(folder)
    record: dict[str, Any] = {
        "id": f"{resolved.name}-{secrets.token_hex(4)}",
        "name": resolved.name,
        "status": "running",
        "message": "",
        "runtime": runtime,
        "security": secure,
        "mode": resolved.mode,
        "rate": resolved.rate,
        "seed": resolved.seed,
        "frames": resolved.frames,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": [os.path.basename(sys.argv[0]), *sys.argv[1:]],
        "versions": run_folder.versions(),
        "timings": {},
        "nodes": {},
    }
    run_folder.write_json(folder / "run.json", record)
    begun = time.monotonic()
    error: MastError | None = None
    try:
        with Display(console, resolved.name, resolved.frames) as display:
            if runtime == "inproc":
                _run_inproc(resolved, folder, record, display)
            else:
                launch = Launch(resolved, folder, record, display, endpoint, listen, secure, engine)
                prepare(launch)
                launch.run()
    except MastError as caught:
        error = caught
    record["timings"]["total_s"] = round(time.monotonic() - begun, 3)
    record["status"] = "ok" if error is None else "interrupted" if isinstance(error, Interrupted) else "failed"
    record["message"] = str(error) if error else record["message"]
    run_folder.write_json(folder / "run.json", record)
    if any(entry["kind"] != "attack" for entry in resolved.timeline):
        checks.run(folder, resolved)
    return Run(folder, record, error)


def _run_inproc(resolved: Resolved, folder: Path, record: dict[str, Any], display: Display) -> None:
    """All nodes in this process."""
    if resolved.network.get("faults"):
        raise BackendError("host faults need hosts: one process has no network between its nodes; use runtime 'mesh'")
    states = dict.fromkeys(resolved.nodes, "running")
    with stop_signals() as received:

        def progress(frame: int) -> bool:
            display.update(frame, states)
            return not received

        process = InProcess(resolved.in_folder(folder), progress=progress)
        outcomes = process.run()
    timing = outcomes.pop("")
    record["timings"] |= run_folder.rates(timing["frames"], timing["wall_s"])
    record["steps"] = [step._asdict() for step in process.steps]
    for name, host in (process.hosts | process.gone).items():
        killed = name not in outcomes
        record["nodes"][name] = {
            "role": resolved.nodes[name].role,
            "pid": os.getpid(),
            "exit": None if killed else 0,
            "ended": "killed by the scenario" if killed else "ok",
            "restarts": [(s.node, s.action) for s in process.steps].count((name, "start"))
            - (name in process.timetable.absent),
            "last_frame": host.frame,
            "rejected": {f"{key}: {reason}": n for (key, reason), n in host.rejected.items()},
            "foreign": 0,
            "failures": dict(host.failures),
        }
    run_folder.note_recording(record, outcomes)
    run_folder.write_results(folder, outcomes, {"late": results.late(outcomes)})
    if received:
        raise Interrupted("stopped by Ctrl-C or SIGTERM")
