"""Servers on the loopback address answer requests to this computer, and survive clients that go away."""

from __future__ import annotations

import socket
import struct
import sys
import threading
from typing import Any

from mast_zenoh.viewer.loopback import LoopbackHandler, LoopbackServer, is_own_host, tunnel

_RESET = struct.pack("ii", 1, 0)  # closing the connection discards what has not been sent


def test_only_names_of_this_computer_are_its_own() -> None:
    for host in ("127.0.0.1", "localhost:8000", "LOCALHOST", "LocalHost:8000"):
        assert is_own_host(host)
    for host in ("", "attacker.example", "attacker.example:8000", "127.0.0.1.example"):
        assert not is_own_host(host)


def test_a_tunnel_leads_to_the_port_of_an_address() -> None:
    assert tunnel("ws://127.0.0.1:8765").startswith("ssh -L 8765:127.0.0.1:8765 ")


class Server(LoopbackServer):
    """Remembers the errors of its handlers."""

    def __init__(self, handler: type[LoopbackHandler]) -> None:
        self.errors: list[BaseException | None] = []
        self.asked, self.client_gone, self.answered = (threading.Event() for _ in range(3))
        super().__init__(0, handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        self.errors.append(sys.exc_info()[1])

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        self.answered.set()


class LargePage(LoopbackHandler):
    """Sends more than the buffers of a connection hold, to a client that has gone."""

    server: Server

    def answer(self, path: str) -> None:
        self.server.asked.set()
        assert self.server.client_gone.wait(20)
        self.send_content(bytes(1 << 24), "text/html", "default-src 'none'")


class FailingPage(LoopbackHandler):
    """Has a defect."""

    server: Server

    def answer(self, path: str) -> None:
        self.server.asked.set()
        raise ZeroDivisionError


def errors_of(handler: type[LoopbackHandler]) -> list[BaseException | None]:
    """What a server reports when a client closes its connection before the answer."""
    with Server(handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with socket.create_connection(("127.0.0.1", server.server_port)) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            client.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert server.asked.wait(20)
        server.client_gone.set()
        assert server.answered.wait(20)
        server.shutdown()
    return server.errors


def test_a_client_that_closes_early_is_no_error_but_others_are_reported() -> None:
    assert errors_of(LargePage) == []
    assert [type(error) for error in errors_of(FailingPage)] == [ZeroDivisionError]
