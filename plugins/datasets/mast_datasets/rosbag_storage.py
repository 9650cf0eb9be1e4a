"""Reads the files of ROS 2 bags, SQLite3 and MCAP: bounded in size, within the bag's folder, without running anything.

A bag may come from anybody. SQL of a database file (views, triggers, generated columns) is never run.
"""

from __future__ import annotations

import sqlite3
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple
from urllib.parse import quote

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from mast_datasets.files import Element
from mast_datasets.opv2v_yaml import read_yaml
from mast_zenoh.errors import SceneError

METADATA = "metadata.yaml"
#: What files of the two storages end with.
SUFFIXES = (".db3", ".mcap")

#: Limits on one message, and on one chunk of MCAP, bytes; clouds and images of unmapped topics are in chunks, too.
MAX_MESSAGE_BYTES = 16 << 20
MAX_CHUNK_BYTES = 256 << 20
#: Limit on what the chunks of a file unpack to, in relation to its size, and bytes that are always allowed.
_MAX_EXPANSION, _ALWAYS_BYTES = 200, 1 << 30
_MAX_DEFINITION = 200_000  # characters
_MAX_NAME = 1000
_MAX_FILES = 10_000
_LISTED = 100  # topics in a message

_SQLITE_MAGIC = b"SQLite format 3\0"
_MCAP_MAGIC = b"\x89MCAP0\r\n"


class Topic(NamedTuple):
    """A topic of a bag.

    name:       such as "/odom";  type: such as "nav_msgs/msg/Odometry"
    definition: its fields in the language of `.msg` files, and those of the types in it; "": the bag has none
    hash:       of the type, "RIHS01_…"; "": the bag has none
    encoding:   of its messages: "cdr"
    """

    name: str
    type: str
    definition: str
    hash: str
    encoding: str


class BagMessage(NamedTuple):
    """A message of a bag. received_ns: ns, when it was recorded"""

    topic: Topic
    received_ns: int
    payload: bytes


@dataclass(frozen=True)
class Bag:
    """An open bag.

    path:   as it was given;  files: its parts, in order
    packed: whether each message is compressed by zstd
    """

    path: Path
    files: tuple[Path, ...]
    packed: bool

    def messages(self, wanted: Collection[str]) -> Iterator[BagMessage]:
        """The messages of the wanted topics, file by file. Raises SceneError with the file."""
        for file in self.files:
            read = _read_mcap if _is_mcap(file) else _read_sqlite
            for topic, received_ns, payload in read(file, wanted):
                if payload is None:
                    continue
                if topic.encoding != "cdr":
                    raise SceneError(
                        f"{file}: {topic.name}: found messages encoded as {topic.encoding!r}, expected cdr"
                    )
                if self.packed:
                    payload = _unpacked_message(file, topic, payload)
                if len(payload) > MAX_MESSAGE_BYTES:
                    raise SceneError(
                        f"{file}: {topic.name}: found a message of {len(payload)} bytes, "
                        f"expected at most {MAX_MESSAGE_BYTES}"
                    )
                yield BagMessage(topic, received_ns, payload)

    def topics(self) -> dict[str, tuple[str, int]]:
        """Type and number of messages of every topic, by name. Raises SceneError with the file."""
        counts: Counter[tuple[str, str]] = Counter()
        for file in self.files:
            if _is_mcap(file):
                counts.update((topic.name, topic.type) for topic, _, _ in _read_mcap(file, ()))
            else:
                counts.update(_sqlite_counts(file))
        return {name: (kind, count) for (name, kind), count in sorted(counts.items())}

    def listed_topics(self) -> str:
        """All topics with types and numbers of messages, a line each. Raises SceneError with the file."""
        topics = self.topics()
        lines = [f"\n  {_printable(name)}  {_printable(kind)}  {count}" for name, (kind, count) in topics.items()]
        more = f"\n  and {len(lines) - _LISTED} more" if len(lines) > _LISTED else ""
        return f"{len(lines)} topics (name, type, messages):{''.join(lines[:_LISTED])}{more}"


