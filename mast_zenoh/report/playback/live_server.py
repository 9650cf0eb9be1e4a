"""Serves the page of a running run, and its frames over a WebSocket, on one loopback port."""

from __future__ import annotations

import logging
import threading
from contextlib import suppress
from http import HTTPStatus
from types import TracebackType

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.sync.server import Server, ServerConnection, serve

from mast_zenoh.report.page import page_text
from mast_zenoh.report.playback.feed import Feed
from mast_zenoh.report.playback.inline import live_parts
from mast_zenoh.viewer.loopback import HOST_EXPECTED, LOOPBACK, is_own_host, page_headers, unusable_port

FRAMES = "/frames"
_WAKE_S = 1.0
#: Frames that a page may not have shown yet. It confirms each: the buffers of its connection would hold hundreds.
_UNSHOWN = 2
_LOGGER = logging.getLogger(__name__)


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a record tells of a fault of this server, and not of a peer that left or does not speak HTTP."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, WebSocketException | OSError | EOFError)


_LOGGER.addFilter(_is_ours)


class LiveServer:
    """Context manager: serves until it is left.

    title: of the page;  port: 0 for any free one
    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, title: str, feed: Feed, port: int = 0) -> None:
        self.feed = feed
        parts = live_parts(FRAMES)
        page = page_text("viewer.html.j2", {"title": title, "headline": title, "viewer": parts}).encode()
        self._content = page, str(parts["policy"])
        self._over = threading.Event()
        try:
            self._server: Server = serve(
                self._send_frames,
                LOOPBACK,
                port,
                process_request=self._answer,
                compression=None,  # frames are compressed
                max_size=1024,  # the page only confirms frames
                server_header=None,
                logger=_LOGGER,
            )
        except OSError as error:
            raise unusable_port(port, error) from None
        self.port = int(self._server.socket.getsockname()[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="viewer", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK}:{self.port}/"

    def __enter__(self) -> LiveServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._server.shutdown()

    def show_finished(self, page: str, policy: str) -> None:
        """Serve another page from now on, and tell all that are open to load it."""
        self._content = page.encode("utf-8", "surrogateescape"), policy
        self.feed.close(reload=True)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None for the WebSocket of the frames."""
        try:
            host = request.headers.get("Host", "").lower()
            # Browsers let any page open a WebSocket here, but say which page it is.
            origin = request.headers.get("Origin", f"http://{host}").lower()
        except (ValueError, LookupError):  # no address, or several
            return _refusal(HTTPStatus.FORBIDDEN, "expected one host and one origin")
        if not is_own_host(host):
            return _refusal(HTTPStatus.FORBIDDEN, HOST_EXPECTED)
        path = request.path.partition("?")[0]
        if path == FRAMES:
            if origin != f"http://{host}":
                return _refusal(HTTPStatus.FORBIDDEN, "expected a page of this server")
            return None
        if path != "/":
            return _refusal(HTTPStatus.NOT_FOUND, "not found")
        page, policy = self._content
        headers = Headers(page_headers("text/html; charset=utf-8", policy, len(page)))
        return Response(HTTPStatus.OK, HTTPStatus.OK.phrase, headers, page)

    def _send_frames(self, connection: ServerConnection) -> None:
        """Send what the feed has, in a thread for each page; a page that does not read blocks only this thread."""
        with self.feed.listener() as listener:
            if listener is None:
                connection.close(1013, "too many pages")
                return
            more, unshown = True, 0
            try:
                while more and not self._over.is_set() and connection.protocol.state is State.OPEN:
                    if unshown == _UNSHOWN:
                        with suppress(TimeoutError):
                            connection.recv(timeout=_WAKE_S)
                            unshown -= 1
                        continue
                    messages, more = listener.take(_UNSHOWN - unshown, _WAKE_S)
                    for message in messages:
                        connection.send(message)
                        unshown += isinstance(message, bytes)
            except ConnectionClosed:
                pass


def _refusal(status: HTTPStatus, text: str) -> Response:
    body = f"{text}\n".encode()
    headers = Headers([("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(body)))])
    return Response(status, status.phrase, headers, body)
