"""Writes a finished run as files of other programs (docs/exports.md)."""

from __future__ import annotations

import importlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mast_zenoh.errors import DiskFull, ExportError, is_disk_full, nearest
from mast_zenoh.viewer.formats import FORMATS, Format
from mast_zenoh.viewer.frames import RunFrames


class Exported(NamedTuple):
    """The result of an export.

    paths:   the files and folders that were written
    missing: a sentence for everything that the run's record lacks, and therefore the export
    """

    paths: tuple[Path, ...]
    missing: tuple[str, ...]


def export(run: Path, to: str, out: Path) -> Exported:
    """Write the finished run in a folder in another format.

    run: its folder;  to: one of FORMATS;  out: a new file or folder, which is complete or not there at all

    Raises ExportError for an unknown format, a package that is not installed, or a file that is in the way;
    RunFolderError if the run cannot be read; DiskFull.
    """
    if to not in FORMATS:
        raise ExportError(f"unknown format {to!r}: expected one of {', '.join(FORMATS)}{nearest(to, FORMATS)}")
    _check_free(out)
    write = _writer(FORMATS[to])
    frames = RunFrames.load(run)
    try:
        with tempfile.TemporaryDirectory(prefix=".export-", dir=out.absolute().parent) as place:
            write(frames, Path(place) / out.name)
            written = sorted(Path(place).iterdir())
            targets = tuple(out.with_name(path.name) for path in written)
            for target in targets:
                _check_free(target)
            for path, target in zip(written, targets, strict=True):
                os.rename(path, target)
    except OSError as error:
        if is_disk_full(error):
            free = shutil.disk_usage(out.absolute().parent).free >> 20
            raise DiskFull(f"{out}: {error.strerror} ({free} MiB are free): nothing was written") from error
        raise ExportError(f"{out}: cannot be written: {error.strerror or error}") from error
    return Exported(targets, tuple(frames.missing))


def not_installed(error: ModuleNotFoundError, extra: str) -> Exception:
    """The error to raise where a module is missing: an ExportError if it belongs to optional packages."""
    package = (error.name or "").partition(".")[0]
    if not extra or package == "mast_zenoh":
        return error
    return ExportError(f"{package} is not installed: pip install 'mast-zenoh[{extra}]'")


def _check_free(target: Path) -> None:
    """Raise ExportError unless something can be created at a path."""
    if target.exists() or target.is_symlink():
        raise ExportError(f"{target}: exists already: expected a new file or folder")
    if not target.absolute().parent.is_dir():
        raise ExportError(f"{target}: found no folder {str(target.absolute().parent)!r}, expected it to exist")


def _writer(form: Format) -> Callable[[RunFrames, Path], None]:
    """The function that writes a format; raises ExportError if its packages are not installed."""
    module, _, name = form.writer.partition(".")
    try:
        writer: Callable[[RunFrames, Path], None] = getattr(
            importlib.import_module(f"mast_zenoh.viewer.export.{module}"), name
        )
    except ModuleNotFoundError as error:
        raise not_installed(error, form.extra) from None
    return writer
