"""`mast view` serves one page to this computer alone, survives clients that go away, and ends with Ctrl-C."""

import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import WatchedPage
from own_requests import answer

from mast_zenoh.errors import ConfigurationError, NotComparable, RunFolderError
from mast_zenoh.viewer.loopback import LoopbackHandler, LoopbackServer, is_own_host, tunnel
from mast_zenoh.viewer.page.page import ViewerServer, viewer_page

_RESET = struct.pack("ii", 1, 0)  # closing the connection discards what has not been sent


@pytest.fixture
def server() -> Iterator[ViewerServer]:
    with ViewerServer(b"<p>page</p>") as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def test_the_page_alone_is_served_with_a_policy_that_admits_no_other_host(server: ViewerServer) -> None:
    response = answer(server.server_port, "/")
    assert response.status == 200
    assert "default-src 'none'" in (response.getheader("Content-Security-Policy") or "")
    assert response.read() == b"<p>page</p>"
    assert server.server_address[0] == "127.0.0.1"
    assert answer(server.server_port, "/run.json").status == 404
    assert answer(server.server_port, "/../run.json").status == 404
    assert answer(server.server_port, "/", host="attacker.example").status == 403


def test_a_port_in_use_is_refused_by_name(server: ViewerServer) -> None:
    with pytest.raises(ConfigurationError, match=f"--port: found {server.server_port}, which cannot be used"):
        ViewerServer(b"", server.server_port)


def test_folders_that_hold_nothing_to_show_are_refused(tmp_path: Path, attacked_run: Path) -> None:
    with pytest.raises(RunFolderError, match="no such folder"):
        viewer_page([tmp_path / "nothing"])
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(RunFolderError, match=r"expected objects\.parquet or scene\.npz"):
        viewer_page([tmp_path])


def test_runs_without_a_common_agent_are_refused(attacked_run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "run.json").write_text("{}")
    (other / "metrics.json").write_text('{"agents": {"stranger": {}}}')
    (other / "objects.parquet").write_bytes((attacked_run / "objects.parquet").read_bytes())
    with pytest.raises(NotComparable, match="expected runs with a common agent"):
        viewer_page([attacked_run, other])


def test_the_command_prints_where_the_page_is_and_ends_with_ctrl_c(
    attacked_run: Path, baseline_run: Path, open_page: Callable[..., WatchedPage]
) -> None:
    command = [sys.executable, "-m", "mast_zenoh", "view", str(attacked_run), str(baseline_run), "--frame", "30"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            lines = [process.stdout.readline() for _ in range(3)]
            address = lines[0].removeprefix("view: ").strip()
            port = address.rpartition(":")[2].strip("/")
            assert f"ssh -L {port}:127.0.0.1:{port} " in lines[1]
            page = open_page(address)
            assert page.run("viewer.panels.map((panel) => panel.marks().frame)") == [30, 30]
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30) == 0
        finally:
            process.kill()


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
