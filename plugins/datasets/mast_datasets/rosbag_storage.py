"""Opens ROS 2 bags with rosbags, within limits of memory and time.

A bag may come from anybody. rosbags reads its files, but has no limits: reads, chunks and rows that are too large are
refused here, before they are in memory. MCAP is read from front to back, chunk by chunk.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from io import BufferedReader, BytesIO, FileIO
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn, cast

import apsw
import lz4.frame  # type: ignore[import-untyped]  # comes with rosbags, as apsw does
import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader

from mast_datasets.files import read_yaml
from mast_zenoh.errors import SceneError

METADATA = "metadata.yaml"
#: Limits on one message, and on one chunk or record of MCAP, bytes; clouds and images of unmapped topics are in chunks.
MAX_MESSAGE_BYTES = 16 << 20
MAX_CHUNK_BYTES = 256 << 20
#: Limit on what the chunks of a file unpack to, in relation to its size, and bytes that are always allowed.
_MAX_EXPANSION, _ALWAYS_BYTES = 200, 1 << 30
#: Limits on the steps of SQLite's virtual machine: a damaged tree of pages can lead to the same page again and again.
_STEPS_ALWAYS, _STEPS_PER_BYTE, _STEPS_AT_ONCE = 10_000_000, 40, 100_000
_MAX_FILES = 10_000
_MAX_NAME = 1000
_LISTED = 100  # topics in a message

#: Bytes that chunks of the bag being read may unpack to; None: others use rosbags.
_unpackable: ContextVar[int | None] = ContextVar("_unpackable", default=None)


def _unpack(kind: str, data: bytes, most: int) -> bytes:
    """Unpack data, up to one byte more than `most`."""
    if kind == "lz4":
        return bytes(lz4.frame.open(BytesIO(data)).read(most + 1))
    return zstandard.ZstdDecompressor(max_window_size=1 << 28).stream_reader(data).read(most + 1)


def _unpack_chunk(kind: str, data: bytes, size: int) -> bytes:
    if (remaining := _unpackable.get()) is not None:
        _unpackable.set(remaining - size)
        if size > min(remaining, MAX_CHUNK_BYTES):
            raise ReaderError(f"found a chunk of {size} bytes unpacked, or chunks that unpack to too many bytes in all")
    return _unpack(kind, data, size)


DECOMPRESSORS.update(zstd=partial(_unpack_chunk, "zstd"), lz4=partial(_unpack_chunk, "lz4"))


class _BoundedFile(BufferedReader):
    """A file that is never read whole."""

    def read(self, size: int | None = -1) -> bytes:
        size = MAX_CHUNK_BYTES if size is None or size < 0 else size
        if size > MAX_CHUNK_BYTES:
            raise ReaderError(f"found a record of {size} bytes, expected at most {MAX_CHUNK_BYTES}")
        return super().read(size)


class _BoundedPath(type(Path())):  # type: ignore[misc]  # the class of this system
    """A path whose file is bounded."""

    def open(self, *_: Any, **__: Any) -> _BoundedFile:
        return _BoundedFile(FileIO(self))


@dataclass(frozen=True)
class Bag:
    """An open bag. path: as it was given; readers: of its files, in order; packed: whether messages are, by zstd

    All methods raise SceneError with the file.
    """

    path: Path
    readers: tuple[Reader, ...]
    packed: bool

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics, file by file: connection, time of recording ns, and payload."""
        for reader in self.readers:
            wanted = [connection for connection in reader.connections if connection.topic in topics]
            found: Counter[int] = Counter()
            for connection in wanted:
                encoding = cast("ConnectionExtRosbag2", connection.ext).serialization_format
                if encoding != "cdr":
                    _refuse(reader.path, f"{connection.topic}: found messages encoded as {encoding!r}, expected cdr")
            try:
                read = reader.storage.messages_scan if isinstance(reader.storage, McapReader) else reader.messages
                for connection, received_ns, payload in read(wanted) if wanted else ():
                    if not isinstance(received_ns, int) or not isinstance(payload, bytes):
                        raise ReaderError(f"{connection.topic}: found a message that is no bytes with a whole time")
                    payload = _unpack("zstd", payload, MAX_MESSAGE_BYTES) if self.packed else payload
                    if len(payload) > MAX_MESSAGE_BYTES:
                        raise ReaderError(f"{connection.topic}: a message has more than {MAX_MESSAGE_BYTES} bytes")
                    found[connection.id] += 1
                    yield connection, received_ns, payload
            except SceneError:
                raise
            except Exception as error:  # damaged files make it raise anything
                _refuse(reader.path, error)
            for connection in wanted:
                if found[connection.id] != connection.msgcount:
                    number = f"found {found[connection.id]} messages, expected {connection.msgcount}"
                    _refuse(reader.path, f"{connection.topic}: {number}: the file is damaged")

    def topics(self) -> dict[str, tuple[str, int]]:
        """Type and number of messages of every topic, by name."""
        counts: Counter[tuple[str, str]] = Counter()
        for connection in (each for reader in self.readers for each in reader.connections):
            counts[connection.topic, connection.msgtype] += connection.msgcount
        return {name: (kind, count) for (name, kind), count in sorted(counts.items())}

    def listed_topics(self) -> str:
        """All topics with types and numbers of messages, a line each, without what would move a terminal's cursor."""
        topics = self.topics()
        lines = [f"{name[:120]}  {kind[:120]}  {count}" for name, (kind, count) in topics.items()][:_LISTED]
        lines += [f"and {len(topics) - _LISTED} more"] if len(topics) > _LISTED else []
        listed = "".join("\n  " + "".join(filter(str.isprintable, line)) for line in lines)
        return f"{len(topics)} topics (name, type, messages):{listed}"


