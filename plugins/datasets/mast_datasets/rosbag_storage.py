"""Reads the files of ROS 2 bags, SQLite3 and MCAP: bounded in size, within the bag's folder, without running anything.

A bag may come from anybody. SQL of a database file (views, triggers, generated columns) is never run. MCAP is read from
its first record to its last one, and unpacked chunk by chunk: an index may say anything.
"""

from __future__ import annotations

import sqlite3
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple
from urllib.parse import quote

import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Chunk, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader

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
_MAX_FILES = _MAX_TOPICS = 10_000
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
                try:
                    payload = _unpacked_zstd(payload, MAX_MESSAGE_BYTES) if self.packed else payload
                except ValueError as error:
                    raise SceneError(f"{file}: {topic.name}: a message cannot be unpacked: {error}") from error
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


def _start(file: Path) -> bytes:
    """The first bytes of a file. Raises SceneError if it cannot be read."""
    try:
        with file.open("rb") as opened:
            return opened.read(len(_SQLITE_MAGIC))
    except OSError as error:
        raise SceneError(f"{file}: cannot be read: {error}") from error


def _is_mcap(file: Path) -> bool:
    """Whether a file is of the storage MCAP; it is SQLite3 otherwise. Raises SceneError if it is neither."""
    start = _start(file)
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

#: Limits on the steps of SQLite's virtual machine for all queries of a file.
_STEPS_ALWAYS, _STEPS_PER_BYTE, _STEPS_AT_ONCE = 10_000_000, 20, 100_000
_READABLE = ("sqlite_master", "topics", "messages", "message_definitions")
_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"


@contextmanager
def _database(file: Path) -> Iterator[sqlite3.Connection]:
    """A database, opened so that it is read only, and that no SQL in it runs. Raises SceneError for all failures."""
    size = file.stat().st_size
    for suffix in ("-wal", "-journal"):
        journal = file.with_name(file.name + suffix)
        # One that is kept for the next change begins with 0.
        if journal.is_file() and _start(journal)[:1] not in (b"", b"\0"):
            raise SceneError(f"{journal}: found a change that is not in the bag, expected a bag that was closed")
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


def _authorize(action: int, first: str | None, second: str | None, *_: str | None) -> int:
    """Allow to read and to count what is in the tables of a bag, and nothing else."""
    allowed = (
        action == sqlite3.SQLITE_SELECT
        or (action == sqlite3.SQLITE_READ and first in _READABLE)
        or (action == sqlite3.SQLITE_PRAGMA and first == "table_xinfo")
        or (action == sqlite3.SQLITE_FUNCTION and second == "count")
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def _sqlite_topics(file: Path, connection: sqlite3.Connection) -> dict[int, Topic]:
    """The topics of a database, by id."""
    # Neither views, nor virtual tables, nor those with generated columns: these are functions.
    names = [name for (name,) in connection.execute(_TABLES) if name in _READABLE]
    tables = {name for name in names if not any(row[6] for row in connection.execute(f"PRAGMA table_xinfo({name})"))}
    if not tables.issuperset(("topics", "messages")):
        raise ValueError("found no tables topics and messages, expected those of a bag")
    definitions: dict[str, str] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
        definitions.update(connection.execute(query))
    columns = [column for column, *_ in connection.execute("SELECT * FROM topics LIMIT 0").description]
    digest = "type_description_hash" if "type_description_hash" in columns else "''"
    rows = connection.execute(f"SELECT id, name, type, {digest}, serialization_format FROM topics")
    return {
        number: _check_topic(file, Topic(name, kind, definitions.get(kind, ""), text, encoding))
        for number, name, kind, text, encoding in rows
    }


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


def _read_mcap(file: Path, wanted: Collection[str]) -> Iterator[_Read]:
    """All messages of an MCAP file; of topics that are not wanted, without their payload."""
    channels: dict[int, Topic] = {}
    schemas: dict[int, tuple[str, str]] = {}  # name and definition
    try:
        with file.open("rb") as opened:
            for record in _records(opened, file.stat().st_size):
                if isinstance(record, Schema):
                    if len(record.data) > _MAX_DEFINITION or len(schemas) > _MAX_TOPICS:
                        raise ValueError(f"found a definition of {len(record.data)} bytes, {len(schemas)} before it")
                    text = record.data.decode() if record.encoding == "ros2msg" else ""
                    schemas.setdefault(record.id, (record.name, text))
                elif isinstance(record, Channel):
                    digest = record.metadata.get("topic_type_hash", "")
                    kind = schemas.get(record.schema_id, ("", ""))
                    topic = Topic(record.topic, *kind, digest, record.message_encoding)
                    channels[record.id] = _check_topic(file, topic)
                elif isinstance(record, Message):
                    if record.channel_id not in channels:
                        raise ValueError(f"found a message of channel {record.channel_id}, which is unknown")
                    topic = channels[record.channel_id]
                    yield topic, record.log_time, record.data if topic.name in wanted else None
    except (OSError, McapError, ValueError, OverflowError, MemoryError, struct.error) as error:
        reason = str(error) or type(error).__name__
        raise SceneError(
            f"{file}: cannot be read as MCAP: it is cut off or damaged: {reason}; `mcap recover` saves what can be read"
        ) from error


def _records(opened: IO[bytes], size: int) -> Iterator[McapRecord]:
    """All records, also those in chunks; the file is checked to its last byte."""
    remaining = _ALWAYS_BYTES + _MAX_EXPANSION * size
    counts: Counter[type] = Counter()
    reader = StreamReader(opened, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES)
    for record in reader.records:
        counts[type(record)] += 1
        if isinstance(record, Statistics):
            written, found = (record.message_count, record.chunk_count), (counts[Message], counts[Chunk])
            if written != found:
                raise ValueError("found {} messages and {} chunks, expected {} and {}".format(*found, *written))
        if not isinstance(record, Chunk):
            yield record
            continue
        content = _unpacked_chunk(record)
        remaining -= len(content)
        if remaining < 0:
            raise ValueError(f"found too many bytes unpacked in a file of {size}")
        with suppress(EndOfFile):  # at the end of the chunk, which has no footer
            for inner in StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True).records:
                counts[type(inner)] += 1
                yield inner
    if opened.read(1):
        raise ValueError("found a footer that does not end the file")


def _unpacked_chunk(chunk: Chunk) -> bytes:
    """The content of a chunk. Raises ValueError before more memory is used than MAX_CHUNK_BYTES."""
    size, content = chunk.uncompressed_size, chunk.data
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"found a chunk of {size} bytes unpacked, expected at most {MAX_CHUNK_BYTES}")
    if chunk.compression == "zstd":
        content = _unpacked_zstd(content, size)
    elif chunk.compression == "lz4":
        content = _unpacked_lz4(content, size)
    elif chunk.compression:
        raise ValueError(f"found a chunk compressed by {chunk.compression!r:.20}, expected zstd or lz4")
    if len(content) != size:
        raise ValueError(f"found a chunk of {len(content)} bytes unpacked, which claims to have {size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("found a chunk whose checksum is not that of its content")
    return content


def _unpacked_zstd(data: bytes, most: int) -> bytes:
    """Unpacked data. Raises ValueError before more memory is used than `most` bytes."""
    try:
        size = zstandard.frame_content_size(data)  # the decompressor allocates this much; -1: it is not given
        if size > most:
            raise ValueError(f"found {size} bytes unpacked, expected at most {most}")
        return zstandard.ZstdDecompressor(max_window_size=1 << 28).decompress(data, most)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


def _unpacked_lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]  # comes with rosbags

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except RuntimeError as error:
        raise ValueError(str(error)) from error
