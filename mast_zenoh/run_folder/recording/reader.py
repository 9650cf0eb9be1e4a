"""Reads messages.mcap, also if truncated, a few chunks at a time; from where on it is incomplete; why there is none.

Messages are ordered by (time, frame, wire, publisher, sequence number): a measurement made between two frames comes
before the other messages of its frame.
"""

from __future__ import annotations

import heapq
import shlex
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import accumulate, count
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.records import Schema as SchemaRecord
from mcap.writer import MCAP0_MAGIC

from mast_zenoh.arrays.states import Ints
from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import BUILT_IN, Schema
from mast_zenoh.run_folder import check_plain, read_object
from mast_zenoh.run_folder.recording.format import EVENT, ORDER, STEPS, RecordedEvent, user_schema
from mast_zenoh.run_folder.recording.writer import FILE

_RECORD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")
_CHANNEL = struct.Struct("<H")  # begins a message
_LEAST_MESSAGE = 22  # bytes: channel, sequence, two times
_STATISTICS = struct.Struct("<QHIIII")  # numbers of messages, schemas, channels, attachments, metadata and chunks
_DATA_END_BYTES = 4
#: Records among the chunks that hold no messages.
_BETWEEN_CHUNKS = (Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)

#: Limit on a metadata record.
MAX_METADATA_BYTES = 16 << 20
#: Limit on the messages that wait for earlier ones in later chunks, with what each of them takes beside its bytes.
MAX_WAITING_BYTES = 400 << 20
_OVERHEAD = 1000

#: Limit of the difference between a message's log time and the time in its header, which is the rank of its key.
_RANKS_NS = 1 << 16


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recorded message.

    key:       on which it was sent;  wire: the key without the tap leg;  tap: whether it was on a tap leg
    message:   message type of the wire
    publisher: name of the node that made it
    frame:     index of the frame that it is about; -1: unknown, as it is malformed
    time_ns:   time in its header; of a malformed message, time of the latest clock when it arrived
    seq:       its number among those of its publisher on its wire; of malformed ones, among those of its key
    payload:   the bytes as they were sent
    step:      the run's frame when it was sent: later than `frame` if a link delayed it; -1: unknown
    rank:      sending order among messages of one key and frame; -1: first, or the only one
    schema:    the message type, if it is a user's: as it was when the run was recorded
    """

    key: str
    wire: str
    tap: bool
    message: str
    publisher: str
    frame: int
    time_ns: int
    seq: int
    payload: bytes
    malformed: bool
    step: int
    rank: int = -1
    schema: Schema | None = None

    @property
    def type(self) -> str | Schema:
        """By which `codec` decodes it."""
        return self.schema or self.message

    @property
    def order(self) -> tuple[int, int, str, str, int, str]:
        """Sort key among all messages; the time goes with the frame."""
        return self.time_ns, self.frame, self.wire, self.publisher, self.seq, self.key


def file_of(path: Path) -> Path:
    """The recording at a path, a file or a run folder; raises RunFolderError if none, or for a link in a folder."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise RunFolderError(f"{path}: no such folder, expected the folder of a run")
    if not (path / FILE).is_file():
        raise RunFolderError(f"{path / FILE}: missing; {without_recording(path)}")
    return check_plain(path / FILE)


class _ChunkIndex(NamedTuple):
    """A chunk of the file.

    byte:     its offset;  length: in bytes, packed;  start_ns, end_ns: the earliest and the latest log time in it
    steps:    by place in the chunk, the steps of messages that were not sent in their own frame
    ranks:    by place in the chunk, the ranks of messages that share key and frame with another one
    """

    start_ns: int
    end_ns: int
    byte: int
    length: int
    steps: Mapping[int, int]
    ranks: Mapping[int, int]


class _End(NamedTuple):
    """The end of the data, after the last message."""


#: Whether the messages of a channel are wanted, by its `wire`, `message` and `publisher`, as in `Recorded`.
Wanted = Callable[[Mapping[str, str]], bool]


