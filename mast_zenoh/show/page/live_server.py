"""Serves the page of finished runs, or that of a running run with its frames over a WebSocket, on one loopback port.

Each page that is open has a short queue of frames, which drops the oldest ones.

Shows a running run in browsers, one block a frame, until it has ended; then all of it.
"""

from __future__ import annotations

import getpass
import json
import logging
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np
import zenoh
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.sync.server import Server, ServerConnection, serve

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.errors import ConfigurationError, MastError
from mast_zenoh.metrics.estimates import ESTIMATORS
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.address import LiveAddress
from mast_zenoh.runs.live.observer import POLL_S, Observer
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import truth_states
from mast_zenoh.show.page.block import AgentPoses, judgements_of, pack_frames
from mast_zenoh.show.page.motion import Packer, motion_of
from mast_zenoh.show.page.page import live_parts, page_of, policy, viewer_page

LOOPBACK = "127.0.0.1"  #: nobody else on the network can read runs
_HOSTS = (LOOPBACK, "localhost")
FRAMES = "/frames"
#: Frames that wait for a page, and pages at a time.
QUEUED, MOST_PAGES = 3, 8
_WAKE_S = 1.0
#: Frames that a page may not have shown yet. It confirms each: the buffers of its connection would hold hundreds.
_UNSHOWN = 2
#: Headers of every page.
_ALWAYS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store"}
_LOGGER = logging.getLogger(__name__)


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a record tells of a fault of this server, and not of a peer that left or does not speak HTTP."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, WebSocketException | OSError | EOFError)


_LOGGER.addFilter(_is_ours)


class PageConnection:
    """What waits for one page. changed: guards it, and is notified of every change"""

    def __init__(self, changed: threading.Condition, texts: Mapping[str, str]) -> None:
        self.texts = dict(texts)  # by kind, the newest that the page lacks
        self.frames: deque[bytes] = deque()
        self.dropped = 0
        self._changed = changed

    def put(self, frame: bytes) -> None:
        """Add a frame, in place of the oldest one if there are too many."""
        self.frames.append(frame)
        while len(self.frames) > QUEUED:
            self.frames.popleft()
            self.dropped += 1

    def take(self, most: int, timeout_s: float) -> tuple[list[str | bytes], bool]:
        """Wait for messages; returns them, with at most so many frames, and whether more may come."""
        with self._changed:
            if not (self.texts or self.frames):
                self._changed.wait(timeout_s)
            messages: list[str | bytes] = [self.texts.pop(kind) for kind in ("lasting", "notes") if kind in self.texts]
            if self.dropped:
                messages.append(_text("dropped", count=self.dropped))
            messages += [self.frames.popleft() for _ in range(min(most, len(self.frames)))]
            self.dropped = 0
            over = not self.frames and "over" in self.texts
            return [*messages, self.texts["over"]] if over else messages, not over


def _text(kind: str, **content: Any) -> str:
    return json.dumps({"kind": kind, **content}, separators=(",", ":"))


class Feed:
    """Distributes frames to the listeners; never waits for one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._listeners: list[PageConnection] = []
        self._texts: dict[str, str] = {}  # by kind, the newest
        self._newest: bytes | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether a page is open that has taken what was sent before."""
        return any(len(listener.frames) < QUEUED for listener in tuple(self._listeners))

    @contextmanager
    def listener(self) -> Iterator[PageConnection | None]:
        """A listener for one page; None: there are too many already."""
        with self._changed:
            listener = PageConnection(self._changed, self._texts)
            if self._newest is not None:
                listener.put(self._newest)
            accepted = len(self._listeners) < MOST_PAGES
            if accepted:
                self._listeners.append(listener)
        try:
            yield listener if accepted else None
        finally:
            if accepted:
                with self._changed:
                    self._listeners.remove(listener)

    def publish(self, lasting: Mapping[str, Any], frame: bytes) -> None:
        """Give a frame to all listeners. lasting: the part of its header that rarely changes"""
        with self._changed:
            if self._tell("lasting", header=lasting):
                for listener in self._listeners:
                    listener.frames.clear()  # of another header
            self._newest = frame
            for listener in self._listeners:
                listener.put(frame)
            self._changed.notify_all()

    def note(self, notes: Sequence[str]) -> None:
        """Give all listeners what is to be said of the view, if it has changed: frames may fail to say it."""
        with self._changed:
            if notes or "notes" in self._texts:
                self._tell("notes", notes=[*notes])

    def close(self, *, reload: bool) -> None:
        """Tell all pages that the run is over. reload: whether the page then shows all of it"""
        with self._changed:
            self._tell("over", reload=reload)

    def _tell(self, kind: str, **content: Any) -> bool:
        """Give all listeners a text of a kind; returns whether it has changed."""
        text = _text(kind, **content)
        changed = self._texts.get(kind) != text
        if changed:
            self._texts[kind] = text
            for listener in self._listeners:
                listener.texts[kind] = text
            self._changed.notify_all()
        return changed


