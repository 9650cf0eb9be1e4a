"""Writes a finished run as files of other programs (docs/how-to-export.md)."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh.config import plugins
from mast_zenoh.errors import ExportError
from mast_zenoh.run_folder import check_free, write_new
from mast_zenoh.runs.recorded import open_recorded
from mast_zenoh.show.formats import FORMATS, Format, check


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


def _writer(form: Format) -> Any:
    """The function that writes a format.

    Raises ExportError if its packages are not installed, and PluginError if its plugin is not.
    """
    module, _, name = form.writer.rpartition(".")
    if form.plugin:
        return getattr(plugins.required(module, form.plugin), name)
    try:
        return getattr(importlib.import_module(f"mast_zenoh.show.export.{module}"), name)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if not form.extra or package == "mast_zenoh":
            raise
        raise ExportError(f"{package} is not installed: pip install 'mast-zenoh[{form.extra}]'") from None
