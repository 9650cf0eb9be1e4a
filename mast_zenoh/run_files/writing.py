"""Writes files of a run folder: whole or not at all, and never through a link."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mast_zenoh.errors import RunFolderError


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