@contextmanager
def open_bag(path: Path, max_unpacked_mb: float) -> Iterator[Bag]:
    """Open a bag: a file of either storage, or a folder with metadata.yaml.

    max_unpacked_mb: limit on the size of compressed files, unpacked into a temporary folder, 10^6 bytes

    Raises SceneError for a file that is missing, outside the folder, a link, or that rosbags cannot read.
    """
    with ExitStack() as opened:
        files, mode = ([path], "") if path.is_file() else _listed_files(path)
        if mode == "file":
            folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="mast-bag-")))
            files = _unpack_files(files, folder, max_unpacked_mb)
        limit = _ALWAYS_BYTES + _MAX_EXPANSION * sum(file.stat().st_size for file in files)
        opened.callback(_unpackable.reset, _unpackable.set(limit))
        readers = []
        for file in files:
            for journal in (file.with_name(f"{file.name}-{kind}") for kind in ("wal", "journal")):
                # One that is kept for the next change begins with 0.
                if journal.is_file() and _start(journal) not in (b"", b"\0"):
                    _refuse(journal, "found a change that is not in the bag, expected a bag that was closed")
            steps = (_STEPS_ALWAYS + _STEPS_PER_BYTE * file.stat().st_size) // _STEPS_AT_ONCE
            apsw.connection_hooks.append(partial(_limit, steps))
            try:
                reader = opened.enter_context(Reader(_BoundedPath(file)))
                for name in (
                    each for found in reader.connections for each in (found.topic, found.msgtype, found.digest)
                ):
                    if not isinstance(name, str) or len(name) > _MAX_NAME:
                        raise ReaderError(f"found a name of a topic or type that is no text of {_MAX_NAME} characters")
                readers.append(reader)
            except Exception as error:  # damaged files make it raise anything
                _refuse(file, error)
            finally:
                apsw.connection_hooks.pop()
        yield Bag(path, tuple(readers), mode == "message")


def _refuse(place: Any, reason: object) -> NoReturn:
    words = " ".join(str(reason).split()) or type(reason).__name__
    raise SceneError(
        f"{place}: cannot be read as a bag: {words:.300}" if isinstance(reason, Exception) else f"{place}: {words}"
    )


def _start(file: Path) -> bytes:
    with file.open("rb") as opened:
        return opened.read(1)


def _limit(steps: int, connection: apsw.Connection) -> None:
    """Bound the rows and the time of a database, and run no SQL that is in it."""
    remaining = iter(range(steps))
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
    connection.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    connection.set_progress_handler(lambda: next(remaining, None) is None, _STEPS_AT_ONCE)


def _listed_files(path: Path) -> tuple[list[Path], str]:
    """The files that the metadata of a bag names, and what is compressed by zstd: "", "file" or "message"."""
    if not path.is_dir():
        raise SceneError(f"{path}: no such file or folder, expected a ROS 2 bag")
    information = read_yaml(_plain(path / METADATA))["rosbag2_bagfile_information"]
    names = information["relative_file_paths"].elements()
    if not 0 < len(names) <= _MAX_FILES:
        information["relative_file_paths"].fail(f"1 to {_MAX_FILES} names of files")
    mode = information.get("compression_mode")
    how = "" if mode is None else mode.text().lower()
    if mode is not None and how not in ("", "none", "file", "message"):
        mode.fail("none, file or message")
    if how in ("file", "message"):
        information["compression_format"].text(("zstd",))
    # Old versions write the folder before a name.
    return [_plain(path / PurePosixPath(name.text().replace("\0", "")).name) for name in names], how


def _plain(path: Path) -> Path:
    """A file in the bag's folder. Raises SceneError for a link, which might lead outside, and for all else."""
    if path.is_symlink() or not path.is_file():
        found = "a link" if path.is_symlink() else "no such file"
        raise SceneError(f"{path}: found {found}, expected a file in the folder of the bag")
    return path


def _unpack_files(files: list[Path], folder: Path, max_unpacked_mb: float) -> list[Path]:
    """Unpack files into a folder. Raises SceneError as soon as they exceed the limit."""
    remaining, unpacked = max_unpacked_mb * 1e6, []
    for index, file in enumerate(files):
        unpacked.append(folder / f"{index}{Path(file.stem).suffix}")
        try:
            with file.open("rb") as source, unpacked[-1].open("wb") as target:
                for piece in zstandard.ZstdDecompressor(max_window_size=1 << 27).read_to_iter(source):
                    remaining -= target.write(piece)
                    if remaining < 0:
                        raise SceneError(f"{file}: unpacks to more than {max_unpacked_mb:g} MB (max_unpacked_mb)")
        except (OSError, zstandard.ZstdError) as error:
            raise SceneError(f"{file}: cannot be unpacked: {error}") from error
    return unpacked
