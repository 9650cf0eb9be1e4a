"""A detour relays every byte until it is redirected."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mast_zenoh.study.rogue.detour import Detour


@contextmanager
def echo(word: bytes) -> Iterator[int]:
    """The port of a server that echoes data with a prefix."""
    listening = socket.create_server(("127.0.0.1", 0))
    served: list[socket.socket] = []

    def serve() -> None:
        while True:
            try:
                served.append(listening.accept()[0])
            except OSError:
                return
            threading.Thread(target=answer, args=(served[-1],), daemon=True).start()

    def answer(link: socket.socket) -> None:
        while data := link.recv(100):
            link.sendall(word + data)
        link.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        thread.join()


def reply(link: socket.socket) -> bytes:
    link.sendall(b"?")
    return link.recv(100)


def test_connections_go_to_the_target_except_while_redirected() -> None:
    before = threading.active_count()
    with echo(b"true") as port, echo(b"rogue") as other, Detour(lambda: port) as detour:
        first = socket.create_connection(("127.0.0.1", detour.port), 5)
        assert reply(first) == b"true?"
        for override, word in ((other, b"rogue?"), (None, b"true?")):
            detour.redirect(override)
            assert first.recv(100) == b"", "existing connections are closed"
            first.close()
            first = socket.create_connection(("127.0.0.1", detour.port), 5)
            assert reply(first) == word
        first.close()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and thread.name != "MainThread" and thread.daemon:
            thread.join(5)
    assert threading.active_count() == before


def test_connection_to_a_closed_port_is_closed() -> None:
    with echo(b"") as port:
        pass
    with Detour(lambda: port) as detour, socket.create_connection(("127.0.0.1", detour.port), 5) as link:
        assert link.recv(1) == b""