@contextmanager
def open_bag(path: Path, max_unpacked_mb: float) -> Iterator[Bag]:
    """Open a bag: a file of either storage, or a folder with metadata.yaml.

    max_unpacked_mb: limit on the size of compressed files, unpacked into a temporary folder, 10^6 bytes

    Raises SceneError for a file that is missing, outside the folder, a link, or of no known kind.
    """
    if not path.is_dir():
        if not path.is_file():
            raise SceneError(f"{path}: no such file or folder, expected a ROS 2 bag")
        _is_mcap(path)
        yield Bag(path, (path,), False)
        return
    information = read_yaml(_plain(path / METADATA))["rosbag2_bagfile_information"]
    names = information["relative_file_paths"].elements()
    if not 0 < len(names) <= _MAX_FILES:
        information["relative_file_paths"].fail(f"1 to {_MAX_FILES} names of files")
    files = [_plain(path / _name_in(path, name)) for name in names]
    mode = information.get("compression_mode")
    how = "" if mode is None else mode.text().lower()
    if mode is not None and how not in ("", "none", "file", "message"):
        mode.fail("none, file or message")
    if how in ("file", "message") and (kind := information["compression_format"]).text() != "zstd":
        kind.fail("zstd")
    if how != "file":
        yield Bag(path, tuple(files), how == "message")
        return
    with tempfile.TemporaryDirectory(prefix="mast-bag-") as folder:
        remaining, unpacked = int(max_unpacked_mb * 1e6), []
        for index, file in enumerate(files):
            unpacked.append(Path(folder) / f"{index}")
            remaining -= _unpack_file(file, unpacked[-1], remaining, max_unpacked_mb)
        yield Bag(path, tuple(unpacked), False)


def _printable(text: str) -> str:
    """A name of a bag without what would move the cursor of a terminal."""
    return "".join(filter(str.isprintable, text[:120]))


def _name_in(folder: Path, element: Element) -> str:
    """The name of a file of a bag; old versions write the folder before it."""
    text = element.text()
    parts = PurePosixPath(text).parts
    if not parts or len(text) > _MAX_NAME or "\0" in text or ".." in parts or parts[0] == "/" or len(parts) > 2:
        element.fail(f"the name of a file in {folder}")
    return parts[-1]


def _plain(path: Path) -> Path:
    """A file in the bag's folder. Raises SceneError for a link, which might lead outside, and for all else."""
    if path.is_symlink() or not path.is_file():
        found = "a link" if path.is_symlink() else "something else" if path.exists() else "no such file"
        raise SceneError(f"{path}: found {found}, expected a file in the folder of the bag")
    return path


def _is_mcap(file: Path) -> bool:
    """Whether a file is of the storage MCAP; it is SQLite3 otherwise. Raises SceneError if it is neither."""
    try:
        with file.open("rb") as opened:
            start = opened.read(len(_SQLITE_MAGIC))
    except OSError as error:
        raise SceneError(f"{file}: cannot be read: {error}") from error
    if not start.startswith((_MCAP_MAGIC, _SQLITE_MAGIC)):
        raise SceneError(f"{file}: begins with {start[:8]!r}, expected a bag of ROS 2: SQLite3 or MCAP")
    return start.startswith(_MCAP_MAGIC)


def _unpack_file(packed: Path, target: Path, max_bytes: int, max_unpacked_mb: float) -> int:
    """Unpack a file, and return its size. Raises SceneError as soon as it exceeds `max_bytes`."""
    size = 0
    try:
        with packed.open("rb") as source, target.open("wb") as file:
            for piece in zstandard.ZstdDecompressor(max_window_size=1 << 27).read_to_iter(source):
                size += len(piece)
                if size > max_bytes:
                    raise SceneError(
                        f"{packed}: unpacks to more than {max_unpacked_mb:g} MB with the other files, expected at "
                        "most that much (max_unpacked_mb)"
                    )
                file.write(piece)
    except (OSError, zstandard.ZstdError) as error:
        raise SceneError(f"{packed}: cannot be unpacked: {error}") from error
    return size


def _unpacked_message(file: Path, topic: Topic, payload: bytes) -> bytes:
    """A message that is compressed by itself."""
    try:
        size = zstandard.frame_content_size(payload)  # the decompressor allocates this much; -1: it is not given
        if size > MAX_MESSAGE_BYTES:
            raise SceneError(f"{file}: {topic.name}: found a message of {size} bytes, expected {MAX_MESSAGE_BYTES}")
        return zstandard.ZstdDecompressor(max_window_size=1 << 27).decompress(payload, MAX_MESSAGE_BYTES)
    except zstandard.ZstdError as error:
        raise SceneError(f"{file}: {topic.name}: a message cannot be unpacked: {error}") from error


