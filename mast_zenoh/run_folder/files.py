"""JSON and plain files of a run folder: read within bounds, and written whole or not at all, never through a link."""

from __future__ import annotations

import json
import math
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder.shapes import check_file

#: Limits of a JSON file. A run of a thousand agents needs a tenth of each; the largest content takes about 150 MB.
MAX_JSON_BYTES = 32 << 20
MAX_DEPTH = 64
MAX_CONTAINERS = 200_000
MAX_ITEMS = 2_000_000


def open_plain(path: Path) -> BinaryIO:
    """Open a plain file; raises RunFolderError for a link, a device, a pipe, a socket or a folder.

    A link may lead anywhere, and reading the others may never end. Raises FileNotFoundError if there is none.
    """
    try:
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC), "rb")
    except OSError:
        _check_plain(path, path.lstat().st_mode)
        raise
    try:
        _check_plain(path, os.fstat(file.fileno()).st_mode)
    except RunFolderError:
        file.close()
        raise
    return file


def check_plain(path: Path) -> Path:
    """Return the path of a plain file; raises as `open_plain` does. For readers that open files themselves."""
    open_plain(path).close()
    return path


def read_json(path: Path, *, shaped: bool = True) -> Any:
    """The content of a JSON file; that of run.json and of others in `shapes` has the types that they promise.

    shaped: whether these types are checked

    Raises RunFolderError for a file that is missing, is no plain file, is too large, or has another content.
    """
    try:
        content = parse_json(_json_bytes(path))
        if shaped:
            check_file(content, path.name)
    except FileNotFoundError:
        raise RunFolderError(f"{path}: missing; is {path.parent} a run folder?") from None
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RunFolderError(f"{path}: cannot be read: {error}") from None
    return content


def read_object(path: Path, *, shaped: bool = True) -> dict[str, Any]:
    """The object in a JSON file; raises RunFolderError as `read_json` does."""
    content = read_json(path, shaped=shaped)
    if not isinstance(content, dict):
        raise RunFolderError(f"{path}: cannot be read: found {type(content).__name__}, expected an object")
    return content


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Turn errors that only contents of a run folder explain into RunFolderError.

    `shapes` has what every run has; nodes of users add what they like.
    """
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        description = " ".join(f"{type(error).__name__}: {error}".split())
        raise RunFolderError(f"{folder}: its contents cannot be used: {description:.300}") from error


def parse_json(content: bytes | str) -> Any:
    """JSON of limited size and depth; raises ValueError for any other."""
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    if len(data) > MAX_JSON_BYTES:
        raise ValueError(f"found {len(data)} bytes of JSON, expected at most {MAX_JSON_BYTES}")
    if data.count(b"[") + data.count(b"{") > MAX_CONTAINERS or data.count(b",") > MAX_ITEMS:
        raise ValueError(f"expected JSON with at most {MAX_CONTAINERS} objects and lists, and {MAX_ITEMS} items")
    try:
        value = json.loads(data)
    except RecursionError:
        value = None
        depth = MAX_DEPTH + 1
    else:
        depth = _depth(value)
    if depth > MAX_DEPTH:
        raise ValueError(f"found JSON that is nested more than {MAX_DEPTH} levels deep")
    if b"\\u" in data:  # a lone surrogate cannot be written anywhere; bytes of paths that are not UTF-8 can
        json.dumps(value, ensure_ascii=False).encode("utf-8", "surrogateescape")
    return value


def _json_bytes(path: Path) -> bytes:
    """The content of a plain file, unless it is too large."""
    with open_plain(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_JSON_BYTES:
            raise ValueError(f"found {size} bytes of JSON, expected at most {MAX_JSON_BYTES}")
        return file.read(MAX_JSON_BYTES + 1)


def _check_plain(path: Path, mode: int) -> None:
    """Raise RunFolderError unless a mode is that of a plain file."""
    if not stat.S_ISREG(mode):
        found = "a link" if stat.S_ISLNK(mode) else "a folder" if stat.S_ISDIR(mode) else "a special file"
        raise RunFolderError(f"{path}: found {'a pipe' if stat.S_ISFIFO(mode) else found}, expected a file")


def _depth(value: Any) -> int:
    """How many objects and lists are inside each other, up to one more than MAX_DEPTH."""
    depth, level = 0, [value] if isinstance(value, (dict, list)) else []
    while level and depth <= MAX_DEPTH:
        depth += 1
        level = [
            item
            for each in level
            for item in (each.values() if isinstance(each, dict) else each)
            if isinstance(item, (dict, list))
        ]
    return depth


def subfolder(folder: Path, *names: str) -> Path:
    """A folder inside a run folder, created if needed; raises RunFolderError if one of its parts is a link."""
    for name in names:
        folder = folder / name
        with suppress(FileExistsError):
            folder.mkdir(parents=True)
        if folder.is_symlink() or not folder.is_dir():
            found = "a link" if folder.is_symlink() else "a file"
            raise RunFolderError(f"{folder}: found {found}, expected a folder: remove it")
    return folder


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file that takes the place of `path`, whole or not at all, at the end of the block.

    A link there is replaced, and never followed. Raises RunFolderError if a folder is in the way.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".new-", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, IsADirectoryError):
            raise RunFolderError(f"{path}: found a folder, expected a file: remove it") from None
        raise


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file of a run folder; see `replacing`."""
    with replacing(path) as new:
        new.write_bytes(content)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically: a reader sees the old file or the new one."""
    with replacing(path) as new, new.open("w", encoding="utf-8") as file:
        json.dump(content, file, indent=2, allow_nan=False)
        file.write("\n")


def json_or_empty(path: Path) -> dict[str, Any]:
    """Read the object in a JSON file; {} if that fails."""
    try:
        return read_object(path)
    except RunFolderError:
        return {}


def finite(value: Any) -> Any:
    """Plain JSON values: a number that is not finite becomes null, an array a list."""
    if hasattr(value, "dtype"):  # of NumPy, which is slow to load
        plain = value.tolist()
        return [str(item) for item in plain] if value.dtype.kind in "OU" and value.shape else finite(plain)
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
