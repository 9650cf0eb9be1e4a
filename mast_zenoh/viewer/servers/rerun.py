"""Recordings for the Rerun viewer over HTTP on the loopback address, and its web viewer."""

from __future__ import annotations

import json
import os
import queue
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import urllib.request
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import IO

import rerun

from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.export import rrd
from mast_zenoh.viewer.frame import FramedRun
from mast_zenoh.viewer.loopback import LOOPBACK, LoopbackHandler, LoopbackServer

#: Names of the files with their media types.
FILES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
_ADDRESS = re.compile(rf"web-viewer at (http://{re.escape(LOOPBACK)}:\d+)")
_DEADLINE_S = 30.0


def web_viewer_files() -> dict[str, bytes]:
    """The contents of FILES; raises ExportError if the installed rerun-sdk does not provide them."""
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--bind", LOOPBACK]
    command += ["--port", "auto", "--web-viewer-port", "0"]
    with tempfile.TemporaryDirectory(prefix="mast-rerun-") as home:
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=_environment(home),
            start_new_session=True,  # the command starts another process
        )
        try:
            address = _address(process)
            return {name: _fetched(f"{address}/{name}") for name in FILES}
        except OSError as error:
            raise ExportError(f"rerun-sdk: its web viewer cannot be read: {error}: use the native viewer") from None
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _environment(home: str) -> Mapping[str, str]:
    """Variables for a process that finds its settings in a folder, with usage statistics off."""
    settings = Path(home) / "rerun" / "analytics.json"
    settings.parent.mkdir()
    settings.write_text(json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}), encoding="utf-8")
    return {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "NO_COLOR": "1"}


def _address(process: subprocess.Popen[bytes]) -> str:
    """Where the program serves the files, as it prints it; raises OSError if it ends first, or takes too long."""
    found: queue.Queue[str | None] = queue.Queue()
    last = "it printed nothing"

    def read(output: IO[bytes]) -> None:
        nonlocal last
        for line in output:
            text = line.decode("utf-8", "replace").strip()
            last = text or last
            if match := _ADDRESS.search(text):
                found.put(match[1])
        found.put(None)

    assert process.stdout is not None
    threading.Thread(target=read, args=(process.stdout,), daemon=True).start()
    try:
        address = found.get(timeout=_DEADLINE_S)
    except queue.Empty:
        raise TimeoutError(f"no address within {_DEADLINE_S:g} s: {last}") from None
    if address is None:
        raise ChildProcessError(f"the program ended: {last}")
    return address


def _fetched(address: str) -> bytes:
    """What is at an address on this computer, without any proxy."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(address, timeout=_DEADLINE_S) as answer:
        content: bytes = answer.read()
        return content


#: Bytes that are kept: what a client sees that connects later, and how far behind one may be.
HISTORY_BYTES = 64 << 20
#: Time between two portions, s. Each has overhead for every entity.
PORTION_S = 0.5

#: An RRD file: a header, messages (kind, length, content), and an end with an index, which a growing one does not have.
_MAGIC, _HEADER_BYTES = b"RRF2", 12
_MESSAGE = struct.Struct("<QQ")
_END = 0


class LateClient(Exception):
    """A client is so slow that what it needs next is not kept any more."""


class RrdStream:
    """Encodes the frames of a live run, once for all clients, into a history of bounded size.

    history_bytes: the bound
    """

    def __init__(self, run: FramedRun, history_bytes: int = HISTORY_BYTES) -> None:
        self._run, self._limit = run, history_bytes
        self._stream = rerun.RecordingStream(rrd.APPLICATION, recording_id=run.id)
        self._stream.set_log_time_enabled(False)
        self._binary = rerun.binary_stream(self._stream)
        self._stream.send_blueprint(rrd.blueprint(run))
        rrd.write_static(run, self._stream)
        start = self._binary.read() or b""
        self._start = start[:_HEADER_BYTES] + messages(start)
        self._portions: deque[bytes] = deque()
        self._dropped = 0  # number of portions that are not kept any more
        self._changed = threading.Condition()
        self._ending, self._complete = threading.Event(), False

    def encode(self) -> None:
        """Encode all frames of the run as they come, until it ends."""
        pump = threading.Thread(target=self._pump, daemon=True)
        pump.start()
        try:
            for frame in self._run:
                rrd.write_frame(self._run, frame, self._stream)
        finally:
            self.end()
            pump.join()

    def end(self) -> None:
        """End the streams of all clients after what has been encoded."""
        self._ending.set()

    def client(self) -> Iterator[bytes]:
        """What one client gets: the recording so far, as far as it is kept, and all that follows.

        Raises LateClient if the client is so slow that what it needs next is not kept any more.
        """
        yield self._start
        with self._changed:
            place = self._dropped
        while True:
            with self._changed:
                while place >= self._dropped + len(self._portions):
                    if self._complete:
                        return
                    self._changed.wait()
                if place < self._dropped:
                    raise LateClient(f"is more than {self._limit / 2**20:g} MiB behind")
                portion = self._portions[place - self._dropped]
            place += 1
            yield portion

    @property
    def kept_bytes(self) -> int:
        """The size of the history."""
        return sum(map(len, self._portions))

    def _pump(self) -> None:
        """Move what has been encoded to the history, so that neither it nor Rerun's own buffer grows."""
        while not self._complete:
            last = self._ending.wait(PORTION_S)
            portion = messages(self._binary.read() or b"")
            with self._changed:
                if portion:
                    self._portions.append(portion)
                while self.kept_bytes > self._limit:
                    self._portions.popleft()
                    self._dropped += 1
                self._complete = last
                self._changed.notify_all()


