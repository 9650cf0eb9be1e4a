"""`mast report`: the report of a run, again, or of a run that is measured from its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import Against, Confirmed, allowed_code, check_reference, reference_folder, reporting
from mast_zenoh.cli.options import err as _err
from mast_zenoh.cli.options import out as _out
from mast_zenoh.errors import ConfigurationError


def report(
    run_folder: Annotated[Path, typer.Argument(help="The folder of a run.", autocompletion=completion.run_folders)],
    frame: Annotated[int | None, typer.Option(min=0, help="The frame that figures show.")] = None,
    against: Against = None,
    measure: Annotated[bool, typer.Option("--measure", help="Measure the run again, from its recording.")] = False,
    figures: Annotated[list[Path] | None, typer.Option(help="A Python file whose figures are added.")] = None,
    confirmed: Confirmed = False,
) -> None:
    """Write the report of a run again, compared with another run if one is named.

    A run without metrics is measured first, if it was recorded.
    """
    from mast_zenoh.launch import measurement
    from mast_zenoh.report import html, terminal

    check_reference(against)
    if missing := next((file for file in figures or () if not file.is_file()), None):
        raise ConfigurationError(f"no file {str(missing)!r}: --figures expects a Python file")
    allowed = allowed_code(*(figures or ()), confirmed=confirmed)
    if measure or measurement.can_fill_in(run_folder):
        for refused in measurement.measure(run_folder, allowed):
            _err.print(f"warning: {refused}", markup=False, highlight=False)
        _out.print(f"measured: {run_folder / measurement.METRICS}", markup=False, highlight=False)
    other = None if against is None else reference_folder(run_folder, against, allowed)
    with reporting(run_folder):
        if other is not None:
            terminal.show_run(_out, run_folder, other)
        _out.print(f"report: {html.write_report(run_folder, frame, other, figures or ())}", highlight=False)
    if warning := terminal.failure(run_folder):
        _err.print(f"warning: {warning}", style="bold yellow", markup=False, highlight=False)
