"""Reads messages.mcap in the order (frame, wire, publisher, sequence), whole or cut off, a few chunks at a time."""

from __future__ import annotations

import heapq
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import IO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from mast_zenoh import codec
from mast_zenoh.errors import MessageError, RunFolderError
from mast_zenoh.messagelog.writer import FILE

_RECORD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")

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
        found = "a run that was not recorded" if (path / "run.json").is_file() else "no folder of a run"
        raise RunFolderError(f"{path / FILE}: missing; {path} is {found}")
    return path / FILE


def read(path: Path) -> Iterator[Recorded]:
    """All messages of a file or run folder, ordered. One that was cut off is read up to its last whole chunk.

    Raises RunFolderError where there is no recording, or one that is damaged within.
    """
    path = file_of(path)
    try:
        file = path.open("rb")
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None
    with file:
        places = _chunks(file, path)
        starts = [start for start, _ in places]
        #: by chunk, the earliest time in it and all behind it
        floors = list(accumulate(reversed(starts), min))[::-1]
        channels: dict[int, Channel] = {}
        waiting: list[tuple[tuple[int, int, str, str, int, str], int, Recorded]] = []
        loaded = count = 0
        while waiting or loaded < len(places):
            while loaded < len(places) and (not waiting or floors[loaded] <= waiting[0][0][0] + _RANKS_NS):
                for found in _messages(file, path, places[loaded][1], channels):
                    heapq.heappush(waiting, (found.order, count, found))
                    count += 1
                loaded += 1
            if waiting:
                yield heapq.heappop(waiting)[2]


def _chunks(file: IO[bytes], path: Path) -> list[tuple[int, int]]:
    """(earliest log time, place in the file) of every whole chunk."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RunFolderError(f"{path}: does not begin as an MCAP file")
    size = path.stat().st_size
    found = []
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        place = file.tell()
        if opcode == Opcode.DATA_END or place + length > size:
            break
        if opcode == Opcode.CHUNK:
            found.append((_TIMES.unpack(file.read(_TIMES.size))[0], place))
        file.seek(place + length)
    return found


def _messages(file: IO[bytes], path: Path, place: int, channels: dict[int, Channel]) -> Iterator[Recorded]:
    """The messages of the chunk at a place; channels that it introduces are added to `channels`."""
    file.seek(place)
    try:
        records = breakup_chunk(Chunk.read(ReadDataStream(file)), validate_crc=True)
    except (McapError, ValueError, struct.error, zlib.error, zstandard.ZstdError) as error:
        raise RunFolderError(f"{path}: byte {place}: a damaged chunk: {error}") from None
    for record in records:
        if isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            if record.channel_id not in channels:
                raise RunFolderError(
                    f"{path}: byte {place}: a message of channel {record.channel_id}, which is unknown"
                )
            yield _recorded(channels[record.channel_id], record, path)


def _recorded(channel: Channel, record: Message, path: Path) -> Recorded:
    """A message with what its channel and its header say of it."""
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
        channel.topic, wire, tap, message, publisher, frame, record.publish_time, seq, record.data, malformed
    )
