"""One run on a mesh, whichever supervisor starts its nodes."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import Any

import zenoh
from rich.markup import escape

from mast_zenoh.config.resolved import RECORDING, Resolved, joining_files
from mast_zenoh.control import control_prefix, files, flow, prefix
from mast_zenoh.control.codec import InvalidMessages
from mast_zenoh.control.failures import described
from mast_zenoh.control.files import DESCRIBE, WITHOUT_SCENE, encode_description
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import BackendError, MastError, MessageError, RunError, ServiceDied, StallError
from mast_zenoh.launch import conclusion, ending, local_mesh
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.interception import InterceptionServer
from mast_zenoh.launch.launcher_protocol import DRIVER_TIMEOUT_S, Endings, LauncherActions, Steps, churn_of
from mast_zenoh.launch.live_interception import Interceptions
from mast_zenoh.launch.local_mesh import BlockingClients
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.observation import Observation
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.supervisor import Supervisor
from mast_zenoh.runtime.protocol.stamp import stamp_of
from mast_zenoh.runtime.protocol.timetable import Timetable
from mast_zenoh.wiring.model import Wiring


def declare_description(context: RunContext, session: zenoh.Session) -> Any:
    """Answer queries for a description of the run; returns the queryable.

    On a mesh with access rights no viewer may query: observers there need the run folder.
    """
    key = f"{prefix(context.run_id)}/{DESCRIBE}"

    def answer(query: zenoh.Query) -> None:
        resolved = context.resolved
        file = context.folder / RECORDING
        asked = query.payload.to_bytes() if query.payload else b""
        scene = b""
        if asked != WITHOUT_SCENE:
            with suppress(OSError):  # a user's simulator has no prepared scene
                scene = file.read_bytes()
        content = encode_description(context.run_id, resolved.to_json(), resolved.wiring, scene)
        with suppress(zenoh.ZError):
            # In a queue of its own: a client that does not read its reply blocks the queue, and this thread.
            query.reply(key, content, priority=zenoh.Priority.DATA_LOW)

    handler: Any = zenoh.handlers.Callback(answer, indirect=True)
    return session.declare_queryable(key, handler)


MAX_WAITING = 1000  #: requests of the driver in the queue


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


class StepRequests:
    """Queue of the driver's requests for process steps, decoded on arrival."""

    def __init__(self, steps: Steps, signatures: Signatures, invalid: InvalidMessages) -> None:
        self._steps = steps
        self._signatures = signatures
        self._invalid = invalid
        # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout expires.
        self._waiting: queue.Queue[flow.Act] = queue.Queue(MAX_WAITING)

    def take(self, payload: bytes) -> None:
        """Queue a request, in Zenoh's thread; refuse a malformed or unsigned one."""
        try:
            self._waiting.put_nowait(self._signatures.open("act", payload, flow.decode_act))
        except MessageError as error:
            self._invalid.note("act", error)
        except queue.Full:
            self._invalid.note("act", f"more than {MAX_WAITING} requests are waiting")

    def serve(self, timeout_s: float, *, stopping: bool = False) -> None:
        """Wait up to timeout_s for a request; carry it out unless the run is stopping."""
        try:
            request = self._waiting.get(timeout=timeout_s)
        except queue.Empty:
            return
        if not stopping:
            try:
                self._steps.carry_out(*request)
            except MessageError as error:
                self._invalid.note("act", error)


