"""Opens ROS 2 bags with rosbags, within limits of memory and time, and decodes their messages.

A bag may come from anybody. rosbags reads its files, but has no limits: reads, chunks and rows that are too large are
refused here, before they are in memory. MCAP is read from front to back, chunk by chunk.

Known types of a bag have the hash of ours, so bytes are never read with the fields of another version. Of own types,
rosbags makes Python classes and functions, in whose code names of letters, digits and _ are all that is theirs; an
element of an array is a line, so arrays have a limit.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from functools import partial
from io import BufferedReader, BytesIO, FileIO
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, NoReturn, cast

import apsw
import lz4.frame  # type: ignore[import-untyped]  # comes with rosbags, as apsw does
import zstandard
from mast_ros2 import type_store
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Nodetype
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mast_datasets.files import read_pieces, read_yaml
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

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


class Bag(NamedTuple):
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
                if journal.is_file() and next(read_pieces(journal), b"\0")[:1] != b"\0":
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


#: Makes a message of a payload; raises MessageError for bytes that are none.
Decode = Callable[[bytes], Any]
#: Constants and fields of types by name, as rosbags has them.
Fields = dict[str, Any]
#: Steps to a value in nested messages and lists.
Steps = tuple[str | int, ...]

_MAX_DEFINITION = 200_000  # characters
_MAX_ARRAYS = 1000  # elements of all arrays in a type that are no numbers


def parse_definition(name: str, text: str) -> Fields:
    """The fields of a type, and of types in it, from a `.msg` text. Raises ValueError for a text that is none."""
    if len(text) > _MAX_DEFINITION:
        raise ValueError(f"a definition of {len(text)} characters, expected at most {_MAX_DEFINITION}")
    try:
        return {kind: ([], fields) for kind, (_, fields) in get_types_from_msg(text, name).items()}
    except Exception as error:  # of the parser, which raises many kinds
        words = " ".join(str(error).split())
        raise ValueError(f"the definition of {name!r:.120} cannot be read: {words:.200}") from None


def _defined(connection: Connection) -> Fields:
    definition = connection.msgdef
    is_text = definition.format == MessageDefinitionFormat.MSG
    return parse_definition(connection.msgtype, definition.data) if is_text else {}


def known_decoder(place: str, connection: Connection) -> Decode:
    """How to decode a type that is known. Raises SceneError if the bag has another version of it. place: of the bag"""
    name, store = connection.msgtype, get_typestore(Stores.EMPTY)
    try:
        store.fielddefs = _defined(connection)
        theirs = {connection.digest, store.hash_rihs01(name) if store.fielddefs else ""}
    except Exception as error:  # a definition may lack types, or contain itself
        raise SceneError(f"{place}: {connection.topic}: {error!s:.300}") from None
    if others := theirs - {"", type_store.type_hash(name)}:
        raise SceneError(
            f"{place}: {connection.topic}: the bag has another version of {name}: found the hash "
            f"{', '.join(sorted(others)):.200}, expected {type_store.type_hash(name)}; `fields` in the map reads any"
        )
    return lambda payload: type_store.decode(name, payload)


class OwnType:
    """A type that is read by its definition, with attributes for its fields.

    place: of the bag, for messages;  of_map: fields of the types that the map defines, by name; they take precedence

    Raises ConfigurationError if neither the map nor the bag defines the type, and SceneError for a definition that is
    none.
    """

    def __init__(self, place: str, connection: Connection, of_map: Fields) -> None:
        self._name, self._store = connection.msgtype, get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = type_store.MOST_ELEMENTS
        try:
            known = {**type_store.STORE.fielddefs, **_defined(connection), **of_map}
            self._store.register(_needed(f"{place}: {connection.topic}", self._name, known))
            self._store.get_msgdef(self._name)
        except ConfigurationError:
            raise
        except Exception as error:  # of rosbags, for a type that cannot be
            name = f"{place}: {connection.topic}: {self._name!r:.120}"
            raise SceneError(f"{name} cannot be read: {error!s:.200}") from None

    def decode(self, payload: bytes) -> Any:
        """The message of a payload. Raises MessageError for bytes that are none."""
        try:
            return self._store.deserialize_cdr(payload, self._name)
        except SerdeError as error:
            raise MessageError(f"{self._name}: {len(payload)} bytes: {error}") from None

    def check_paths(self, paths: Mapping[str, Steps]) -> None:
        """Raise ValueError unless `list` leads to a list of messages, and the others to something in these."""
        kind, detail = self._at(self._name, paths["list"])
        if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or detail[0][0] != Nodetype.NAME:
            raise ValueError(f"{'.'.join(map(str, paths['list']))} of {self._name} is no list of messages")
        for name, path in paths.items():
            if name != "list":
                self._at(str(detail[0][1]), path)

    def _at(self, name: str, path: Steps) -> Any:
        """The description of what is at a path in a type."""
        kind: Nodetype = Nodetype.NAME
        detail: Any = name
        for step in path:
            is_list = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            if is_list and isinstance(step, int):
                kind, detail = detail[0]
                continue
            fields = dict(self._store.fielddefs[detail][1]) if kind == Nodetype.NAME else {}
            if step not in fields:
                known = ", ".join(fields) or ("a number" if is_list else "no step")
                where = f"{'.'.join(map(str, path))} of {name}"
                raise ValueError(f"{where}: found no {step!r}, expected one of {known}{nearest(str(step), fields)}")
            kind, detail = fields[step]
        return kind, detail


def _needed(place: str, name: str, known: Fields) -> Fields:
    """The fields of a type, and of all types in it.

    Raises ConfigurationError for a type that is not defined, and ValueError for arrays that are too long, or empty:
    every element takes a byte at least, so the work is bounded by the size of the message.
    """
    needed: Fields = {}
    missing, elements = [name], 0
    while missing:
        kind = missing.pop()
        if kind not in known:
            expected = f"expected one under `types` of the map{nearest(kind, list(known))}"
            raise ConfigurationError(f"{place}: the bag has no definition of {kind!r:.120}: {expected}")
        needed[kind] = known[kind]
        for _, (node, detail) in known[kind][1]:
            inner, length = ((node, detail), 1) if node in (Nodetype.BASE, Nodetype.NAME) else detail
            if node == Nodetype.ARRAY:
                elements += length if inner[0] == Nodetype.NAME or inner[1][0] == "string" else 0
                if length < 1 or elements > _MAX_ARRAYS:
                    raise ValueError(f"{kind} has a list of {length} elements, expected 1 to {_MAX_ARRAYS} in all")
            if inner[0] == Nodetype.NAME and inner[1] not in needed:
                missing.append(inner[1])
    return needed
