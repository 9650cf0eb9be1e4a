"""`mast list KIND`: what a scenario can name, with parameters, defaults and units."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Annotated

import typer

from mast_zenoh.cli import completion
from mast_zenoh.cli.options import out as _out

_WIDTH = 80
_HELP = (
    "attacks, trackers, fusion, defences, scenes, links, faults, metrics, messages, scenarios or studies. "
    "Default: all their names."
)


def list_kind(
    kind: Annotated[str | None, typer.Argument(help=_HELP, autocompletion=completion.kinds)] = None,
    name: Annotated[str | None, typer.Argument(help="One entry of this kind; shows only that entry.")] = None,
    file: Annotated[Path | None, typer.Option(help="Your own Python file: its definitions are listed too.")] = None,
) -> None:
    """List what a scenario can name, with parameters, defaults and units."""
    from mast_zenoh.api import catalogue  # every package of algorithms: commands that need none do not load them
    from mast_zenoh.config import loading

    if file is not None:
        loading.module(file)
    if kind is None:
        for each in catalogue.KINDS:
            names = ", ".join(catalogue.list_kind(each).names)
            lines = textwrap.wrap(f"{each}: {names}", _WIDTH, subsequent_indent="    ", break_on_hyphens=False)
            _out.print("\n".join(lines), markup=False, highlight=False)
        return
    listing = catalogue.list_kind(kind)
    _out.print(str(listing if name is None else listing[name]), markup=False, highlight=False)
