"""A page of a running run that leaves, or never was one, is nothing that its user has to read about."""

from __future__ import annotations

import logging
import socket
import struct
import threading
from collections.abc import Callable
from enum import Enum

import pytest
from launched import eventually
from websockets.sync.client import connect

from mast_zenoh.viewer.page.live_server import FRAMES, Feed, LiveServer


class Step(Enum):
    """What a peer does besides sending: reads some bytes, or all; or closes without a farewell, as a killed browser."""

    READ, READ_ALL, RESET = range(3)


_PAGE, _SOCKET = ("GET " + path + " HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n" for path in ("/", FRAMES))
_UPGRADE = (
    f"{_SOCKET}Upgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
)
PEERS: dict[str, list[str | Step]] = {
    "says nothing": [],
    "resets at once": [Step.RESET],
    "sends garbage": ["\x16\x03\x01\x02\x00\x01\xff\r\n\r\n" * 50],
    "posts": [_PAGE.replace("GET", "POST") + "Content-Length: 0\r\n\r\n", Step.READ_ALL],
    "sends many headers": ["HEAD / HTTP/1.1\r\n" + "a: b\r\n" * 1000],
    "leaves in the handshake": [_UPGRADE],
    "leaves after the request": [f"{_UPGRADE}\r\n", Step.RESET],
    "asks without an upgrade": [f"{_SOCKET}\r\n", Step.READ_ALL],
    "leaves while the page loads": [f"{_PAGE}\r\n", Step.READ, Step.RESET],
    "sends garbage on the socket": [f"{_UPGRADE}\r\n", Step.READ, "\xff" * 200, Step.READ_ALL],
}


def visit(server: LiveServer, steps: list[str | Step]) -> None:
    with socket.create_connection(("127.0.0.1", server.port), timeout=10.0) as peer:
        for step in steps:
            if isinstance(step, str):
                peer.sendall(step.replace("{port}", str(server.port)).encode("latin-1"))
            elif step is Step.RESET:
                reset(peer)
            else:
                while peer.recv(4096) and step is Step.READ_ALL:
                    pass


def reset(peer: socket.socket) -> None:
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()


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


VISITS: dict[str, Callable[[LiveServer], None]] = {
    **{name: lambda server, steps=steps: visit(server, steps) for name, steps in PEERS.items()},
    **{each.__name__: each for each in (sends_a_long_message, closes_the_tab, is_killed_while_frames_arrive)},
}


@pytest.mark.parametrize("name", VISITS)
def test_a_visit_prints_nothing(name: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    # as in the program, which sets up no logging: warnings and errors go to the terminal
    monkeypatch.setattr(logging.root, "handlers", [])
    before = set(threading.enumerate())
    with LiveServer("a run", Feed()) as server:
        VISITS[name](server)
        with connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None) as page:
            page.ping().wait(10.0)
    eventually(lambda: set(threading.enumerate()) <= before, "every connection is over", 30)
    assert capfd.readouterr() == ("", "")
