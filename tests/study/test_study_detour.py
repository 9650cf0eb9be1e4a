"""A detour passes every byte on, until it is turned."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mast_zenoh.study.rogue.detour import Detour


@contextmanager
def echo(word: bytes) -> Iterator[int]:
    """A server that answers everything with this word before it; its port."""
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


def asked(link: socket.socket) -> bytes:
    link.sendall(b"?")
    return link.recv(100)


def test_connections_go_where_they_are_meant_for_until_it_is_turned_and_again_when_it_is_turned_back() -> None:
    before = threading.active_count()
    with echo(b"true") as port, echo(b"rogue") as other, Detour(lambda: port) as detour:
        first = socket.create_connection(("127.0.0.1", detour.port), 5)
        assert asked(first) == b"true?"
        for turned, word in ((other, b"rogue?"), (None, b"true?")):
            detour.turn(turned)
            assert first.recv(100) == b"", "what is connected is cut"
            first.close()
            first = socket.create_connection(("127.0.0.1", detour.port), 5)
            assert asked(first) == word
        first.close()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and thread.name != "MainThread" and thread.daemon:
            thread.join(5)
    assert threading.active_count() == before


def test_where_nobody_listens_nobody_is_connected_for_long() -> None:
    with echo(b"") as port:
        pass
    with Detour(lambda: port) as detour, socket.create_connection(("127.0.0.1", detour.port), 5) as link:
        assert link.recv(1) == b""
