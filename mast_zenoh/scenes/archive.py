"""Unpacks tar archives within limits: no archive may fill the disk or the memory, or write outside its folder."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tarfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

from mast_zenoh.errors import SceneError

#: Members of an archive, of any kind.
MAX_MEMBERS = 200_000

#: Bytes of the headers of one member: a header may hold a path of any length, and is read into memory.
_MAX_HEADER = 64 << 10

_COMPRESSIONS: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_BROKEN = (tarfile.TarError, EOFError, OSError, ValueError, ArithmeticError, lzma.LZMAError, zlib.error)


def unpack(path: Path, folder: Path, suffixes: tuple[str, ...], max_bytes: int) -> None:
    """Unpack those files of a tar archive whose names have one of the suffixes; pass over the others.

    path:      the archive, plain or compressed by gzip, bzip2 or xz
    max_bytes: limit for all unpacked files together

    Raises SceneError at the first file that would exceed a limit or leave the folder, that is a link or a device, or
    that cannot be read. The files before it have been unpacked by then.
    """
    total = 0
    try:
        with _decompressed(path) as content:
            bounded = _Bounded(content, path)
            with tarfile.open(fileobj=cast("IO[bytes]", bounded), mode="r:") as archive:
                for member in _members(archive, bounded, path):
                    if not member.name.endswith(suffixes) or member.isdir():
                        continue
                    if not member.isfile() or member.issparse():
                        raise SceneError(f"{path}: {_special(member)}")
                    total += member.size
                    if total > max_bytes:
                        raise SceneError(
                            f"{path}: too large: {_mb(total)} unpacked up to and including {member.name}, expected at "
                            f"most {_mb(max_bytes)}; if you trust the archive, raise the scene's max_unpacked_mb"
                        )
                    bounded.left = member.size
                    archive.extract(member, folder, filter="data")
    except _BROKEN as error:
        raise SceneError(f"{path}: cannot be unpacked: {error}") from error


def _decompressed(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(8)
    for magic, opener in _COMPRESSIONS.items():
        if start.startswith(magic):
            return cast("IO[bytes]", opener(path, "rb"))
    return path.open("rb")


class _Bounded:
    """The file that tarfile reads; left: bytes that it may read before the limit is set anew. Seeking is free."""

    def __init__(self, content: IO[bytes], path: Path) -> None:
        self.left = _MAX_HEADER
        self._content = content
        self._path = path

    def read(self, size: int) -> bytes:
        self.left -= size
        if self.left < 0:
            raise SceneError(f"{self._path}: a header of more than {_MAX_HEADER} bytes, expected at most so many")
        return self._content.read(size)

    def seek(self, offset: int) -> int:
        return self._content.seek(offset)

    def tell(self) -> int:
        return self._content.tell()


def _members(archive: tarfile.TarFile, bounded: _Bounded, path: Path) -> Iterator[tarfile.TarInfo]:
    """The members one by one; none is kept."""
    count = 0
    bounded.left = _MAX_HEADER
    while (member := archive.next()) is not None:
        count += 1
        if count > MAX_MEMBERS:
            raise SceneError(f"{path}: more than {MAX_MEMBERS:,} files and folders, expected at most so many")
        yield member
        archive.members.clear()  # type: ignore[attr-defined]  # typeshed does not know it
        archive.pax_headers.clear()  # type: ignore[attr-defined]  # a dict
        bounded.left = _MAX_HEADER


def _special(member: tarfile.TarInfo) -> str:
    if member.islnk() or member.issym():
        kind = f"a link to {member.linkname!r}"
    else:
        kind = "a sparse file" if member.issparse() else "no file"
    return f"{member.name} is {kind}, expected plain files: pack with tar --dereference --hard-dereference"


def _mb(size: int) -> str:
    return f"{size / 1e6:,.6g} MB"
