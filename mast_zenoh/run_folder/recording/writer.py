"""Writes messages.mcap; if the process dies, only its last chunk is lost."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

from mast_zenoh.errors import DiskFull, RunFolderError, is_disk_full
from mast_zenoh.messages.layout import MAX_BYTES
from mast_zenoh.messages.schemas import SCHEMAS, Header
from mast_zenoh.run_folder.recording import format as formats
from mast_zenoh.wiring.model import Input
from mast_zenoh.wiring.plain_shapes import EXPECTED_NAME, is_name

if TYPE_CHECKING:
    from mcap.writer import Writer

FILE = "messages.mcap"

#: A chunk is written when its messages have this many bytes, or when it spans this many frames.
CHUNK_BYTES = 1 << 20
CHUNK_FRAMES = 25
CHUNK_MESSAGES = 50_000

_SEQUENCES = 1 << 32  # MCAP has 32 bits for a sequence number


class _Entry(NamedTuple):
    """A message of the chunk being built; entries are written in ascending order."""

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
    """The log file, created by `begin`.

    path:      in a scenario, relative to the run folder
    messages:  number of messages written
    malformed: number of messages without a valid header
    lost:      number of messages that could not be written, or are in the chunk being built
    problem:   why nothing more can be written; "" if there is no problem
    disk_full: whether the reason is a full disk
    """

    def __init__(self, path: Path = Path(FILE)) -> None:
        self.path = path
        self.messages = 0
        self.problem = ""
        self.disk_full = False
        self._file: IO[bytes] | None = None
        self._chunk: list[_Entry] = []
        self._bytes = 0
        self._frame = 0  # the first of the chunk
        self._added = 0
        self._n_malformed: Counter[str] = Counter()  # malformed messages by key
        #: The latest written frames of each channel.
        self._frames: defaultdict[int, deque[int]] = defaultdict(partial(deque, maxlen=256))

    @classmethod
    def load(cls, path: Path) -> MessageLog:
        """The log of a path in a scenario; raises RunFolderError for one that is not in the run folder itself."""
        if not is_name(str(path)):
            raise RunFolderError(f"{str(path)!r:.120}: a recording is a file of the run folder, {EXPECTED_NAME}")
        return cls(path)

    @property
    def malformed(self) -> int:
        """Number of messages without a valid header."""
        return self._n_malformed.total()

    @property
    def lost(self) -> int:
        """Number of messages that could not be written, or are in the chunk being built."""
        return self._added - self.messages

    def begin(self, inputs: Mapping[str, Input]) -> None:
        """Open the file, with a channel for every key; others get one on first use.

        Raises RunFolderError if the file exists or cannot be created, and DiskFull.
        """
        try:
            self._open(inputs)
        except OSError as error:
            if self._file is not None:  # its content is unreadable
                with suppress(OSError):
                    self._file.close()
                self.path.unlink()
                self._file = None
            problem = f"{self.path}: cannot create the recording: {error.strerror or error}"
            raise DiskFull(problem) if is_disk_full(error) else RunFolderError(problem) from None

    def add(self, key: str, payload: bytes, header: Header, step: int) -> None:
        """Add a message; it is lost if there is a problem.

        step: the run's frame when it was sent; -1: unknown
        """
        if len(payload) > MAX_BYTES:
            self.add_malformed(key, payload, header.frame, header.time_ns, step)
            return
        if key not in self._channels:
            self._channels[key] = self._channel(key)
        self._add(
            key, _Entry(0, header.frame, header.seq, 0, header.time_ns, self._channels[key], payload, step, False)
        )

    def add_malformed(self, key: str, payload: bytes, frame: int, time_ns: int, step: int) -> None:
        """Add a malformed message, of one that is too long its beginning; it is lost if there is a problem.

        frame, time_ns: of the latest clock when it arrived;  step: as in `add`
        """
        name = f"{key}/{formats.MALFORMED}"
        if name not in self._channels:
            self._channels[name] = self._channel(key, malformed=True)
        self._n_malformed[key] += 1
        number = self._n_malformed[key] - 1
        self._add(key, _Entry(0, frame, number, 0, time_ns, self._channels[name], payload[:MAX_BYTES], step, True))

    def add_event(self, event: formats.RecordedEvent) -> None:
        """Add a change of the run; it is lost if there is a problem."""
        if not self.problem:
            self._write(lambda: self._writer.add_metadata(formats.EVENT, event.to_metadata()))

    def close(self) -> None:
        """Write the remaining messages and the index."""
        if self._file is None:
            return
        self._flush()
        file, self._file = self._file, None
        if not self.problem:
            self._write(self._writer.finish)
        self._write(file.close)

    def _open(self, inputs: Mapping[str, Input]) -> None:
        from mcap.writer import CompressionType, Writer  # every node imports this module, one writes

        self._file = self.path.open("xb")
        self._writer: Writer = Writer(self._file, chunk_size=1 << 40, compression=CompressionType.ZSTD)
        self._writer.start(formats.PROFILE)
        self._schemas = {name: self._schema(name) for name in sorted({input_.message for input_ in inputs.values()})}
        self._inputs = inputs
        #: The rank of a key among all, by wire and leg, which orders messages of the same time.
        self._ranks = {key: rank for rank, key in enumerate(sorted(inputs, key=formats.wire_and_key))}
        self._channels = {key: self._channel(key) for key in self._ranks}
        self._file.flush()  # a run that is killed at once leaves a valid recording without messages

    def _schema(self, name: str) -> int:
        content = formats.json_schema(SCHEMAS[name]).encode()
        return int(self._writer.register_schema(f"{name}.{SCHEMAS[name].version}", formats.SCHEMA_ENCODING, content))

    def _channel(self, key: str, *, malformed: bool = False) -> int:
        input_ = self._inputs[key]
        if input_.message not in self._schemas:
            self._schemas[input_.message] = self._schema(input_.message)
        return int(
            self._writer.register_channel(
                f"{key}/{formats.MALFORMED}" if malformed else key,
                "" if malformed else formats.ENCODING,
                0 if malformed else self._schemas[input_.message],
                formats.metadata(key, input_.message, input_.source, malformed=malformed),
            )
        )

    def _add(self, key: str, entry: _Entry) -> None:
        """Add a message to the chunk, with its rank."""
        self._added += 1
        if self.problem:
            return
        if not self._chunk:
            self._frame = entry.frame
        log_time = entry.time_ns + self._ranks.setdefault(key, len(self._ranks))
        self._chunk.append(entry._replace(log_time=log_time, rank=self._added))
        self._bytes += len(entry.payload)
        if (
            self._bytes >= CHUNK_BYTES
            or len(self._chunk) >= CHUNK_MESSAGES
            or entry.frame >= self._frame + CHUNK_FRAMES
        ):
            self._flush()

    def _flush(self) -> None:
        """Write the sorted chunk; after an error nothing more, so the file stays readable."""
        chunk, self._chunk, self._bytes = sorted(self._chunk), [], 0
        if self.problem:
            return

        def write() -> None:
            # Written before the chunk, so that no chunk is read without the steps of its messages.
            late = (i for i, entry in enumerate(chunk) if entry.malformed or entry.step != entry.frame)
            if steps := {str(i): str(chunk[i].step) for i in late}:
                self._writer.add_metadata(formats.STEPS, steps)
            if order := {str(i): str(chunk[i].rank) for i in self._sharing(chunk)}:
                self._writer.add_metadata(formats.ORDER, order)
            for entry in chunk:
                self._writer.add_message(
                    entry.channel, entry.log_time, entry.payload, entry.time_ns, entry.sequence % _SEQUENCES
                )
            self._writer.flush()

        if self._write(write):
            self.messages += len(chunk)

    def _sharing(self, chunk: list[_Entry]) -> Iterator[int]:
        """Indices of messages whose key and frame occur again, also in earlier chunks."""
        frames = Counter((entry.channel, entry.frame) for entry in chunk)
        for place, entry in enumerate(chunk):
            if frames[entry.channel, entry.frame] > 1 or entry.frame in self._frames[entry.channel]:
                yield place
        for channel, frame in frames:
            self._frames[channel].append(frame)

    def _write(self, write: Callable[[], None]) -> bool:
        """Run `write`; returns False after an error, which is kept in `problem`."""
        try:
            write()
        except OSError as error:
            self.problem = self.problem or f"{self.path}: cannot be written: {error.strerror or error}"
            self.disk_full |= is_disk_full(error)
        return not self.problem
