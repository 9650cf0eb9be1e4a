"""One run on a mesh, whichever supervisor starts its nodes."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import Any

import zenoh

from mast_zenoh.control import control_prefix, prefix
from mast_zenoh.errors import BackendError
from mast_zenoh.launch import description, local_mesh, mesh_conclusion
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.engine import Engine
from mast_zenoh.launch.file_server import FileServer
from mast_zenoh.launch.interception.server import InterceptionServer
from mast_zenoh.launch.mesh_actions import MeshActions
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.protocol.interception import Interceptions
from mast_zenoh.launch.protocol.steps import Steps
from mast_zenoh.launch.reports import Reports
from mast_zenoh.launch.steps import StepRequests
from mast_zenoh.launch.watch import Watch
from mast_zenoh.runtime.protocol.stamp import stamp_of
from mast_zenoh.runtime.protocol.timetable import Timetable

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
        declared = [*_declare(context, session, requests, hosts), description.declare(context, session)]
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
    mesh_conclusion.conclude(context, supervisor, reports, begun)


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
