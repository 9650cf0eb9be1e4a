"""Recordings for the Rerun viewer over HTTP on the loopback address, and its web viewer.

Rerun's own servers are not used: they listen on all interfaces, and its page contacts outside hosts. Here a content
security policy admits no other host.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path

from mast_zenoh.viewer.loopback import LoopbackHandler, LoopbackServer
from mast_zenoh.viewer.servers.rrd_stream import LateClient, RrdStream
from mast_zenoh.viewer.servers.web_viewer import FILES

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