class MeshActions(LauncherActions):
    """The actions of a launcher that has joined the mesh with this session."""

    def __init__(self, context: RunContext, session: zenoh.Session, supervisor: Supervisor[Any]) -> None:
        self._context = context
        self._session = session
        self._supervisor = supervisor
        self._control = control_prefix(context.run_id)
        self._changes: list[dict[str, Any]] = context.record.setdefault("interceptions", [])
        self._adopted = context.resolved
        self._joining: str | None = None

    def stop(self, reason: str) -> None:
        self._put("stop", reason)

    def leave(self, node: str, reason: str) -> None:
        self._put(f"leave/{node}", reason)

    def _put(self, key: str, text: str) -> None:
        self._session.put(f"{self._control}/{key}", self._context.signatures.sign(key, text.encode()))

    def rewire(self, payload: bytes, answered: Callable[[bytes | None], None]) -> None:
        replies: list[zenoh.Reply] = []

        def finish() -> None:
            answered(next((reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None), None))

        handler: Any = zenoh.handlers.Callback(replies.append, finish, indirect=False)
        self._session.get(f"{self._control}/rewire", handler, payload=payload, timeout=DRIVER_TIMEOUT_S)

    def answer(self, query: zenoh.Query, payload: bytes) -> None:
        query.reply(query.key_expr, payload)
        query.drop()

    def refuse(self, query: zenoh.Query, error: Exception) -> None:
        if not isinstance(error, MastError) or isinstance(error, MessageError):
            self._context.invalid.note("intercept", described(error))
        with suppress(zenoh.ZError):
            query.reply_err(files.encode_refusal(error))
        query.drop()

    def adopt(self, resolved: Resolved, joining: tuple[str, Resolved] | None) -> None:
        if joining is not None:
            self._joining = joining[0]
            self._write(joining[1], *joining_files(joining[0]))
        if resolved is not self._adopted:
            self._adopted = resolved
            self._write(resolved)
        if joining is None and self._joining is not None:
            for name in joining_files(self._joining):
                (self._context.folder / name).unlink(missing_ok=True)

    def _write(self, resolved: Resolved, scenario: str = "scenario.json", wiring: str = "wiring.json") -> None:
        run_folder.write_json(self._context.folder / wiring, resolved.wiring)
        run_folder.write_json(self._context.folder / scenario, resolved.to_json())

    def record(self, change: dict[str, Any]) -> None:
        self._changes.append(change)
        self._context.record["nodes"] = self._supervisor.to_json({})
        run_folder.write_json(self._context.folder / "run.json", self._context.record)

    def last_log_line(self, node: str) -> str:
        log = self._context.folder / "logs" / f"{node}.log"
        lines = log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""


_POLL_S = 0.05


class Watch:
    """The launcher's loop while nodes run.

    file_server: for nodes that live elsewhere, else None; hosts: network namespaces of nodes, if any
    """

    def __init__(
        self,
        context: RunContext,
        mesh: Mesh,
        display: Display,
        *,
        steps: Steps,
        actions: LauncherActions,
        requests: StepRequests,
        reports: Reports,
        interceptions: Interceptions,
        file_server: FileServer | None = None,
        hosts: Hosts | None = None,
    ) -> None:
        self._context = context
        self._stop = context.stop
        self._supervisor = mesh.supervisor
        self._display = display
        self._requests = requests
        self._reports = reports
        self._interceptions = interceptions
        self._file_server = file_server
        self._hosts = hosts
        self._endings = Endings(
            *(context, mesh.supervisor, steps, actions),
            take_reports=self.take_reports,
            last_received_s=lambda: file_server.last_received_s if file_server else float("-inf"),
        )
        # Routers that are not patient end silent links by themselves.
        endpoint = context.record["endpoint"] if mesh.has_router and context.resolved.patient else None
        self._blocking = BlockingClients(context, mesh, endpoint) if endpoint else None
        observing = display.live and mesh.has_router  # elsewhere, what is observed would cross the network
        self._observation = Observation(context, mesh.session if observing else None)

    def run(self) -> None:
        """Watch until every process has ended, or the grace period of a stop is over."""
        try:
            self._watch()
        finally:
            self._observation.close()

    def _watch(self) -> None:
        over = False
        while not over:
            self._requests.serve(_POLL_S, stopping=self._stop.requested)
            self._check_file_server()
            self._context.show_refusals()
            self._disconnect_blocking()
            self._check_network()
            over = self._endings.advance()
            self._interceptions.advance()  # after the reports: a node that has handed in its results did not die
            self._observation.advance()
            self._display.update(self._context.frame + 1, lambda: self._observation.status(self._supervisor.children))

    def take_reports(self) -> None:
        """Take the nodes' reports: results, and failures of handlers."""
        for report in self._reports.take():
            if report.failure is not None:
                self._endings.handler_failed(report.node, report.failure)
            else:
                self._endings.handed_in(report.node, self._reports.outcomes[report.node].get("stop_reason"))

    def _check_file_server(self) -> None:
        """End the run if the file server has died: nodes elsewhere depend on it."""
        server = self._file_server
        if server is not None and server.died and not self._stop.requested:
            self._stop.fail(
                ServiceDied(f"the launcher's file server has ended: {server.fatal_error}"),
                "a service has ended",
            )

    def _disconnect_blocking(self) -> None:
        """Disconnect foreign clients that hold up the run, and tell it."""
        for sentence in self._blocking.disconnect() if self._blocking else ():
            self._context.record.setdefault("disconnected", []).append(sentence)
            self._context.show(f"[yellow]{escape(sentence)}")

    def _check_network(self) -> None:
        """End the run if its network has failed; heal the network when nodes are to stop."""
        if self._hosts is None:
            return
        if (problem := self._hosts.problem()) and self._stop.problem is None:
            self._stop.fail(BackendError(f"hosts: {problem}"), "the network has failed")
        if self._stop.requested:
            self._hosts.heal()


