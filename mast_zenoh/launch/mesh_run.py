"""One run on a mesh, whichever supervisor starts its nodes."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from typing import Any

import zenoh
from rich.markup import escape

from mast_zenoh import run_folder
from mast_zenoh.config.resolved import RECORDING, Resolved, joining_files
from mast_zenoh.errors import BackendError, MastError, MessageError, RunError, ServiceDied, StallError
from mast_zenoh.launch import conclusion, ending, local_mesh
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.launcher_protocol import DRIVER_TIMEOUT_S, LauncherActions, LauncherProtocol, Report, churn_of
from mast_zenoh.launch.live_interception import InterceptionServer
from mast_zenoh.launch.local_mesh import BlockingClients
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.observation import Observation
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import control_prefix, files, flow, prefix
from mast_zenoh.mesh.control.failures import described
from mast_zenoh.mesh.control.files import DESCRIBE, WITHOUT_SCENE, encode_description
from mast_zenoh.mesh.control.key_marks import check_control_mark, control_mark
from mast_zenoh.mesh.control.results import EVALUATOR
from mast_zenoh.mesh.protocol.traffic import stamp_of
from mast_zenoh.mesh.session import direct
from mast_zenoh.wiring.model import Wiring

MAX_ACTS = 1000  #: requests of the driver for process steps in the queue
_POLL_S = 0.05
_END_GRACE_S = 1.0  # after closing inputs, and after SIGTERM


def run(context: RunContext, display: Display, endpoint: str | None, listen: str, engine: Engine | None) -> None:
    """Join the mesh, start the nodes, watch them to the end, write the results.

    endpoint: of an existing router; None: start one in this process, listening at `listen`
    engine:   where the nodes live, if not here as processes
    Raises RunError for a run that failed.
    """
    begun = time.monotonic()
    with ExitStack() as stack:
        hosts, file_server = None, None
        if engine is None:
            mesh, hosts = local_mesh.join(context, stack, endpoint, listen)
        elif endpoint or context.resolved.network:
            where = f"the router at {endpoint}" if endpoint else "hosts in network namespaces"
            raise BackendError(f"engine {engine.name} starts its own router: found {where}")
        else:
            mesh = engine.join(context, stack)
        context.attach(mesh)
        if engine is not None:
            file_server = FileServer(mesh.session, context, mesh.supervisor.is_started)
            stack.callback(file_server.close)
        launcher = MeshLauncher(context, mesh, display, hosts, file_server)
        launcher.run()
    if hosts is not None:
        context.record["network"] = hosts.done
    launcher.conclude(begun)


class MeshLauncher(LauncherActions):
    """The launcher of a run on a mesh: its loop, what arrives for it, and what its protocol asks for.

    hosts: network namespaces of nodes, if any;  file_server: for nodes that live elsewhere, else None
    """

    def __init__(
        self,
        context: RunContext,
        mesh: Mesh,
        display: Display,
        hosts: Hosts | None = None,
        file_server: FileServer | None = None,
    ) -> None:
        self._context = context
        self._stop = context.stop
        self._session = session = mesh.session
        self._supervisor = mesh.supervisor
        self._display = display
        self._hosts = hosts
        self._file_server = file_server
        self._control = control_prefix(context.run_id)
        self._adopted = context.resolved
        self._joining: str | None = None
        self._changes: list[dict[str, Any]] = context.record.setdefault("interceptions", [])
        # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout expires.
        self._acts: queue.Queue[flow.Act] = queue.Queue(MAX_ACTS)
        self._tables = TableFiles(context.folder)
        self._reports = Reports(session, self._control, mesh.supervisor.children, context.invalid, self._tables)
        self._protocol = LauncherProtocol(context, mesh.supervisor, self)
        base = prefix(context.run_id)
        interceptions = InterceptionServer(context.folder, base, session, self._protocol.interceptions, self)
        on_describe: Any = zenoh.handlers.Callback(self._on_describe, indirect=True)
        declared: list[Any] = [
            session.declare_subscriber(f"{base}/clock", direct(self._on_clock)),
            session.declare_subscriber(f"{self._control}/act", direct(self._on_act)),
            session.declare_queryable(f"{base}/{DESCRIBE}", on_describe),
        ]
        if file_server is not None:
            declared.append(session.liveliness().declare_token(f"{self._control}/launcher"))
        self._close = [interceptions.close, self._reports.close, *(entity.undeclare for entity in declared)]
        # Routers that are not patient end silent links by themselves.
        endpoint = context.record["endpoint"] if mesh.has_router and context.resolved.patient else None
        self._blocking = BlockingClients(context, mesh, endpoint) if endpoint else None
        observing = display.live and mesh.has_router  # elsewhere, what is observed would cross the network
        self._observation = Observation(context, session if observing else None)

    def run(self) -> None:
        """Start the nodes, and watch until every process has ended, or the grace period of a stop is over."""
        context, steps = self._context, self._protocol.steps
        try:
            context.record["steps"] = steps.done
            if context.awaited:
                self._write_nodes()  # observers read there where the router is
            for wait in context.awaited:
                wait()
            steps.start_all()
            self._write_nodes()
            while not self.advance():
                pass
        finally:
            self._observation.close()
            self._supervisor.end(_END_GRACE_S)
            self._protocol.finish()
            self._tables.close()
            for close in self._close:
                close()

    def advance(self) -> bool:
        """One iteration of the loop; returns whether the run is over."""
        act = None
        with suppress(queue.Empty):
            act = self._acts.get(timeout=_POLL_S)
        self._check_file_server()
        self._context.show_refusals()
        for sentence in self._blocking.disconnect() if self._blocking else ():
            self._context.record.setdefault("disconnected", []).append(sentence)
            self._context.show(f"[yellow]{escape(sentence)}")
        self._check_network()
        over = self._protocol.advance(act)
        self._observation.advance()
        waiting = self._protocol.endings.waiting
        self._display.update(
            self._context.frame + 1,
            lambda: self._observation.status(self._supervisor.children, waiting),
            waiting,
        )
        return over

    def _check_file_server(self) -> None:
        """End the run if the file server has died: nodes elsewhere depend on it."""
        server = self._file_server
        if server is not None and server.died and not self._stop.requested:
            problem = ServiceDied(f"the launcher's file server has ended: {server.fatal_error}")
            self._stop.fail(problem, "a service has ended")

    def _check_network(self) -> None:
        """End the run if its network has failed; heal the network when nodes are to stop."""
        if self._hosts is None:
            return
        if (problem := self._hosts.problem()) and self._stop.problem is None:
            self._stop.fail(BackendError(f"hosts: {problem}"), "the network has failed")
        if self._stop.requested:
            self._hosts.heal()

    def conclude(self, begun: float) -> None:
        """Write the results into the run folder, and raise the run's error if it has one.

        begun: when the run began, s on the monotonic clock
        """
        context, record, stop, outcomes = self._context, self._context.record, self._stop, self._reports.outcomes
        record["nodes"] = self._supervisor.to_json(self._reports.by_node())
        driver: Mapping[str, Any] = next((o for o in outcomes.values() if "sent_ns" in o), {})
        if context.first_frame_s is not None:
            record["timings"]["start_s"] = round(context.first_frame_s - begun, 3)
        if driver:
            record["timings"] |= conclusion.rates(driver["frames"], driver["wall_s"])
            record["churn"] = churn_of(outcomes, context)
        children = self._supervisor.children.values()
        lost = [child for child in children if not child.handed_in and not child.exit_expected]
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
        conclusion.write(context.resolved, context.folder, record, handed_in, measured, self._tables)
        if isinstance(stop.problem, StallError):
            stop.problem = ending.of_stall(stop.problem, record["notices"])
        if stop.problem is None and EVALUATOR not in handed_in:
            stop.problem = RunError("the evaluator handed in no results")
        if stop.problem is not None:
            raise stop.problem

    # -- what arrives, in Zenoh's threads ----------------------------------------------------------------------------

    def _on_clock(self, sample: zenoh.Sample) -> None:
        context = self._context
        _, frame = stamp_of(sample.attachment, "clock")
        timespan = context.resolved.timespan  # None: a user's simulator, which may play longer
        if frame < 0 or (timespan is not None and frame >= max(1, timespan.frames)):
            return
        if context.first_frame_s is None:
            context.first_frame_s = time.monotonic()
        context.frame = frame
        if self._hosts is not None:
            self._hosts.begin()

    def _on_act(self, sample: zenoh.Sample) -> None:
        """Queue a request of the driver for process steps; refuse a malformed or unsigned one."""
        try:
            check_control_mark(sample.key_expr, sample.attachment)
            act = self._context.signatures.open("act", sample.payload.to_bytes(), flow.decode_act)
            self._acts.put_nowait(act)
        except MessageError as error:
            self.note_invalid("act", error)
        except queue.Full:
            self.note_invalid("act", MessageError(f"more than {MAX_ACTS} requests are waiting"))

    def _on_describe(self, query: zenoh.Query) -> None:
        """Describe the run to an observer that has no access to its folder.

        On a mesh with access rights no viewer may query: observers there need the run folder.
        """
        resolved = self._context.resolved
        asked = query.payload.to_bytes() if query.payload else b""
        scene = b""
        if asked != WITHOUT_SCENE:
            with suppress(OSError):  # a user's simulator has no prepared scene
                scene = (self._context.folder / RECORDING).read_bytes()
        content = encode_description(self._context.run_id, resolved.to_json(), resolved.wiring, scene)
        key = f"{prefix(self._context.run_id)}/{DESCRIBE}"
        with suppress(zenoh.ZError):
            # In a queue of its own: a client that does not read its reply blocks the queue, and this thread.
            query.reply(key, content, priority=zenoh.Priority.DATA_LOW)

    # -- what the protocol asks for ----------------------------------------------------------------------------------

    def reports(self) -> Iterator[Report]:
        return self._reports.take()

    def last_data_s(self, node: str) -> float:
        times_s = [self._reports.last_part_s, self._file_server.last_received_s if self._file_server else {}]
        return max(of_node.get(node, float("-inf")) for of_node in times_s)

    def stop(self, reason: str) -> None:
        self._put("stop", reason)

    def leave(self, node: str, reason: str) -> None:
        self._put(f"leave/{node}", reason)

    def _put(self, key: str, text: str) -> None:
        payload = self._context.signatures.sign(key, text.encode())
        self._session.put(f"{self._control}/{key}", payload, attachment=control_mark(key))

    def rewire(self, request: bytes, answered: Callable[[bytes | None], None]) -> None:
        payload = self._context.signatures.sign("rewire", request)
        replies: list[zenoh.Reply] = []

        def finish() -> None:
            answered(next((reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None), None))

        options: Any = {"attachment": control_mark("rewire"), "timeout": DRIVER_TIMEOUT_S}
        self._session.get(f"{self._control}/rewire", direct(replies.append, finish), payload=payload, **options)

    def answer(self, query: zenoh.Query, payload: bytes) -> None:
        query.reply(query.key_expr, payload)
        query.drop()

    def refuse(self, query: zenoh.Query, error: Exception) -> None:
        if not isinstance(error, MastError) or isinstance(error, MessageError):
            self._context.invalid.note("intercept", described(error))
        with suppress(zenoh.ZError):
            query.reply_err(files.encode_refusal(error))
        query.drop()

    def note_invalid(self, kind: str, error: MessageError) -> None:
        self._context.invalid.note(kind, error)

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
        self._write_nodes()

    def _write_nodes(self) -> None:
        """Write run.json as of now."""
        self._context.record["nodes"] = self._supervisor.to_json({})
        run_folder.write_json(self._context.folder / "run.json", self._context.record)

    def last_log_line(self, node: str) -> str:
        log = self._context.folder / "logs" / f"{node}.log"
        lines = log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
