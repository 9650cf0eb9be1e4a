"""Serves the page of a running run, and its frames over a WebSocket, on one loopback port.

Each page that is open has a short queue of frames, which drops the oldest ones.
"""

from __future__ import annotations

import json
import logging
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from http import HTTPStatus
from types import TracebackType
from typing import Any

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.sync.server import Server, ServerConnection, serve

from mast_zenoh.viewer.loopback import HOST_EXPECTED, LOOPBACK, is_own_host, page_headers, unusable_port
from mast_zenoh.viewer.page.page import live_parts, page_of

FRAMES = "/frames"
#: Frames that wait for a page, and pages at a time.
QUEUED, MOST_PAGES = 3, 8
_WAKE_S = 1.0
#: Frames that a page may not have shown yet. It confirms each: the buffers of its connection would hold hundreds.
_UNSHOWN = 2
_LOGGER = logging.getLogger(__name__)


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a record tells of a fault of this server, and not of a peer that left or does not speak HTTP."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, WebSocketException | OSError | EOFError)


_LOGGER.addFilter(_is_ours)


class PageConnection:
    """What waits for one page: messages, of which frames (bytes) may be dropped."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._texts: deque[str] = deque()
        self._frames: deque[tuple[int, bytes]] = deque()
        self._lasting = 0  # version of the lasting header that the page has
        self._dropped = 0
        self._notes = ""
        self._last_words = ""

    def put(self, version: int, lasting: str, frame: bytes) -> None:
        """Add a frame. version, lasting: of the part of the header that it lacks"""
        with self._changed:
            if version != self._lasting:
                self._frames.clear()  # of another header
                self._texts = deque([lasting])
                self._lasting = version
            self._frames.append((version, frame))
            while len(self._frames) > QUEUED:
                self._frames.popleft()
                self._dropped += 1
            self._changed.notify()

    @property
    def has_room(self) -> bool:
        """Whether the page has taken what was sent before."""
        return len(self._frames) < QUEUED

    def note(self, text: str) -> None:
        """Set what is to be said of the view."""
        with self._changed:
            self._notes = text
            self._changed.notify()

    def close(self, text: str) -> None:
        """End with a last message."""
        with self._changed:
            self._last_words = text
            self._changed.notify()

    def take(self, most: int, timeout_s: float) -> tuple[list[str | bytes], bool]:
        """Wait for messages; returns them, with at most so many frames, and whether more may come."""
        with self._changed:
            if not (self._texts or self._frames or self._notes or self._last_words):
                self._changed.wait(timeout_s)
            messages: list[str | bytes] = [*self._texts, *([self._notes] if self._notes else [])]
            if self._dropped:
                messages.append(json.dumps({"kind": "dropped", "count": self._dropped}))
            messages += [self._frames.popleft()[1] for _ in range(min(most, len(self._frames)))]
            self._texts.clear()
            self._dropped = 0
            self._notes = ""
            over = bool(self._last_words) and not self._frames
            return [*messages, self._last_words] if over else messages, not over


class Feed:
    """Distributes frames to the listeners; never waits for one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: list[PageConnection] = []
        self._lasting: dict[str, Any] = {}
        self._version = 0
        self._newest: bytes | None = None
        self._notes: list[str] = []
        self._last_words = ""

    @property
    def is_wanted(self) -> bool:
        """Whether a page is open that reads its frames."""
        return any(listener.has_room for listener in tuple(self._listeners))

    @contextmanager
    def listener(self) -> Iterator[PageConnection | None]:
        """A listener for one page; None: there are too many already."""
        listener = PageConnection()
        with self._lock:
            accepted = len(self._listeners) < MOST_PAGES
            if accepted:
                self._listeners.append(listener)
                if self._newest is not None:
                    listener.put(self._version, self._lasting_text, self._newest)
                if self._notes:
                    listener.note(self._notes_text)
                if self._last_words:
                    listener.close(self._last_words)
        try:
            yield listener if accepted else None
        finally:
            if accepted:
                with self._lock:
                    self._listeners.remove(listener)

    def publish(self, lasting: Mapping[str, Any], frame: bytes) -> None:
        """Give a frame to all listeners. lasting: the part of its header that rarely changes"""
        with self._lock:
            if lasting != self._lasting:
                self._lasting = dict(lasting)
                self._version += 1
            self._newest = frame
            for listener in self._listeners:
                listener.put(self._version, self._lasting_text, frame)

    def note(self, notes: Sequence[str]) -> None:
        """Give all listeners what is to be said of the view, if it has changed: frames may fail to say it."""
        with self._lock:
            if self._notes != [*notes]:
                self._notes = [*notes]
                for listener in self._listeners:
                    listener.note(self._notes_text)

    def close(self, *, reload: bool) -> None:
        """Tell all pages that the run is over. reload: whether the page then shows all of it"""
        with self._lock:
            self._last_words = json.dumps({"kind": "over", "reload": reload})
            for listener in self._listeners:
                listener.close(self._last_words)

    @property
    def _notes_text(self) -> str:
        return json.dumps({"kind": "notes", "notes": self._notes})

    @property
    def _lasting_text(self) -> str:
        return json.dumps({"kind": "lasting", "header": self._lasting}, separators=(",", ":"))


class LiveServer:
    """Context manager: serves until it is left.

    title: of the page;  port: 0 for any free one
    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, title: str, feed: Feed, port: int = 0) -> None:
        self.feed = feed
        parts = live_parts(FRAMES)
        self._content = page_of(title, parts), parts.policy
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

    def show_finished(self, page: bytes, policy: str) -> None:
        """Serve another page from now on, and tell all that are open to load it."""
        self._content = page, policy
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