def conclude(context: RunContext, supervisor: Supervisor[Any], reports: Reports, begun: float) -> None:
    """Write the results into the run folder, and raise the run's error if it has one.

    begun: when the run began, s on the monotonic clock
    """
    record, stop, outcomes = context.record, context.stop, reports.outcomes
    record["nodes"] = supervisor.to_json(reports.by_node())
    driver: Mapping[str, Any] = next((o for o in outcomes.values() if "sent_ns" in o), {})
    if context.first_frame_s is not None:
        record["timings"]["start_s"] = round(context.first_frame_s - begun, 3)
    if driver:
        record["timings"] |= conclusion.rates(driver["frames"], driver["wall_s"])
        record["churn"] = churn_of(outcomes, context)
    lost = [child for child in supervisor.children.values() if not child.handed_in and not child.exit_expected]
    record["message"] = "; ".join(f"{child.name} {child.ended}" for child in lost)
    record["invalid_control"] = context.invalid.entry()
    if context.secure != "open":  # no node can have obeyed an unsigned message, whatever it reports
        record["nodes"] = {name: node | {"unsigned_control": 0} for name, node in record["nodes"].items()}
    unsigned = [node["unsigned_control"] or 0 for node in record["nodes"].values()]
    record["unsigned_control"] = context.signatures.obeyed + sum(unsigned)
    handed_in = {name: outcome["results"] for name, outcome in outcomes.items()}
    measured: dict[str, Any] = {}
    if context.resolved.mode == "realtime":
        measured["latency_ms"] = conclusion.latency_ms(Wiring.from_json(context.resolved.wiring), outcomes)
        measured["frames_per_second"] = record["timings"].get("frames_per_second")
    conclusion.write(context.resolved, context.folder, record, handed_in, measured)
    if isinstance(stop.problem, StallError):
        stop.problem = ending.of_stall(stop.problem, record["notices"])
    if stop.problem is None and EVALUATOR not in handed_in:
        stop.problem = RunError("the evaluator handed in no results")
    if stop.problem is not None:
        raise stop.problem


_END_GRACE_S = 1.0  # after closing inputs, and after SIGTERM


