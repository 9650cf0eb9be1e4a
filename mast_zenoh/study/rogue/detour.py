"""The way of one node to the router, in the hands of whoever can turn it: a TCP relay that can be pointed elsewhere."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from types import TracebackType

_CONNECT_S = 2.0


class Detour:
    """Relays connections byte for byte to the port that `target` says, until it is turned to another one.

    It stands for what turns a way in a real network (a forged ARP or DNS answer, a NAT rule), and needs no privilege.

    target: the port on this machine that a connection is for; asked for each anew
    """

    def __init__(self, target: Callable[[], int]) -> None:
        self._target = target
        self._turned: int | None = None
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept, name="detour")]
        self._threads[0].start()

    def turn(self, port: int | None) -> None:
        """Cut what is connected, and lead what connects from now on to this port; None: where it is meant for."""
        self._turned = port
        self._cut()

    def close(self) -> None:
        """Cut everything and stop."""
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # wakes the accepting thread, which close alone does not
        self._listening.close()
        self._cut()
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> Detour:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _cut(self) -> None:
        with self._lock:
            for end in self._open:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            try:
                port = self._target() if self._turned is None else self._turned
                far = socket.create_connection(("127.0.0.1", port), _CONNECT_S)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            pair = _Pair(near, far, self._forget)
            with self._lock:
                self._open |= {near, far}
            for way in ((near, far), (far, near)):
                self._threads.append(threading.Thread(target=pair.relay, args=way, name="detour"))
                self._threads[-1].start()

    def _forget(self, ends: set[socket.socket]) -> None:
        with self._lock:
            self._open -= ends


class _Pair:
    """One connection and its continuation; when one way ends, so does the other."""

    def __init__(self, near: socket.socket, far: socket.socket, closed: Callable[[set[socket.socket]], None]) -> None:
        self._ends = {near, far}
        self._closed = closed
        self._left = 2
        self._lock = threading.Lock()
        for end in self._ends:
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def relay(self, source: socket.socket, target: socket.socket) -> None:
        """One way, until an end closes."""
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        for end in self._ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._left -= 1
            last = self._left == 0
        if last:
            self._closed(self._ends)
            for end in self._ends:
                end.close()
