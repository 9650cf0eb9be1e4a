"""`mast wiring SCENARIO`: the publishers and subscribers of every key."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterator
from typing import Annotated, Literal

import typer

from mast_zenoh.cli.options import Scenario, Settings
from mast_zenoh.cli.options import out as _out
from mast_zenoh.wiring.model import Wiring, to_mermaid, to_text

_CHAIN_COLUMN = 37  # of `to_text`: nodes are to the right of it
_LEG_INDENT = 10


def wiring(
    scenario_file: Scenario,
    settings: Settings = None,
    format: Annotated[Literal["text", "json", "mermaid"], typer.Option(help="How to print it.")] = "text",
) -> None:
    """Show the publishers and subscribers of every key, with rewrites marked."""
    from mast_zenoh import scenario

    path, loaded = scenario.load(scenario_file, settings or ())
    resolved = scenario.resolve(path, loaded, record=True)
    resolved_wiring = Wiring.from_json(resolved.wiring)
    if format == "json":
        text = json.dumps(resolved_wiring.to_json(), indent=2)
    elif format == "mermaid":
        text = to_mermaid(resolved_wiring)
    else:
        text = to_text(resolved_wiring)
        if _out.is_terminal:  # elsewhere each wire is one line, for other programs
            text = "\n".join(_wrapped(text, _out.width))
    sys.stdout.write(text + "\n")


def _wrapped(text: str, width: int) -> Iterator[str]:
    """The lines of `to_text` for a terminal, continued below the nodes."""
    for line in text.splitlines():
        indent = _LEG_INDENT if line.startswith("   ") else _CHAIN_COLUMN
        yield from textwrap.wrap(
            line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
        ) or [""]