def read(path: Path, wanted: Wanted | None = None, times_ns: Ints | None = None) -> Iterator[Recorded]:
    """All messages of a file or run folder, ordered.

    wanted:   the headers of other messages are not looked at; None: all
    times_ns: ascending times of messages that are wanted, as in their headers: chunks without any are left out, and
              messages of other times that are in the same chunk are not. None: all

    A truncated file is read up to its last whole chunk.

    Raises RunFolderError if there is no recording, or if it is damaged before its end.
    """
    path = file_of(path)
    with _open(path) as file:
        every = [record for record in _records(file, path) if isinstance(record, _ChunkIndex)]
        indexes = every if times_ns is None else _within(every, times_ns)
        read_too = {chunk.byte for chunk in indexes}
        left_out = [chunk for chunk in every if chunk.byte not in read_too]
        #: by chunk, the earliest time in it and in all later ones
        floors = list(accumulate((chunk.start_ns for chunk in reversed(indexes)), min))[::-1]
        channels: dict[int, Channel] = {}
        schemas: dict[int, Schema] = {}
        queue: list[tuple[tuple[int, int, str, str, int, str], int, Recorded]] = []
        loaded = count = waiting = 0
        while queue or loaded < len(indexes):
            while loaded < len(indexes) and (not queue or floors[loaded] <= queue[0][0][0] + _RANKS_NS):
                for message in _messages(file, path, indexes[loaded], channels, schemas, wanted, left_out):
                    heapq.heappush(queue, (message.order, count, message))
                    count += 1
                    waiting += len(message.payload) + _OVERHEAD
                    if waiting > MAX_WAITING_BYTES:
                        problem = f"{waiting} bytes of messages that wait for earlier ones in later chunks"
                        raise RunFolderError(f"{path}: found {problem}, expected at most {MAX_WAITING_BYTES}")
                loaded += 1
            if queue:
                message = heapq.heappop(queue)[2]
                waiting -= len(message.payload) + _OVERHEAD
                yield message


def events(path: Path) -> list[RecordedEvent]:
    """The changes of a run in order; empty for a recording of an earlier version.

    Raises RunFolderError if there is no recording, or if it is damaged before its end.
    """
    path = file_of(path)
    with _open(path) as file:
        return [record for record in _records(file, path) if isinstance(record, RecordedEvent)]


class Extent(NamedTuple):
    """The extent of a recording.

    last_frame: last frame with truth; -1: none
    whole:      whether it was closed properly rather than cut off
    """

    last_frame: int
    whole: bool


def extent(path: Path) -> Extent:
    """The extent of a recording; reads all its truth, raises RunFolderError."""
    path = file_of(path)
    last = max((message.frame for message in read(path, _is_truth)), default=-1)
    return Extent(last, is_whole(path))


def _is_truth(channel: Mapping[str, str]) -> bool:
    return channel.get("message") == "truth"


def is_whole(path: Path) -> bool:
    """Whether a recording was closed properly rather than cut off; raises RunFolderError."""
    path = file_of(path)
    with _open(path) as file:
        return any(isinstance(record, _End) for record in _records(file, path))


