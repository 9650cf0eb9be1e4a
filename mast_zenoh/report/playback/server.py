"""Serves one page on a loopback port: the viewer of one finished run, or of two on one timeline."""

from __future__ import annotations

import getpass
import socket
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from mast_zenoh.errors import ConfigurationError, NotComparable, RunFolderError
from mast_zenoh.report.page import page_text
from mast_zenoh.report.playback.block import run_block
from mast_zenoh.report.playback.inline import policy, viewer_parts
from mast_zenoh.report.runfolder import RunFolder

#: The server listens on no other address, so that nobody else on the network can read runs.
LOOPBACK = "127.0.0.1"
HOSTS = (LOOPBACK, "localhost")


def viewer_page(folders: Sequence[Path], frame: int | None = None) -> str:
    """The page with the runs in these folders, one or two.

    frame: to show first
    Raises RunFolderError for a folder that holds no run, or nothing to show; NotComparable for two runs without a
    common agent.
    """
    runs = [RunFolder.load(folder) for folder in folders]
    blocks = []
    for run in runs:
        try:
            block = run_block(run, frame)
        except ValueError as error:
            raise RunFolderError(f"{run.path}: cannot be shown: {error}") from None
        if block is None:
            raise RunFolderError(f"{run.path}: expected objects.parquet or scene.npz: the run has nothing to show")
        blocks.append(block)
    if len(runs) > 1:
        agents = [set(run.recording.agent_names if run.recording else run.metrics.get("agents", ())) for run in runs]
        if not agents[0] & agents[1]:
            raise NotComparable(
                f"{runs[0].path} and {runs[1].path}: found no common agent, expected runs of the same scene"
            )
    title = " and ".join(run.label if run.label != runs[0].label or run is runs[0] else run.path.name for run in runs)
    return page_text("viewer.html.j2", {"title": title, "headline": title, "viewer": viewer_parts(blocks)})


def tunnel(port: int) -> str:
    """The command that brings a port to another computer."""
    return f"ssh -L {port}:{LOOPBACK}:{port} {getpass.getuser()}@{socket.gethostname()}"


def page_headers(length: int, policy: str) -> list[tuple[str, str]]:
    """The headers of a page of `length` bytes, which may do nothing but what the policy says."""
    return [
        ("Content-Type", "text/html; charset=utf-8"),
        ("Content-Length", str(length)),
        ("Content-Security-Policy", policy + "; frame-ancestors 'none'"),
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
        ("Cache-Control", "no-store"),
    ]


class ViewerServer(ThreadingHTTPServer):
    """Serves one page.

    page: as from `viewer_page`;  port: 0 for any free one
    Raises ConfigurationError if the port cannot be used.
    """

    daemon_threads = True

    def __init__(self, page: str, port: int = 0) -> None:
        self.content = page.encode("utf-8", "surrogateescape")
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            problem = f"found {port}, which cannot be used ({error.strerror})"
            raise ConfigurationError(f"--port: {problem}: expected a free port, or 0 for any") from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    @property
    def tunnel(self) -> str:
        """The command that brings the page to another computer."""
        return tunnel(self.server_port)


class _Handler(BaseHTTPRequestHandler):
    server: ViewerServer

    def do_GET(self) -> None:
        """Send the page; anything else is not found."""
        name = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if name not in HOSTS:  # a page of another host, whose name was made to lead here
            self.send_error(HTTPStatus.FORBIDDEN, "expected the host 127.0.0.1 or localhost")
        elif self.path.partition("?")[0] != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self.send_response(HTTPStatus.OK)
            for header, value in page_headers(len(self.server.content), policy()):
                self.send_header(header, value)
            self.end_headers()
            self.wfile.write(self.server.content)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal shows where the page is."""
