"""Disconnects foreign clients that take nothing any more and thereby hold up a lock-step run.

Messages in lock-step wait until everyone who subscribed has room for them, so that no node misses any. A client that is
no node, such as a recorder of somebody else, would stop the run when it is suspended: the router waits for it. Viewers
are no such clients (`session.OBSERVERS`).
"""

from __future__ import annotations

import fcntl
import json
import socket
import struct
import time

import zenoh

from mast_zenoh.runtime.mesh.session import OBSERVERS, own_sockets

#: s without a new frame after which links are looked at, and between two looks.
_PAUSE_S, _LOOK_S = 2.0, 1.0
_ADMIN_S = 2.0
#: Of Linux: the request for the number of unsent bytes, and the place of `bytes_acked` in `struct tcp_info`.
_SIOCOUTQ, _ACKED_AT = 0x5411, 120
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: closing waits for nobody


class BlockingClients:
    """Looks at the links of a router in this process while no frame begins.

    session: the router's;  endpoint: its own;  prefix: of all keys of the run
    """

    def __init__(self, session: zenoh.Session, endpoint: str, prefix: str) -> None:
        self._session = session
        self._ports = {int(endpoint.rpartition(":")[2])}
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
        self._due = now + _LOOK_S
        before, self._before = self._before, self._full_links()
        stuck = {address for address, acked in self._before.items() if before.get(address) == acked}
        return self._end(stuck) if stuck else []

    def _full_links(self) -> dict[str, int]:
        """By address of the other side: the bytes that it has taken, of links on which more are waiting."""
        links = {}
        for own in own_sockets(self._ports):
            if not own.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                waiting = struct.unpack("i", fcntl.ioctl(own.fileno(), _SIOCOUTQ, bytes(4)))[0]
                info = own.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _ACKED_AT + 8)
                if waiting:
                    links[_address(own)] = int(struct.unpack_from("Q", info, _ACKED_AT)[0])
        return links

    def _end(self, stuck: set[str]) -> list[str]:
        """End those of these links that lead neither to nodes, which lock-step waits for, nor to observers."""
        excepted = {*OBSERVERS, *self._nodes()}
        zids = {str(link.dst).partition("/")[2]: str(link.zid) for link in self._session.info.links()}
        ended = []
        for own in own_sockets(self._ports):
            if own.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                continue
            address = _address(own)
            if address in stuck and (zid := zids.get(address)) is not None and zid not in excepted:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                own.shutdown(socket.SHUT_RDWR)
                ended.append(
                    f"a client that is no node of this run held it up at frame {self._frame}: {address} (Zenoh id "
                    f"{zid}) did not read what it subscribed to, and was disconnected"
                )
        return ended

    def _nodes(self) -> set[str]:
        """The ids of the sessions that hold the tokens of the run's nodes."""
        return {
            zid
            for reply in self._session.get(self._alive, timeout=_ADMIN_S)
            if reply.ok is not None
            for zid in json.loads(reply.ok.payload.to_string())["clients"]
        }


def _address(own: socket.socket) -> str:
    """The other side of a socket, as Zenoh writes it."""
    host, port = own.getpeername()[:2]
    return f"[{host}]:{port}" if own.family == socket.AF_INET6 and "." not in host else f"{host}:{port}"
