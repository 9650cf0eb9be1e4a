"""One run on a mesh, from the first process to the last: whoever its nodes are started by."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from rich.markup import escape

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import failures, flow
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.control.results import EVALUATOR
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import (
    BackendError,
    ImplausibleCounts,
    MessageError,
    NodeDied,
    RunError,
    ServiceDied,
    StallError,
    StartError,
    VersionMismatch,
)
from mast_zenoh.launch import conclusion, ending, latency
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.file_server import Depot
from mast_zenoh.launch.interception.server import Interceptions
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.processes import Processes
from mast_zenoh.launch.reports import Report, Reports
from mast_zenoh.launch.steps import Steps
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.runtime.lockstep.timetable import Timetable
from mast_zenoh.runtime.mesh.node import prefix
from mast_zenoh.runtime.mesh.session import open_client, open_router
from mast_zenoh.runtime.mesh.stamp import stamp_of
from mast_zenoh.security import levels
from mast_zenoh.security.deployment import Deployment
from mast_zenoh.wiring.model import Wiring

_POLL_S = 0.05
_IMPLAUSIBLE = "implausible: "
_LEAVE_GRACE_S = 20.0  # from the end of the scene to the last node's results
_INTERRUPT_GRACE_S = 5.0
_MAX_ASKED = 1000  # of what the driver asks for and is not done yet
_END_GRACE_S = 1.0  # between closing inputs, SIGTERM and SIGKILL


@dataclass
class Launch:
    """One run on a mesh, from the first process to the last."""

    resolved: Resolved
    folder: Path
    record: dict[str, Any]
    display: Display
    endpoint: str | None
    listen: str
    secure: str = "open"
    engine: Engine | None = None
    detours: dict[str, str] = field(default_factory=dict)  # endpoints of nodes that reach the router another way
    frame: int = -1
    problem: RunError | None = None
    stopping_since: float | None = None
    _why: str = "end"  # it stops
    signals: list[int] = field(default_factory=list)
    hosts: Hosts | None = None
    deployment: Deployment | None = None
    session: zenoh.Session | None = None
    depot: Depot | None = None
    # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout is over.
    _asked: queue.Queue[flow.Act] = field(default_factory=lambda: queue.Queue(_MAX_ASKED))
    signatures: Signatures = field(init=False)
    reports: Reports = field(init=False)
    invalid: InvalidMessages = field(init=False)
    _to_say: queue.SimpleQueue[str] = field(default_factory=queue.SimpleQueue)  # by threads that are not the main one

    def __post_init__(self) -> None:
        self.invalid = InvalidMessages(self._to_say.put)
        self.signatures = Signatures(self.record["id"])

    def run(self) -> None:
        """Start the nodes, watch them to the end, write the results. Raises RunError for a run that failed."""
        begun = time.monotonic()
        timetable = Timetable(self.resolved, lockstep=self.resolved.mode == "lockstep")

        def leave(name: str) -> None:
            session.put(f"{control}/leave/{name}", self.signatures.sign(f"leave/{name}", b"leave"))

        with ExitStack() as stack:
            session, supervisor = self._join(stack)
            self.session = session
            self.signatures = Signatures(self.record["id"], self.deployment.control if self.deployment else None)
            control = f"{prefix(self.record['id'])}/@control"
            self.reports = Reports(session, control, supervisor.children, self.invalid)
            declared = self._declare(session)
            if self.engine is not None:
                declared.append(self._keep_depot(session, supervisor, stack))
            interceptions = Interceptions(self, session, supervisor)
            try:
                steps = Steps(supervisor, self.resolved.nodes, timetable.absent, leave, self.resolved.steps)
                self.record["steps"] = steps.done
                steps.start_all()
                self.record["nodes"] = supervisor.to_json({})
                run_folder.write_json(self.folder / "run.json", self.record)
                self._watch(session, supervisor, steps, interceptions)
            finally:
                supervisor.end(_END_GRACE_S)
                interceptions.close()
                self._take_reports()
                self.reports.close()
                for entity in declared:
                    entity.undeclare()
        if self.hosts is not None:
            self.record["network"] = self.hosts.done
        self._conclude(supervisor, begun)

    def _join(self, stack: ExitStack) -> tuple[zenoh.Session, Supervisor[Any]]:
        """A session on the mesh, and who starts its nodes; the router is in this process, yours, or at a centre."""
        run = self.record["id"]
        if self.engine is not None:
            if self.endpoint or self.resolved.network:
                where = f"the router at {self.endpoint}" if self.endpoint else "hosts in network namespaces"
                raise BackendError(f"engine {self.engine.name} has a router of its own: found {where}")
            return self.engine.join(self, stack)
        if self.secure != "open" and (self.endpoint or self.resolved.network):
            where = self.endpoint or "hosts in network namespaces"
            raise BackendError(f"security level {self.secure}: expected a router in this process, found {where}")
        if self.resolved.network:
            if self.endpoint:
                raise BackendError(f"hosts have a router of their own: they cannot be on the mesh of {self.endpoint}")
            spec = self.resolved.network
            self.hosts = stack.enter_context(Hosts(spec, self.resolved.rate, self.folder / "logs"))
            self.record["endpoint"] = self.hosts.endpoint
            session = stack.enter_context(open_client(self.hosts.endpoint))
            return session, Processes(self.folder, run, self.hosts.inside, self.hosts.command)
        if self.endpoint:
            self.record["endpoint"] = self.endpoint
            session = stack.enter_context(open_client(self.endpoint, patient=self.resolved.patient))
            return session, Processes(self.folder, run, self.endpoint)
        nodes = self.resolved.nodes
        driver = next((name for name, spec in nodes.items() if spec.role == "simulator"), "")
        wiring, listen = Wiring.from_json(self.resolved.wiring), levels.endpoint(self.secure, self.listen)
        self.deployment = stack.enter_context(
            Deployment(self.secure, run, wiring, nodes, prefix=prefix(run), driver=driver, hosts=levels.hosts([listen]))
        )
        session, self.record["endpoint"] = open_router(
            listen, security=self.deployment.router, patient=self.resolved.patient
        )
        supervisor = Processes(self.folder, run, self.record["endpoint"], told=self._told)
        return stack.enter_context(session), supervisor

    def _told(self, name: str) -> list[str]:
        """What a node's command is told besides: where its credentials are, and another way if it has one."""
        own = self.deployment.arguments(name) if self.deployment else []
        return [*own, "--endpoint", self.detours[name]] if name in self.detours else own

    def _declare(self, session: zenoh.Session) -> list[Any]:
        """Listen for what the driver asks for, and for the progress of the clock."""
        base = prefix(self.record["id"])

        def on_clock(sample: zenoh.Sample) -> None:
            _, frame = stamp_of(sample.attachment.to_bytes() if sample.attachment else None)
            timespan = self.resolved.timespan  # None: of another simulator than ours, which may play on for longer
            if frame < 0 or (timespan is not None and frame >= max(1, timespan.frames)):
                return
            self.frame = frame
            if self.hosts is not None:
                self.hosts.begin()

        def on_act(sample: zenoh.Sample) -> None:
            self._ask(sample.payload.to_bytes())

        direct = zenoh.handlers.Callback
        return [
            session.declare_subscriber(f"{base}/clock", direct(on_clock, indirect=False)),
            session.declare_subscriber(f"{base}/@control/act", direct(on_act, indirect=False)),
        ]

    def _keep_depot(self, session: zenoh.Session, supervisor: Supervisor[Any], stack: ExitStack) -> Any:
        """Serve the nodes that live elsewhere, and show them that the launcher is there; the token that shows it."""

        def mismatch(error: VersionMismatch) -> None:
            self.problem = self.problem or error

        self.depot = Depot(
            session,
            self.record["id"],
            self.folder,
            lambda: self.resolved,
            lambda node: supervisor.without.get(node, []),
            mismatch,
            self.invalid,
        )
        stack.callback(self.depot.close)
        return session.liveliness().declare_token(f"{prefix(self.record['id'])}/@control/launcher")

    def _watch(
        self, session: zenoh.Session, supervisor: Supervisor[Any], steps: Steps, interceptions: Interceptions
    ) -> None:
        """Until every process has ended, or the grace of a run that is to stop is over."""
        interrupted = 0
        while supervisor.running():
            self._act(steps)
            self._check_depot()
            self._say()
            interceptions.turn()
            self._take_reports()
            for child in supervisor.newly_ended():
                self._ended(child, steps)
            if len(self.signals) > interrupted:
                interrupted = len(self.signals)
                self.problem = ending.from_signals(self.signals)
                self._stop("interrupted")
            if self.hosts is not None:
                self._mind(self.hosts)
            if self.stopping_since is not None:
                # Again and again: who is still starting, or was cut off, has not heard it.
                stop = self.signatures.sign("stop", self._why.encode())
                session.put(f"{prefix(self.record['id'])}/@control/stop", stop)
                if interrupted > 1:
                    return
                supervisor.resume(supervisor.running())  # who stands still cannot hear that it is to stop
                supervisor.connect(supervisor.running())
                grace = _INTERRUPT_GRACE_S if interrupted and not steps.cut else _LEAVE_GRACE_S  # to find back
                busy_at = max(self.stopping_since, self.depot.taken_at if self.depot else self.stopping_since)
                if time.monotonic() - busy_at > grace:
                    return
            self.display.update(self.frame + 1, self._states(supervisor))

    def _ask(self, payload: bytes) -> None:
        """The driver asks for something, in Zenoh's thread: what is none of its messages takes no room."""
        try:
            self._asked.put_nowait(self.signatures.open("act", payload, flow.decode_act))
        except MessageError as error:
            self.invalid.note("act", error)
        except queue.Full:
            self.invalid.note("act", f"more than {_MAX_ASKED} wait")

    def _act(self, steps: Steps) -> None:
        """Wait a little for the driver to ask for something, and do it, unless all is to end anyway."""
        with suppress(queue.Empty):
            asked = self._asked.get(timeout=_POLL_S)
            if self.stopping_since is None:
                try:
                    steps.carry_out(*asked)
                except MessageError as error:
                    self.invalid.note("act", error)

    def _check_depot(self) -> None:
        """Without a depot nodes elsewhere get nothing and hand in nothing: the run ends, and says why."""
        if self.depot is not None and self.depot.died and self.stopping_since is None:
            self.problem = self.problem or ServiceDied(
                f"the depot, which serves the nodes' files, has ended: {self.depot.death}"
            )
            self._stop("a service has ended")

    def _say(self) -> None:
        """Show what other threads have to say."""
        while not self._to_say.empty():
            self.display.say(f"[yellow]{escape(self._to_say.get())}")

    def _mind(self, hosts: Hosts) -> None:
        """A network that has failed ends the run. When all is to end it is healed: all are to hear it, and hand in."""
        if (what := hosts.problem()) and self.problem is None:
            self.problem = BackendError(f"hosts: {what}")
            self._stop("the network has failed")
        if self.stopping_since is not None:
            hosts.heal()

    def _ended(self, child: Child, steps: Steps) -> None:
        """A process has ended: as it should, or not."""
        self._take_reports()
        if child.meant:
            return
        if child.exit == 0 and (child.handed_in or self.stopping_since is not None):
            return
        what = f"{child.name} {child.ended} at frame {self.frame}"
        if self.frame < 0:
            self.problem = self.problem or StartError(
                f"{child.name} ended before the first frame: {child.ended}{self._last_words(child)}"
            )
            self._stop("a node did not start")
        elif child.spec.on_exit == "continue":
            self.display.say(f"[yellow]{what}; going on without it")
        elif child.spec.on_exit == "restart" and self.stopping_since is None:
            again = steps.restart(child)
            self.display.say(f"[yellow]{what}; {'restarted' if again else 'restarted too often, going on without it'}")
        elif self.problem is None:
            self.problem = NodeDied(f"{what}; see logs/{child.name}.log{self._last_words(child)}")
            self._stop("a node died")

    def _last_words(self, child: Child) -> str:
        lines = (self.folder / "logs" / f"{child.name}.log").read_text(errors="replace").strip().splitlines()
        return f": {lines[-1]}" if lines else ""

    def _stop(self, reason: str) -> None:
        """From now on everyone is asked to finish."""
        if self.stopping_since is None:
            self.stopping_since, self._why = time.monotonic(), reason

    def _take_reports(self) -> None:
        """Take what the nodes have reported: results, and failures of handlers, which are shown at once."""
        for report in self.reports.take():
            if report.failure is not None:
                self._show_failure(report)
                continue
            reason = self.reports.outcomes[report.node].get("stop_reason")
            if reason is not None:
                if self.stopping_since is None:
                    self.stopping_since = time.monotonic()
                if reason.startswith("stall"):
                    self.problem = self.problem or StallError(reason)
                elif reason.startswith("start"):
                    self.problem = self.problem or StartError(reason)
                elif reason.startswith(_IMPLAUSIBLE):
                    self.problem = self.problem or ImplausibleCounts(reason.removeprefix(_IMPLAUSIBLE))
                elif reason != "end":  # neither the scene's end nor anything of ours
                    self.problem = self.problem or RunError(
                        f"told to stop at frame {self.frame}, not by us: {reason!r:.80}"
                    )

    def _show_failure(self, report: Report) -> None:
        """Show the first failure of a handler; one of `start` ends the run."""
        assert report.failure is not None
        (line,) = failures.lines({report.node: [report.failure]}, {report.node: f"logs/{report.node}.log"})
        self.display.say(f"[red]{escape(line)}")
        if report.failure["handler"] == "start":
            self.problem = self.problem or ending.from_failed_start(line, report.failure["exception"])
            self._stop("a node did not start")

    def _states(self, supervisor: Supervisor[Any]) -> dict[str, str]:
        def state(child: Child) -> str:
            if child.exit is not None:
                return "done" if child.exit == 0 and child.handed_in else "away" if child.meant else "dead"
            if child.paused:
                return "paused"
            if child.cut_off:
                return "cut off"
            return "running" if self.frame >= 0 else "starting"

        return {name: state(child) for name, child in supervisor.children.items()}

    def _conclude(self, supervisor: Supervisor[Any], begun: float) -> None:
        """Write what came, and raise what went wrong."""
        outcomes = self.reports.outcomes
        self.record["nodes"] = supervisor.to_json(self.reports.by_node())
        driver: Mapping[str, Any] = next((o for o in outcomes.values() if "sent_ns" in o), {})
        if driver:
            self.record["timings"] |= run_folder.rates(driver["frames"], driver["wall_s"])
            self.record["timings"]["start_s"] = round(time.monotonic() - begun - driver["wall_s"], 3)
            self.record["churn"] = driver["churn"]
        gone = [child for child in supervisor.children.values() if not child.handed_in and not child.meant]
        self.record["message"] = "; ".join(f"{child.name} {child.ended}" for child in gone)
        self.record["invalid_control"] = self.invalid.entry()
        if self.secure != "open":  # nobody can have obeyed one, whatever it says
            self.record["nodes"] = {name: node | {"unsigned_control": 0} for name, node in self.record["nodes"].items()}
        unsigned = [node["unsigned_control"] or 0 for node in self.record["nodes"].values()]
        self.record["unsigned_control"] = self.signatures.obeyed + sum(unsigned)
        handed_in = {name: outcome["results"] for name, outcome in outcomes.items()}
        measured: dict[str, Any] = {}
        if self.resolved.mode == "realtime":
            measured["latency_ms"] = latency.measured(Wiring.from_json(self.resolved.wiring), outcomes)
            measured["frames_per_second"] = self.record["timings"].get("frames_per_second")
        conclusion.write(self.resolved, self.folder, self.record, handed_in, measured)
        if isinstance(self.problem, StallError):
            self.problem = ending.of_stall(self.problem, self.record["notices"])
        if self.problem is None and EVALUATOR not in handed_in:
            self.problem = RunError("the evaluator handed in no results")
        if self.problem is not None:
            raise self.problem
