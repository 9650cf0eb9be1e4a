"""Opens ROS 2 bags with rosbags, and decodes their messages.

A bag may come from anybody. rosbags reads its files, but has no limits: records, chunks and rows that are too large
are refused here, before they are in memory. MCAP is read from front to back, chunk by chunk.

Types have the fields that the bag says. Of these, rosbags makes Python classes and functions, in whose code names of
letters, digits and _ are all that is theirs; an element of an array is a line, so arrays have a limit.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from io import BufferedReader, BytesIO, FileIO
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NamedTuple, cast

import apsw
import lz4.frame  # type: ignore[import-untyped]  # comes with rosbags, as apsw does
import zstandard
from mast_ros2 import type_store
from msgspec import Meta
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Nodetype
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapReader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mast_datasets.files import read_pieces, read_yaml
from mast_zenoh.errors import ConfigurationError, MessageError, SceneError, nearest

METADATA = "metadata.yaml"
#: Limits on one message, and on one record, chunk or row, bytes; clouds and images of unmapped topics are in chunks.
MAX_MESSAGE_BYTES = 16 << 20
MAX_CHUNK_BYTES = 256 << 20
#: Limits on the steps of SQLite's virtual machine: a damaged tree of pages can lead to the same page again and again.
_STEPS_ALWAYS, _STEPS_PER_BYTE, _STEPS_AT_ONCE = 10_000_000, 40, 100_000
_MAX_NAME = 1000
_LISTED = 100  # topics in a message
_FileNames = Annotated[list[str], Meta(min_length=1, max_length=10_000)]


def _unpack(kind: str, data: bytes, most: int) -> bytes:
    """Unpack data, up to one byte more than `most`."""
    if kind == "lz4":
        return bytes(lz4.frame.open(BytesIO(data)).read(most + 1))
    return zstandard.ZstdDecompressor(max_window_size=1 << 28).stream_reader(data).read(most + 1)


def _unpack_chunk(kind: str, data: bytes, size: int) -> bytes:
    if size > MAX_CHUNK_BYTES:
        raise ReaderError(f"found a chunk of {size} bytes unpacked, expected at most {MAX_CHUNK_BYTES}")
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
    """An open bag. path: as it was given; readers: of its files, in order

    All methods raise SceneError with the file.
    """

    path: Path
    readers: tuple[Reader, ...]

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics, file by file: connection, time of recording ns, and payload."""
        for reader in self.readers:
            with _reading(reader.path):
                yield from _messages(reader, [each for each in reader.connections if each.topic in topics])

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


