"""Recordings for Rerun over HTTP: whole ones and growing ones, in its web viewer out of the installed package."""

from __future__ import annotations

import io
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium
from own_requests import answer
from PIL import Image
from rerun.chunk import RrdReader

import mast_zenoh as mast
from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.recorded import RecordedRun
from mast_zenoh.viewer.servers import rerun
from mast_zenoh.viewer.servers.rerun import FILES, RerunServer, RrdStream, web_viewer_files

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def run(recorded: mast.Run) -> RecordedRun:
    return RecordedRun.load(recorded.path)


@pytest.fixture
def file(exported_to: Callable[[str], Path]) -> Path:
    return exported_to("rrd")


def started(server: RerunServer) -> RerunServer:
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def frames_in(recording: bytes, path: Path) -> set[int]:
    """The frames in a recording, as Rerun's own reader finds them."""
    path.write_bytes(recording)
    found: set[int] = set()
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if "frame" in batch.schema.names:
            found |= set(batch.column("frame").to_pylist())
    return found


def test_only_the_recording_is_served_and_only_to_this_computer(file: Path) -> None:
    with started(RerunServer(file, {})) as server:
        response = answer(server.server_port, "/run.rrd")
        assert response.status == 200
        assert response.read() == file.read_bytes()
        assert "default-src 'none'" in (response.getheader("Content-Security-Policy") or "")
        assert server.server_address[0] == "127.0.0.1"
        assert answer(server.server_port, "/run.rrd", host="attacker.example").status == 403
        assert answer(server.server_port, "/../run.json").status == 404
        assert answer(server.server_port, "/").status == 404
        server.shutdown()


class Live:
    """A run whose frames come when the test allows it."""

    def __init__(self, run: RecordedRun) -> None:
        self._run, self.frames = run, list(run)
        self.going_on = threading.Event()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def __iter__(self) -> Iterator[Any]:
        yield from self.frames[:10]
        assert self.going_on.wait(60)
        yield from self.frames[10:]


def test_a_growing_recording_reaches_clients_while_the_run_goes_on(run: RecordedRun, tmp_path: Path) -> None:
    live = Live(run)
    stream = RrdStream(live)
    encoding = threading.Thread(target=stream.encode)
    encoding.start()
    with started(RerunServer(stream, {})) as server:
        response = answer(server.server_port, "/run.rrd")
        data = response.read(100_000)  # before the run has ended
        live.going_on.set()
        encoding.join(60)
        assert frames_in(data + response.read(), tmp_path / "whole.rrd") == set(range(len(live.frames)))
        assert frames_in(answer(server.server_port, "/run.rrd").read(), tmp_path / "late.rrd") == set(
            range(len(live.frames))
        )
        server.shutdown()


def test_a_client_that_is_too_slow_is_disconnected_with_a_message(
    run: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun, "PORTION_S", 0.05)
    live = Live(run)
    live.going_on.set()
    live.frames = live.frames[:10] * 6
    stream = RrdStream(live, history_bytes=1 << 18)
    told: list[str] = []
    disconnected = threading.Event()

    def tell(sentence: str) -> None:
        told.append(sentence)
        disconnected.set()

    with started(RerunServer(stream, {}, dropped=tell)) as server:
        with socket.create_connection(("127.0.0.1", server.server_port)) as stalled:
            stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stalled.sendall(b"GET /run.rrd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            stalled.recv(100)
            stream.encode()
            while stalled.recv(1 << 16):
                pass
            assert disconnected.wait(20)
        server.shutdown()
    assert "MiB behind: it is disconnected" in told[0]
    assert stream.kept_bytes <= 1 << 18


def test_the_web_viewer_shows_the_boxes_and_reaches_no_other_host(file: Path) -> None:
    files = web_viewer_files()
    assert set(files) == set(FILES)
    with chromium() as browser, started(RerunServer(file, files)) as server:
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        answered: list[str] = []
        page.on("response", lambda response: answered.append(response.url))
        page.goto(server.url)
        page.wait_for_selector("#message", state="detached", timeout=120_000)
        blue = 0
        for _ in range(60):
            page.wait_for_timeout(500)
            picture = np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=60_000))).convert("RGB")).astype(int)
            blue = int(((picture[..., 2] - picture[..., 0] > 80) & (picture[..., 2] > 120)).sum())
            if blue > 500:
                break
        assert blue > 500
        assert f"{server.url}run.rrd" in answered
        assert all(address.startswith(server.url) for address in answered)
        page.close()
        server.shutdown()


def test_a_web_viewer_that_fails_at_once_is_reported_with_its_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rerun_cli.py").write_text("import sys\nsys.exit('error: no web viewer in this build')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(ExportError, match="the program ended: error: no web viewer in this build: use the native"):
        web_viewer_files()