def _open(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None


def _records(file: IO[bytes], path: Path) -> Iterator[_ChunkIndex | RecordedEvent | _End]:
    """All whole chunks and events in order, and the end unless the file is truncated."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RunFolderError(f"{path}: does not begin as an MCAP file")
    chunk_metadata: dict[str, Mapping[int, int]] = {}
    n_chunks = 0
    whole = _whole_records(file, path.stat().st_size)
    for opcode, length, byte in whole:
        if opcode == Opcode.DATA_END and length == _DATA_END_BYTES:
            _check_summary(file, path, whole, n_chunks)
            yield _End()
            break
        n_chunks += opcode == Opcode.CHUNK
        if opcode == Opcode.CHUNK and length >= _TIMES.size:
            start_ns, end_ns = _TIMES.unpack(file.read(_TIMES.size))
            yield _ChunkIndex(
                start_ns, end_ns, byte, length, chunk_metadata.pop(STEPS, {}), chunk_metadata.pop(ORDER, {})
            )
        elif opcode == Opcode.CHUNK:
            raise RunFolderError(f"{path}: byte {byte}: a damaged chunk: found {length} bytes")
        elif opcode == Opcode.METADATA:
            if length > MAX_METADATA_BYTES:
                expected = f"expected at most {MAX_METADATA_BYTES}"
                raise RunFolderError(f"{path}: byte {byte}: found {length} bytes of metadata, {expected}")
            try:
                record = Metadata.read(ReadDataStream(BytesIO(file.read(length))))
                if record.name in (STEPS, ORDER):
                    chunk_metadata[record.name] = {int(place): int(number) for place, number in record.metadata.items()}
                elif record.name == EVENT:
                    yield RecordedEvent.from_metadata(record.metadata)
            except (McapError, ValueError, KeyError, struct.error) as error:
                raise RunFolderError(f"{path}: byte {byte}: damaged metadata: {error}") from None
        elif opcode not in _BETWEEN_CHUNKS:
            raise RunFolderError(f"{path}: byte {byte}: found a record of kind {opcode}, expected a chunk of messages")


def _whole_records(file: IO[bytes], size: int) -> Iterator[tuple[int, int, int]]:
    """The kind, length and first byte of each record up to the first that the file, of so many bytes, does not hold.

    The file is at that byte, and may be read before the next record is asked for.
    """
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        byte = file.tell()
        if byte + length > size:
            return
        yield opcode, length, byte
        file.seek(byte + length)


def _check_summary(file: IO[bytes], path: Path, rest: Iterator[tuple[int, int, int]], n_chunks: int) -> None:
    """Raise RunFolderError if the rest of a file knows of more or fewer chunks than were found before it."""
    for opcode, length, _ in rest:
        if opcode == Opcode.STATISTICS and length >= _STATISTICS.size:
            *_, known = _STATISTICS.unpack(file.read(_STATISTICS.size))
            if known != n_chunks:
                raise RunFolderError(f"{path}: found {n_chunks} chunks of messages, expected {known} as its end says")
            return


def _within(chunks: Sequence[_ChunkIndex], times_ns: Ints) -> list[_ChunkIndex]:
    """The chunks that can have messages of these times."""
    after = np.searchsorted(times_ns, [max(0, chunk.start_ns - _RANKS_NS) for chunk in chunks])
    until = np.searchsorted(times_ns, [chunk.end_ns for chunk in chunks], side="right")
    return [chunk for chunk, first, last in zip(chunks, after, until, strict=True) if first < last]


def _messages(
    file: IO[bytes],
    path: Path,
    index: _ChunkIndex,
    channels: dict[int, Channel],
    schemas: dict[int, Schema],
    wanted: Wanted | None,
    left_out: list[_ChunkIndex],
) -> Iterator[Recorded]:
    """The messages of a chunk that are wanted; its new channels and user types go into the dicts.

    left_out: chunks that are not read, unless a channel is needed that one of them defines; then all before this one
    """
    count = 0
    for record in _chunk_records(file, path, index):
        if record.opcode != Opcode.MESSAGE:
            _define(record, path, index, channels, schemas)
            continue
        (channel_id,) = _CHANNEL.unpack_from(record.content, record.start)
        while channel_id not in channels and left_out and left_out[0].byte < index.byte:
            earlier = left_out.pop(0)
            for other in _chunk_records(file, path, earlier):
                _define(other, path, earlier, channels, schemas)
        if channel_id not in channels:
            raise RunFolderError(f"{path}: byte {index.byte}: a message of channel {channel_id}, which is unknown")
        channel = channels[channel_id]
        if wanted is None or wanted(channel.metadata):
            step, rank = index.steps.get(count), index.ranks.get(count, -1)
            message = Message.read(record.stream(), record.length)
            yield _recorded(channel, message, path, step, rank, schemas.get(channel.schema_id))
        count += 1


def _define(
    record: _Record, path: Path, index: _ChunkIndex, channels: dict[int, Channel], schemas: dict[int, Schema]
) -> None:
    """Note the channel or the user type of a record; others are left out."""
    try:
        if record.opcode == Opcode.CHANNEL:
            channel = Channel.read(record.stream())
            channels[channel.id] = channel
        elif record.opcode == Opcode.SCHEMA:
            found = SchemaRecord.read(record.stream())
            try:
                schema = user_schema(found.data)
            except ValueError as error:
                raise RunFolderError(f"{path}: byte {index.byte}: schema {found.name!r:.80}: {error}") from None
            if schema is not None:
                schemas[found.id] = schema
    except (McapError, ValueError, OverflowError, struct.error) as error:
        raise RunFolderError(f"{path}: byte {index.byte}: a damaged chunk: {error}") from None


def _recorded(
    channel: Channel, record: Message, path: Path, step: int | None, rank: int, schema: Schema | None
) -> Recorded:
    """A message with the data of its channel and header; step None: its frame."""
    metadata = channel.metadata
    try:
        wire, message, publisher = metadata["wire"], metadata["message"], metadata["publisher"]
        tap, malformed = metadata["tap"] == "true", metadata["malformed"] == "true"
    except KeyError as error:
        raise RunFolderError(f"{path}: channel {channel.topic!r} has no {error} in its metadata") from None
    frame, seq = -1, record.sequence
    if not malformed:
        try:
            header = codec.decode_header(record.data, schema or BUILT_IN[message])
        except (MessageError, KeyError) as error:
            raise RunFolderError(f"{path}: {channel.topic}: {error}") from None
        frame, seq = header.frame, header.seq
    of_channel = channel.topic, wire, tap, message, publisher
    of_record = frame, record.publish_time, seq, record.data
    return Recorded(*of_channel, *of_record, malformed, frame if step is None else step, rank, schema)


#: Limits on a chunk, unpacked. The writer begins a new one after 1 MiB or CHUNK_MESSAGES, and a message has 16 MiB at
#: most.
MAX_CHUNK_BYTES = 64 << 20
MAX_CHUNK_MESSAGES = 200_000


class _Record(NamedTuple):
    """A record in the content of a chunk: its type, and where what follows its head is."""

    opcode: int
    content: bytes
    start: int
    length: int

    def stream(self) -> ReadDataStream:
        """What the MCAP library reads it from."""
        return ReadDataStream(BytesIO(self.content[self.start : self.start + self.length]))


def _chunk_records(file: IO[bytes], path: Path, index: _ChunkIndex) -> list[_Record]:
    """The channels, schemas and messages in a chunk; raises RunFolderError if they exceed a limit, or are damaged."""
    file.seek(index.byte)
    try:
        return list(_unpacked_records(file, index.length))
    except (McapError, ValueError, OverflowError, struct.error, zstandard.ZstdError) as error:
        raise RunFolderError(f"{path}: byte {index.byte}: a damaged chunk: {error}") from None


def _unpacked_records(file: IO[bytes], length: int) -> Iterator[_Record]:
    """The records in the chunk that begins here; length: of the chunk in the file, bytes"""
    if length > MAX_CHUNK_BYTES:
        raise ValueError(f"found {length} bytes, expected at most {MAX_CHUNK_BYTES}")
    chunk = Chunk.read(ReadDataStream(BytesIO(file.read(length))))
    content = _unpacked(chunk)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("its checksum is not that of its content")
    place = messages = 0
    while place < len(content):
        opcode, length = _RECORD.unpack_from(content, place)
        start = place + _RECORD.size
        place = start + length
        if place > len(content):
            raise ValueError(f"a record of {length} bytes is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            messages += 1
            if messages > MAX_CHUNK_MESSAGES:
                raise ValueError(f"found more than {MAX_CHUNK_MESSAGES} messages, expected at most as many")
            if length < _LEAST_MESSAGE:
                raise ValueError(f"found a message of {length} bytes")
        yield _Record(opcode, content, start, length)


def _unpacked(chunk: Chunk) -> bytes:
    """The content of a chunk. Raises ValueError before more memory is used than MAX_CHUNK_BYTES."""
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:  # zeros compress to almost nothing
        raise ValueError(f"found {chunk.uncompressed_size} bytes in one chunk, expected at most {MAX_CHUNK_BYTES}")
    if chunk.compression not in ("zstd", ""):
        raise ValueError(f"found compression {chunk.compression!r:.20}, expected 'zstd', as recordings are written")
    size = len(chunk.data)
    if chunk.compression:
        size = zstandard.frame_content_size(chunk.data)  # the decompressor allocates this much; -1: it is not given
    if size not in (-1, chunk.uncompressed_size):
        raise ValueError(f"found {size} bytes in one chunk, which claims to have {chunk.uncompressed_size}")
    if not chunk.compression:
        return chunk.data
    return zstandard.decompress(chunk.data, chunk.uncompressed_size)


def without_recording(folder: Path) -> str:
    """Why a folder has no recording, as text."""
    if not (folder / "run.json").exists():
        return f"{folder} is not the folder of a run"
    run: dict[str, Any] = {}
    with suppress(RunFolderError):
        run = read_object(folder / "run.json")
    if run.get("status") == "running":
        return f"run.json says that the run is in progress: nothing is recorded in {folder} yet"
    if messages := (run.get("recorded") or {}).get("messages"):
        return f"the run was recorded, and run.json counts {messages} messages: expected the recording in {folder}"
    return f"{folder} is a run that was not recorded: {_how_to_record(run)}"


def _how_to_record(run: dict[str, Any]) -> str:
    """The command that repeats a run with a recording; in general words if run.json does not say what started it."""
    command = run.get("command")
    if isinstance(command, str) and command.startswith("mast_zenoh.run(") and command.isprintable():
        return f"repeat it with record=True: {command:.500}"
    if isinstance(command, list) and all(isinstance(word, str) and word.isprintable() for word in command):
        program, *words = command or [""]
        if program.rpartition("/")[2] == "mast" and len(words) > 1 and words[0] in ("run", "replay"):
            recorded = [word for word in words if word != "--no-record"]
            # Without that option it was the scenario that asked for no recording.
            recorded += ["--set", "run.record=true"] if recorded == words and words[0] == "run" else []
            return f"repeat it in a new folder with a recording: {shlex.join(['mast', *_without_out(recorded)])}"
    return "repeat it without --no-record, or its study with --record"


def _without_out(words: list[str]) -> list[str]:
    """The words of a command without its output folder, which is in use."""
    named = {index for index, word in enumerate(words) if word in ("--out", "-o")}
    return [
        word
        for index, word in enumerate(words)
        if index not in named and index - 1 not in named and not word.startswith("--out=")
    ]


def first_incomplete_frame(path: Path) -> int:
    """The first frame that may be incomplete: the one before the first without truth.

    0 for a recording that cannot be read.
    """
    try:
        frames = {message.frame for message in read(file_of(path), _is_truth)}
    except RunFolderError:
        return 0
    return max(0, _first_absent(frames) - 1)


def first_missing_frame(path: Path, publisher: str, scans: bool = True) -> int | None:
    """The first frame without a message of `publisher`; None if none is missing.

    scans: whether scans count; not if they are recorded only while their wires have an interposer

    A missing message is a gap in the sequence numbers of its wire.
    A message counts as recorded if it was recorded on any leg of its wire. Missing messages after the last recorded one
    are not detected. 0 for a recording that cannot be read.
    """
    recorded: defaultdict[str, dict[int, int]] = defaultdict(dict)  # by wire: sequence number to frame
    try:
        for message in read(file_of(path), lambda channel: channel.get("publisher") == publisher):
            if not message.malformed and (scans or message.message != "points"):
                recorded[message.wire][message.seq] = message.frame
    except RunFolderError:
        return 0
    missing = [
        frames.get(seq - 1, -1) + 1 for frames in recorded.values() if (seq := _first_absent(frames)) < len(frames)
    ]
    return min(missing, default=None)


def _first_absent(numbers: Container[int]) -> int:
    """The smallest number from 0 that is absent."""
    return next(number for number in count() if number not in numbers)
