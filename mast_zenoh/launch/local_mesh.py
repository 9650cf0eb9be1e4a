"""Joins the mesh of a run whose nodes are processes on this machine, and disconnects clients that hold it up.

The router is in this process, an existing one, or in the network namespaces of the run.

Messages in lock-step wait until every subscriber has room for them, so that no node misses any. A client that is
no node, such as a third-party recorder, would stop the run when it is suspended, or slow it down to its own pace.
Routers do not wait for viewers (`session.OBSERVERS`).

Zenoh's own setting does not do the same: with nodes on Unix sockets, `qos/network` can drop what TCP links do not take.
A client that reads slowly then loses most messages (of 2,000 at 2 ms each 237 arrive, instead of all), and nobody is
named. With TLS the links of nodes and of other clients look alike, and the run stalls.

Nodes are known by the Zenoh ids that the launcher gave them, as anybody may claim their liveliness tokens. The router's
admin space knows who does, but reading it while a client connects can lock up the router (Zenoh 1.10).
"""

from __future__ import annotations

import fcntl
import logging
import socket
import struct
import time
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import NamedTuple

import zenoh

from mast_zenoh.errors import BackendError
from mast_zenoh.launch.context import VIEWER_CREDENTIALS, Mesh, RunContext
from mast_zenoh.launch.netns.hosts import Hosts
from mast_zenoh.launch.processes import Processes
from mast_zenoh.mesh.security import levels
from mast_zenoh.mesh.security.credentials import VIEWER
from mast_zenoh.mesh.session import OBSERVERS, open_client, open_router, own_sockets

#: s between two looks at the links; s for which a link is watched before it is ended.
_LOOK_S, _PATIENCE_S = 0.5, 2.5
#: Share of that time in which the router waited for the other side to read.
_WAITED_SHARE = 0.9
#: s in which a client that reads takes something.
_TAKEN_S = 0.2
#: Of Linux: the request for the number of unsent bytes, and the place of `tcpi_rwnd_limited` in `struct tcp_info`.
_SIOCOUTQ, _WAITED_OFFSET = 0x5411, 176
log = logging.getLogger("mast.launch")

_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close without waiting


class _Look(NamedTuple):
    """Links at one time: monotonic clock, s; the newest frame; by address, s for which the other side did not read."""

    now: float
    frame: int
    waited_s: Mapping[str, float]


class BlockingClients:
    """Looks at the links of a router in this process.

    mesh: `session` is the router's own;  endpoint: the router's
    """

    def __init__(self, context: RunContext, mesh: Mesh, endpoint: str) -> None:
        self._context = context
        self._session = mesh.session
        self._nodes = mesh.zids
        self._port = _port(endpoint)
        self._due = 0.0
        self._looks = deque[_Look]()
        self._disconnected: set[str] = set()  # Zenoh ids

    def disconnect(self) -> list[str]:
        """End the links that hold up the run, if any; returns a sentence for each client. To be called often.

        A client that was disconnected once stays out: Zenoh connects and subscribes again by itself.
        """
        now = time.monotonic()
        if now < self._due:
            return []
        self._due = now + _LOOK_S
        look = _Look(now, self._context.frame, _waited_s(self._port))
        self._looks.append(look)
        while len(self._looks) > 1 and now - self._looks[1].now >= _PATIENCE_S:
            self._looks.popleft()
        unread = self._unread(self._looks[0], look)
        if not (unread or self._disconnected):
            return []
        addresses = {str(link.zid): str(link.dst).partition("/")[2] for link in self._session.info.links()}
        known = {*OBSERVERS, *self._nodes, *self._disconnected}
        new = {zid for zid, address in addresses.items() if address in unread and zid not in known}
        self._disconnected |= new
        _reset(self._port, {addresses[zid] for zid in self._disconnected & addresses.keys()})
        return [
            f"a client that is no node of this run held it up at frame {look.frame}: {addresses[zid]} (Zenoh id {zid}) "
            "did not read in time what it subscribed to, and was disconnected"
            for zid in sorted(new)
        ]

    def _unread(self, first: _Look, last: _Look) -> set[str]:
        """The addresses that did not read between two looks, if the run was slower than its scene meanwhile."""
        passed = last.now - first.now
        scene_s = (last.frame - first.frame) * self._context.resolved.period_ns * 1e-9
        if passed < _PATIENCE_S or first.frame < 0 or scene_s >= passed:
            return set()
        enough = _WAITED_SHARE * passed
        return {
            address
            for address, waited_s in last.waited_s.items()
            if waited_s - first.waited_s.get(address, waited_s) >= enough
        }


@contextmanager
def closing_router(router: zenoh.Session, endpoint: str) -> Iterator[zenoh.Session]:
    """A router in this process, closed at the end, after the links of clients that do not take everything soon.

    Closing it would wait for them, and fail. The nodes have left by then.
    """
    try:
        yield router
    finally:
        port = _port(endpoint)
        if _full_links(port):
            time.sleep(_TAKEN_S)
            _reset(port, _full_links(port))
        try:
            router.close()
        except zenoh.ZError as error:  # the run is over: nothing is lost that belongs to it
            log.warning("the router of the run was not closed: %s", error)


def _port(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


def _links(port: int) -> Iterator[tuple[str, socket.socket]]:
    """The links of a router in this process that have another side, with its address."""
    for own in own_sockets({port}):
        try:
            address = _address(own)
        except OSError:  # the socket listens, or its other side has left
            continue
        yield address, own


def _full_links(port: int) -> set[str]:
    """The addresses of the other side of links on which bytes are waiting."""
    full = set()
    for address, own in _links(port):
        with suppress(OSError):
            if struct.unpack("i", fcntl.ioctl(own.fileno(), _SIOCOUTQ, bytes(4)))[0]:
                full.add(address)
    return full


def _waited_s(port: int) -> dict[str, float]:
    """By address of the other side: s for which this side waited for it to read, since the link began."""
    waited = {}
    for address, own in _links(port):
        with suppress(OSError, struct.error):  # an old kernel does not have it
            info = own.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _WAITED_OFFSET + 8)
            waited[address] = struct.unpack_from("Q", info, _WAITED_OFFSET)[0] * 1e-6
    return waited


def _reset(port: int, addresses: Collection[str]) -> None:
    """End the links to these addresses without waiting."""
    for address, own in _links(port):
        if address in addresses:
            with suppress(OSError):  # the other side may leave meanwhile
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                own.shutdown(socket.SHUT_RDWR)


def _address(own: socket.socket) -> str:
    """The other side of a socket, as Zenoh writes it."""
    host, port = own.getpeername()[:2]
    return f"[{host}]:{port}" if own.family == socket.AF_INET6 and "." not in host else f"{host}:{port}"


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
    if not endpoint:
        return _open_router(context, stack, listen), None
    context.record["endpoint"] = endpoint
    session = stack.enter_context(open_client(endpoint, patient=context.resolved.patient))
    return Mesh(session, Processes(context.folder, context.run_id, endpoint)), None


def _join_hosts(context: RunContext, stack: ExitStack) -> tuple[Mesh, Hosts]:
    """Join a mesh of nodes in network namespaces, with the router in a separate one."""
    hosts = stack.enter_context(Hosts(context.resolved.network, context.resolved.rate, context.folder / "logs"))
    context.record["endpoint"] = hosts.endpoint
    session = stack.enter_context(open_client(hosts.endpoint))
    return Mesh(session, Processes(context.folder, context.run_id, hosts.inside, hosts.command)), hosts


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
