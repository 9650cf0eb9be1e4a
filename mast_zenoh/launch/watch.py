"""Watches the nodes of a run on a mesh: takes reports, handles exits, stops nodes."""

from __future__ import annotations

from rich.markup import escape

from mast_zenoh.errors import BackendError, ServiceDied
from mast_zenoh.launch.blocking_clients import BlockingClients
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.observation import Observation
from mast_zenoh.launch.protocol.actions import LauncherActions
from mast_zenoh.launch.protocol.endings import Endings
from mast_zenoh.launch.protocol.interception import Interceptions
from mast_zenoh.launch.protocol.steps import Steps
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.steps import StepRequests

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
