"""Unpacks tar archives from anybody: within limits, and never outside a folder."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tarfile
import zlib
from pathlib import Path
from typing import IO, Any, cast

from mast_zenoh.errors import SceneError

#: Limit on the members of an archive, of any kind.
MAX_MEMBERS = 200_000

#: Limit on the unpacked size of an archive, its other files included, by its own size; beyond `max_bytes`. Above what
#: gzip can reach (1032), so it bounds xz and bzip2 alone.
_MAX_RATIO = 1100
#: Limit on the memory in which xz unpacks; its highest level takes 65 MB.
_MAX_XZ_MEMORY = 200_000_000

#: Limit on the header bytes of one member: a header may hold a path of any length, and is read into memory.
_MAX_HEADER = 64 << 10

_COMPRESSIONS: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_READ_ERRORS = (tarfile.TarError, EOFError, OSError, ValueError, ArithmeticError, lzma.LZMAError, zlib.error)


def unpack(path: Path, folder: Path, suffixes: tuple[str, ...], max_bytes: int) -> None:
    """Unpack the files of a tar archive whose names end in one of the suffixes.

    path:      the archive, plain or compressed by gzip, bzip2 or xz
    max_bytes: limit on the total size of the unpacked files

    Raises SceneError at the first file that exceeds a limit, leaves the folder, is a link or a device, or cannot be
    read. Earlier files have been unpacked by then.
    """
    total = 0
    try:
        with _decompressed(path) as content:
            bounded = _BoundedContent(content, path, max_bytes + _MAX_RATIO * path.stat().st_size)
            archive: Any = tarfile.open(fileobj=cast("IO[bytes]", bounded), mode="r:")  # noqa: SIM115 (it holds nothing)
            for count, member in enumerate(iter(archive.next, None), start=1):
                if count > MAX_MEMBERS:
                    raise SceneError(f"{path}: the archive exceeds the limit of {MAX_MEMBERS:,} files and folders")
                if member.name.endswith(suffixes) and not member.isdir():
                    if not member.isfile() or member.issparse():
                        is_link = member.islnk() or member.issym()
                        kind = f"a link to {member.linkname!r}" if is_link else "not a regular file"
                        expected = "expected plain files: pack with tar --dereference --hard-dereference"
                        raise SceneError(f"{path}: {member.name} is {kind}, {expected}")
                    total += member.size
                    if total > max_bytes:
                        raise SceneError(
                            f"{path}: too large: {_mb(total)} unpacked up to and including {member.name}, expected at "
                            f"most {_mb(max_bytes)}; if you trust the archive, raise the scene's max_unpacked_mb"
                        )
                    bounded.budget = member.size
                    archive.extract(member, folder, filter="data")
                archive.members.clear()  # they need memory
                archive.pax_headers.clear()
                bounded.budget = _MAX_HEADER
    except _READ_ERRORS as error:
        raise SceneError(f"{path}: cannot be unpacked: {error}") from error


def _decompressed(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(1 << 16)
    opener = next((opener for magic, opener in _COMPRESSIONS.items() if start.startswith(magic)), Path.open)
    if opener is lzma.open:
        lzma.LZMADecompressor(memlimit=_MAX_XZ_MEMORY).decompress(start, 1)
    return cast("IO[bytes]", opener(path, "rb"))


class _BoundedContent:
    """The file that tarfile reads; `budget` is the number of bytes it may still read.

    Seeking unpacks what is skipped, up to `end` bytes from the start.
    """

    def __init__(self, content: IO[bytes], path: Path, end: int) -> None:
        self._content, self._path, self._end = content, path, end
        self.budget = _MAX_HEADER
        self.tell = content.tell

    def read(self, size: int) -> bytes:
        self.budget -= size
        if self.budget < 0:
            raise SceneError(f"{self._path}: a header exceeds the limit of {_MAX_HEADER} bytes")
        return self._content.read(size)

    def seek(self, offset: int) -> int:
        if offset > self._end:
            raise SceneError(
                f"{self._path}: found {_mb(offset)} unpacked or more, files that are not needed included; "
                f"expected at most {_mb(self._end)}"
            )
        return self._content.seek(offset)


def _mb(size: int) -> str:
    return f"{size / 1e6:,.6g} MB"
