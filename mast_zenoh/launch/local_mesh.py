"""Joins the mesh of a run whose nodes are processes of this machine; the router is here, yours, or among its hosts."""

from __future__ import annotations

from contextlib import ExitStack

from mast_zenoh.errors import BackendError
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.processes import Processes
from mast_zenoh.runtime.mesh.session import open_client, open_router
from mast_zenoh.security import levels


def join(context: RunContext, stack: ExitStack, endpoint: str | None, listen: str) -> tuple[Mesh, Hosts | None]:
    """The mesh, and the network namespaces of its nodes if the scenario has hosts; the stack closes all of it.

    endpoint: of a router that is there already; None: one in this process, listening at `listen`
    Raises BackendError for a combination that is not possible.
    """
    network = context.resolved.network
    if context.secure != "open" and (endpoint or network):
        where = endpoint or "hosts in network namespaces"
        raise BackendError(f"security level {context.secure}: expected a router in this process, found {where}")
    if network:
        if endpoint:
            raise BackendError(f"hosts have a router of their own: they cannot be on the mesh of {endpoint}")
        return _join_hosts(context, stack)
    return (_join_router(context, stack, endpoint) if endpoint else _open_router(context, stack, listen)), None


def _join_hosts(context: RunContext, stack: ExitStack) -> tuple[Mesh, Hosts]:
    """Nodes in network namespaces, and the router in one of its own."""
    hosts = stack.enter_context(Hosts(context.resolved.network, context.resolved.rate, context.folder / "logs"))
    context.record["endpoint"] = hosts.endpoint
    session = stack.enter_context(open_client(hosts.endpoint))
    return Mesh(session, Processes(context.folder, context.run_id, hosts.inside, hosts.command)), hosts


def _join_router(context: RunContext, stack: ExitStack, endpoint: str) -> Mesh:
    """A router that is there already."""
    context.record["endpoint"] = endpoint
    session = stack.enter_context(open_client(endpoint, patient=context.resolved.patient))
    return Mesh(session, Processes(context.folder, context.run_id, endpoint))


def _open_router(context: RunContext, stack: ExitStack, listen: str) -> Mesh:
    """A router in this process, with credentials for all nodes above the level "open"."""
    resolved, run = context.resolved, context.run_id
    listen = levels.endpoint(context.secure, listen)
    deployment = stack.enter_context(context.make_deployment(levels.hosts([listen])))

    def extra_arguments(name: str) -> list[str]:
        """Where its credentials are, and its own way to the router if it has one."""
        own = deployment.arguments(name)
        return [*own, "--endpoint", context.detours[name]] if name in context.detours else own

    session, endpoint = open_router(listen, security=deployment.router, patient=resolved.patient)
    context.record["endpoint"] = endpoint
    processes = Processes(context.folder, run, endpoint, extra_arguments=extra_arguments)
    return Mesh(stack.enter_context(session), processes, deployment)
