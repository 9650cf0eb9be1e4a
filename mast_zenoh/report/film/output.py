"""A file that is complete, or not there at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mast_zenoh.errors import DiskFull, ExportError, is_disk_full


def kind_of(out: Path, kinds: Mapping[str, Any]) -> str:
    """The kind of a file by its name, one of `kinds`.

    Raises ExportError for another name, a file that exists already, or a folder that does not exist.
    """
    kind = out.suffix.lower().removeprefix(".")
    if kind not in kinds:
        names = [f".{name}" for name in kinds]
        raise ExportError(f"{out}: expected a name that ends with {', '.join(names[:-1])} or {names[-1]}")
    _check_free(out)
    if not out.absolute().parent.is_dir():
        raise ExportError(f"{out}: found no folder {str(out.absolute().parent)!r}, expected it to exist")
    return kind


def write_complete(out: Path, write: Callable[[Path], None]) -> None:
    """Write a file through a temporary one next to it.

    Raises ExportError if it cannot be written, DiskFull.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".film-", dir=out.absolute().parent) as place:
            unfinished = Path(place) / out.name
            write(unfinished)
            _check_free(out)
            os.rename(unfinished, out)
    except OSError as error:
        if is_disk_full(error):
            free = shutil.disk_usage(out.absolute().parent).free >> 20
            raise DiskFull(f"{out}: {error.strerror} ({free} MiB are free): nothing was written") from error
        raise ExportError(f"{out}: cannot be written: {error.strerror or error}") from error


def _check_free(out: Path) -> None:
    if out.exists() or out.is_symlink():
        raise ExportError(f"{out}: exists already: expected a new file")