#: A message: its topic, when it was received, and its payload if the topic is wanted.
_Read = tuple[Topic, int, bytes | None]


def _check_topic(file: Path, topic: Topic) -> Topic:
    for what, text, most in (
        ("name", topic.name, _MAX_NAME),
        ("type", topic.type, _MAX_NAME),
        ("hash", topic.hash, _MAX_NAME),
        ("definition", topic.definition, _MAX_DEFINITION),
    ):
        if not isinstance(text, str) or len(text) > most:
            raise SceneError(f"{file}: found a {what} of a topic that is longer than {most}, or no text")
    return topic


# SQLite3

_COLUMNS = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("topic_id", "timestamp", "data"),
}
_DEFINITIONS = ("topic_type", "encoding", "encoded_message_definition")
_HASH = "type_description_hash"
#: Limits on the steps of SQLite's virtual machine for all queries of a file.
_STEPS_ALWAYS, _STEPS_PER_BYTE, _STEPS_AT_ONCE = 10_000_000, 20, 100_000
_READABLE = ("sqlite_master", "message_definitions", *_COLUMNS)


@contextmanager
def _database(file: Path) -> Iterator[sqlite3.Connection]:
    """A database, opened so that it is read only, and that no SQL in it runs. Raises SceneError for all failures."""
    size = file.stat().st_size
    for suffix, content in (
        ("-wal", "messages that are not in the bag yet"),
        ("-journal", "a change that was cut off"),
    ):
        journal = file.with_name(file.name + suffix)
        if _is_hot(journal):
            raise SceneError(f"{journal}: found {content}, expected a bag that was closed")
    try:
        # Immutable: neither locks nor journals beside the file, which might be anything.
        uri = f"file:{quote(str(file.absolute()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as connection:
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            connection.set_authorizer(_authorize)
            # A damaged tree of pages can lead to the same page again and again: the rows of a sound one fit the file.
            remaining = iter(range((_STEPS_ALWAYS + _STEPS_PER_BYTE * size) // _STEPS_AT_ONCE))
            connection.set_progress_handler(lambda: next(remaining, None) is None, _STEPS_AT_ONCE)
            yield connection
    except (sqlite3.Error, sqlite3.Warning, ValueError, OverflowError) as error:
        raise SceneError(f"{file}: cannot be read as SQLite3: {error}") from error


def _is_hot(journal: Path) -> bool:
    """Whether a journal has something for its database; one that is kept for the next change begins with 0."""
    if not journal.is_file():
        return False
    with journal.open("rb") as file:
        return file.read(1) not in (b"", b"\0")


def _authorize(action: int, first: str | None, *_: str | None) -> int:
    """Allow to read the tables of a bag, and nothing else."""
    allowed = (
        action == sqlite3.SQLITE_SELECT
        or (action == sqlite3.SQLITE_READ and first in _READABLE)
        or (action == sqlite3.SQLITE_PRAGMA and first == "table_xinfo")
        or action == sqlite3.SQLITE_FUNCTION
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def _columns(file: Path, connection: sqlite3.Connection, table: str) -> set[str]:
    """The columns of a table that hold stored values; empty if it is no table."""
    kind = connection.execute("SELECT type, rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()
    if kind is None or kind[0] != "table" or not kind[1]:  # a view, or a virtual table
        return set()
    return {row[1] for row in connection.execute(f"PRAGMA table_xinfo({table})") if row[6] == 0}


def _sqlite_topics(file: Path, connection: sqlite3.Connection) -> dict[int, Topic]:
    """The topics of a database, by id."""
    columns = {table: _columns(file, connection, table) for table in (*_COLUMNS, "message_definitions")}
    for table, needed in _COLUMNS.items():
        missing = [name for name in needed if name not in columns[table]]
        if missing:
            raise SceneError(f"{file}: table {table}: found no column {', '.join(missing)}, expected those of a bag")
    definitions: dict[str, str] = {}
    if columns["message_definitions"].issuperset(_DEFINITIONS):
        for name, encoding, text in connection.execute(f"SELECT {', '.join(_DEFINITIONS)} FROM message_definitions"):
            if encoding == "ros2msg":
                definitions[name] = text
    topics = {}
    of_hash = _HASH if _HASH in columns["topics"] else "''"
    for number, name, kind, encoding, digest in connection.execute(
        f"SELECT {', '.join(_COLUMNS['topics'])}, {of_hash} FROM topics"
    ):
        topics[number] = _check_topic(file, Topic(name, kind, definitions.get(kind, ""), digest, encoding))
    return topics


def _read_sqlite(file: Path, wanted: Collection[str]) -> Iterator[_Read]:
    """The messages of the wanted topics in a database."""
    size = file.stat().st_size
    with _database(file) as connection:
        topics = _sqlite_topics(file, connection)
        numbers = [number for number, topic in topics.items() if topic.name in wanted]
        places = ", ".join("?" * len(numbers))
        rows = connection.execute(
            f"SELECT topic_id, timestamp, data FROM messages NOT INDEXED WHERE topic_id IN ({places})", numbers
        )
        total = 0
        for number, received_ns, payload in rows:
            if not isinstance(received_ns, int) or not isinstance(payload, bytes):
                raise SceneError(f"{file}: {topics[number].name}: found a message that is no bytes with a whole time")
            total += len(payload)
            if total > size:
                raise SceneError(f"{file}: found more than {size} bytes of messages in a file of that size")
            yield topics[number], received_ns, payload


def _sqlite_counts(file: Path) -> Counter[tuple[str, str]]:
    """Numbers of messages by name and type of their topic, also 0."""
    with _database(file) as connection:
        topics = _sqlite_topics(file, connection)
        counts = dict(connection.execute("SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id"))
    result: Counter[tuple[str, str]] = Counter()
    for number, topic in topics.items():
        result[topic.name, topic.type] += counts.get(number, 0)
    return result


# MCAP

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, number, ns of recording, ns of sending
_STATISTICS = struct.Struct("<QHIIII")  # numbers of messages, schemas, channels, attachments, metadata, chunks
_CHECKSUM = struct.Struct("<I")
#: Kinds of records that the format allows in each part of a file; applications may add private ones in all of them.
_IN_CHUNK = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_IN_DATA = frozenset(
    {*_IN_CHUNK, Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END}
)
_IN_SUMMARY = frozenset(Opcode) - _IN_DATA | {Opcode.SCHEMA, Opcode.CHANNEL}
_FIRST_PRIVATE = 0x80


def _read_mcap(file: Path, wanted: Collection[str]) -> Iterator[_Read]:
    """All messages of an MCAP file; of topics that are not wanted, without their payload."""
    channels: dict[int, Topic] = {}
    schemas: dict[int, Schema] = {}
    try:
        with file.open("rb") as opened:
            for opcode, content in _records(opened, file.stat().st_size):
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(ReadDataStream(BytesIO(content)))
                    if len(schema.data) > _MAX_DEFINITION:
                        raise ValueError(f"found a definition of {len(schema.data)} bytes")
                    schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(ReadDataStream(BytesIO(content)))
                    channels[channel.id] = _check_topic(file, _topic(channel, schemas))
                elif opcode == Opcode.MESSAGE:
                    number, _, received_ns, _ = _MESSAGE.unpack_from(content)
                    if number not in channels:
                        raise ValueError(f"found a message of channel {number}, which is unknown")
                    topic = channels[number]
                    yield topic, received_ns, bytes(content[_MESSAGE.size :]) if topic.name in wanted else None
    except (OSError, McapError, ValueError, OverflowError, struct.error, zstandard.ZstdError) as error:
        raise SceneError(f"{file}: cannot be read as MCAP: {error}") from error


def _topic(channel: Channel, schemas: dict[int, Schema]) -> Topic:
    schema = schemas.get(channel.schema_id)
    is_text = schema is not None and schema.encoding == "ros2msg"
    definition = schema.data.decode() if schema is not None and is_text else ""
    kind = "" if schema is None else schema.name
    digest = channel.metadata.get("topic_type_hash", "")
    return Topic(channel.topic, kind, definition, digest, channel.message_encoding)


def _records(file: IO[bytes], size: int) -> Iterator[tuple[int, memoryview]]:
    """Schemas, channels and messages of the data, also those in chunks; the file is checked to its last byte."""
    most, unpacked = _ALWAYS_BYTES + _MAX_EXPANSION * size, 0
    messages = chunks = 0
    allowed = _IN_DATA
    for opcode, length in _record_heads(file, size):
        start = file.tell()
        if opcode not in allowed and opcode < _FIRST_PRIVATE:
            raise _damaged(start - _RECORD.size, f"found a record of kind {opcode}")
        if allowed is _IN_SUMMARY:
            if opcode == Opcode.STATISTICS:
                written, *_, written_chunks = _STATISTICS.unpack(file.read(_STATISTICS.size))
                if (written, written_chunks) != (messages, chunks):
                    expected = f"{written} and {written_chunks}, as its statistics say"
                    raise _damaged(size, f"found {messages} messages and {chunks} chunks, expected {expected}")
        elif opcode == Opcode.DATA_END:
            if length != _CHECKSUM.size:
                raise _damaged(start, f"found an end of the data of {length} bytes, expected {_CHECKSUM.size}")
            (checksum,) = _CHECKSUM.unpack(file.read(_CHECKSUM.size))
            if checksum and checksum != _checksum(file, start - _RECORD.size):
                raise _damaged(start, "found data whose checksum is another")
            allowed = _IN_SUMMARY
        elif opcode in (*_IN_CHUNK, Opcode.CHUNK):
            if length > MAX_CHUNK_BYTES:
                raise ValueError(f"found a record of {length} bytes, expected at most {MAX_CHUNK_BYTES}")
            content = file.read(length)
            if opcode != Opcode.CHUNK:
                messages += opcode == Opcode.MESSAGE
                yield opcode, memoryview(content)
                continue
            chunks += 1
            chunk = _unpacked_chunk(Chunk.read(ReadDataStream(BytesIO(content))))
            unpacked += len(chunk)
            if unpacked > most:
                raise ValueError(f"found more than {most} bytes unpacked in a file of {size}")
            for record in _in_chunk(memoryview(chunk)):
                messages += record[0] == Opcode.MESSAGE
                yield record


def _record_heads(file: IO[bytes], size: int) -> Iterator[tuple[int, int]]:
    """Opcode and length of each record, up to the footer, which ends the file; the file is at the record's content."""
    opcode, at = 0, len(_MCAP_MAGIC)
    while opcode != Opcode.FOOTER:
        file.seek(at)
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise _damaged(size, "found no footer")
        opcode, length = _RECORD.unpack(head)
        at += _RECORD.size + length
        if at > size:
            raise _damaged(size, f"found a record that ends at byte {at}")
        yield opcode, length
    file.seek(at)
    if file.read(len(_MCAP_MAGIC) + 1) != _MCAP_MAGIC:
        raise _damaged(at, "found a footer that does not end the file")


def _damaged(at: int, problem: str) -> ValueError:
    return ValueError(f"it is cut off or damaged at byte {at}: {problem}; `mcap recover` saves what can be read")


def _checksum(file: IO[bytes], end: int) -> int:
    """The checksum of a file's bytes before `end`."""
    result, at = 0, 0
    file.seek(0)
    while piece := file.read(min(1 << 20, end - at)):
        result, at = zlib.crc32(piece, result), at + len(piece)
    return result


def _in_chunk(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    at = 0
    while at < len(content):
        opcode, length = _RECORD.unpack_from(content, at)
        start = at + _RECORD.size
        at = start + length
        if at > len(content):
            raise ValueError("found a record that is longer than its chunk")
        if opcode in _IN_CHUNK:
            yield opcode, content[start:at]
        elif opcode < _FIRST_PRIVATE:
            raise ValueError(f"found a record of kind {opcode} in a chunk: it is damaged")


def _unpacked_chunk(chunk: Chunk) -> bytes:
    """The content of a chunk. Raises ValueError before more memory is used than MAX_CHUNK_BYTES."""
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"found a chunk of {size} bytes unpacked, expected at most {MAX_CHUNK_BYTES}")
    if chunk.compression == "":
        content = chunk.data
    elif chunk.compression == "zstd":
        claimed = zstandard.frame_content_size(chunk.data)  # the decompressor allocates this much; -1: it is not given
        if claimed not in (-1, size):
            raise ValueError(f"found a chunk of {claimed} bytes unpacked, which claims to have {size}")
        content = zstandard.ZstdDecompressor(max_window_size=1 << 28).decompress(chunk.data, size)
    elif chunk.compression == "lz4":
        content = _unpacked_lz4(chunk.data, size)
    else:
        raise ValueError(f"found a chunk compressed by {chunk.compression!r:.20}, expected zstd or lz4")
    if len(content) != size:
        raise ValueError(f"found a chunk of {len(content)} bytes unpacked, which claims to have {size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("found a chunk whose checksum is not that of its content")
    return content


def _unpacked_lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]  # comes with rosbags

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except RuntimeError as error:
        raise ValueError(f"a damaged chunk: {error}") from error
