"""New files and folders that are complete, or not there at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from mast_zenoh.errors import DiskFull, ExportError, is_disk_full


def check_free(out: Path) -> None:
    """Raise ExportError unless something can be created at a path."""
    if out.exists() or out.is_symlink():
        raise ExportError(f"{out}: exists already: expected a new file or folder")
    if not out.absolute().parent.is_dir():
        raise ExportError(f"{out}: found no folder {str(out.absolute().parent)!r}, expected it to exist")


def write_new(out: Path, write: Callable[[Path], object]) -> tuple[Path, ...]:
    """Write a file or folder through a temporary folder next to it.

    write: gets a path of the same name there; it can write more files beside it, which are kept too

    Returns what is there now, in order of names. Raises ExportError if it cannot be written or something is
    in the way, DiskFull.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out.absolute().parent) as temporary:
            write(Path(temporary) / out.name)
            written = sorted(Path(temporary).iterdir())
            targets = tuple(out.with_name(path.name) for path in written)
            for target in targets:
                check_free(target)
            for path, target in zip(written, targets, strict=True):
                os.rename(path, target)
    except OSError as error:
        if is_disk_full(error):
            free = shutil.disk_usage(out.absolute().parent).free >> 20
            raise DiskFull(f"{out}: {error.strerror} ({free} MiB are free): nothing was written") from error
        raise ExportError(f"{out}: cannot be written: {error.strerror or error}") from error
    return targets
