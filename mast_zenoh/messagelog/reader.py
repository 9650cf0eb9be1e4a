"""Reads messages.mcap in the order (frame, wire, publisher, sequence), whole or cut off, a few chunks at a time."""

from __future__ import annotations

import heapq
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import IO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.messagelog.events import EVENT, ORDER, STEPS, Event
from mast_zenoh.messagelog.writer import FILE
from mast_zenoh.messages import codec

_RECORD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")

#: A chunk holds little more than one message, and none is recorded that is longer than a node's inbox takes.
MAX_CHUNK_BYTES = 256 << 20

#: No message's log time is so much later than the time in its header: it is later by the rank of its key.
_RANKS_NS = 1 << 16


@dataclass(frozen=True, slots=True)
class Recorded:
    """A message of the file.

    key:       on which it was sent;  wire: the same without the tap leg;  tap: whether it was on one
    message:   message type of the wire
    publisher: name of the node that made it
    frame:     index of the frame that it is about; -1: malformed, so that nobody knows
    time_ns:   time of that frame; of a malformed message, time of the newest clock when it came
    seq:       its number among those of its publisher on its wire; of malformed ones, among those of its key
    payload:   the bytes as they were sent
    step:      the frame that the run was at when it was sent: later than `frame` if a link held it back; -1: unknown
    rank:      orders the messages of one key and frame by when they were sent; -1: first, or the only one
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

    @property
    def order(self) -> tuple[int, int, str, str, int, str]:
        """Where it stands among all messages; the time goes with the frame."""
        return self.time_ns, self.frame, self.wire, self.publisher, self.seq, self.key


def file_of(path: Path) -> Path:
    """The recording that a path means: a file, or that of a run folder. Raises RunFolderError where there is none."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise RunFolderError(f"{path}: no such folder, expected the folder of a run")
    if not (path / FILE).is_file():
        raise RunFolderError(f"{path / FILE}: missing; {_without_recording(path)}")
    return path / FILE


def _without_recording(folder: Path) -> str:
    """Why a folder holds no recording: one that was written is gone, there was none, or it is no run's folder."""
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return f"{folder} is no folder of a run"
    except (OSError, ValueError):
        run = None
    recorded = run.get("recorded") if isinstance(run, dict) else None
    messages = recorded.get("messages") if isinstance(recorded, dict) else None
    if messages:
        return f"the run was recorded, and run.json counts {messages} messages: expected the recording in {folder}"
    return f"{folder} is a run that was not recorded"


class _Place(NamedTuple):
    """A chunk of the file: its place, the earliest log time in it, and by place in the chunk the steps of messages that
    were not sent in their own frame, and the ranks of those that are not alone in theirs."""

    start_ns: int
    byte: int
    steps: Mapping[int, int]
    ranks: Mapping[int, int]


class _End(NamedTuple):
    """The end of the data: no message comes after it."""


def read(path: Path) -> Iterator[Recorded]:
    """All messages of a file or run folder, ordered. One that was cut off is read up to its last whole chunk.

    Raises RunFolderError where there is no recording, or one that is damaged within.
    """
    path = file_of(path)
    with _opened(path) as file:
        places = [record for record in _records(file, path) if isinstance(record, _Place)]
        #: by chunk, the earliest time in it and all behind it
        floors = list(accumulate((place.start_ns for place in reversed(places)), min))[::-1]
        channels: dict[int, Channel] = {}
        waiting: list[tuple[tuple[int, int, str, str, int, str], int, Recorded]] = []
        loaded = count = 0
        while waiting or loaded < len(places):
            while loaded < len(places) and (not waiting or floors[loaded] <= waiting[0][0][0] + _RANKS_NS):
                for message in _messages(file, path, places[loaded], channels):
                    heapq.heappush(waiting, (message.order, count, message))
                    count += 1
                loaded += 1
            if waiting:
                yield heapq.heappop(waiting)[2]


def events(path: Path) -> list[Event]:
    """How the run changed while it was recorded, in order; empty for a recording of an earlier version.

    Raises RunFolderError where there is no recording, or one that is damaged within.
    """
    path = file_of(path)
    with _opened(path) as file:
        return [record for record in _records(file, path) if isinstance(record, Event)]