def _messages(reader: Reader, wanted: list[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """The messages of some connections of a file. Raises ReaderError for those that cannot be, or are too few."""
    found: Counter[int] = Counter()
    for connection in wanted:
        encoding = cast("ConnectionExtRosbag2", connection.ext).serialization_format
        if encoding != "cdr":
            raise ReaderError(f"{connection.topic}: found messages encoded as {encoding!r}, expected cdr")
    read = reader.storage.messages_scan if isinstance(reader.storage, McapReader) else reader.messages
    for connection, received_ns, payload in read(wanted) if wanted else ():
        if not isinstance(received_ns, int) or not isinstance(payload, bytes):
            raise ReaderError(f"{connection.topic}: found a message that is no bytes with a whole time")
        if payload.startswith(zstandard.FRAME_HEADER):  # CDR begins with 0
            payload = _unpack("zstd", payload, MAX_MESSAGE_BYTES)
        if len(payload) > MAX_MESSAGE_BYTES:
            raise ReaderError(f"{connection.topic}: a message has more than {MAX_MESSAGE_BYTES} bytes")
        found[connection.id] += 1
        yield connection, received_ns, payload
    for connection in wanted:
        if found[connection.id] != connection.msgcount:
            number = f"found {found[connection.id]} messages, expected {connection.msgcount}"
            raise ReaderError(f"{connection.topic}: {number}: the file is damaged")


@contextmanager
def _reading(file: object) -> Iterator[None]:
    """Raise SceneError with the file for whatever a damaged one makes rosbags raise."""
    try:
        yield
    except Exception as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"{file}: cannot be read as a bag: {words:.300}") from error


@contextmanager
def open_bag(path: Path, max_unpacked_mb: float) -> Iterator[Bag]:
    """Open a bag: a file of either storage, or a folder with metadata.yaml.

    max_unpacked_mb: limit on the size of compressed files, unpacked into a temporary folder, 10^6 bytes

    Raises SceneError for a file that is missing, outside the folder, a link, or that rosbags cannot read.
    """
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="mast-bag-")))
        readers = []
        for file in _unpacked(_files(path), folder, max_unpacked_mb):
            with _reading(file), _limited(file):
                for journal in (file.with_name(f"{file.name}-{kind}") for kind in ("wal", "journal")):
                    # One that is kept for the next change begins with 0.
                    if journal.is_file() and next(read_pieces(journal), b"\0")[:1] != b"\0":
                        raise ReaderError(f"{journal.name} has a change that is not in the bag, expected a closed bag")
                readers.append(opened.enter_context(Reader(_BoundedPath(file))))
                for each in readers[-1].connections:
                    for name in (each.topic, each.msgtype, each.digest):
                        if not isinstance(name, str) or len(name) > _MAX_NAME:
                            raise ReaderError(f"found a name of a topic that is no text of {_MAX_NAME} characters")
        yield Bag(path, tuple(readers))