def run(context: RunContext, display: Display, endpoint: str | None, listen: str, engine: Engine | None) -> None:
    """Join the mesh, start the nodes, watch them to the end, write the results.

    endpoint: of an existing router; None: start one in this process, listening at `listen`
    engine:   where the nodes live, if not here as processes
    Raises RunError for a run that failed.
    """
    begun = time.monotonic()
    lockstep = context.resolved.mode == "lockstep"
    with ExitStack() as stack:
        mesh, hosts = _join(context, stack, endpoint, listen, engine)
        context.attach(mesh)
        session, supervisor = mesh.session, mesh.supervisor
        control = control_prefix(context.run_id)
        actions = MeshActions(context, session, supervisor)
        resolved = context.resolved
        absent = Timetable(resolved, lockstep=lockstep).absent
        steps = Steps(supervisor, resolved.nodes, absent, actions, resolved.steps, context.now_s)
        requests = StepRequests(steps, context.signatures, context.invalid)
        reports = Reports(session, control, supervisor.children, context.invalid)
        declared = [*_declare(context, session, requests, hosts), declare_description(context, session)]
        file_server = None
        if engine is not None:
            file_server = _serve_files(context, mesh, stack)
            declared.append(session.liveliness().declare_token(f"{control}/launcher"))
        interceptions = Interceptions(context, supervisor, actions, lambda: context.signatures)
        requested = InterceptionServer(context, session, interceptions, actions)
        watch = Watch(
            context,
            mesh,
            display,
            steps=steps,
            actions=actions,
            requests=requests,
            reports=reports,
            interceptions=interceptions,
            file_server=file_server,
            hosts=hosts,
        )
        try:
            context.record["steps"] = steps.done
            steps.start_all()
            context.record["nodes"] = supervisor.to_json({})
            run_folder.write_json(context.folder / "run.json", context.record)
            watch.run()
        finally:
            supervisor.end(_END_GRACE_S)
            requested.close()
            watch.take_reports()
            reports.close()
            for entity in declared:
                entity.undeclare()
    if hosts is not None:
        context.record["network"] = hosts.done
    conclude(context, supervisor, reports, begun)


def _join(
    context: RunContext, stack: ExitStack, endpoint: str | None, listen: str, engine: Engine | None
) -> tuple[Mesh, Hosts | None]:
    """The mesh of the run, and the network namespaces of its nodes if it has any."""
    if engine is None:
        return local_mesh.join(context, stack, endpoint, listen)
    if endpoint or context.resolved.network:
        where = f"the router at {endpoint}" if endpoint else "hosts in network namespaces"
        raise BackendError(f"engine {engine.name} starts its own router: found {where}")
    return engine.join(context, stack), None


def _declare(context: RunContext, session: zenoh.Session, requests: StepRequests, hosts: Hosts | None) -> list[Any]:
    """Subscribe to the clock and to the driver's requests for process steps."""
    base = prefix(context.run_id)

    def on_clock(sample: zenoh.Sample) -> None:
        _, frame = stamp_of(sample.attachment)
        timespan = context.resolved.timespan  # None: a user's simulator, which may play longer
        if frame < 0 or (timespan is not None and frame >= max(1, timespan.frames)):
            return
        if context.first_frame_s is None:
            context.first_frame_s = time.monotonic()
        context.frame = frame
        if hosts is not None:
            hosts.begin()

    def on_act(sample: zenoh.Sample) -> None:
        requests.take(sample.payload.to_bytes())

    direct = zenoh.handlers.Callback
    return [
        session.declare_subscriber(f"{base}/clock", direct(on_clock, indirect=False)),
        session.declare_subscriber(f"{base}/@control/act", direct(on_act, indirect=False)),
    ]


def _serve_files(context: RunContext, mesh: Mesh, stack: ExitStack) -> FileServer:
    """Serve the files of nodes that live elsewhere, until the stack closes."""
    server = FileServer(
        mesh.session,
        context.run_id,
        context.folder,
        context.resolved_for,
        context.stop.note,
        context.invalid,
        mesh.supervisor.is_started,
    )
    stack.callback(server.close)
    return server