class Extent(NamedTuple):
    """How far a recording goes.

    last_frame: last frame of which it holds the truth; -1: none
    whole:      whether it was ended as recordings are, rather than cut off
    """

    last_frame: int
    whole: bool


def extent(path: Path) -> Extent:
    """How far a recording goes, by all its messages; raises RunFolderError as `read` does."""
    path = file_of(path)
    last = max((message.frame for message in read(path) if message.message == "truth"), default=-1)
    with _opened(path) as file:
        return Extent(last, any(isinstance(record, _End) for record in _records(file, path)))


def _opened(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None


def _records(file: IO[bytes], path: Path) -> Iterator[_Place | Event | _End]:
    """Every whole chunk of the file and every event, in the order of the file, and its end if it was not cut off."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RunFolderError(f"{path}: does not begin as an MCAP file")
    size = path.stat().st_size
    told: dict[str, Mapping[int, int]] = {}
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        byte = file.tell()
        if byte + length > size:
            break
        if opcode == Opcode.DATA_END:
            yield _End()
            break
        if opcode == Opcode.CHUNK and length >= _TIMES.size:
            start_ns, _ = _TIMES.unpack(file.read(_TIMES.size))
            yield _Place(start_ns, byte, told.pop(STEPS, {}), told.pop(ORDER, {}))
        elif opcode == Opcode.CHUNK:
            raise RunFolderError(f"{path}: byte {byte}: a damaged chunk: found {length} bytes")
        elif opcode == Opcode.METADATA:
            try:
                record = Metadata.read(ReadDataStream(file))
                if record.name in (STEPS, ORDER):
                    told[record.name] = {int(place): int(number) for place, number in record.metadata.items()}
                elif record.name == EVENT:
                    yield Event.from_metadata(record.metadata)
            except (McapError, ValueError, KeyError, struct.error) as error:
                raise RunFolderError(f"{path}: byte {byte}: damaged metadata: {error}") from None
        file.seek(byte + length)


def _messages(file: IO[bytes], path: Path, place: _Place, channels: dict[int, Channel]) -> Iterator[Recorded]:
    """The messages of the chunk at a place; channels that it introduces are added to `channels`."""
    file.seek(place.byte)
    try:
        chunk = Chunk.read(ReadDataStream(file))
        if chunk.uncompressed_size > MAX_CHUNK_BYTES:  # zeros take no room in a file
            found = f"{chunk.uncompressed_size} bytes in one chunk, expected at most {MAX_CHUNK_BYTES}"
            raise RunFolderError(f"{path}: byte {place.byte}: found {found}")
        records = breakup_chunk(chunk, validate_crc=True)
    except (McapError, ValueError, struct.error, zlib.error, zstandard.ZstdError) as error:
        raise RunFolderError(f"{path}: byte {place.byte}: a damaged chunk: {error}") from None
    count = 0
    for record in records:
        if isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            if record.channel_id not in channels:
                raise RunFolderError(
                    f"{path}: byte {place.byte}: a message of channel {record.channel_id}, which is unknown"
                )
            rank = place.ranks.get(count, -1)
            yield _recorded(channels[record.channel_id], record, path, place.steps.get(count), rank)
            count += 1


def _recorded(channel: Channel, record: Message, path: Path, step: int | None, rank: int) -> Recorded:
    """A message with what its channel and its header say of it; step: None: that of its frame."""
    told = channel.metadata
    try:
        wire, message, publisher = told["wire"], told["message"], told["publisher"]
        tap, malformed = told["tap"] == "true", told["malformed"] == "true"
    except KeyError as error:
        raise RunFolderError(f"{path}: channel {channel.topic!r} has no {error} in its metadata") from None
    frame, seq = -1, record.sequence
    if not malformed:
        try:
            header = codec.decode_header(record.data, message)
        except (MessageError, KeyError) as error:
            raise RunFolderError(f"{path}: {channel.topic}: {error}") from None
        frame, seq = header.frame, header.seq
    return Recorded(
        channel.topic,
        wire,
        tap,
        message,
        publisher,
        frame,
        record.publish_time,
        seq,
        record.data,
        malformed,
        frame if step is None else step,
        rank,
    )
