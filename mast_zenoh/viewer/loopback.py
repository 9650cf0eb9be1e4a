"""HTTP on the loopback address alone, so that nobody else on the network can read runs."""

from __future__ import annotations

import getpass
import socket
from abc import ABC, abstractmethod
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

from mast_zenoh.errors import ConfigurationError

LOOPBACK = "127.0.0.1"
#: The refusal of a request to another host.
HOST_EXPECTED = "expected the host 127.0.0.1 or localhost"
_HOSTS = (LOOPBACK, "localhost")


def is_own_host(host: str) -> bool:
    """Whether a `Host` header, with or without a port, names this computer.

    A page of another host can send requests here under that host's name, if its name was made to lead here.
    """
    return (host.rpartition(":")[0] or host).lower() in _HOSTS


def tunnel(url: str) -> str:
    """The command that brings the port of an address on this computer to another computer."""
    port = urlsplit(url).port
    return f"ssh -L {port}:{LOOPBACK}:{port} {getpass.getuser()}@{socket.gethostname()}"


def unusable_port(port: int, error: OSError) -> ConfigurationError:
    """The error to raise for a port that cannot be listened on."""
    problem = f"found {port}, which cannot be used ({error.strerror or error})"
    return ConfigurationError(f"--port: {problem}: expected a free port, or 0 for any")


def page_headers(kind: str, policy: str, length: int | None) -> list[tuple[str, str]]:
    """The headers of an answer.

    kind: its media type;  length: None for a stream
    policy: its content security policy; no page may show it in a frame of its own
    """
    return [
        ("Content-Type", kind),
        *([] if length is None else [("Content-Length", str(length))]),
        ("Content-Security-Policy", f"{policy}; frame-ancestors 'none'"),
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
        ("Cache-Control", "no-store"),
    ]


class LoopbackServer(ThreadingHTTPServer):
    """An HTTP server on the loopback address.

    port: 0 for any free one
    Raises ConfigurationError if the port cannot be used.
    """

    daemon_threads = True

    def __init__(self, port: int, handler: type[LoopbackHandler]) -> None:
        try:
            super().__init__((LOOPBACK, port), handler)
        except OSError as error:
            raise unusable_port(port, error) from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK}:{self.server_port}/"


class LoopbackHandler(BaseHTTPRequestHandler, ABC):
    """Answers requests to this computer's own names, and refuses others."""

    def handle(self) -> None:
        """Answer a client's requests; one that closes its connection meanwhile, such as a closed tab, is no error."""
        with suppress(ConnectionError):
            super().handle()

    def do_GET(self) -> None:
        """Check the host, then answer."""
        if is_own_host(self.headers.get("Host", "")):
            self.answer(self.path.partition("?")[0])
        else:
            self.send_error(HTTPStatus.FORBIDDEN, HOST_EXPECTED)

    @abstractmethod
    def answer(self, path: str) -> None:
        """Answer a request for a path."""

    def send_content(self, content: bytes, kind: str, policy: str) -> None:
        """Send a whole answer.

        kind: its media type;  policy: its content security policy
        """
        self.begin(kind, policy, len(content))
        self.wfile.write(content)

    def begin(self, kind: str, policy: str, length: int | None = None) -> None:
        """Send the headers of an answer; length: None for a stream that ends with the connection."""
        self.send_response(HTTPStatus.OK)
        for name, value in page_headers(kind, policy, length):
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal shows where the page is."""
