"""`mast export`: a finished run as files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import out as _out
from mast_zenoh.run_files import reading
from mast_zenoh.viewer.formats import FormatName


def export(
    run_folder: Annotated[
        Path, typer.Argument(help="The folder of a finished run.", autocompletion=completion.run_folders)
    ],
    to: Annotated[FormatName, typer.Option(help="The format, see docs/exports.md.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PATH", help="The new file or folder.")],
) -> None:
    """Write a finished run in another format."""
    from mast_zenoh.viewer import export as formats

    with reading(run_folder):
        exported = formats.export(run_folder, to, out)
    for path in exported.paths:
        _out.print(f"exported: {path}", markup=False, highlight=False)
    for sentence in exported.missing:
        _err.print(f"warning: {sentence}", style="bold yellow", markup=False, highlight=False)
