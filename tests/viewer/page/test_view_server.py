"""`mast view` serves one page to this computer alone, and ends with Ctrl-C."""

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser import WatchedPage
from own_requests import answer

from mast_zenoh.errors import ConfigurationError, NotComparable, RunFolderError
from mast_zenoh.show.page.live_server import FRAMES, PageServer
from mast_zenoh.show.page.page import policy, viewer_page


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(b"<p>page</p>", policy()) as running:
        yield running


def test_the_page_alone_is_served_with_a_policy_that_admits_no_other_host(server: PageServer) -> None:
    response = answer(server.port, "/")
    assert response.status == 200
    assert "default-src 'none'" in (response.getheader("Content-Security-Policy") or "")
    assert response.read() == b"<p>page</p>"
    assert server.url.startswith("http://127.0.0.1:")
    assert answer(server.port, FRAMES).status == 404
    assert answer(server.port, "/run.json").status == 404
    assert answer(server.port, "/../run.json").status == 404
    assert answer(server.port, "/", host="attacker.example").status == 403


def test_a_port_in_use_is_refused_by_name(server: PageServer) -> None:
    with pytest.raises(ConfigurationError, match=f"--port.*{server.port}.*used"):
        PageServer(b"", "", server.port)


def test_folders_that_hold_nothing_to_show_are_refused(tmp_path: Path, attacked_run: Path) -> None:
    with pytest.raises(RunFolderError, match="no such folder"):
        viewer_page([tmp_path / "nothing"])
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(RunFolderError, match=r"objects\.parquet.*scene\.npz"):
        viewer_page([tmp_path])


def test_runs_without_a_common_agent_are_refused(attacked_run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "run.json").write_text("{}")
    (other / "metrics.json").write_text('{"agents": {"stranger": {}}}')
    (other / "objects.parquet").write_bytes((attacked_run / "objects.parquet").read_bytes())
    with pytest.raises(NotComparable, match=r"runs.*common agent"):
        viewer_page([attacked_run, other])


@pytest.mark.heavy
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
