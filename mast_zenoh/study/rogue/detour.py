"""A redirectable TCP relay between a node and the router."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from types import TracebackType

_CONNECT_S = 2.0


class Detour:
    """Relays connections byte for byte to the port that `target` returns, until redirected.

    It models redirection in a real network (a forged ARP or DNS reply, a NAT rule), and needs no privileges.

    target: returns the local port to connect to; called for each connection
    """

    def __init__(self, target: Callable[[], int]) -> None:
        self._target = target
        self._override_port: int | None = None
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept, name="detour")]
        self._threads[0].start()

    def redirect(self, port: int | None) -> None:
        """Close all connections, and relay new ones to a port; None: the original target."""
        self._override_port = port
        self._disconnect()

    def close(self) -> None:
        """Close all connections and stop."""
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)  # wakes the accepting thread; closing alone does not
        self._server.close()
        self._disconnect()
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> Detour:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _disconnect(self) -> None:
        with self._lock:
            for endpoint in self._open:
                with contextlib.suppress(OSError):
                    endpoint.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            try:
                port = self._target() if self._override_port is None else self._override_port
                far = socket.create_connection(("127.0.0.1", port), _CONNECT_S)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            connection = _RelayedConnection(near, far, self._remove)
            with self._lock:
                self._open |= {near, far}
            for direction in ((near, far), (far, near)):
                self._threads.append(threading.Thread(target=connection.relay, args=direction, name="detour"))
                self._threads[-1].start()

    def _remove(self, ends: set[socket.socket]) -> None:
        with self._lock:
            self._open -= ends


class _RelayedConnection:
    """A relayed connection; when one direction ends, so does the other."""

    def __init__(self, near: socket.socket, far: socket.socket, closed: Callable[[set[socket.socket]], None]) -> None:
        self._ends = {near, far}
        self._closed = closed
        self._open_directions = 2
        self._lock = threading.Lock()
        for endpoint in self._ends:
            endpoint.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def relay(self, source: socket.socket, target: socket.socket) -> None:
        """Relay one direction until either endpoint closes."""
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        for endpoint in self._ends:
            with contextlib.suppress(OSError):
                endpoint.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._open_directions -= 1
            last = self._open_directions == 0
        if last:
            self._closed(self._ends)
            for endpoint in self._ends:
                endpoint.close()
