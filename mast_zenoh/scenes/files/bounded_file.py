"""Reads plain and gzip-compressed files in pieces, up to a limit on their unpacked size."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, cast

from mast_zenoh.errors import SceneError

#: Limit on the unpacked size of one file, bytes.
MAX_FILE_BYTES = 500_000_000
#: Limit on one line of a text file, bytes.
MAX_LINE = 100_000
_PIECE = 1 << 18
_GZIP = b"\x1f\x8b"


def read_pieces(path: Path, max_bytes: int = MAX_FILE_BYTES) -> Iterator[bytes]:
    """The content of a file, unpacked if it is compressed by gzip.

    Raises SceneError if it cannot be read, or as soon as it exceeds `max_bytes`.
    """
    total = 0
    try:
        with _opened(path) as file:
            while piece := file.read(_PIECE):
                total += len(piece)
                if total > max_bytes:
                    raise SceneError(f"{path}: found more than {max_bytes} bytes unpacked, expected at most as many")
                yield piece
    except (OSError, EOFError, zlib.error) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from error


def read_lines(path: Path, max_bytes: int = MAX_FILE_BYTES) -> Iterator[str]:
    """The lines of a text file in UTF-8, without their ends; compressed or not.

    Raises SceneError if it cannot be read, is too large, has a line that is too long, or is not UTF-8.
    """
    number, rest = 1, b""
    for piece in read_pieces(path, max_bytes):
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            yield _decoded(line, path, number)
            number += 1
        if len(rest) > MAX_LINE:
            _decoded(rest, path, number)
    if rest:
        yield _decoded(rest, path, number)


def _decoded(line: bytes, path: Path, number: int) -> str:
    if len(line) > MAX_LINE:
        raise SceneError(f"{path}: line {number}: found {len(line)} bytes, expected at most {MAX_LINE}")
    try:
        return line.rstrip(b"\r").decode("utf-8-sig" if number == 1 else "utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: line {number}: {error}") from error


def _opened(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        start = file.read(len(_GZIP))
    return cast("IO[bytes]", gzip.open(path, "rb")) if start == _GZIP else path.open("rb")