def messages(recording: bytes) -> bytes:
    """The messages of a whole RRD file, without its header and its end.

    Raises ValueError for anything else.
    """
    if not recording:
        return b""
    if not recording.startswith(_MAGIC):
        raise ValueError(f"found {recording[:4]!r}, expected {_MAGIC!r}")
    place = _HEADER_BYTES
    while place + _MESSAGE.size <= len(recording):
        kind, length = _MESSAGE.unpack_from(recording, place)
        if kind == _END:
            break
        place += _MESSAGE.size + length
    if place > len(recording):
        raise ValueError(f"found {len(recording)} bytes, expected {place} at least")
    return recording[_HEADER_BYTES:place]


#: Where the recording is.
RECORDING = "run.rrd"
_POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src data:; worker-src 'none'; base-uri 'none'; form-action 'none'"
)
_PAGE = Path(__file__).with_name("rerun_page")
_PAGE_FILES = {"": "text/html; charset=utf-8", "page.js": "text/javascript", "page.css": "text/css"}
_PIECE = 1 << 16
#: Time after which a client that takes nothing is disconnected, s.
_STALLED_S = 30.0


class RerunServer(LoopbackServer):
    """Serves one recording.

    recording: a whole file, or the stream of a live run
    viewer:    the files of the web viewer, see `web_viewer_files`; empty: only native viewers are served
    port:      0 for any free one
    dropped:   called with a sentence when a client that is too slow has been disconnected

    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(
        self,
        recording: Path | RrdStream,
        viewer: Mapping[str, bytes],
        port: int = 0,
        dropped: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self.recording, self.dropped = recording, dropped
        self.files = {name: (kind, viewer[name]) for name, kind in FILES.items() if name in viewer}
        if viewer:
            for name, kind in _PAGE_FILES.items():
                self.files[name] = kind, (_PAGE / (name or "index.html")).read_bytes()
        super().__init__(port, _Handler)

    @property
    def recording_url(self) -> str:
        """What the native viewer opens."""
        return self.url + RECORDING


class _Handler(LoopbackHandler):
    server: RerunServer
    timeout = _STALLED_S

    def answer(self, path: str) -> None:
        """Send the recording, or a file of the web viewer."""
        name = path.removeprefix("/")
        if name == RECORDING:
            try:
                self._send_recording(self.server.recording)
            except TimeoutError:
                self._drop(f"has taken nothing for {_STALLED_S:g} s")
            except LateClient as late:
                self._drop(str(late))
        elif name in self.server.files:
            kind, content = self.server.files[name]
            self.send_content(content, kind, _POLICY)
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _send_recording(self, recording: Path | RrdStream) -> None:
        kind = "application/octet-stream"
        if isinstance(recording, Path):
            with recording.open("rb") as file:
                self.begin(kind, _POLICY, recording.stat().st_size)
                while piece := file.read(_PIECE):
                    self.wfile.write(piece)
        else:
            self.begin(kind, _POLICY)
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _PIECE)
            for portion in recording.client():
                for begin in range(0, len(portion), _PIECE):
                    self.wfile.write(portion[begin : begin + _PIECE])

    def _drop(self, reason: str) -> None:
        """Disconnect a client that is too slow."""
        self.close_connection = True
        self.server.dropped(f"a viewer at port {self.client_address[1]} {reason}: it is disconnected")


def serve_live(stream: RrdStream, server: RerunServer, stop: threading.Event) -> None:
    """Encode a live run and serve it meanwhile, until `stop` is set; after the run the server has what is kept."""
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    try:
        stream.encode()
        stop.wait()
    finally:
        server.shutdown()
        serving.join()
