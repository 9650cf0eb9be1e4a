"""Runs a resolved scenario: as processes on a mesh, or in this process."""

from __future__ import annotations

import logging
import os
import resource
import secrets
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.markup import escape

from mast_zenoh import kernels, run_folder
from mast_zenoh.config import plugins, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import BackendError, MastError, ResourcesExhausted
from mast_zenoh.launch import checks, conclusion, ending, liveness, mesh_run, stop_signals
from mast_zenoh.launch.context import RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.observation import InProcessObservation
from mast_zenoh.launch.processes import check_interpreters
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import failures
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.mesh.protocol_log import PROTOCOL_LOGS
from mast_zenoh.messages import user_types
from mast_zenoh.messages.packed import check_kernels
from mast_zenoh.run_folder.recording import churn, script
from mast_zenoh.scenes import Scene, inspection
from mast_zenoh.wiring.model import Wiring

#: Where scenes are generated.
_GENERATED = "mast_zenoh.scenes.generated."
#: Descriptors that any run needs, and for each process of a mesh: a pipe, a log, its connection to the router.
BASE, PER_NODE = 64, 16


def ensure_descriptors(processes: int) -> None:
    """Raise this process's limit to what a run needs; its nodes inherit it.

    processes: number of nodes that are processes of their own
    Raises ResourcesExhausted if the system does not allow as many.
    """
    needed = BASE + PER_NODE * processes
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ResourcesExhausted(
            f"found a limit of {hard} file descriptors, expected at least {needed} for this run: raise it (ulimit -n)"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


class NodeLogs(logging.Handler):
    """Context manager that appends records of logger `mast.<node>` to <node>.log.

    A file is created at the first record.

    failure: why the logs are incomplete; None if nothing was lost
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter(_FORMAT))
        self.failure: OSError | None = None
        self._folder = folder
        self._files: dict[str, TextIO] = {}
        self._logger = logging.getLogger("mast")

    def __enter__(self) -> NodeLogs:
        self._logger.addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        for file in self._files.values():
            try:
                file.close()
            except OSError as error:
                self.failure = self.failure or error

    def emit(self, record: logging.LogRecord) -> None:
        """Append a record to its node's file."""
        node = record.name.removeprefix("mast.")
        try:
            if node not in self._files:
                self._files[node] = (self._folder / f"{node}.log").open("a", encoding="utf-8")
            print(self.format(record), file=self._files[node], flush=True)
        except OSError as error:  # must not fail the handler that logs
            self.failure = self.failure or error


def check_steps(resolved: Resolved, where: str, *, unplugs: bool) -> None:
    """Raise BackendError for steps that are impossible where the nodes live.

    where: in words; unplugs: whether nodes can be disconnected from their networks there
    """
    for step in resolved.steps:
        if step.action == "disconnect" and not unplugs:
            raise BackendError(
                f"Unplug of {step.node!r} (before frame {step.frame}): only the containers of engine compose can be "
                f"disconnected from their networks (mast deploy up --engine compose), found {where}; use Partition, or "
                "on this machine `hosts` with HostPartition"
            )


@dataclass
class EndedRun:
    """A run that has ended: its folder, its run.json, and why it failed, if it did."""

    folder: Path
    record: dict[str, Any]
    error: MastError | None = None

    @property
    def failures(self) -> dict[str, list[failures.Entry]]:
        """The failures of handlers by node, including allowed ones."""
        nodes = self.record["nodes"]
        return {name: node["failures"] for name, node in nodes.items() if node.get("failures")}

    @property
    def logs(self) -> dict[str, str]:
        """The paths of the nodes' logs."""
        return {name: str(self.folder / node["log"]) for name, node in self.record["nodes"].items() if node.get("log")}


def run(
    resolved: Resolved,
    out: Path | None = None,
    *,
    runtime: str = "mesh",
    endpoint: str | None = None,
    listen: str = "tcp/127.0.0.1:0",
    secure: str = "open",
    engine: Engine | None = None,
    allow_failures: bool = False,
    allow_churn: bool = False,
    prepare: Callable[[RunContext], None] = lambda context: None,
    console: Console | None = None,
    quiet: bool = False,
    debug_protocol: bool = False,
    command: Sequence[str] | str | None = None,
    replay: Mapping[str, Any] | None = None,
) -> EndedRun:
    """Run a scenario and write its run folder; the result and run.json hold any error.

    endpoint: of an existing router; None: start one in this process, listening at `listen`
    secure:   one of `security.levels.LEVELS`; above "open", every participant gets certificates for this run alone
    engine:   where the nodes live, if not here as processes; it has its own router
    allow_failures: whether a run in which a handler failed is still "ok"; otherwise its error is HandlerFailed
    allow_churn: whether a lock-step run in which a node was lost is still "ok"; otherwise its error is NodeLost
    prepare:  called with the context of a run on a mesh before it starts: to set detours, and to observe the run
    debug_protocol: whether each process on a mesh logs its protocol, see `mesh.protocol_log`
    quiet:    print no progress, only what deserves attention
    command:  what started the run, for run.json; None: this process's command line
    replay:   of a replay: what it replays, for run.json and metrics.json, with `notices`, a sentence for each thing
              that is missing
    Raises RunFolderError, DiskFull, ConfigurationError without the kernels or with an interpreter that it cannot use,
    VersionMismatch for an interpreter with another mast-zenoh, and, of the engine,
    BackendError and EngineError before anything is started.

    Keys:
    id, name: of the run; of the scenario
    status: `ok`, `handler_failures`, `node_lost`, `failed`, `interrupted` or `running`, see
        docs/explanation-architecture.md#how-a-run-ends
    message: why it failed; empty: it did not
    runtime, mode, rate, security: `mesh` or `inproc`; `lockstep` or `realtime`; speed in real time; security level
    seed, frames: of all random draws; number of frames to play
    started, command: date and time, UTC; the command line
    launcher: process of the launcher, by which others know whether the run still goes on
    versions: of Python, packages and the platform; `kernels` is `compiled` or `numpy`
    kernels_not_used: why compiled kernels were not in use, if so
    engine_plugin: the plugin of the engine that deployed the run, with its version, if it is of one
    suspicious: what is suspicious about the scene, if anything
    timings: of the run on the wall clock, see below
    nodes: by name, see below
    innovations: by node with a tracker, see docs/ref-metrics.md
    churn: nodes that came and went unplanned: `frame`, `node`, and `what`: lost or back
    steps: actions of faults on processes: `frame`, `action` and `node`
    interceptions: nodes that were inserted and released during the run
    recording: `complete`, and else `from_frame`, from which on messages are missing
    recorded: `messages`, `malformed` and `lost` ones, and the `problem` that ended recording
    notices: findings on anything unusual, each with `text`, its sentence
    endpoint: of the router
    viewer_credentials: of a secure run, the folder of the credentials of its viewers
    deployment: the `engine` and what it needs to find the nodes
    network: faults of hosts' networks, as they happened
    outside: by node, what it exchanged with programs outside the run
    replay: of a replay, what it replays
    invalid_control, unsigned_control: control messages that the launcher refused; number of those obeyed unsigned
    """
    console = console or Console(quiet=True)
    where = f"engine {engine.name}" if engine else "one process" if runtime == "inproc" else "processes of this machine"
    ensure_descriptors(len(resolved.nodes) if runtime == "mesh" else 0)
    check_kernels(Wiring.from_json(resolved.wiring).codecs, resolved.name)
    check_steps(resolved, where, unplugs=engine is not None and engine.unplugs)
    if runtime == "inproc" or engine is not None:
        resolved.refuse_interpreters(f"with {where}" if engine else "in one process")
    check_interpreters(resolved.nodes)
    if engine is not None:
        engine.check(resolved, secure)
    user_types.use(resolved.messages)
    with stop_signals.collected() as received:
        folder = run_folder.create(out, resolved.name)
        record: dict[str, Any] = {
            "id": (engine and engine.run_id) or f"{resolved.name}-{secrets.token_hex(4)}",
            "name": resolved.name,
            "status": ending.RUNNING,
            "message": "",
            "runtime": runtime,
            "security": secure,
            "mode": resolved.mode,
            "rate": resolved.rate,
            "seed": resolved.seed,
            "frames": resolved.frames,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "command": command or [os.path.basename(sys.argv[0]).replace("__main__.py", "mast"), *sys.argv[1:]],
            "launcher": liveness.identity(),
            "versions": run_folder.versions() | plugins.versions_of(resolved.plugins.values()),
            "timings": {},
            "nodes": {},
            "churn": [],
        }
        if engine is not None and (plugin := plugins.plugin_of(type(engine))):
            record["engine_plugin"] = plugin.distribution
        if reason := kernels.why_not():
            record["kernels_not_used"] = reason
        if replay is not None:
            record["replay"] = dict(replay)
        elif suspicious := _suspicious(resolved):
            record["suspicious"] = suspicious
        with run_folder.reserved(folder):
            run_folder.write_json(folder / "run.json", record)
            resolved.write(folder)
            if debug_protocol:
                (folder / PROTOCOL_LOGS).mkdir()
        begun, caught = time.monotonic(), None
        try:
            if received:
                raise ending.from_signals(received)
            with Display(console, resolved.name, resolved.frames, quiet=quiet) as display:
                if slower := kernels.notice():
                    display.say(f"[yellow]{escape(slower)}")
                if "suspicious" in record:
                    display.say(f"[yellow]scene: {escape(record['suspicious'])}")
                if runtime == "inproc":
                    _run_inproc(resolved, folder, record, display, received)
                else:
                    context = RunContext(
                        resolved,
                        display.say,
                        time.monotonic,
                        received,
                        folder=folder,
                        record=record,
                        secure=secure,
                    )
                    prepare(context)
                    mesh_run.run(context, display, endpoint, listen, engine)
        except BaseException as raised:  # whatever it is, the run folder says how the run ended
            caught = raised
        record["timings"]["total_s"] = round(time.monotonic() - begun, 3)
        ended = EndedRun(folder, record, ending.of_run(caught, record, str(folder)))
        if record["churn"] and resolved.mode == "lockstep" and not ended.error and not allow_churn:
            ended.error = churn.error(record["churn"])
        if ended.failures and not ended.error and not allow_failures:
            ended.error = failures.error(ended.failures, ended.logs)
        record["status"] = ending.status(ended.error)
        record["message"] = str(ended.error) if ended.error else record["message"]
        run_folder.finish(folder, record)
        if caught is not None and ending.from_exception(caught) is None:
            raise caught  # a defect
        script.discard(folder)
        if checks.is_checked(resolved) and replay is None:  # what is checked is in the record of the recorded run
            checks.run(folder, resolved)
    if received and not ended.error:
        stop_signals.raise_again(received)  # it came when nothing of the run was left to stop
    return ended


def _suspicious(resolved: Resolved) -> str:
    """What is suspicious about the scene of a run; "": nothing, or the scene is generated, which is no recording."""
    scene = registry.known_types(Scene, resolved.scene.get("type")).get(resolved.scene.get("type", ""))
    if resolved.recording is None or (scene is not None and scene.__module__.startswith(_GENERATED)):
        return ""
    return inspection.at_start(resolved.recording)


def _run_inproc(
    resolved: Resolved, folder: Path, record: dict[str, Any], display: Display, received: list[int]
) -> None:
    """Run all nodes in this process."""
    if resolved.network.get("faults"):
        raise BackendError("host faults need hosts: one process has no network between its nodes; use runtime 'mesh'")
    observation = InProcessObservation(resolved, scored=display.live)
    with NodeLogs(folder / "logs") as logs:

        def progress(frame: int) -> bool:
            display.update(frame, lambda: observation.status(frame, process.hosts))
            return not received

        tables = TableFiles(folder)
        process = InProcess(
            resolved.in_folder(folder),
            progress=progress,
            tap=observation.tap,
            stopping=lambda: bool(received),
            hand_in=tables.add,
        )
        outcomes: dict[str, dict[str, Any]] = {}
        try:
            with stop_signals.second_interrupts(received):
                outcomes = process.run()
        except BaseException:  # no recorder has reported how much it recorded
            conclusion.note_recording(folder, record, {}, resolved.nodes)
            raise
        finally:
            tables.close()
            record["nodes"] = _nodes_inproc(resolved, folder, process, outcomes)
    timing = outcomes.pop("")
    record["timings"] |= conclusion.rates(timing["frames"], timing["wall_s"])
    record["steps"] = [step._asdict() for step in process.steps]
    conclusion.write(resolved, folder, record, outcomes, {}, tables)
    if received and timing["frames"] < resolved.frames:
        raise ending.from_signals(received)
    if logs.failure is not None:
        raise logs.failure


def _nodes_inproc(
    resolved: Resolved, folder: Path, process: InProcess, outcomes: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """The `nodes` part of run.json."""
    nodes: dict[str, Any] = {}
    failed = process.failures()
    for name, host in (process.hosts | process.ended_hosts).items():
        finished, killed = name in outcomes, name in process.ended_hosts
        log = f"logs/{name}.log"
        nodes[name] = {
            "role": resolved.nodes[name].role,
            "pid": os.getpid(),
            "exit": 0 if finished else None,
            "ended": "ok" if finished else "killed by the scenario" if killed else "did not finish",
            "restarts": [(s.node, s.action) for s in process.steps].count((name, "start"))
            - (name in process.timetable.absent),
            "log": log if (folder / log).is_file() else None,
            "last_frame": host.frame,
            "rejected": {f"{key}: {reason}": n for (key, reason), n in host.rejected.items()},
            "first_rejected": host.first_rejected,
            "unaccepted": host.unaccepted,
            "foreign": {},
            "invalid_control": {},
            "unsigned_control": 0,
            "failures": failed.get(name, []),
        }
    return nodes