@contextmanager
def _limited(file: Path) -> Iterator[None]:
    """Bound the rows and the time of the databases that are opened, and run no SQL that is in them. file: its size"""
    steps = iter(range((_STEPS_ALWAYS + _STEPS_PER_BYTE * file.stat().st_size) // _STEPS_AT_ONCE))

    def limit(connection: apsw.Connection) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        connection.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
        connection.set_progress_handler(lambda: next(steps, None) is None, _STEPS_AT_ONCE)

    apsw.connection_hooks.append(limit)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(limit)


def _files(path: Path) -> list[Path]:
    """The files of a bag, those of a folder as its metadata names them."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise SceneError(f"{path}: no such file or folder, expected a ROS 2 bag")
    names = read_yaml(_plain(path / METADATA))["rosbag2_bagfile_information"]["relative_file_paths"].read(_FileNames)
    return [_plain(path / PurePosixPath(name).name) for name in names]  # old versions write the folder before a name


def _plain(path: Path) -> Path:
    """A file in the bag's folder. Raises SceneError for a link, which might lead outside, and for all else."""
    if path.is_symlink() or not path.is_file():
        found = "a link" if path.is_symlink() else "no such file"
        raise SceneError(f"{path}: found {found}, expected a file in the folder of the bag")
    return path


def _unpacked(files: list[Path], folder: Path, max_unpacked_mb: float) -> Iterator[Path]:
    """The files; those compressed by zstd are unpacked into a folder. Raises SceneError when they exceed the limit."""
    remaining = max_unpacked_mb * 1e6
    for index, file in enumerate(files):
        if file.suffix != ".zstd":
            yield file
            continue
        target = folder / f"{index}{Path(file.stem).suffix}"
        try:
            with file.open("rb") as source, target.open("wb") as unpacked:
                for piece in zstandard.ZstdDecompressor(max_window_size=1 << 27).read_to_iter(source):
                    remaining -= unpacked.write(piece)
                    if remaining < 0:
                        raise SceneError(f"{file}: unpacks to more than {max_unpacked_mb:g} MB (max_unpacked_mb)")
        except (OSError, zstandard.ZstdError) as error:
            raise SceneError(f"{file}: cannot be unpacked: {error}") from error
        yield target


#: Makes a message of a payload; raises MessageError for bytes that are none.
Decode = Callable[[bytes], Any]
#: Constants and fields of types by name, as rosbags has them.
Fields = dict[str, Any]
#: Steps to a value in nested messages and lists.
Steps = tuple[str | int, ...]

_MAX_DEFINITION = 200_000  # characters
_MAX_ARRAYS = 1000  # elements of all arrays in a definition that are no numbers


def parse_definition(name: str, text: str) -> Fields:
    """The fields of a type, and of types in it, from a `.msg` text.

    Raises ValueError for a text that is none, and for arrays that are too long, or empty: every element takes a byte at
    least, so the work is bounded by the size of the message.
    """
    if len(text) > _MAX_DEFINITION:
        raise ValueError(f"a definition of {len(text)} characters, expected at most {_MAX_DEFINITION}")
    try:
        types = get_types_from_msg(text, name)
    except Exception as error:  # of the parser, which raises many kinds
        words = " ".join(str(error).split())
        raise ValueError(f"the definition of {name!r:.120} cannot be read: {words:.200}") from None
    elements = 0
    for kind, (_, fields) in types.items():
        for _, field in fields:
            if field[0] == Nodetype.ARRAY:
                inner, length = field[1]
                elements += length if inner[0] == Nodetype.NAME or inner[1][0] == "string" else 0
                if length < 1 or elements > _MAX_ARRAYS:
                    raise ValueError(f"{kind} has a list of {length} elements, expected 1 to {_MAX_ARRAYS} in all")
    return {kind: ([], fields) for kind, (_, fields) in types.items()}


def _store(connection: Connection, of_map: Fields) -> Typestore:
    """A store with the types that the map defines, then those that the bag defines for a topic, then ours."""
    store, definition = get_typestore(Stores.EMPTY), connection.msgdef
    is_text = definition.format == MessageDefinitionFormat.MSG
    own = {**(parse_definition(connection.msgtype, definition.data) if is_text else {}), **of_map}
    store.max_sequence_length = type_store.MOST_ELEMENTS
    store.types |= type_store.STORE.types
    store.fielddefs |= {name: fields for name, fields in type_store.STORE.fielddefs.items() if name not in own}
    store.register(own)
    return store


@contextmanager
def _compiling(place: str, connection: Connection) -> Iterator[None]:
    """Raise ConfigurationError if a type is not defined, and SceneError for one that cannot be. place: of the bag"""
    where = f"{place}: {connection.topic}"
    try:
        yield
    except KeyError as error:
        expected = f"expected one under `types` of the map{nearest(str(error.args[0]), list(type_store.TYPES))}"
        raise ConfigurationError(f"{where}: the bag has no definition of {error}: {expected}") from None
    except Exception as error:  # of rosbags, and of definitions
        raise SceneError(f"{where}: {connection.msgtype!r:.120} cannot be read: {error!s:.200}") from None


def known_decoder(place: str, connection: Connection) -> Decode:
    """How to decode a type that is known. Raises SceneError if the bag has another version of it. place: of the bag"""
    name, expected = connection.msgtype, type_store.type_hash(connection.msgtype)
    with _compiling(place, connection):
        found = {connection.digest, _store(connection, {}).hash_rihs01(name)}
    if others := found - {"", expected}:
        raise SceneError(
            f"{place}: {connection.topic}: the bag has another version of {name}: found the hash "
            f"{', '.join(sorted(others)):.200}, expected {expected}; `fields` in the map reads any"
        )
    return partial(type_store.decode, name)


class OwnType:
    """A type that is read by its definition, with attributes for its fields.

    place: of the bag, for messages;  of_map: fields of types that the map defines, by name; they take precedence

    Raises ConfigurationError if a type is not defined, and SceneError for a definition that is none.
    """

    def __init__(self, place: str, connection: Connection, of_map: Fields) -> None:
        self._name = connection.msgtype
        with _compiling(place, connection):
            self._store = _store(connection, of_map)
            self._store.get_msgdef(self._name)

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
