"""A page of a running run that leaves, or never was one, is nothing that its user has to read about."""

from __future__ import annotations

import logging
import socket
import struct
import threading
from collections.abc import Callable

import pytest
from launched import eventually
from websockets.sync.client import connect

from mast_zenoh.viewer.page.live_server import FRAMES, Feed, LiveServer

_UPGRADE = (
    "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)


def opened(server: LiveServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), timeout=10.0)


def reset(peer: socket.socket) -> None:
    """Close without a farewell, as a killed browser does."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()


def says_nothing(server: LiveServer) -> None:
    opened(server).close()


def resets_at_once(server: LiveServer) -> None:
    reset(opened(server))


def sends_garbage(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall(b"\x16\x03\x01\x02\x00\x01\xff\r\n\r\n" * 50)


def posts(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall(f"POST / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nContent-Length: 0\r\n\r\n".encode())
        while peer.recv(4096):
            pass


def asks_for_its_headers_size(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall(b"HEAD / HTTP/1.1\r\n" + b"a: b\r\n" * 1000)


def leaves_in_the_handshake(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall(_UPGRADE.format(path=FRAMES, port=server.port).encode())


def leaves_after_the_request(server: LiveServer) -> None:
    peer = opened(server)
    peer.sendall((_UPGRADE + "\r\n").format(path=FRAMES, port=server.port).encode())
    reset(peer)


def asks_without_an_upgrade(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall(f"GET {FRAMES} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        while peer.recv(4096):
            pass


def leaves_while_the_page_loads(server: LiveServer) -> None:
    peer = opened(server)
    peer.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
    peer.recv(100)
    reset(peer)


def sends_garbage_on_the_socket(server: LiveServer) -> None:
    with opened(server) as peer:
        peer.sendall((_UPGRADE + "\r\n").format(path=FRAMES, port=server.port).encode())
        peer.recv(4096)
        peer.sendall(b"\xff" * 200)
        while peer.recv(4096):
            pass


def sends_a_long_message(server: LiveServer) -> None:
    with connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None) as page:
        page.send(bytes(100_000))


def closes_the_tab(server: LiveServer) -> None:
    with connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None):
        pass


def is_killed_while_frames_arrive(server: LiveServer) -> None:
    page = connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None)
    eventually(lambda: server.feed.is_wanted, "the page waits for frames")
    server.feed.publish({"id": "run-1", "number": 1}, bytes(1_000_000))
    page.recv(timeout=10.0)
    reset(page.socket)


VISITS = [
    says_nothing,
    resets_at_once,
    sends_garbage,
    posts,
    asks_for_its_headers_size,
    leaves_in_the_handshake,
    leaves_after_the_request,
    asks_without_an_upgrade,
    leaves_while_the_page_loads,
    sends_garbage_on_the_socket,
    sends_a_long_message,
    closes_the_tab,
    is_killed_while_frames_arrive,
]


@pytest.mark.parametrize("visit", VISITS, ids=lambda visit: visit.__name__)
def test_a_visit_prints_nothing(
    visit: Callable[[LiveServer], None], capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # as in the program, which sets up no logging: warnings and errors go to the terminal
    monkeypatch.setattr(logging.root, "handlers", [])
    before = set(threading.enumerate())
    with LiveServer("a run", Feed()) as server:
        visit(server)
        with connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None) as page:
            page.ping().wait(10.0)
    eventually(lambda: set(threading.enumerate()) <= before, "every connection is over", 30)
    assert capfd.readouterr() == ("", "")
