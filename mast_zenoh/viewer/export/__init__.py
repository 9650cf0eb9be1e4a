"""Writes a finished run as files of other programs (docs/exports.md)."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mast_zenoh.errors import ExportError
from mast_zenoh.run_folder import check_free, write_new
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.runs.run import Run
from mast_zenoh.viewer.formats import FORMATS, Format, check


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

    Raises ExportError for an unknown format, a package that is not installed, a file that is in the way, or a run
    without messages for the format; RunFolderError if the run cannot be read; DiskFull.
    """
    check(to)
    check_free(out)
    write = _writer(FORMATS[to])
    recorded = open_recorded(run)
    written = write_new(out, lambda path: write(recorded, path))
    return Exported(written, tuple(recorded.files.missing))


def not_installed(error: ModuleNotFoundError, extra: str) -> Exception:
    """The error to raise where a module is missing: an ExportError if it belongs to optional packages."""
    package = (error.name or "").partition(".")[0]
    if not extra or package == "mast_zenoh":
        return error
    return ExportError(f"{package} is not installed: pip install 'mast-zenoh[{extra}]'")


def _writer(form: Format) -> Callable[[Run, Path], None]:
    """The function that writes a format; raises ExportError if its packages are not installed."""
    module, _, name = form.writer.partition(".")
    try:
        writer: Callable[[Run, Path], None] = getattr(
            importlib.import_module(f"mast_zenoh.viewer.export.{module}"), name
        )
    except ModuleNotFoundError as error:
        raise not_installed(error, form.extra) from None
    return writer
