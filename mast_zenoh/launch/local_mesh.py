"""Joins the mesh of a run whose nodes are processes on this machine.

The router is in this process, an existing one, or in the network namespaces of the run.
"""

from __future__ import annotations

from contextlib import ExitStack

from mast_zenoh.errors import BackendError
from mast_zenoh.launch.blocking_clients import closing_router
from mast_zenoh.launch.context import VIEWER_CREDENTIALS, Mesh, RunContext
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.processes import Processes
from mast_zenoh.runtime.mesh.session import open_client, open_router
from mast_zenoh.security import levels
from mast_zenoh.security.credentials import VIEWER


def join(context: RunContext, stack: ExitStack, endpoint: str | None, listen: str) -> tuple[Mesh, Hosts | None]:
    """Join the mesh; create network namespaces if the scenario has hosts.

    stack: closes everything that is opened here
    endpoint: an existing router's; None: start a router in this process, listening at `listen`
    Raises BackendError for an impossible combination.
    """
    network = context.resolved.network
    if context.secure != "open" and (endpoint or network):
        where = endpoint or "hosts in network namespaces"
        raise BackendError(f"security level {context.secure}: expected a router in this process, found {where}")
    if network:
        if endpoint:
            raise BackendError(f"hosts need their own router: they cannot join the mesh of {endpoint}")
        return _join_hosts(context, stack)
    return (_join_router(context, stack, endpoint) if endpoint else _open_router(context, stack, listen)), None


def _join_hosts(context: RunContext, stack: ExitStack) -> tuple[Mesh, Hosts]:
    """Join a mesh of nodes in network namespaces, with the router in a separate one."""
    hosts = stack.enter_context(Hosts(context.resolved.network, context.resolved.rate, context.folder / "logs"))
    context.record["endpoint"] = hosts.endpoint
    session = stack.enter_context(open_client(hosts.endpoint))
    return Mesh(session, Processes(context.folder, context.run_id, hosts.inside, hosts.command)), hosts


def _join_router(context: RunContext, stack: ExitStack, endpoint: str) -> Mesh:
    """Join an existing router."""
    context.record["endpoint"] = endpoint
    session = stack.enter_context(open_client(endpoint, patient=context.resolved.patient))
    return Mesh(session, Processes(context.folder, context.run_id, endpoint))


def _open_router(context: RunContext, stack: ExitStack, listen: str) -> Mesh:
    """Open a router in this process, with credentials for nodes above level "open"."""
    resolved, run = context.resolved, context.run_id
    listen = levels.endpoint(context.secure, listen)
    deployment = stack.enter_context(context.make_deployment(levels.hosts([listen])))
    if context.viewer and deployment.folder is not None:
        context.record[VIEWER_CREDENTIALS] = str(deployment.of(VIEWER))

    def extra_arguments(name: str) -> list[str]:
        """Arguments for a node's credentials, and for its detour to the router if any."""
        arguments = deployment.arguments(name)
        return [*arguments, "--endpoint", context.detours[name]] if name in context.detours else arguments

    session, endpoint = open_router(listen, security=deployment.router, patient=resolved.patient)
    context.record["endpoint"] = endpoint
    processes = Processes(context.folder, run, endpoint, extra_arguments=extra_arguments)
    router = stack.enter_context(closing_router(session, endpoint))
    return Mesh(router, processes, deployment, has_router=True, zids=processes.zids)