class PageServer:
    """Context manager: serves one page until it is left.

    page, policy: its content, and its content security policy;  port: 0 for any free one
    feed: the frames of a running run; None: the page needs none
    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, page: bytes, policy: str, port: int = 0, feed: Feed | None = None) -> None:
        self._feed = feed
        self._content = page, policy
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
            problem = f"found {port}, which cannot be used ({error.strerror or error})"
            raise ConfigurationError(f"--port: {problem}: expected a free port, or 0 for any") from None
        self.port = int(self._server.socket.getsockname()[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="viewer", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK}:{self.port}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._server.shutdown()

    def wait(self) -> None:
        """Wait for ever: until KeyboardInterrupt."""
        self._over.wait()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None for the WebSocket of the frames."""
        try:
            host = request.headers.get("Host", "").lower()
            # Browsers let any page open a WebSocket here, but say which page it is.
            origin = request.headers.get("Origin", f"http://{host}").lower()
        except (ValueError, LookupError):  # no address, or several
            return _refusal(HTTPStatus.FORBIDDEN, "expected one host and one origin")
        if not is_own_host(host):
            return _refusal(HTTPStatus.FORBIDDEN, "expected the host 127.0.0.1 or localhost")
        path = request.path.partition("?")[0]
        if path == FRAMES and self._feed is not None:
            if origin != f"http://{host}":
                return _refusal(HTTPStatus.FORBIDDEN, "expected a page of this server")
            return None
        if path != "/":
            return _refusal(HTTPStatus.NOT_FOUND, "not found")
        page, policy = self._content
        headers = Headers({"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(page)), **_ALWAYS})
        headers["Content-Security-Policy"] = f"{policy}; frame-ancestors 'none'"
        return Response(HTTPStatus.OK, HTTPStatus.OK.phrase, headers, page)

    def _send_frames(self, connection: ServerConnection) -> None:
        """Send what the feed has, in a thread for each page; a page that does not read blocks only this thread."""
        assert self._feed is not None
        with self._feed.listener() as listener:
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


class LiveServer(PageServer):
    """Serves the page of a running run, named `title`, and its frames, until another page is shown."""

    def __init__(self, title: str, feed: Feed, port: int = 0) -> None:
        self.feed = feed
        parts = live_parts(FRAMES)
        super().__init__(page_of(title, parts), parts.policy, port, feed)

    def show_finished(self, page: bytes, policy: str) -> None:
        """Serve another page from now on, and tell all that are open to load it."""
        self._content = page, policy
        self.feed.close(reload=True)


def is_own_host(host: str) -> bool:
    """Whether a `Host` header, with or without a port, names this computer.

    A page of another host can send requests here under that host's name, if its name was made to lead here.
    """
    return (host.rpartition(":")[0] or host).lower() in _HOSTS


def tunnel(url: str) -> str:
    """The command that brings the port of an address on this computer to another computer."""
    port = urlsplit(url).port
    return f"ssh -L {port}:{LOOPBACK}:{port} {getpass.getuser()}@{socket.gethostname()}"


def _refusal(status: HTTPStatus, text: str) -> Response:
    body = f"{text}\n".encode()
    headers = Headers([("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(body)))])
    return Response(status, status.phrase, headers, body)


#: s in which a finished run must have its results.
_RESULTS_S = 60.0
#: s after which a page that does not read is taken as stopped.
_PATIENCE_S = 2.0
#: Parts of the header that rarely change: the page gets them once, and again when they change.
LASTING = (
    *("format", "id", "label", "ego", "centre", "scored", "gate_m", "range_m", "classes", "colours", "estimates"),
    *("buildings", "tops", "agents", "states", "flags", "judged", "effects", "recorded"),
)


class LiveBlocks:
    """Makes blocks of the frames of an observed run."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        #: By agent, its latest position (3,) m and rotation (3, 3), which later frames may not repeat.
        self._poses: dict[str, tuple[Floats, Floats]] = {}
        if (scene := observer.address.scene) is not None:
            poses = zip(scene.agent_position[0], scene.agent_rotation[0], strict=True)
            self._poses = dict(zip(scene.agent_names, poses, strict=True))

    def header_and_block(self, frame: Frame) -> tuple[dict[str, Any], bytes]:
        """The lasting part of the header of a frame, and the block with everything else.

        Raises ValueError if a number is too large for a block.
        """
        down = [{"node": node, "action": "kill", "frame": frame.index} for node in self._observer.down]
        run = frame.run.with_(record={**frame.run.files.record, "steps": down})
        body = frame.bodies.get(TRUTH) if run.files.scene is not None else None
        states = ObjectStates.empty() if body is None else truth_states(body)
        truth = np.full(len(states), frame.index), states
        judged = judgements_of(run.files.all_objects, truth)
        tracks = [body for series, body in frame.bodies.items() if series.estimator in ESTIMATORS]
        motion = motion_of(judged, truth, ((frame.index, body) for body in tracks))
        packer = Packer()
        packer.add("time", np.array([frame.time_ns * 1e-9]), scale=1e-3)
        frames = range(frame.index, frame.index + 1)
        header = pack_frames(packer, run, judged, motion, self._surroundings(frame), frames)
        header |= {"label": run.name, "recorded": True, "scored": None}
        header |= self._happening(run, frame)
        lasting = {name: header.pop(name) for name in LASTING}
        return lasting, packer.block(header)

    def _happening(self, run: Run, frame: Frame) -> dict[str, Any]:
        """What is said of the run as a whole, up to this frame."""
        observer = self._observer
        record = {**run.files.record, "interceptions": observer.interceptions}
        return {
            "number": frame.index,
            "spans": spans(run.with_(record=record), run.times(np.arange(frame.index + 1))),
            "newest": observer.frame,
            "refused": frame.refused,
            "down": observer.down,
            "notes": observer.meter.notes,
            "wires": [
                {"key": wire.key, "legs": [leg._asdict() for leg in wire.legs], "to": wire.subscribers}
                for wire in observer.wires()
            ],
        }

    def _surroundings(self, frame: Frame) -> AgentPoses | None:
        """The agents as the messages have them."""
        scene = frame.run.files.scene
        if scene is None:
            return None
        self._poses.update({name: pose for name, pose in frame.poses.items() if name in self._poses})
        position, rotation = (np.array([[self._poses[name][part] for name in scene.agent_names]]) for part in (0, 1))
        number = scene.nearest(frame.index)
        roles = {spec.role for spec in self._observer.address.resolved.nodes.values()}
        stepped = "driver" in roles  # the prepared sweeps are of another drive
        sweeps = () if stepped else tuple(sweep[number : number + 1] for sweep in scene.sweeps)
        return AgentPoses(position, rotation, sweeps)


def show(run: LiveAddress, session: zenoh.Session, server: LiveServer, stop: threading.Event) -> None:
    """Show a running run on a server until `stop` is set, also after its end.

    session: a client of the run's router
    """
    observer = Observer(run, session)
    try:
        _follow(observer, server.feed, stop)
    finally:
        observer.close()
    if stop.is_set():
        return
    if run.folder is None or (page := _finished_page(run.folder, stop)) is None:
        server.feed.close(reload=False)
    else:
        server.show_finished(page, policy())
    stop.wait()


def _follow(observer: Observer, feed: Feed, stop: threading.Event) -> None:
    """Publish frames until the run is over; receives nothing but the clock while no page reads them."""
    blocks = LiveBlocks(observer)
    wanted = time.monotonic()
    while not stop.is_set():
        if feed.is_wanted:
            wanted = time.monotonic()
        observer.listen(everything=time.monotonic() - wanted < _PATIENCE_S)
        if not feed.is_wanted:
            observer.keep_up()
        elif (frame := observer.advance()) is not None:
            try:
                feed.publish(*blocks.header_and_block(frame))
            except Exception as error:  # such as numbers that no page can draw: one frame is lost, and the page says so
                observer.note(f"frame {frame.index} cannot be shown: {error!r:.200}")
        feed.note(observer.meter.notes)
        if observer.is_over():
            return
        stop.wait(POLL_S)


def _finished_page(folder: Path, stop: threading.Event) -> bytes | None:
    """The page of the finished run; None: its results do not arrive."""
    deadline = time.monotonic() + _RESULTS_S
    while time.monotonic() < deadline and not stop.is_set():
        with suppress(MastError):
            return viewer_page([folder])
        stop.wait(1.0)
    return None
