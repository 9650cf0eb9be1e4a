"""Writes messages.mcap. What is not yet a whole chunk is lost with the process; whole chunks are not."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

from mast_zenoh.errors import DiskFull, RunFolderError, is_disk_full
from mast_zenoh.messagelog import channels
from mast_zenoh.messagelog.events import EVENT, ORDER, STEPS, Event
from mast_zenoh.messages.schemas import SCHEMAS, Header
from mast_zenoh.wiring.model import Input

if TYPE_CHECKING:
    from mcap.writer import Writer

FILE = "messages.mcap"

#: A chunk is written when the messages in it have so many bytes, or when it has lasted for so many frames.
CHUNK_BYTES = 1 << 20
CHUNK_FRAMES = 25

_SEQUENCES = 1 << 32  # MCAP has 32 bits for a sequence number


class _Entry(NamedTuple):
    """A message of the chunk in the making; they are written in ascending order."""

    log_time: int
    frame: int
    sequence: int
    rank: int
    time_ns: int
    channel: int
    payload: bytes
    step: int
    malformed: bool


class MessageLog:
    """The file, which is made when it begins.

    path: where it will be; relative to the run folder in a scenario
    messages:  how many have been written
    malformed: how many have come that have no sound header
    lost:      how many could not be written, or are in the chunk that is being made
    problem:   why nothing more can be written; "" if nothing is wrong
    disk_full: whether that is for want of room
    """

    def __init__(self, path: Path = Path(FILE)) -> None:
        self.path = path
        self.messages = 0
        self.problem = ""
        self.disk_full = False
        self._file: IO[bytes] | None = None
        self._chunk: list[_Entry] = []
        self._bytes = 0
        self._frame = 0  # in which the chunk began
        self._added = 0
        self._flaws: Counter[str] = Counter()  # malformed messages by key
        #: The newest frames of each channel that have been written.
        self._frames: defaultdict[int, deque[int]] = defaultdict(partial(deque, maxlen=256))

    @classmethod
    def load(cls, path: Path) -> MessageLog:
        """The log of a path in a scenario."""
        return cls(path)

    @property
    def malformed(self) -> int:
        """See the class."""
        return self._flaws.total()

    @property
    def lost(self) -> int:
        """See the class."""
        return self._added - self.messages

    def begin(self, hears: Mapping[str, Input]) -> None:
        """Open the file, with a channel for every key; those that are heard later get theirs with their first message.

        Raises RunFolderError where there is a file or cannot be one, and DiskFull.
        """
        try:
            self._open(hears)
        except OSError as error:
            if self._file is not None:  # what it holds cannot be read
                with suppress(OSError):
                    self._file.close()
                self.path.unlink()
                self._file = None
            what = f"{self.path}: cannot be made a recording: {error.strerror or error}"
            raise DiskFull(what) if is_disk_full(error) else RunFolderError(what) from None

    def add(self, key: str, payload: bytes, header: Header, step: int) -> None:
        """A message on a key; lost if there is a problem. step: the frame in which it was sent; -1: unknown"""
        if key not in self._channels:
            self._channels[key] = self._channel(key)
        self._add(
            key, _Entry(0, header.frame, header.seq, 0, header.time_ns, self._channels[key], payload, step, False)
        )

    def add_malformed(self, key: str, payload: bytes, frame: int, time_ns: int, step: int) -> None:
        """What came on a key and is no message of its wire, as it is; lost if there is a problem.

        frame, time_ns: of the newest clock when it came;  step: see `add`
        """
        name = f"{key}/{channels.MALFORMED}"
        if name not in self._channels:
            self._channels[name] = self._channel(key, malformed=True)
        self._flaws[key] += 1
        number = self._flaws[key] - 1
        self._add(key, _Entry(0, frame, number, 0, time_ns, self._channels[name], payload, step, True))

    def add_event(self, event: Event) -> None:
        """What changed about the run; lost if there is a problem."""
        if not self.problem:
            self._write(lambda: self._writer.add_metadata(EVENT, event.to_metadata()))

    def close(self) -> None:
        """Write what is left, and the index."""
        if self._file is None:
            return
        self._flush()
        file, self._file = self._file, None
        if not self.problem:
            self._write(self._writer.finish)
        self._write(file.close)

    def _open(self, hears: Mapping[str, Input]) -> None:
        from mcap.writer import CompressionType, Writer  # every node knows this module, one writes

        self._file = self.path.open("xb")
        self._writer: Writer = Writer(self._file, chunk_size=1 << 40, compression=CompressionType.ZSTD)
        self._writer.start(channels.PROFILE)
        self._schemas = {name: self._schema(name) for name in sorted({heard.message for heard in hears.values()})}
        self._hears = hears
        #: The rank of a key among all, by wire and leg: it keeps their order among messages of one time.
        self._ranks = {key: rank for rank, key in enumerate(sorted(hears, key=channels.wire_and_key))}
        self._channels = {key: self._channel(key) for key in self._ranks}
        self._file.flush()  # a run that is killed at once leaves a recording of no messages

    def _schema(self, name: str) -> int:
        told = channels.json_schema(SCHEMAS[name]).encode()
        return int(self._writer.register_schema(f"{name}.{SCHEMAS[name].version}", channels.SCHEMA_ENCODING, told))

    def _channel(self, key: str, *, malformed: bool = False) -> int:
        heard = self._hears[key]
        if heard.message not in self._schemas:
            self._schemas[heard.message] = self._schema(heard.message)
        return int(
            self._writer.register_channel(
                f"{key}/{channels.MALFORMED}" if malformed else key,
                "" if malformed else channels.ENCODING,
                0 if malformed else self._schemas[heard.message],
                channels.metadata(key, heard.message, heard.source, malformed=malformed),
            )
        )

    def _add(self, key: str, entry: _Entry) -> None:
        """Put a message into the chunk, with its place among all."""
        self._added += 1
        if self.problem:
            return
        if not self._chunk:
            self._frame = entry.frame
        log_time = entry.time_ns + self._ranks.setdefault(key, len(self._ranks))
        self._chunk.append(entry._replace(log_time=log_time, rank=self._added))
        self._bytes += len(entry.payload)
        if self._bytes >= CHUNK_BYTES or entry.frame >= self._frame + CHUNK_FRAMES:
            self._flush()

    def _flush(self) -> None:
        """Write the chunk, sorted. Where that fails nothing more is written, and what is there can be read."""
        chunk, self._chunk, self._bytes = sorted(self._chunk), [], 0
        if self.problem:
            return

        def write() -> None:
            # Before the chunk, so that no chunk is read without the steps of its messages.
            late = (i for i, entry in enumerate(chunk) if entry.malformed or entry.step != entry.frame)
            if steps := {str(i): str(chunk[i].step) for i in late}:
                self._writer.add_metadata(STEPS, steps)
            if order := {str(i): str(chunk[i].rank) for i in self._sharing(chunk)}:
                self._writer.add_metadata(ORDER, order)
            for entry in chunk:
                self._writer.add_message(
                    entry.channel, entry.log_time, entry.payload, entry.time_ns, entry.sequence % _SEQUENCES
                )
            self._writer.flush()

        if self._write(write):
            self.messages += len(chunk)

    def _sharing(self, chunk: list[_Entry]) -> Iterator[int]:
        """The places of messages that share key and frame with another one, of this chunk or of one before it."""
        frames = Counter((entry.channel, entry.frame) for entry in chunk)
        for place, entry in enumerate(chunk):
            if frames[entry.channel, entry.frame] > 1 or entry.frame in self._frames[entry.channel]:
                yield place
        for channel, frame in frames:
            self._frames[channel].append(frame)

    def _write(self, write: Callable[[], None]) -> bool:
        """Whether what is to be written was; if not, `problem` says why, and nothing more is written."""
        try:
            write()
        except OSError as error:
            self.problem = self.problem or f"{self.path}: cannot be written: {error.strerror or error}"
            self.disk_full |= is_disk_full(error)
        return not self.problem
