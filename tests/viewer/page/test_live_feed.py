"""Pages of a running run get its newest frames; one that does not read, or leaves rudely, holds back nothing."""

import json
import logging
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from enum import Enum

import pytest
from launched import eventually
from own_requests import answer
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mast_zenoh.show.page.live_server import FRAMES, MOST_PAGES, QUEUED, Feed, LiveServer

LASTING = {"label": "a run"}


@pytest.fixture
def server() -> Iterator[LiveServer]:
    with LiveServer("a run", Feed()) as running:
        yield running


def test_a_slow_listener_keeps_the_newest_frames_and_is_told_how_many_it_missed() -> None:
    feed = Feed()
    with feed.listener() as listener:
        for number in range(10):
            feed.publish(LASTING, bytes([number]))
        messages, more = listener.take(9, 1.0)
    assert more
    assert json.loads(messages[0]) == {"kind": "lasting", "header": LASTING}
    assert json.loads(messages[1]) == {"kind": "dropped", "count": 10 - QUEUED}
    assert messages[2:] == [bytes([number]) for number in range(10 - QUEUED, 10)]


def test_a_frame_never_meets_the_header_of_another_one() -> None:
    feed = Feed()
    with feed.listener() as listener:
        feed.publish(LASTING, b"old")
        feed.publish({"label": "rewired"}, b"new")
        messages, _ = listener.take(9, 1.0)
        assert [json.loads(messages[0])["header"]["label"], messages[1]] == ["rewired", b"new"]
        feed.publish({"label": "rewired"}, b"newer")
        assert listener.take(9, 1.0)[0] == [b"newer"], "the header is sent once"


def test_notes_reach_pages_also_if_no_frame_does() -> None:
    feed = Feed()
    with feed.listener() as early:
        for _ in range(2):
            feed.note(["frame 0 cannot be shown"])
        messages, _ = early.take(9, 1.0)
        assert [json.loads(message) for message in messages] == [
            {"kind": "notes", "notes": ["frame 0 cannot be shown"]}
        ]
    with feed.listener() as late:
        assert late.take(9, 1.0)[0] == messages
    feed.publish(LASTING, b"frame")
    feed.note(["another"])
    with feed.listener() as latest:
        kinds = [json.loads(each)["kind"] for each in latest.take(9, 1.0)[0] if isinstance(each, str)]
    assert kinds == ["lasting", "notes"], "the header first"


def test_a_page_that_opens_late_gets_the_newest_frame_and_the_end() -> None:
    feed = Feed()
    feed.publish(LASTING, b"frame")
    feed.close(reload=True)
    with feed.listener() as listener:
        messages, more = listener.take(9, 1.0)
    assert not more
    assert messages[1] == b"frame"
    assert json.loads(messages[-1]) == {"kind": "over", "reload": True}, "after all frames"


def test_a_page_that_does_not_read_does_not_stop_the_others(server: LiveServer) -> None:
    frame = bytes(1 << 20)
    address = f"ws://127.0.0.1:{server.port}{FRAMES}"
    with socket.create_connection(("127.0.0.1", server.port)) as stalled:
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        request = f"GET {FRAMES} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{key}\r\n"
        stalled.sendall(request.encode())
        assert b"101" in stalled.recv(64)
        with connect(address, max_size=None) as reading:
            for number in range(30):  # far more than the buffers of a socket hold
                server.feed.publish(LASTING, frame + bytes([number]))
                while (message := reading.recv(timeout=20)) != frame + bytes([number]):
                    assert isinstance(message, str) or message < frame + bytes([number])
                reading.send("shown")


def test_other_pages_and_other_hosts_may_not_read_frames(server: LiveServer) -> None:
    address = f"ws://127.0.0.1:{server.port}{FRAMES}"
    own = f"127.0.0.1:{server.port}"
    # This server has no https: such a page is another program's.
    for origin in ("http://attacker.example", f"https://{own}", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin)  # type: ignore[arg-type]
    connect(address, origin=f"http://{own}").close()  # type: ignore[arg-type]
    assert answer(server.port, "/", host="attacker.example").status == 403
    assert answer(server.port, "/run.json").status == 404
    page = answer(server.port, "/", host="localhost")
    assert page.status == 200
    assert "connect-src 'self'" in (page.getheader("Content-Security-Policy") or "")


def test_more_pages_than_the_limit_are_refused(server: LiveServer) -> None:
    address = f"ws://127.0.0.1:{server.port}{FRAMES}"
    server.feed.publish(LASTING, b"frame")
    open_pages = [connect(address) for _ in range(MOST_PAGES)]
    for page in open_pages:
        page.recv(timeout=20)
    with connect(address) as refused, pytest.raises(Exception, match="too many pages"):
        refused.recv(timeout=20)
    for page in open_pages:
        page.close()


def test_a_page_that_confirms_nothing_gets_two_frames_and_is_waited_for_by_nobody(server: LiveServer) -> None:
    with connect(f"ws://127.0.0.1:{server.port}{FRAMES}") as page:
        frames: list[bytes] = []
        while len(frames) < 2:
            server.feed.publish(LASTING, b"frame")
            frames += [message for message in [page.recv(timeout=20)] if isinstance(message, bytes)]
        for _ in range(5):
            server.feed.publish(LASTING, b"later frame")
        assert not server.feed.is_wanted
        with pytest.raises(TimeoutError):
            page.recv(timeout=0.2)
        page.send("shown")
        told = [page.recv(timeout=20) for _ in range(2)]
        assert json.loads(told[0])["kind"] == "dropped"
        assert told[1] == b"later frame"


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


def test_visits_print_nothing(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    # as in the program, which sets up no logging: warnings and errors go to the terminal
    monkeypatch.setattr(logging.root, "handlers", [])
    before = set(threading.enumerate())
    with LiveServer("a run", Feed()) as server:
        for visit_server in VISITS.values():
            visit_server(server)
        with connect(f"ws://127.0.0.1:{server.port}{FRAMES}", compression=None) as page:
            page.ping().wait(10.0)
    eventually(lambda: set(threading.enumerate()) <= before, "every connection is over", 30)
    assert capfd.readouterr() == ("", "")
