"""Watches the nodes of a run on a mesh: takes reports, handles exits, stops nodes."""

from __future__ import annotations

import time

from rich.markup import escape

from mast_zenoh.control import control_prefix, failures
from mast_zenoh.control.stop_reasons import StopKind, decode_reason
from mast_zenoh.errors import (
    BackendError,
    ImplausibleCounts,
    NodeDied,
    RunError,
    ServiceDied,
    StallError,
    StartError,
)
from mast_zenoh.launch import ending
from mast_zenoh.launch.blocking_clients import BlockingClients
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.interception.server import Interceptions
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.observation import Observation
from mast_zenoh.launch.reports import Report, Reports
from mast_zenoh.launch.steps import StepRequests, Steps
from mast_zenoh.launch.supervisor import Child

_POLL_S = 0.05
_LEAVE_GRACE_S = 20.0  # from the end of the scene to the last node's results
_INTERRUPT_GRACE_S = 5.0


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
        requests: StepRequests,
        reports: Reports,
        interceptions: Interceptions,
        file_server: FileServer | None = None,
        hosts: Hosts | None = None,
    ) -> None:
        self._context = context
        self._stop = context.stop
        self._session = mesh.session
        self._supervisor = mesh.supervisor
        self._display = display
        self._steps = steps
        self._requests = requests
        self._reports = reports
        self._interceptions = interceptions
        self._file_server = file_server
        self._hosts = hosts
        # Routers that are not patient end silent links by themselves.
        endpoint = context.record["endpoint"] if mesh.has_router and context.resolved.patient else None
        self._blocking = BlockingClients(context, mesh, endpoint) if endpoint else None
        self._interrupts = 0  # stop signals that have been handled
        observing = display.live and mesh.has_router  # elsewhere, what is observed would cross the network
        self._observation = Observation(context, mesh.session if observing else None)

    def run(self) -> None:
        """Watch until every process has ended, or the grace period of a stop is over."""
        try:
            self._watch()
        finally:
            self._observation.close()

    def _watch(self) -> None:
        while self._supervisor.running():
            self._requests.serve(_POLL_S, stopping=self._stop.requested)
            self._check_file_server()
            self._context.show_refusals()
            self._disconnect_blocking()
            self.take_reports()
            for child in self._supervisor.newly_ended():
                self._handle_exit(child)
            self._interceptions.advance()  # after the reports: a node that has handed in its results did not die
            if len(self._context.signals) > self._interrupts:
                self._interrupts = len(self._context.signals)
                self._stop.problem = ending.from_signals(self._context.signals)
                self._stop.request("interrupted")
            self._check_network()
            if self._stop.since is not None and self._ask_to_stop(self._stop.since):
                return
            self._observation.advance()
            self._display.update(self._context.frame + 1, lambda: self._observation.status(self._supervisor.children))

    def take_reports(self) -> None:
        """Take the nodes' reports: results, and failures of handlers, which are shown."""
        for report in self._reports.take():
            if report.failure is not None:
                self._show_failure(report)
                continue
            text = self._reports.outcomes[report.node].get("stop_reason")
            if text is not None:
                self._stop.request()
                if (problem := self._problem(report.node, text)) is not None:
                    self._stop.note(problem)

    def _problem(self, node: str, text: str) -> RunError | None:
        """The error for the driver's reason to stop; None for the end of the scene."""
        reason = decode_reason(text)
        if reason.kind is StopKind.END:
            return None
        if reason.kind is StopKind.STALL:
            return StallError(text)
        if reason.kind is StopKind.START:
            return StartError(text)
        if reason.kind is StopKind.IMPLAUSIBLE:
            return ImplausibleCounts(reason.detail)
        # If the launcher asked it to stop, there is a problem already, and this one is ignored.
        return RunError(f"{node} was told to stop at frame {self._context.frame}, not by the launcher: {text!r:.80}")

    def _ask_to_stop(self, since: float) -> bool:
        """Ask all nodes to stop; return whether the grace period is over."""
        # Every time: a node that is still starting, or was cut off, has not received it yet.
        stop = self._context.signatures.sign("stop", self._stop.reason.encode())
        self._session.put(f"{control_prefix(self._context.run_id)}/stop", stop)
        if self._interrupts > 1:
            return True
        self._supervisor.resume(self._supervisor.running())  # a suspended node receives no message
        self._supervisor.connect(self._supervisor.running())
        # A disconnected node needs the longer grace period to reconnect.
        grace = _INTERRUPT_GRACE_S if self._interrupts and not self._steps.cut else _LEAVE_GRACE_S
        last_activity = max(since, self._file_server.last_received_s if self._file_server else since)
        return time.monotonic() - last_activity > grace

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

    def _handle_exit(self, child: Child) -> None:
        """Handle the end of a process; if it is unexpected, as the node's `on_exit` specifies."""
        self.take_reports()
        if child.exit_expected or (child.exit == 0 and (child.handed_in or self._stop.requested)):
            return
        event = f"{child.name} {child.ended} at frame {self._context.frame}"
        if self._context.frame < 0:
            text = f"{child.name} ended before the first frame: {child.ended}{self._last_log_line(child)}"
            self._stop.fail(StartError(text), "a node did not start")
        elif child.spec.on_exit == "continue":
            self._context.show(f"[yellow]{event}; continuing without it")
        elif child.spec.on_exit == "restart" and not self._stop.requested:
            restarted = self._steps.restart(child)
            self._context.show(
                f"[yellow]{event}; {'restarted' if restarted else 'restarted too often, continuing without it'}"
            )
        elif self._stop.problem is None:
            text = f"{event}; see logs/{child.name}.log{self._last_log_line(child)}"
            self._stop.fail(NodeDied(text), "a node died")

    def _last_log_line(self, child: Child) -> str:
        """The last line of a node's log."""
        log = self._context.folder / "logs" / f"{child.name}.log"
        lines = log.read_text(errors="replace").strip().splitlines()
        return f": {lines[-1]}" if lines else ""

    def _show_failure(self, report: Report) -> None:
        """Show the first failure of a handler; one of `start` ends the run."""
        assert report.failure is not None
        (line,) = failures.lines({report.node: [report.failure]}, {report.node: f"logs/{report.node}.log"})
        self._context.show(f"[red]{escape(line)}")
        if report.failure["handler"] == "start":
            self._stop.fail(ending.from_failed_start(line, report.failure["exception"]), "a node did not start")
