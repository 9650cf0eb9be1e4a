"""A live run as a growing recording for the Rerun viewer."""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Iterator

import rerun

from mast_zenoh.viewer.export import rrd
from mast_zenoh.viewer.frame import FrameSource

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

    def __init__(self, run: FrameSource, history_bytes: int = HISTORY_BYTES) -> None:
        self._run, self._limit = run, history_bytes
        self._stream = rerun.RecordingStream(rrd.APPLICATION, recording_id=run.name)
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
