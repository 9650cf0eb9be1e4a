"""Runs a resolved scenario on this machine: as processes on a mesh of its own, or in this process."""

from __future__ import annotations

import os
import queue
import secrets
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rich.console import Console

from mast_zenoh.errors import Interrupted, MastError, NodeDied, RunError, StallError, StartError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.supervisor import Child, Supervisor, how_ended
from mast_zenoh.runtime import results
from mast_zenoh.runtime.inproc import InProcess
from mast_zenoh.runtime.mesh import ATTACHMENT, prefix
from mast_zenoh.runtime.session import open_client, open_router
from mast_zenoh.scenario import Resolved

_POLL_S = 0.05
_LEAVE_GRACE_S = 20.0  # from the end of the scene to the last node's results
_INTERRUPT_GRACE_S = 5.0
_END_GRACE_S = 1.0  # between closing inputs, SIGTERM and SIGKILL


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
    console: Console | None = None,
) -> Run:
    """Run a scenario and write its run folder; what goes wrong is in the result and in run.json.

    endpoint: of a router that is there already; None: one in this process, listening at `listen`
    Raises RunFolderError before anything is started.
    """
    console = console or Console(quiet=True)
    folder = run_folder.create(out, resolved.name)
    resolved.write(folder)
    record: dict[str, Any] = {
        "id": f"{resolved.name}-{secrets.token_hex(4)}",
        "name": resolved.name,
        "status": "running",
        "message": "",
        "runtime": runtime,
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
                Launch(resolved, folder, record, display, endpoint, listen).run()
    except MastError as caught:
        error = caught
    record["timings"]["total_s"] = round(time.monotonic() - begun, 3)
    record["status"] = "ok" if error is None else "interrupted" if isinstance(error, Interrupted) else "failed"
    record["message"] = str(error) if error else record["message"]
    run_folder.write_json(folder / "run.json", record)
    return Run(folder, record, error)


def _run_inproc(resolved: Resolved, folder: Path, record: dict[str, Any], display: Display) -> None:
    """All nodes in this process."""
    states = dict.fromkeys(resolved.nodes, "running")
    with stop_signals() as received:

        def progress(frame: int) -> bool:
            display.update(frame, states)
            return not received

        process = InProcess(resolved.in_folder(folder), progress=progress)
        outcomes = process.run()
    timing = outcomes.pop("")
    record["timings"] |= _rates(timing["frames"], timing["wall_s"])
    for name, host in process.hosts.items():
        record["nodes"][name] = {
            "role": resolved.nodes[name].role,
            "pid": os.getpid(),
            "exit": 0,
            "ended": "ok",
            "restarts": 0,
            "last_frame": host.frame,
            "rejected": {f"{key}: {reason}": n for (key, reason), n in host.rejected.items()},
            "foreign": 0,
            "failures": dict(host.failures),
        }
    _note_recording(record, outcomes)
    run_folder.write_results(folder, outcomes, None)
    if received:
        raise Interrupted("stopped by Ctrl-C or SIGTERM")


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """The SIGINT and SIGTERM that come while it lasts, instead of what they would do."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda n, _: received.append(n)) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass
class Launch:
    """One run on a mesh, from the first process to the last."""

    resolved: Resolved
    folder: Path
    record: dict[str, Any]
    display: Display
    endpoint: str | None
    listen: str
    outcomes: dict[str, dict[str, Any]] = field(default_factory=dict)
    frame: int = -1
    problem: RunError | None = None
    stopping_since: float | None = None
    signals: list[int] = field(default_factory=list)
    _handed_in: queue.SimpleQueue[tuple[str, bytes]] = field(default_factory=queue.SimpleQueue)

    def run(self) -> None:
        """Start the nodes, watch them to the end, write the results. Raises RunError for a run that failed."""
        session, endpoint = (open_client(self.endpoint), self.endpoint) if self.endpoint else open_router(self.listen)
        supervisor = Supervisor(self.folder, self.record["id"], endpoint)
        self.record["endpoint"] = endpoint
        begun = time.monotonic()
        with session, stop_signals() as self.signals:
            declared = self._declare(session)
            try:
                for name, spec in self.resolved.nodes.items():
                    supervisor.start(name, spec)
                self.record["nodes"] = supervisor.to_json({})
                run_folder.write_json(self.folder / "run.json", self.record)
                self._watch(session, supervisor)
            finally:
                supervisor.end(_END_GRACE_S)
                self._take_results()
                for entity in declared:
                    entity.undeclare()
        self._conclude(supervisor, begun)

    def _declare(self, session: zenoh.Session) -> list[Any]:
        """Listen for results and for the progress of the clock."""
        base = prefix(self.record["id"])

        def on_result(query: zenoh.Query) -> None:
            payload = query.payload.to_bytes() if query.payload else b""
            self._handed_in.put((str(query.key_expr).rpartition("/")[2], payload))
            query.reply(query.key_expr, b"taken")

        def on_clock(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            if attachment and len(attachment) == ATTACHMENT.size:
                self.frame = ATTACHMENT.unpack(attachment.to_bytes())[2]

        direct = zenoh.handlers.Callback
        return [
            session.declare_queryable(f"{base}/@control/result/*", direct(on_result, indirect=False)),
            session.declare_subscriber(f"{base}/clock", direct(on_clock, indirect=False)),
        ]

    def _watch(self, session: zenoh.Session, supervisor: Supervisor) -> None:
        """Until every process has ended, or the grace of a run that is to stop is over."""
        pause = threading.Event()
        interrupted = 0
        while supervisor.running():
            pause.wait(_POLL_S)
            self._take_results()
            for child in supervisor.newly_ended():
                self._ended(child, supervisor, session)
            if len(self.signals) > interrupted:
                interrupted = len(self.signals)
                self.problem = Interrupted("stopped by Ctrl-C or SIGTERM")
                self._stop(session, "interrupted")
                if interrupted > 1:
                    return
            if self.stopping_since is not None:
                grace = _INTERRUPT_GRACE_S if interrupted else _LEAVE_GRACE_S
                if time.monotonic() - self.stopping_since > grace:
                    return
            self.display.update(self.frame + 1, self._states(supervisor))

    def _ended(self, child: Child, supervisor: Supervisor, session: zenoh.Session) -> None:
        """A process has ended: as it should, or not."""
        self._take_results()
        if child.name in self.outcomes and child.exit == 0:
            return
        if self.stopping_since is not None and child.exit == 0:
            return
        what = f"{child.name} {how_ended(child.exit)} at frame {self.frame}"
        if self.frame < 0:
            self.problem = StartError(
                f"{child.name} ended before the first frame: {how_ended(child.exit)}{self._last_words(child)}"
            )
            self._stop(session, "a node did not start")
        elif child.spec.on_exit == "continue":
            self.display.say(f"[yellow]{what}; going on without it")
        elif child.spec.on_exit == "restart" and self.stopping_since is None:
            again = supervisor.restart(child)
            self.display.say(f"[yellow]{what}; {'restarted' if again else 'restarted too often, going on without it'}")
        elif self.problem is None:
            self.problem = NodeDied(f"{what}; see logs/{child.name}.log{self._last_words(child)}")
            self._stop(session, "a node died")

    def _last_words(self, child: Child) -> str:
        lines = (self.folder / "logs" / f"{child.name}.log").read_text(errors="replace").strip().splitlines()
        return f": {lines[-1]}" if lines else ""

    def _stop(self, session: zenoh.Session, reason: str) -> None:
        """Ask everyone to finish."""
        if self.stopping_since is None:
            self.stopping_since = time.monotonic()
            session.put(f"{prefix(self.record['id'])}/@control/stop", reason)

    def _take_results(self) -> None:
        while not self._handed_in.empty():
            name, payload = self._handed_in.get()
            self.outcomes[name] = results.unpack(payload)
            reason = self.outcomes[name].get("stop_reason")
            if reason is not None:
                if self.stopping_since is None:
                    self.stopping_since = time.monotonic()
                if reason.startswith("stall"):
                    self.problem = self.problem or StallError(reason)
                elif reason.startswith("start"):
                    self.problem = self.problem or StartError(reason)

    def _states(self, supervisor: Supervisor) -> dict[str, str]:
        def state(child: Child) -> str:
            if child.exit is not None:
                return "done" if child.exit == 0 else "dead"
            return "running" if self.frame >= 0 else "starting"

        return {name: state(child) for name, child in supervisor.children.items()}

    def _conclude(self, supervisor: Supervisor, begun: float) -> None:
        """Write what came, and raise what went wrong."""
        self.record["nodes"] = supervisor.to_json(self.outcomes)
        driver: Mapping[str, Any] = next((o for o in self.outcomes.values() if "sent_ns" in o), {})
        if driver:
            self.record["timings"] |= _rates(driver["frames"], driver["wall_s"])
            self.record["timings"]["start_s"] = round(time.monotonic() - begun - driver["wall_s"], 3)
        gone = [c for c in supervisor.children.values() if c.name not in self.outcomes and c.exit != 0]
        self.record["message"] = "; ".join(f"{child.name} {child.ended}" for child in gone)
        wall = None
        if self.resolved.mode == "realtime":
            wall = {
                "latency_ms": {"sim_to_picture": self._measured_latency(driver)},
                "frames_per_second": self.record["timings"].get("frames_per_second"),
            }
        handed_in = {name: outcome["results"] for name, outcome in self.outcomes.items()}
        _note_recording(self.record, handed_in)
        run_folder.write_results(self.folder, handed_in, wall)
        if self.problem is None and "evaluator" not in self.outcomes and "evaluator" in supervisor.children:
            self.problem = RunError("the evaluator handed in no results")
        if self.problem is not None:
            raise self.problem

    def _measured_latency(self, driver: Mapping[str, Any]) -> dict[str, float | None]:
        """From the moment a frame was sent to that at which the evaluator got its picture, on the wall clock."""
        sent = driver.get("sent_ns", {})
        got = self.outcomes.get("evaluator", {}).get("arrived_ns", {}).get("cc/picture", {})
        latency = [(got[frame] - sent[frame]) * 1e-6 for frame in got if frame in sent]
        if not latency:
            return {"p50": None, "p95": None, "p99": None}
        return {f"p{p}": round(float(np.percentile(latency, p)), 3) for p in (50, 95, 99)}


def _note_recording(record: dict[str, Any], handed_in: Mapping[str, Mapping[str, Any]]) -> None:
    """How many messages were recorded goes to run.json, and a note if some could not be."""
    for outcome in handed_in.values():
        if "recorded" in outcome:
            record["recorded"] = outcome["recorded"]
            if lost := outcome["recorded"]["lost"]:
                said = [record["message"]] if record["message"] else []
                record["message"] = "; ".join([*said, f"{lost} messages could not be recorded"])


def _rates(frames: int, wall_s: float) -> dict[str, Any]:
    return {"run_s": round(wall_s, 4), "frames_per_second": round(frames / wall_s, 2) if wall_s else None}
