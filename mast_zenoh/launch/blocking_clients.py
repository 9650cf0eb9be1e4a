"""Disconnects foreign clients that stopped reading and block a lock-step run.

Messages in lock-step wait until every subscriber has room for them, so that no node misses any. A client that is
no node, such as a third-party recorder, would stop the run when it is suspended: the router waits for it. Routers do
not wait for viewers (`session.OBSERVERS`).
"""

from __future__ import annotations

import fcntl
import json
import logging
import socket
import struct
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress

import zenoh

from mast_zenoh.runtime.mesh.session import OBSERVERS, own_sockets

#: s without a new frame after which links are looked at, and between two looks.
_PAUSE_S, _CHECK_INTERVAL_S = 2.0, 1.0
#: s, limit on a query of the router's admin space.
_ADMIN_S = 2.0
#: s in which a client that reads takes something.
_TAKEN_S = 0.2
#: Of Linux: the request for the number of unsent bytes, and the place of `bytes_acked` in `struct tcp_info`.
_SIOCOUTQ, _ACKED_OFFSET = 0x5411, 120
log = logging.getLogger("mast.launch")

_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close without waiting


class BlockingClients:
    """Looks at the links of a router in this process while no frame begins.

    session: the router's;  endpoint: its own;  prefix: of all keys of the run
    nodes: the names of its nodes now
    """

    def __init__(self, session: zenoh.Session, endpoint: str, prefix: str, nodes: Collection[str]) -> None:
        self._session = session
        self._names = nodes
        self._port = _port(endpoint)
        self._alive = f"@/{session.info.zid()}/router/token/{prefix}/alive/*"
        self._frame = -1
        self._due = 0.0
        self._before: dict[str, int] = {}

    def disconnect(self, frame: int) -> list[str]:
        """End the links that hold up the run, if any; returns a sentence for each. To be called often.

        frame: the newest that has begun; nothing happens before the first
        """
        now = time.monotonic()
        if frame != self._frame:
            self._frame, self._due, self._before = frame, now + _PAUSE_S, {}
        if frame < 0 or now < self._due:
            return []
        self._due = now + _CHECK_INTERVAL_S
        before, self._before = self._before, _full_links(self._port)
        stuck = {address for address, acked in self._before.items() if before.get(address) == acked}
        return self._end(stuck) if stuck else []

    def _end(self, stuck: set[str]) -> list[str]:
        """End those of these links that lead neither to nodes, which lock-step waits for, nor to observers."""
        excepted = {*OBSERVERS, *self._nodes()}
        zids = {str(link.dst).partition("/")[2]: str(link.zid) for link in self._session.info.links()}
        foreign = {address for address in stuck if address in zids and zids[address] not in excepted}
        return [
            f"a client that is no node of this run held it up at frame {self._frame}: {address} (Zenoh id "
            f"{zids[address]}) did not read what it subscribed to, and was disconnected"
            for address in _reset(self._port, foreign)
        ]

    def _nodes(self) -> set[str]:
        """The ids of the sessions that hold the tokens of the run's nodes."""
        return {
            zid
            for reply in self._session.get(self._alive, timeout=_ADMIN_S)
            if reply.ok is not None and str(reply.ok.key_expr).rpartition("/")[2] in self._names
            for zid in json.loads(reply.ok.payload.to_string())["clients"]
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
            _reset(port, _full_links(port).keys())
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


def _full_links(port: int) -> dict[str, int]:
    """By address of the other side: the bytes that it has taken, of links on which more are waiting."""
    links = {}
    for address, own in _links(port):
        with suppress(OSError):
            waiting = struct.unpack("i", fcntl.ioctl(own.fileno(), _SIOCOUTQ, bytes(4)))[0]
            info = own.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _ACKED_OFFSET + 8)
            if waiting:
                links[address] = int(struct.unpack_from("Q", info, _ACKED_OFFSET)[0])
    return links


def _reset(port: int, addresses: Collection[str]) -> list[str]:
    """End the links to these addresses without waiting; returns those that there were."""
    ended = []
    for address, own in _links(port):
        if address in addresses:
            with suppress(OSError):  # the other side may leave meanwhile
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                own.shutdown(socket.SHUT_RDWR)
                ended.append(address)
    return ended


def _address(own: socket.socket) -> str:
    """The other side of a socket, as Zenoh writes it."""
    host, port = own.getpeername()[:2]
    return f"[{host}]:{port}" if own.family == socket.AF_INET6 and "." not in host else f"{host}:{port}"
